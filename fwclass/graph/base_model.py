"""What a run has of the base model that it learns further: whose rows mean which of its classes, and in words."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from fwclass.classes import SEVERAL, ClassDef, counterparts, one_to_one
from fwclass.graph.context_layer import ContextLayer, context_layer
from fwclass.graph.stage import Plan
from fwclass.model import Contextual, Model
from fwclass.store.model_rows import ROWS
from fwclass.store.models import load_model
from fwclass.store.remote_file import local


@lru_cache(maxsize=2)
def _load(path: str, digest: str) -> Model:
    return load_model(Path(path))


def base_of(plan: Plan) -> Model | None:
    """The base model of a run, None without one."""
    return _load(str(local(plan.base[0])), plan.base[1]) if plan.base is not None else None


def base_layer(model: Model, classes: Sequence[ClassDef], layer: ContextLayer | None) -> ContextLayer | None:
    """The layer whose context the base model's rows have, with its codes in the order of `classes`; None where it is
    not the run's `layer`: other cells, or classes that do not mean its own one by one."""
    if layer is None or not isinstance(model, Contextual) or not one_to_one(model.classes, classes):
        return None
    means = counterparts(model.classes, classes).tolist()
    theirs = ContextLayer(tuple(model.classes[means.index(k)].code for k in range(len(classes))), model.cells)
    return theirs if theirs.cells == layer.cells else None


def base_has_context(plan: Plan) -> bool:
    """Whether the rows of the base model have the context that the run's second layer decides by."""
    model = base_of(plan)
    return model is not None and base_layer(model, plan.config.classes, context_layer(plan)) is not None


def classes_of_base(plan: Plan) -> frozenset[int]:
    """Codes of the run's classes that the base model has rows of."""
    model, classes = base_of(plan), plan.config.classes
    if model is None:
        return frozenset()
    means = counterparts(model.classes, classes)
    kept = [one.code for one in model.classes]
    return frozenset(
        classes[k].code for k, code in zip(means, kept, strict=True) if k >= 0 and model.card[ROWS].get(str(code))
    )


def base_remarks(plan: Plan) -> list[str]:
    """What is to be said of a base model whose classes are not the run's own, name by name and code by code."""
    model, ours = base_of(plan), plan.config.classes
    if model is None:
        return []
    means = counterparts(model.classes, ours).tolist()
    meant = [(one, ours[k]) for one, k in zip(model.classes, means, strict=True) if k >= 0]
    several = [one for one, k in zip(model.classes, means, strict=True) if k == SEVERAL]
    unknown = [one for one, k in zip(model.classes, means, strict=True) if k == -1]
    sentences = []
    if any(one.code != own.code or one.name.lower() != own.name.lower() for one, own in meant):
        listed = ", ".join(f"{_named(one)} as {_named(own)}" for one, own in meant)
        sentences.append(f"the base model's rows are learned by the codes that they count: {listed}")
    for one in several:
        sentences.append(
            f"the base model's {_named(one)} is several classes here (it counts the codes "
            f"{', '.join(map(str, one.codes))}): none of its rows is learned from"
        )
    if unknown:
        sentences.append(f"the base model's {', '.join(map(_named, unknown))} is no class here: its rows are left out")
    without = [own for own in ours if own.code not in classes_of_base(plan)]
    if without:
        sentences.append(
            f"the base model has no rows of {', '.join(map(_named, without))}: learned from this survey's labels alone"
        )
    layer, others = context_layer(plan), not one_to_one(model.classes, ours)
    if isinstance(model, Contextual) and (others if layer is None else not base_has_context(plan)):
        alone = "does without" if layer is None else "learns its second layer from this survey's labels alone"
        why = "classes are others" if others else "cells are others"
        sentences.append(f"the base model decides in context, but its {why}: this run {alone}")
    return sentences


def _named(one: ClassDef) -> str:
    return f"{one.name} ({one.code})"
