"""The stages of a second layer: first answers, where two classes meet, wide features there, what it learns from, and
the answers of both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.classify.exempt import Exempt
from fwclass.classify.params import RefineParams
from fwclass.classify.refine import BOUNDARY, COARSE, REFINE, at_boundary, refine_boundary
from fwclass.classify.stage import CLASSIFY, classify, count_filled
from fwclass.conf.sections import AreasSection
from fwclass.errors import InputError
from fwclass.features.names import FeatureRequest
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import FEATURE_COMPUTATION, features
from fwclass.graph.areas import IDENTITY_AND_PLACE, training_tiles, within
from fwclass.graph.classify import classes_written, codes_of, given_model, names_that_decide, outside_facts, own_model
from fwclass.graph.corrections import CORRECTIONS, corrections_here
from fwclass.graph.features import tile_table
from fwclass.graph.fine_layer import FineLayer, fine_layer
from fwclass.graph.kept import exempt_argument, exempt_columns
from fwclass.graph.learn import TRAIN_COARSE, fit_layer, parameters_of, with_feature_parameters
from fwclass.graph.loaded_models import MODEL, used_model
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.training_rows import (
    NOT_OF_THE_SAMPLE,
    SAMPLE,
    load_sample,
    places,
    taught_argument,
    taught_rows,
    trains,
)
from fwclass.model import ClassDef, TwoLayer, sample_matrix
from fwclass.model.ranges import RangeCounter
from fwclass.schema import PLACE, Table, canonical_key
from fwclass.stage import Chunk
from fwclass.store.arrays import write_arrays
from fwclass.store.models import load_model, save_model
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.stage import VERSION as BASELINE_VERSION
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import TRAIN, TRAIN_SAMPLE, candidates, merge

ANSWERED = "coarse"
DRAWN, MERGED = "refine-sample", "refine-training"


def answer_coarse(here: StageInputs, model: str | None) -> Result:
    """The first layer's answers of a tile."""
    used = used_model(here, model, TRAIN_COARSE)
    used = used.coarse if isinstance(used, TwoLayer) else used
    missing, tables = 0, []
    outside = RangeCounter.of(used.card, used.features)
    for rows in here.cuts():
        X = sample_matrix(rows, used.features, here.part)
        if outside is not None:
            outside.add(X)
        answers = classify(X, used)
        tables.append(Table(dict(zip(COARSE, (answers[n] for n in CLASSIFY.writes), strict=True))))
        missing += count_filled(X, used)
    table = tables[0] if len(tables) == 1 else Table.concat(tables)
    return table, {"filled": missing, **outside_facts(outside)}


def widen_features(here: StageInputs, layer: FineLayer, params: FeaturesParams) -> Result:
    """Which echoes of a tile are at the boundary, and wide features of those alone, NaN for the others."""
    tables, rows = [], []
    for these, chunk in here.chunks():
        at = at_boundary(chunk, layer.pair, layer.within)
        columns = {name: np.full(len(at), np.nan, np.float32) for name in layer.wide}
        if at.any() and layer.wide:
            some = features(Chunk(chunk.table, chunk.core[at], chunk.tile), layer.wide, params)
            for name in layer.wide:
                columns[name][at] = some[name]
        tables.append(Table({BOUNDARY: at, **columns}))
        rows.append(these)
    table = tile_table(tables, rows)
    return table, {"rows": table.rows, "boundary": int(table[BOUNDARY].sum())}


def draw_fine_tile(
    here: StageInputs,
    layer: FineLayer,
    areas: Any,
    params: FeaturesParams,
    classes: tuple[ClassDef, ...],
    rows: str,
    drawing: TrainParams,
    judging: AreasSection | None = None,
    reach: float = 0.0,
) -> Result:
    """The rows of a tile that the second layer may learn from, with all that it decides by."""
    chunk, own = here.chunk(), here.own_rows()
    corrected = taught_rows(here, own, judging, reach)
    inside = within(own, areas) | corrected
    if rows == "boundary":
        inside &= at_boundary(chunk, layer.pair, layer.within)
    key = canonical_key(own)
    blank = Table({"z": np.zeros(own.rows, np.float32)})  # which rows have a value is not known before it is computed
    sample = candidates(blank, own["reference"], key, inside, drawing, classes, places(own), corrected)
    order = np.argsort(key)
    chosen = order[np.searchsorted(key[order], sample.key)]
    table = own.take(chosen)
    if layer.wide:
        table = table.with_columns(
            features(Chunk(chunk.table, chunk.core[chosen], chunk.tile), layer.wide, params).select(layer.wide)
        )
    X = sample_matrix(table, layer.names, here.part)
    sample = Sample(layer.names, X, sample.y, sample.key, sample.hash, sample.eligible, sample.bare, sample.place)
    write_arrays(here.directory / SAMPLE, sample.arrays())
    return {"rows": sample.rows}


