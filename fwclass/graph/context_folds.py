"""The stages of first layers by folds: what they say of the training areas, whose echoes they have not learned from.

In the training areas a first layer knows the echoes too well. So there the shares that the second layer learns from are
those of a model that has not learned from the echo's square; where it decides they are those of the whole first layer.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.context import whole_shares
from fwclass.classify.stage import CLASSIFY
from fwclass.errors import InputError
from fwclass.graph.areas import training_tiles
from fwclass.graph.context_layer import ContextLayer, context_layer, layer_of, tries
from fwclass.graph.learn import TRAIN_COARSE, fit_layer
from fwclass.graph.loaded_models import MODEL, model_at, used_model
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.training_rows import (
    BASE_ROWS,
    base_rows_part,
    learning_arguments,
    sample_rows,
    survey_sample,
    trains,
    with_base_rows,
)
from fwclass.grid import Tile, millimetres, whole_millimetres
from fwclass.model import ClassDef, sample_matrix
from fwclass.schema import Table
from fwclass.select.folds import Folds, spatial_folds
from fwclass.store.models import save_model
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.stage import VERSION as BASELINE_VERSION
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import TRAIN

FOLDS, FOLD_SHARES = "fold-models", "fold-shares"
FOLD_SHARE = "fold_share"
LEAST_SQUARE = 2.0
"""m, squares of the folds are halved down to this where training areas are small."""
_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
"""A cell and the eight around it."""

_kept: dict[tuple[Any, ...], tuple[Folds, float]] = {}


def squares_of(sample: Sample, block: float, gap: float, folds: int, alone: bool = False) -> tuple[Folds, float]:
    """Folds of a sample's rows by squares of `block` [m], or of a half, a quarter … down to `LEAST_SQUARE` where there
    are too few, and at last by fewer folds; and the edge [m] that it was. `InputError` for a single square, or
    where the first layer may stand `alone`, one fold that nothing trains for."""
    x, y = sample.place[:, 0].astype(np.float64) * 0.001, sample.place[:, 1].astype(np.float64) * 0.001
    edges = [block]
    while edges[-1] / 2 >= LEAST_SQUARE:
        edges.append(round(edges[-1] / 2, 3))
    for edge, count in (*((e, folds) for e in edges), *((edges[-1], n) for n in range(folds - 1, 1, -1))):
        with suppress(InputError):
            return spatial_folds(x, y, sample.y, edge, min(gap, edge / 4), count), edge
    if alone:
        return Folds(np.zeros(sample.rows, np.int16), np.ones((1, sample.rows), bool), 1), edges[-1]
    raise InputError(
        "the training areas are too small to learn the context of an echo",
        where="classify.context, areas.train",
        expected=f"labelled echoes in at least two squares of {edges[-1]:g} m",
        got="one",
        do="larger training areas, or no such layer: --set classify.context.cells=[]",
    )


def _survey_squares(
    here: StageInputs, sample: Sample, block: float, gap: float, folds: int, alone: bool
) -> tuple[Folds, float]:
    """`squares_of` the survey's sample, which a process keeps: the parts of all tiles ask for them in turn."""
    key = (here.inputs.digest("training", "all"), block, gap, folds, alone)
    if key not in _kept:
        _kept.clear()
        _kept[key] = squares_of(sample, block, gap, folds, alone)
    return _kept[key]


def train_fold(
    here: StageInputs,
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    compare: CompareParams,
    block: float,
    gap: float,
    folds: int,
    alone: bool = False,
) -> Result:
    """A first layer that has not learned from the squares of a fold."""
    sample = survey_sample(here.inputs, names)
    division, _ = _survey_squares(here, sample, block, gap, folds, alone)
    rest = rest_of_fold(here, sample, division)
    if rest is not None:
        save_model(here.directory / MODEL, fit_layer(rest, params, compare, classes, block, gap, on_trial=True))
    return {"rows": 0 if rest is None else rest.rows, "model": rest is not None}


def rest_of_fold(here: StageInputs, sample: Sample, division: Folds) -> Sample | None:
    """The rows that train for the fold that the part is named after; None where a class has none, or there are fewer
    folds."""
    fold = int(here.part)
    if fold >= len(division.near):
        return None
    rest = with_base_rows(here, sample.take(division.trains(fold)))
    return rest if (rest.counts > 0).all() else None


