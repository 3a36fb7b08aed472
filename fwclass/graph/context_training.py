"""The stages of a layer that decides in context, as it is learned: first layers by folds, what they say of the training
areas, what the second layer learns from, whether it pays, and what its classes weigh.

In the training areas a first layer knows the echoes too well. So there the shares that the second layer learns from are
those of a model that has not learned from the echo's square; where it decides they are those of the whole first layer.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.context import CONTEXT, context_from, context_of, whole_shares, with_context
from fwclass.classify.shares import answer
from fwclass.classify.stage import CLASSIFY
from fwclass.errors import InputError
from fwclass.graph.areas import training_tiles
from fwclass.graph.context_layer import ContextLayer, context_layer, layer_of, tries
from fwclass.graph.context_trial import Answers, LayerTrial, Verdict, Weighing, verdict, weighing
from fwclass.graph.learn import TRAIN_COARSE, fit_layer, parameters_of, with_feature_parameters
from fwclass.graph.loaded_models import MODEL, model_at, used_model
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.training_rows import (
    BASE_ROWS,
    NOT_OF_THE_SAMPLE,
    SAMPLE,
    base_rows_part,
    learning_arguments,
    load_sample,
    rows_of,
    survey_sample,
    trains,
    with_base_rows,
)
from fwclass.grid import Tile, millimetres, whole_millimetres
from fwclass.model import ClassDef, Contextual, sample_matrix
from fwclass.run.inputs import PartInputs
from fwclass.schema import IDENTITY, PLACE, Table, canonical_key
from fwclass.select.folds import Folds, spatial_folds
from fwclass.store.arrays import write_arrays
from fwclass.store.models import load_forest, load_model, save_model
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.stage import VERSION as BASELINE_VERSION
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import TRAIN, TRAIN_SAMPLE, merge

FOLDS, FOLD_SHARES = "fold-models", "fold-shares"
DRAWN, MERGED, TRIED = "context-sample", "context-training", "context-folds"
FOLD_SHARE = "fold_share"
SQUARES, ANSWERS, NEAR = "squares", "answers", "context"
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
    rest = _rest(here, sample, division)
    if rest is not None:
        save_model(here.directory / MODEL, fit_layer(rest, params, compare, classes, block, gap, on_trial=True))
    return {"rows": 0 if rest is None else rest.rows, "model": rest is not None}


def _rest(here: StageInputs, sample: Sample, division: Folds) -> Sample | None:
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
    known = (squares[:, 0] - low[0]) * width + squares[:, 1] - low[1]  # rises, as `squares` are in order
    inside = (y >= low[1]) & (y < low[1] + width)
    asked = (x - low[0]) * width + y - low[1]
    place = np.minimum(np.searchsorted(known, asked), len(known) - 1)
    return np.where(inside & (known[place] == asked), fold_of[place], -1).astype(np.int64)


def draw_context_tile(here: StageInputs, layer: ContextLayer) -> Result:
    """The context of the rows of a tile that train."""
    drawn = load_sample(here.inputs, TRAIN_SAMPLE.name, here.part, ())
    more = np.empty((drawn.rows, len(layer.names)), np.uint8)
    chosen = rows_of(drawn.key, canonical_key(here.own_rows()))
    for these, chunk in here.chunks():
        mine = np.flatnonzero(np.isin(chosen, these))
        core = chunk.core[np.searchsorted(these, chosen[mine])]
        more[mine] = context_of(chunk.table, core, layer.columns(FOLD_SHARE), layer.cells)
    write_arrays(here.directory / SAMPLE, {NEAR: more})
    return {"rows": drawn.rows}


def merge_context_samples(here: StageInputs, params: TrainParams, layer: ContextLayer) -> Result:
    """The context of the rows of the survey's sample, in their order."""
    drawn = ((t, load_sample(here.inputs, TRAIN_SAMPLE.name, t, ())) for t in here.parts(DRAWN))
    sample = merge((_in_context(here.inputs, DRAWN, t, some, layer.names) for t, some in drawn), params)
    write_arrays(here.directory / SAMPLE, {NEAR: context_from(sample.X)})
    return {"rows": sample.rows, "counts": sample.counts.tolist()}


def context_sample(inputs: PartInputs, own: Sample, names: tuple[str, ...]) -> Sample:
    """`own`, the survey's sample, with the context of its rows, columns `names`."""
    return _in_context(inputs, MERGED, "all", own, names)