def merge_fine_samples(
    here: StageInputs, layer: FineLayer, rows: str, drawing: TrainParams, classes: tuple[ClassDef, ...]
) -> Result:
    """The sample of all tiles; refused where the two classes do not meet in the training areas."""
    tiles = here.parts(DRAWN)
    parts = (load_sample(here.inputs, DRAWN, t, layer.names) for t in tiles)
    sample = merge(parts, drawing) if tiles else None
    if sample is None or (sample.counts == 0).any():
        lacking = classes[int(np.argmin(sample.counts))].name if sample else classes[0].name
        near = f" near a boundary of {classes[0].name} and {classes[1].name}" if rows == "boundary" else ""
        raise InputError(
            f"the second layer has no training rows of class {lacking!r}{near}",
            where="classify.refine, training areas",
            expected="labelled echoes of both classes",
            got="none"
            if sample is None
            else ", ".join(f"{c.name} {n}" for c, n in zip(classes, sample.counts.tolist(), strict=True)),
            do="--set classify.refine.rows=anywhere, or no second layer: --set classify.refine.between=[]",
        )
    write_arrays(here.directory / SAMPLE, sample.arrays())
    return {"rows": sample.rows, "counts": sample.counts.tolist()}


def train_fine(
    here: StageInputs,
    layer: FineLayer,
    params: TrainParams,
    compare: CompareParams,
    refine: RefineParams,
    classes: tuple[ClassDef, ...],
    computed: Mapping[str, Any],
    block: float,
    gap: float,
) -> Result:
    """The second layer, and both as one model, delivered as the run's."""
    coarse = load_model(here.inputs.path(TRAIN_COARSE, "model", MODEL))
    sample, without = _with_values(load_sample(here.inputs, MERGED, "all", layer.names))
    own: dict[str, Any] = {"method": refine.method, "samples_per_class": refine.samples_per_class}
    if not isinstance(params.class_weights, str):  # this layer tells two of the classes
        own["class_weights"] = {c.name: params.class_weights.get(c.name, 1.0) for c in classes}
    params = params.model_copy(update=own)
    fine: Any = fit_layer(sample, params, compare, classes, block, gap)
    if without:
        fine.card["notes"].append(f"no training row has a value of {', '.join(without)}: left out")
    fine = with_feature_parameters(fine, computed)
    card = {k: v for k, v in coarse.card.items() if k not in ("kind", "digest", "preparation")}
    both = TwoLayer(coarse, fine, {**card, "kind": TwoLayer.kind, "refine": refine.model_dump(mode="json")})
    both.check("a newly trained model")
    save_model(here.directory / MODEL, both)
    return {"card": dict(both.card), "fine": dict(fine.card), "trees": None}


def _with_values(sample: Sample) -> tuple[Sample, list[str]]:
    """The sample without features that no row has a value of, and these."""
    some = [bool(np.isfinite(values).any()) for values in sample.X.T]
    names = tuple(n for n, one in zip(sample.features, some, strict=True) if one)
    columns = (sample.X[:, some], sample.y, sample.key, sample.hash, sample.eligible, sample.bare, sample.place)
    return Sample(names, *columns), [n for n in sample.features if n not in names]


def classify_refined(here: StageInputs, probabilities: bool, model: str | None, exempt: Exempt | None = None) -> Result:
    """Answers of both layers for a tile; `exempt` echoes do not get the class that they say."""
    used = used_model(here, model)
    if not isinstance(used, TwoLayer):
        raise InputError("the model has one layer", where=here.part, do="run the same again: it was changed")
    tables, missing = [], 0
    for rows in here.cuts():
        X = sample_matrix(rows.take(np.flatnonzero(rows[BOUNDARY])), used.fine.features, here.part)
        coarse = classify(sample_matrix(rows, used.features, here.part), used.coarse, True) if probabilities else None
        answered = refine_boundary(rows, X, used, coarse)
        tables.append(exempt.written(answered, rows) if exempt else answered)
        missing += count_filled(X, used.fine)
    table = tables[0] if len(tables) == 1 else Table.concat(tables)
    return table, {"codes": codes_of(table), "filled": missing}


def _has(plan: Plan) -> bool:
    return fine_layer(plan) is not None


def _learns(plan: Plan) -> bool:
    return trains(plan) and _has(plan)


def _layer(plan: Plan) -> FineLayer:
    layer = fine_layer(plan)
    if layer is None:
        raise InputError("the run has no second layer", where="classify.refine")
    return layer