def share_folds(
    here: StageInputs,
    names: tuple[str, ...],
    layer: ContextLayer,
    block: float,
    gap: float,
    folds: int,
    alone: bool = False,
) -> Result:
    """Shares of a tile's echoes by the first layer that has not learned from their square, or the whole one where
    nothing of it was learned, or a class stands in one fold alone; 0 of echoes that no row of the sample reaches."""
    sample = survey_sample(here.inputs, names)
    division, edge = _survey_squares(here, sample, block, gap, folds, alone)
    mm = whole_millimetres(edge, "select.block")
    squares, at = _squares_with_rows(sample.place, mm)
    fold_of = division.fold[at]
    halo = whole_millimetres(layer.halo, "classify.context.cells")
    reached = _squares_around(sample.place, halo)
    models = {
        k: model_at(here.inputs.path(FOLDS, str(k), MODEL), here.inputs.digest(FOLDS, str(k)), False, folds)
        for k in range(folds)
        if here.inputs.meta(FOLDS, str(k))["model"]
    }
    whole = used_model(here, None, TRAIN_COARSE, folds)
    tables = []
    for rows in here.cuts():
        X = sample_matrix(rows, names, here.part)
        x, y = millimetres(rows["x"]), millimetres(rows["y"])
        fold = _folds_at(x // mm, y // mm, squares, fold_of)
        near = _folds_at(x // halo, y // halo, reached, np.zeros(len(reached), np.int64)) == 0
        shares = np.zeros((rows.rows, len(layer.codes)), np.uint8)
        for k in np.unique(fold[near]):
            mine = near & (fold == k)
            shares[mine] = whole_shares(X[mine], models.get(int(k), whole))
        tables.append(Table(dict(zip(layer.columns(FOLD_SHARE), shares.T, strict=True))))
    return tables[0] if len(tables) == 1 else Table.concat(tables)


def _squares_with_rows(place: NDArray[np.int64], edge: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """int64 (squares, 2), in order: the squares of `edge` [mm] that hold places (rows, 2); int64 (squares,): the first
    row of each."""
    square = place // edge
    low, high = square.min(axis=0), square.max(axis=0)
    _, at = np.unique((square[:, 0] - low[0]) * (high[1] - low[1] + 1) + square[:, 1] - low[1], return_index=True)
    return square[at], at


def _squares_around(place: NDArray[np.int64], edge: int) -> NDArray[np.int64]:
    """int64 (squares, 2), in order: those, and those beside them: all that lies within `edge` [mm] of a place."""
    squares, _ = _squares_with_rows(place, edge)
    return _squares_with_rows((squares[:, None] + _AROUND).reshape(-1, 2) * edge, edge)[0]


def _folds_at(x: NDArray, y: NDArray, squares: NDArray, fold_of: NDArray) -> NDArray[np.int64]:
    """int64 (rows,): the fold of the square (x, y) of every row; -1 for one that is none of `squares` (n, 2)."""
    width = int(squares[:, 1].max() - squares[:, 1].min()) + 1
    low = squares.min(axis=0)
    numbers = (squares[:, 0] - low[0]) * width + squares[:, 1] - low[1]  # rises, as `squares` are in order
    inside = (y >= low[1]) & (y < low[1] + width)
    asked = (x - low[0]) * width + y - low[1]
    place = np.minimum(np.searchsorted(numbers, asked), len(numbers) - 1)
    return np.where(inside & (numbers[place] == asked), fold_of[place], -1).astype(np.int64)


def learns_context(plan: Plan) -> bool:
    return trains(plan) and context_layer(plan) is not None


def folds_of(plan: Plan) -> list[str]:
    return [str(k) for k in range(plan.config.classify.context.folds)]


def _tiles_around(plan: Plan) -> list[Tile]:
    """Training tiles, and those that their context reaches into."""
    halo, layout = layer_of(plan).halo, plan.layout
    keys = {key for tile in training_tiles(plan) for key in layout.around(tile.box.grown(halo), layout.keys)}
    return [tile for tile in layout.tiles if tile.key in keys]


def _squares(plan: Plan) -> Mapping[str, Any]:
    return {
        "block": plan.config.select.block,
        "gap": plan.config.select.gap,
        "folds": plan.config.classify.context.folds,
        **({"alone": True} if tries(plan) else {}),
    }


def fitting(plan: Plan) -> Mapping[str, Any]:
    """Arguments of the stages that fit a layer."""
    return {**learning_arguments(plan), "compare": plan.config.compare, **_squares(plan)}


def fitting_folds(plan: Plan) -> Mapping[str, Any]:
    """Likewise, of those that fit a layer by fold."""
    params = plan.config.train
    fewer = params.model_copy(update={"trees": min(params.trees, plan.config.classify.context.trees)})
    return {**fitting(plan), "params": fewer}


OF_LAYERS = 1000 * BASELINE_VERSION + TRAIN.version


def rows_of_trees(plan: Plan) -> float:
    """Rows times the trees of a fold's forest."""
    return sample_rows(plan.config) * min(plan.config.train.trees, plan.config.classify.context.trees)


TRAIN_FOLDS = Stage(
    FOLDS,
    1_000_000 + OF_LAYERS,  # forests of folds tell nothing of themselves
    "survey",
    "tree_row",
    train_fold,
    when=learns_context,
    parts=folds_of,
    load=rows_of_trees,
    arguments=fitting_folds,
    silent=frozenset({"importance_repeats", "base_rows"}),
    after=("training", BASE_ROWS),
    needs=lambda plan, part: (("training", "all"), *base_rows_part(plan)),
)
SHARE_FOLDS = Stage(
    FOLD_SHARES,
    1_000_000 + CLASSIFY.version,  # 0 where no row reaches
    "tile",
    "echo",
    share_folds,
    when=learns_context,
    parts=_tiles_around,
    arguments=lambda plan: {"names": plan.names, "layer": layer_of(plan), **_squares(plan)},
    own=lambda plan: ("x", "y", *plan.names),
    writes=lambda plan: layer_of(plan).columns(FOLD_SHARE),
    after=("training", FOLDS, TRAIN_COARSE),
    needs=lambda plan, part: (("training", "all"), (TRAIN_COARSE, "model"), *((FOLDS, k) for k in folds_of(plan))),
    row_digests=True,
)