def _in_context(inputs: PartInputs, stage: str, part: str, rows: Sample, names: tuple[str, ...]) -> Sample:
    """`rows` with what a part of `stage` tells of each, columns `names`."""
    context = inputs.arrays(stage, part, SAMPLE, (NEAR,))[0][NEAR]
    return replace(rows, features=(*rows.features, *names), X=with_context(rows.X, context))


def try_context(
    here: StageInputs,
    names: tuple[str, ...],
    layer: ContextLayer,
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    block: float,
    gap: float,
    folds: int,
    alone: bool = False,
) -> Result:
    """What the first layer and what both say of the rows of a fold's squares, which they have not learned from."""
    sample = context_sample(here.inputs, survey_sample(here.inputs, names), layer.names)
    division, edge = squares_of(sample, block, gap, folds, alone)
    rest = _rest(here, sample, division)
    if rest is None:
        return {"rows": 0}
    asked = sample.take(division.judged(int(here.part)))
    first = asked.X[:, len(names) : len(names) + len(classes)].astype(np.float64)
    both = first + answer(asked.X, fit_layer(rest, params, compare, classes, block, gap, on_trial=True))[1]
    square = asked.place // whole_millimetres(edge, "select.block")
    trial = LayerTrial.of(square, asked.y, first.argmax(axis=1), both.argmax(axis=1), len(classes))
    write_arrays(here.directory / SQUARES, vars(trial))
    write_arrays(here.directory / ANSWERS, Answers(both, asked.y, square)._asdict())
    return {"rows": asked.rows}


def train_context(
    here: StageInputs,
    names: tuple[str, ...],
    layer: ContextLayer,
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    computed: Mapping[str, Any],
    block: float,
    gap: float,
    folds: int,
    most_weight: float,
    alone: bool = False,
) -> Result:
    """The second layer, and both as one model, delivered as the run's; with `alone` the first one where the second does
    not pay."""
    place = here.inputs.path(TRAIN_COARSE, "model", MODEL)
    coarse = load_model(place)
    sample = context_sample(here.inputs, survey_sample(here.inputs, names), layer.names)
    judged = _judged(here, sample, classes, folds)
    tried = _in_words(judged, alone)
    notes = [*coarse.card["notes"], tried]
    if alone and not judged.pays:
        one = load_forest(place)
        one = replace(one, card={k: v for k, v in one.card.items() if k != "digest"} | {"notes": notes})
        save_model(here.directory / MODEL, one)
        return {"card": dict(one.card), "trees": one.trees, "nodes": len(one.feature), "tried": tried}
    fine = with_feature_parameters(
        fit_layer(with_base_rows(here, sample), params, compare, classes, block, gap), computed
    )
    card = {k: v for k, v in coarse.card.items() if k not in ("kind", "digest", "preparation")}
    context = {"cells": list(layer.cells), "judged": dict(judged.facts)}
    weighed = _weighed(here, sample, classes, folds, most_weight)
    if weighed is not None:
        context["weights"] = list(weighed.weights)
        notes, tried = [*notes, weighed.sentence], f"{tried}; {weighed.sentence}"
    both = Contextual(coarse, fine, {**card, "notes": notes, "kind": Contextual.kind, "context": context})
    both.check("a newly trained model")
    save_model(here.directory / MODEL, both)
    return {"card": dict(both.card), "trees": None, "tried": tried}


def _judged(here: StageInputs, sample: Sample, classes: tuple[ClassDef, ...], folds: int) -> Verdict:
    """Whether the second layer pays, by what the folds tried."""
    trials = (LayerTrial(**here.inputs.arrays(TRIED, part, SQUARES)[0]) for part in _tried(here, folds))
    return verdict(LayerTrial.joined(trials, len(classes)), sample.eligible, tuple(c.name for c in classes))


def _weighed(
    here: StageInputs, sample: Sample, classes: tuple[ClassDef, ...], folds: int, most: float
) -> Weighing | None:
    """What the classes weigh, by what both layers said of the folds' rows."""
    answers = [Answers(**here.inputs.arrays(TRIED, part, ANSWERS)[0]) for part in _tried(here, folds)]
    return weighing(answers, sample.eligible, tuple(c.name for c in classes), most)


def _tried(here: StageInputs, folds: int) -> list[str]:
    """The folds that both layers were tried on."""
    return [str(k) for k in range(folds) if here.inputs.meta(TRIED, str(k))["rows"]]