def _pair(plan: Plan, classes: tuple[ClassDef, ...] | None = None) -> tuple[ClassDef, ...]:
    codes = _layer(plan).pair
    return tuple(next(c for c in classes or plan.config.classes if c.code == code) for code in codes)


def _wide_reads(plan: Plan) -> tuple[str, ...]:
    wide = FeatureRequest.of(_layer(plan).wide).columns(plan.config.features)
    return tuple(dict.fromkeys((*PLACE, COARSE[0], *wide)))


def _drawing_arguments(plan: Plan) -> Mapping[str, Any]:
    refine = plan.config.classify.refine
    drawing = plan.config.train.model_copy(update={"samples_per_class": refine.samples_per_class})
    return {"rows": refine.rows, "drawing": drawing}


ANSWER_COARSE = Stage(
    ANSWERED,
    CLASSIFY.version,
    "tile",
    "echo",
    answer_coarse,
    when=_has,
    arguments=lambda plan: {"model": plan.model[1] if plan.model else None},
    keyed=names_that_decide,
    own=lambda plan: plan.names,
    writes=COARSE,
    after=(TRAIN_COARSE,),
    needs=lambda plan, part: () if plan.model else ((TRAIN_COARSE, "model"),),
    source=given_model,
    row_digests=True,
)
DRAW_BOUNDARY = Stage(
    DRAWN,
    1000 * FEATURE_COMPUTATION.version + TRAIN_SAMPLE.version,
    "tile",
    "echo",
    draw_fine_tile,
    when=_learns,
    parts=training_tiles,
    arguments=lambda plan: {
        "layer": _layer(plan),
        "areas": plan.config.areas.boxes("train"),
        "params": plan.config.features,
        "classes": _pair(plan),
        **_drawing_arguments(plan),
    },
    each=taught_argument,
    silent=NOT_OF_THE_SAMPLE | {"also"},
    reads=_wide_reads,
    own=lambda plan: (
        *IDENTITY_AND_PLACE,
        "z",
        "reference",
        *(n for n in _layer(plan).names if n not in _layer(plan).wide),
    ),
    halo=lambda plan: _layer(plan).halo(plan),
    after=(CORRECTIONS,),
    needs=corrections_here,
)
MERGE_BOUNDARY = Stage(
    MERGED,
    TRAIN_SAMPLE.version,
    "survey",
    "row",
    merge_fine_samples,
    when=_learns,
    arguments=lambda plan: {"layer": _layer(plan), "classes": _pair(plan), **_drawing_arguments(plan)},
    silent=NOT_OF_THE_SAMPLE,
    after=(DRAWN,),
    needs=lambda plan, part: [(DRAWN, t.key) for t in training_tiles(plan)],
)
TRAIN_FINE = Stage(
    TRAIN.name,
    1000 * BASELINE_VERSION + TRAIN.version,
    "survey",
    "row",
    train_fine,
    when=_learns,
    parts=lambda plan: ("model",),
    arguments=lambda plan: {
        "layer": _layer(plan),
        "params": plan.config.train,
        "compare": plan.config.compare,
        "refine": plan.config.classify.refine,
        "classes": _pair(plan, plan.config.written_classes),
        "computed": parameters_of(plan, _layer(plan).names),
        "block": plan.config.select.block,
        "gap": plan.config.select.gap,
    },
    after=(MERGED, TRAIN_COARSE),
    needs=lambda plan, part: ((MERGED, "all"), (TRAIN_COARSE, "model")),
    place="deliver",
)
WIDEN_BOUNDARY = Stage(
    REFINE.name,
    1000 * FEATURE_COMPUTATION.version + REFINE.version,
    "tile",
    "echo",
    widen_features,
    when=_has,
    arguments=lambda plan: {"layer": _layer(plan), "params": plan.config.features},
    silent=frozenset({"also"}),
    reads=_wide_reads,
    writes=lambda plan: (BOUNDARY, *_layer(plan).wide),
    halo=lambda plan: _layer(plan).halo(plan),
    after=(ANSWERED,),
)
CLASSIFY_REFINED = Stage(
    CLASSIFY.name,
    CLASSIFY.version,
    "tile",
    "echo",
    classify_refined,
    when=_has,
    arguments=lambda plan: {
        "probabilities": plan.config.classify.probabilities,
        "model": plan.model[1] if plan.model else None,
        **exempt_argument(plan),
    },
    keyed=lambda plan: {"layer": _layer(plan), **names_that_decide(plan)},
    own=lambda plan: (
        *exempt_columns(plan),
        *COARSE,
        BOUNDARY,
        *_layer(plan).names,
        *(plan.names if plan.config.classify.probabilities else ()),
    ),
    writes=classes_written,
    after=("train", REFINE.name),
    needs=own_model,
    source=given_model,
)
