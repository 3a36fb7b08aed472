"""The sample that features are chosen on: training rows with their places, in spatial folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError
from fwclass.graph.areas import IDENTITY_AND_PLACE, training_tiles, within
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.thin import sampled_columns
from fwclass.graph.training_rows import NOT_OF_THE_SAMPLE
from fwclass.grid import Box, millimetres
from fwclass.model import ClassDef
from fwclass.run.inputs import PartInputs
from fwclass.schema import Table, canonical_key
from fwclass.select.folds import Folds, check_folds, spatial_folds
from fwclass.store.arrays import write_arrays
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample, check_counts
from fwclass.train.stage import TRAIN_SAMPLE, candidates, merge

SAMPLE, FOLDS = "sample", "folds"
PLACED, TRAINING = "select-sample", "select-training"
"""Stages: the rows of a tile with their places, and those of all tiles with their folds."""


@dataclass(frozen=True)
class PlacedSample:
    """A sample with the place of every row [m]; columns without information are named in `left_out`."""

    sample: Sample
    x: NDArray[np.float64]
    y: NDArray[np.float64]


def place_rows(
    here: StageInputs,
    names: tuple[str, ...],
    areas: tuple[Box, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
) -> dict[str, Any]:
    """The rows of a tile that may train, with their places."""
    table = here.own_rows()
    inside = within(table, areas)
    if "sampled" in table:  # a thinned run has features of sampled echoes only
        inside &= table["sampled"]
    sample = candidates(table.select(names), table["reference"], canonical_key(table), inside, params, classes)
    _save(here.directory, _with_places(sample, table))
    return {"rows": sample.rows}


def _with_places(sample: Sample, table: Table) -> PlacedSample:
    key = canonical_key(table)
    order = np.argsort(key)
    rows = order[np.searchsorted(key[order], sample.key)]
    return PlacedSample(sample, table["x"][rows], table["y"][rows])


def _save(directory: Path, placed: PlacedSample) -> None:
    where = {"place_x": millimetres(placed.x), "place_y": millimetres(placed.y)}
    write_arrays(directory / SAMPLE, {**placed.sample.arrays(), **where})


def _load(inputs: PartInputs, stage: str, part: str, names: Sequence[str]) -> PlacedSample:
    arrays, _ = inputs.arrays(stage, part, SAMPLE)
    return PlacedSample(Sample.from_arrays(names, arrays), arrays["place_x"] * 0.001, arrays["place_y"] * 0.001)


def fold_sample(
    here: StageInputs,
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    block: float,
    gap: float,
    folds: int,
) -> dict[str, Any]:
    """The survey's sample with its folds; refused where nothing can be chosen on it."""
    tiles = here.parts(PLACED)
    if not tiles:
        raise InputError(
            "no echo lies in any training area", where="areas.train", do="give boxes on the survey, in its coordinates"
        )
    parts = [_load(here.inputs, PLACED, t, names) for t in tiles]
    sample = merge((p.sample for p in parts), params)
    _check_classes(sample, classes)
    key = np.concatenate([p.sample.key for p in parts])
    order = np.argsort(key)
    rows = order[np.searchsorted(key[order], sample.key)]
    x, y = (np.concatenate([getattr(p, n) for p in parts])[rows] for n in ("x", "y"))
    split = spatial_folds(x, y, sample.y, block, gap, folds)
    notes = check_folds(split, sample.y, tuple(c.name for c in classes))
    _save(here.directory, PlacedSample(sample, x, y))
    write_arrays(here.directory / FOLDS, {"fold": split.fold, "near": split.near.astype(np.uint8)})
    return {
        "rows": sample.rows,
        "counts": sample.counts.tolist(),
        "eligible": sample.eligible.tolist(),
        "blocks": split.blocks,
        "digest": sample.digest,
        "useless": useless(sample),
        "notes": list(notes),
        "by_fold": [np.bincount(sample.y[split.judged(f)], minlength=len(classes)).tolist() for f in range(folds)],
    }


def _check_classes(sample: Sample, classes: tuple[ClassDef, ...]) -> None:
    if sample.rows == 0:
        raise InputError(
            "no labelled echo of the training areas has a value of any candidate",
            where="--candidates, areas.train",
            got=", ".join(sample.features[:5]),
            do="name other candidates, or label something in the training areas",
        )
    check_counts({c.name: n for c, n in zip(classes, sample.counts.tolist(), strict=True)})


def useless(sample: Sample) -> dict[str, str]:
    """Columns that cannot tell anything apart, and why: no value in any row, or the same in all."""
    reasons = {}
    for k, name in enumerate(sample.features):
        known = sample.X[:, k][~np.isnan(sample.X[:, k])]
        if len(known) == 0:
            reasons[name] = "no value in any training row"
        elif known.min() == known.max() and len(known) == sample.rows:
            reasons[name] = f"{known[0]:g} in every training row"
    return reasons


_loaded: dict[tuple[str, str], tuple[PlacedSample, Folds]] = {}


def training_of(inputs: PartInputs, names: tuple[str, ...]) -> tuple[PlacedSample, Folds]:
    """The sample and its folds, kept in this process as long as they are the same."""
    key = (str(inputs.path(TRAINING, "all", FOLDS)), inputs.digest(TRAINING, "all"))
    if key not in _loaded:
        _loaded.clear()
        arrays, _ = inputs.arrays(TRAINING, "all", FOLDS)
        folds = Folds(arrays["fold"], arrays["near"].astype(bool), int(inputs.meta(TRAINING, "all")["blocks"]))
        _loaded[key] = _load(inputs, TRAINING, "all", names), folds
    return _loaded[key]


def require_own_labels(config: Config) -> None:
    """`ConfigError` where the survey names a base model: what is compared or chosen here learns from labels alone."""
    if config.survey.base_model is not None:
        raise ConfigError(
            "classifiers and features are compared on the survey's own labels, and the survey names a base model",
            where=f"{config.path}: survey.base_model",
            got=config.survey.base_model,
            do="--set survey.base_model=null, with survey.classes and survey.features",
        )


def folding(plan: Plan) -> dict[str, Any]:
    """How the squares of the training areas are folded."""
    select = plan.config.select
    return {"block": select.block, "gap": select.gap, "folds": select.folds}


def selection_rows(config: Config) -> int:
    """Rows of the sample that features are chosen on, at most."""
    rows: int = config.select.samples_per_class * len(config.survey.classes)
    return rows


def _arguments(plan: Plan) -> dict[str, Any]:
    config = plan.config
    train = config.train.model_copy(update={"samples_per_class": config.select.samples_per_class})
    return {"names": plan.names, "params": train, "classes": config.classes}


PLACE_ROWS = Stage(
    PLACED,
    TRAIN_SAMPLE.version,
    "tile",
    "echo",
    place_rows,
    parts=training_tiles,
    arguments=lambda plan: {**_arguments(plan), "areas": plan.config.areas.boxes("train")},
    silent=NOT_OF_THE_SAMPLE,
    own=lambda plan: (*IDENTITY_AND_PLACE, *plan.names, *sampled_columns(plan), "reference"),
)
FOLD_SAMPLE = Stage(
    TRAINING,
    TRAIN_SAMPLE.version,
    "survey",
    "row",
    fold_sample,
    load=lambda plan: selection_rows(plan.config),
    arguments=lambda plan: {**_arguments(plan), **folding(plan)},
    silent=NOT_OF_THE_SAMPLE,
    after=(PLACED,),
    needs=lambda plan, part: [(PLACED, t.key) for t in training_tiles(plan)],
)
"""The plan's names are the candidates."""
