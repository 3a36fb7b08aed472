"""The stages of a layer that decides in context, as it is learned: what it learns from, whether it pays, and what its
classes weigh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fwclass.classify.context import CONTEXT, context_from, context_of, with_context
from fwclass.classify.shares import answer
from fwclass.graph.areas import training_tiles
from fwclass.graph.context_folds import (
    FOLD_SHARE,
    OF_LAYERS,
    fitting,
    fitting_folds,
    folds_of,
    learns_context,
    rest_of_fold,
    rows_of_trees,
    squares_of,
)
from fwclass.graph.context_layer import ContextLayer, layer_of
from fwclass.graph.context_trial import Answers, LayerTrial, Verdict, Weighing, verdict, weighing
from fwclass.graph.learn import TRAIN_COARSE, fit_layer, parameters_of, with_feature_parameters
from fwclass.graph.loaded_models import MODEL
from fwclass.graph.stage import Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.training_rows import (
    BASE_ROWS,
    NOT_OF_THE_SAMPLE,
    SAMPLE,
    base_rows_part,
    load_sample,
    rows_of,
    survey_sample,
    with_base_rows,
)
from fwclass.grid import whole_millimetres
from fwclass.model import ClassDef, Contextual
from fwclass.run.inputs import PartInputs
from fwclass.schema import IDENTITY, PLACE, canonical_key
from fwclass.store.arrays import write_arrays
from fwclass.store.models import load_forest, load_model, save_model
from fwclass.train.baselines.params import CompareParams
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import TRAIN, TRAIN_SAMPLE, merge

DRAWN, MERGED, TRIED = "context-sample", "context-training", "context-folds"
SQUARES, ANSWERS, NEAR = "squares", "answers", "context"


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
    rest = rest_of_fold(here, sample, division)
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


_OF_JUDGING = 3_000_000 + OF_LAYERS
_OF_NOTES = 1_000_000 + _OF_JUDGING
_OF_ROWS = 1_000_000 + 1000 * CONTEXT.version + TRAIN_SAMPLE.version  # their context alone


DRAW_CONTEXT = Stage(
    DRAWN,
    _OF_ROWS,
    "tile",
    "echo",
    draw_context_tile,
    when=learns_context,
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
    when=learns_context,
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
    when=learns_context,
    parts=folds_of,
    load=rows_of_trees,
    arguments=lambda plan: {**fitting_folds(plan), "layer": layer_of(plan)},
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
    when=learns_context,
    parts=lambda plan: ("model",),
    arguments=lambda plan: {
        **fitting(plan),
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
        *((TRIED, k) for k in folds_of(plan)),
    ),
    place="deliver",
)