def _in_words(judged: Verdict, alone: bool) -> str:
    if judged.pays:
        return judged.sentence
    said = "it is not used, as" if alone else "it does not pay here (--set classify.context.cells=[]):"
    return f"{judged.sentence}: {said} {', '.join(judged.why)}"


def _learns(plan: Plan) -> bool:
    return trains(plan) and context_layer(plan) is not None


def _folds(plan: Plan) -> list[str]:
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


def _fitting(plan: Plan) -> Mapping[str, Any]:
    """Arguments of the stages that fit a layer."""
    return {**learning_arguments(plan), "compare": plan.config.compare, **_squares(plan)}


def _fitting_folds(plan: Plan) -> Mapping[str, Any]:
    """Likewise, of those that fit a layer by fold."""
    params = plan.config.train
    fewer = params.model_copy(update={"trees": min(params.trees, plan.config.classify.context.trees)})
    return {**_fitting(plan), "params": fewer}


_OF_LAYERS = 1000 * BASELINE_VERSION + TRAIN.version
_OF_JUDGING = 3_000_000 + _OF_LAYERS
_OF_NOTES = 1_000_000 + _OF_JUDGING
_OF_ROWS = 1_000_000 + 1000 * CONTEXT.version + TRAIN_SAMPLE.version  # their context alone

TRAIN_FOLDS = Stage(
    FOLDS,
    1_000_000 + _OF_LAYERS,  # forests of folds tell nothing of themselves
    "survey",
    "tree_row",
    train_fold,
    when=_learns,
    parts=_folds,
    arguments=_fitting_folds,
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
    when=_learns,
    parts=_tiles_around,
    arguments=lambda plan: {"names": plan.names, "layer": layer_of(plan), **_squares(plan)},
    own=lambda plan: ("x", "y", *plan.names),
    writes=lambda plan: layer_of(plan).columns(FOLD_SHARE),
    after=("training", FOLDS, TRAIN_COARSE),
    needs=lambda plan, part: (("training", "all"), (TRAIN_COARSE, "model"), *((FOLDS, k) for k in _folds(plan))),
    row_digests=True,
)
DRAW_CONTEXT = Stage(
    DRAWN,
    _OF_ROWS,
    "tile",
    "echo",
    draw_context_tile,
    when=_learns,
    parts=training_tiles,
    arguments=lambda plan: {"layer": layer_of(plan)},
    reads=lambda plan: (*PLACE, *layer_of(plan).columns(FOLD_SHARE)),
    own=IDENTITY,
    halo=lambda plan: layer_of(plan).halo,
    after=(TRAIN_SAMPLE.name,),
    needs=lambda plan, tile: ((TRAIN_SAMPLE.name, tile.key),),
)
MERGE_CONTEXT = Stage(
    MERGED,
    _OF_ROWS,
    "survey",
    "row",
    merge_context_samples,
    when=_learns,
    arguments=lambda plan: {"params": plan.config.train, "layer": layer_of(plan)},
    silent=NOT_OF_THE_SAMPLE,
    after=(TRAIN_SAMPLE.name, DRAWN),
    needs=lambda plan, part: [(stage, t.key) for stage in (TRAIN_SAMPLE.name, DRAWN) for t in training_tiles(plan)],
)
TRY_CONTEXT = Stage(
    TRIED,
    _OF_JUDGING,
    "survey",
    "tree_row",
    try_context,
    when=_learns,
    parts=_folds,
    arguments=lambda plan: {**_fitting_folds(plan), "layer": layer_of(plan)},
    silent=frozenset({"importance_repeats", "base_rows"}),
    after=("training", MERGED, BASE_ROWS),
    needs=lambda plan, part: (("training", "all"), (MERGED, "all"), *base_rows_part(plan)),
)
TRAIN_CONTEXT = Stage(
    TRAIN.name,
    _OF_NOTES,
    "survey",
    "tree_row",
    train_context,
    when=_learns,
    parts=lambda plan: ("model",),
    arguments=lambda plan: {
        **_fitting(plan),
        "layer": layer_of(plan),
        "classes": plan.config.written_classes,
        "computed": parameters_of(plan, plan.names),
        "most_weight": plan.config.classify.context.most_weight,
    },
    after=("training", MERGED, TRIED, TRAIN_COARSE, BASE_ROWS),
    needs=lambda plan, part: (
        ("training", "all"),
        (MERGED, "all"),
        (TRAIN_COARSE, "model"),
        *base_rows_part(plan),
        *((TRIED, k) for k in _folds(plan)),
    ),
    place="deliver",
)
