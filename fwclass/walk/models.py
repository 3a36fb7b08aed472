"""The models that a configuration names: the one that is given, and the one whose rows are learned from too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fwclass.classes import counterparts, one_to_one
from fwclass.conf import Config
from fwclass.conf.checks import refuse_regularized
from fwclass.conf.sections import ClassSection
from fwclass.errors import ConfigError
from fwclass.graph.model_fit import check_computed, check_model
from fwclass.model import Contextual, Layered, Model, TwoLayer
from fwclass.store.installed_models import model_location
from fwclass.store.model_rows import load_same_rows, rows_digest
from fwclass.store.models import load_model, load_same, model_digest
from fwclass.store.remote_file import Location, directory_outside, local
from fwclass.store.url import is_url, url_of


def _location_of_model(config: Config, name: str) -> Location:
    if is_url(name):
        return directory_outside(url_of(name, f"{config.path}: survey.model"), config.store)
    return model_location(name, config.path.parent).resolve()


def with_model(config: Config) -> Config:
    """`config` with the classes of the model that it names, where it names none itself, and the features of the base
    model that it names, and the context that its rows have."""
    survey = config.survey
    named = survey.model or survey.base_model
    if named is None or (survey.classes and survey.base_model is None):
        return config
    path = local(_location_of_model(config, named))
    model = load_model(path)
    update: dict[str, Any] = {}
    if not survey.classes:
        update["classes"] = tuple(
            ClassSection(name=c.name, code=c.code, codes=c.codes, legacy_code=c.legacy_code) for c in model.classes
        )
    if survey.base_model is None:
        return replace(config, survey=survey.model_copy(update=update))
    return _with_context(
        replace(config, survey=survey.model_copy(update={**update, "features": model.features})), model
    )


def _with_context(config: Config, base: Model) -> Config:
    """`config` with the context of a base model's rows, where it may have one and leaves its cells open."""
    one_layer = config.classify.refine.between or config.thin.rate < 1.0 or config.train.method != "forest"
    open_ = config.classify.context.cells in (None, "auto")
    if not open_ or not isinstance(base, Contextual) or one_layer or not one_to_one(base.classes, config.classes):
        return config
    context = config.classify.context.model_copy(update={"cells": base.cells})
    return replace(config, classify=config.classify.model_copy(update={"context": context}))


def given_model(config: Config) -> tuple[Location, str] | None:
    """Place and digest of the model that the configuration names, None where it is to be trained."""
    if config.survey.model is None:
        return None
    location = _location_of_model(config, config.survey.model)
    path = local(location)
    digest = model_digest(path)
    model = load_same(path, digest)
    check_model(model, config, path)
    cells = config.classify.context.cells
    if cells and cells != "auto" and (not isinstance(model, Contextual) or model.cells != cells):
        has = f"cells of {list(model.cells)} m" if isinstance(model, Contextual) else "no layer that decides in context"
        raise ConfigError(
            "the model decides whether it has a layer that decides in context",
            where=f"{config.path}: classify.context.cells",
            expected=f"[], or what the model has: {has}",
            got=list(cells),
            do="--set classify.context.cells=[], or give it as survey.base_model, or train a model",
        )
    if isinstance(model, Layered):
        if isinstance(model, TwoLayer):
            check_computed(model.fine, config.features, path)
            if config.classify.regularize.strength > 0:
                refuse_regularized(path)
        if config.thin.rate < 1.0:
            raise ConfigError(
                "a thinned run has no second layer, and the model has one",
                where=path,
                got=f"thin.rate {config.thin.rate:g}",
                do="--set thin.rate=1, or give its first layer alone: the model's directory `coarse`",
            )
    return location, digest


def base_model(config: Config) -> tuple[Location, str] | None:
    """Place and digest of the model whose rows are learned from too, None without one."""
    if config.survey.base_model is None:
        return None
    location = _location_of_model(config, config.survey.base_model)
    path = local(location)
    digest = rows_digest(path)
    model, _ = load_same_rows(path, digest)
    check_computed(model, config.features, path)
    if not (counterparts(model.classes, config.classes) >= 0).any():
        raise ConfigError(
            "the base model knows none of the survey's classes",
            where=f"{config.path}: survey.classes",
            expected="codes of " + ", ".join(f"{c.name} ({c.code})" for c in model.classes),
            got=", ".join(f"{c.name} ({c.code})" for c in config.classes),
            do="give the classes its codes, or leave survey.classes out",
        )
    return location, digest
