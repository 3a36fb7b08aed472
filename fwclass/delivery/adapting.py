"""`fwclass adapt`: a ready model learns further from a run that has its features."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from fwclass.delivery.explain import tile_features
from fwclass.delivery.opened import Delivery, open_run
from fwclass.errors import InputError
from fwclass.model import Layered, Model, sample_matrix
from fwclass.run.inputs import PartInputs
from fwclass.schema import IDENTITY, canonical_key
from fwclass.single_file.model_directory import check_target, write_model
from fwclass.store.installed_models import model_location
from fwclass.store.model_rows import load_rows
from fwclass.store.run_location import RunLocation
from fwclass.store.run_store import Store
from fwclass.study.adapted import SeenEchoes, adapt, describe, draw_seen
from fwclass.train.params import AdaptParams, TrainParams
from fwclass.train.sample import kept_sample


def adapt_model(
    run: RunLocation, named: Path, target: Path, params: AdaptParams, training: TrainParams, overwrite: bool
) -> str:
    """Write the model that `named`, with the rows that it keeps, becomes on the echoes of a run; a sentence of it.

    `InputError`: `run` is no run that has delivered, has not the features of the model, or has too many echoes of which
    the model is unsure; the model keeps no rows. `ConfigError`: there is something at `target`.
    """
    check_target(target, overwrite)
    delivery = open_run(run)
    model, rows = load_rows(model_location(named))
    first = model.coarse if isinstance(model, Layered) else model
    if tuple(delivery.report["model"]["features"]) != tuple(first.features):
        raise InputError(
            "the run was not classified by the features of this model",
            where=delivery.path,
            expected=f"{len(first.features)} features, those of {named}",
            got=f"{len(delivery.report['model']['features'])}",
            do=f"run the survey with --set survey.model={named} first",
        )
    base = kept_sample(first.features, rows.X, rows.codes, first.classes, first.classes, training.seed)
    seen = draw_seen(_echoes(delivery, first), params.pool, training.seed)
    adapted = adapt(model, base, seen, params, training)
    write_model(adapted, target, overwrite, rows)
    return f"{describe(dict(adapted.card))}\nmodel       {target}"


def _echoes(delivery: Delivery, model: Model) -> Iterator[SeenEchoes]:
    """The model's features of every tile."""
    store = Store(delivery.root, read_only=True)
    inputs = PartInputs(store)
    for tile in (str(t["tile"]) for t in delivery.tiles):
        table = tile_features(store, inputs, tile, (*IDENTITY, *model.features), delivery.table)
        yield SeenEchoes(canonical_key(table), sample_matrix(table, model.features, tile))
