"""The sample that features are chosen on: training rows with their places, in spatial folds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError
from fwclass.graph.areas import within
from fwclass.graph.thin import thins
from fwclass.grid import Box, Tile, millimetres
from fwclass.model import ClassDef
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Task
from fwclass.schema import Table, canonical_key
from fwclass.select.folds import Folds, check_folds, spatial_folds
from fwclass.select.params import SelectParams
from fwclass.store.arrays import write_arrays
from fwclass.study.keys import needs_of, plain, plain_classes
from fwclass.survey.layout import Layout
from fwclass.thin.sample import THIN
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample, check_counts
from fwclass.train.stage import TRAIN_SAMPLE, candidates, merge

SAMPLE, FOLDS = "sample", "folds"
PLACED, TRAINING = "select-sample", "select-training"
"""Stages: the rows of a tile with their places, and those of all tiles with their folds."""

_TABLE = dict.fromkeys(("strip", "pulse", "echo_number", "x", "y"), "tile")


@dataclass(frozen=True)
class PlacedSample:
    """A sample with the place of every row [m]; columns without information are named in `left_out`."""

    sample: Sample
    x: NDArray[np.float64]
    y: NDArray[np.float64]


def sample_tasks(layout: Layout, names: tuple[str, ...]) -> list[Task]:
    """`PLACED` of every tile that a training area touches, and `TRAINING`."""
    config = layout.config
    boxes = config.areas.boxes("train")
    train = config.train.model_copy(update={"samples_per_class": config.select.samples_per_class})
    columns = layout.columns((*names, *(THIN.writes if thins(config) else ())))
    drawn = {
        "seed": train.seed,
        "samples_per_class": train.samples_per_class,
        "classes": plain_classes(config),
        "features": list(names),
        "areas": [list(b.bounds) for b in boxes],
    }
    chosen = tuple(t.key for t in layout.tiles if any(t.box.touches(b) for b in boxes))
    tasks = []
    for tile in layout.tiles:
        if tile.key in chosen:
            work = partial(_place_rows, tile, columns, names, boxes, train, config.classes)
            needs = needs_of({**columns, "reference": "label"}, (tile.key,))
            tasks.append(Task(PLACED, tile.key, TRAIN_SAMPLE.version, drawn, work, needs=needs))
    folded = {n: plain(config.select)[n] for n in ("block", "gap", "folds")}
    work = partial(_fold_sample, chosen, names, train, config.select, config.classes)
    needs = tuple((PLACED, k) for k in chosen)
    return [*tasks, Task(TRAINING, "all", TRAIN_SAMPLE.version, {**drawn, **folded}, work, needs=needs)]


def _place_rows(
    tile: Tile,
    columns: Mapping[str, str],
    names: tuple[str, ...],
    boxes: tuple[Box, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The rows of a tile that may train, with their places."""
    table = inputs.rows(tile.key, {**_TABLE, **columns, "reference": "label"})
    inside = within(table, boxes)
    if "sampled" in table:  # a thinned run has features of sampled echoes only
        inside &= table["sampled"]
    sample = candidates(table.select(names), table["reference"], canonical_key(table), inside, params, classes)
    _save(directory, _with_places(sample, table))
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


def _fold_sample(
    tiles: tuple[str, ...],
    names: tuple[str, ...],
    train: TrainParams,
    params: SelectParams,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The survey's sample with its folds; refused where nothing can be chosen on it."""
    if not tiles:
        raise InputError(
            "no echo lies in any training area", where="areas.train", do="give boxes on the survey, in its coordinates"
        )
    parts = [_load(inputs, PLACED, t, names) for t in tiles]
    sample = merge((p.sample for p in parts), train)
    _check_classes(sample, classes)
    key = np.concatenate([p.sample.key for p in parts])
    order = np.argsort(key)
    rows = order[np.searchsorted(key[order], sample.key)]
    x, y = (np.concatenate([getattr(p, n) for p in parts])[rows] for n in ("x", "y"))
    folds = spatial_folds(x, y, sample.y, params.block, params.gap, params.folds)
    notes = check_folds(folds, sample.y, tuple(c.name for c in classes))
    _save(directory, PlacedSample(sample, x, y))
    write_arrays(directory / FOLDS, {"fold": folds.fold, "near": folds.near.astype(np.uint8)})
    return {
        "rows": sample.rows,
        "counts": sample.counts.tolist(),
        "eligible": sample.eligible.tolist(),
        "blocks": folds.blocks,
        "digest": sample.digest,
        "useless": useless(sample),
        "notes": list(notes),
        "by_fold": [
            np.bincount(sample.y[folds.judged(f)], minlength=len(classes)).tolist() for f in range(params.folds)
        ],
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
