"""Stages that learn: the training rows of every tile, the survey's sample, trees, importances, the model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf.sections import AreasSection
from fwclass.errors import InputError
from fwclass.graph.areas import IDENTITY_AND_PLACE, training_tiles, within
from fwclass.graph.context_layer import context_layer
from fwclass.graph.corrections import CORRECTIONS, corrected_training_rows, corrections_here, corrections_of, reach_here
from fwclass.graph.fine_layer import fine_layer
from fwclass.graph.machine_search import MACHINE_SEARCH, folds_of_squares, gather_trials, judge, searches, trials
from fwclass.graph.model_fit import feature_parameters
from fwclass.graph.stage import Plan, Result, Stage, StageInputs
from fwclass.graph.thin import sampled_columns
from fwclass.grid import Box, millimetres
from fwclass.model import ClassDef, Model, Tree, sample_matrix
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Name
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.store.arrays import write_arrays
from fwclass.store.models import save_model
from fwclass.train.baselines.params import CompareParams, RbfSvmParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.stage import VERSION as BASELINE_VERSION
from fwclass.train.baselines.stage import machine_weights, train_other
from fwclass.train.importance import drops
from fwclass.train.sample import Sample, join, review
from fwclass.train.stage import (
    TRAIN,
    TRAIN_IMPORTANCE,
    TRAIN_SAMPLE,
    TRAIN_TREES,
    TrainParams,
    candidates,
    grow_trees,
    merge,
    train,
)

SAMPLE, TREES, DROPS, MODEL = "sample", "trees", "drops", "model"
TRAIN_COARSE, BASE_ROWS = "train-coarse", "base-rows"

TREES_PER_PART = 5
"""Trees that one task grows; a forest does not depend on it."""


def draw_tile(
    here: StageInputs,
    names: tuple[str, ...],
    areas: tuple[Box, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    judging: AreasSection | None = None,
    reach: float = 0.0,
) -> Result:
    """Which rows of a tile may train: those in training areas, and those that are corrected, wherever they lie."""
    table = here.rows()
    inside, corrected = within(table, areas), taught_rows(here, table, judging, reach)
    inside |= corrected
    if "sampled" in table:  # a thinned run
        inside &= table["sampled"]
    key = canonical_key(table)
    sample = candidates(table.select(names), table["reference"], key, inside, params, classes, first=corrected)
    write_arrays(here.directory / SAMPLE, sample.without_values().arrays())
    return {"rows": sample.rows, **({"corrected": int(corrected.sum())} if judging is not None else {})}


def taught_rows(here: StageInputs, table: Table, judging: AreasSection | None, reach: float) -> NDArray[np.bool_]:
    """bool (rows,): echoes of a tile that train because they are corrected; `judging` None: there is no correction."""
    if judging is None:
        return np.zeros(table.rows, bool)
    return corrected_training_rows(table, corrections_of(here), judging, reach)


def taught_argument(plan: Plan, tile: Any) -> Mapping[str, Any]:
    """What a stage that draws rows gets besides where echoes of its tile are corrected."""
    return {"judging": plan.config.areas, **reach_here(plan, tile)} if corrections_here(plan, tile) else {}


def places(table: Table) -> NDArray[np.int64]:
    """x and y (rows, 2) in whole millimetres."""
    return np.stack([millimetres(table["x"]), millimetres(table["y"])], axis=1).astype(np.int64)


def merge_samples(
    here: StageInputs, names: tuple[str, ...], params: TrainParams, classes: tuple[ClassDef, ...], based: bool = False
) -> Result:
    """The survey's sample; refused where a forest cannot be trained on it, unless it is `based` on another model."""
    tiles = here.parts(TRAIN_SAMPLE.name)
    if not tiles:
        raise InputError(
            "no echo lies in any training area", where="areas.train", do="give boxes on the survey, in its coordinates"
        )
    sample = merged_sample(here.inputs, TRAIN_SAMPLE.name, tiles, {n: here.columns[n] for n in names}, params)
    if not based:  # the base model's rows may be all that there are of a class
        review(sample, classes)
    write_arrays(here.directory / SAMPLE, sample.arrays())
    return {"rows": sample.rows, "counts": sample.counts.tolist()}


def merged_sample(
    inputs: PartInputs, stage: str, tiles: Iterable[str], columns: Mapping[str, str], params: TrainParams
) -> Sample:
    """The sample of the rows that parts of `stage` drew from `tiles`; features (stage by column) and places are read of
    those rows alone that remain."""
    sample, names = merge((load_sample(inputs, stage, t, ()) for t in tiles), params), tuple(columns)
    X, place = np.empty((sample.rows, len(names)), np.float32), np.empty((sample.rows, 2), np.int64)
    for tile in tiles:
        keys = np.intersect1d(inputs.arrays(stage, tile, SAMPLE, ("key",))[0]["key"], sample.key, assume_unique=True)
        if len(keys) == 0:
            continue
        rows = rows_of(keys, canonical_key(inputs.rows(tile, dict.fromkeys(IDENTITY, "tile"))))
        order = np.argsort(rows)
        table = inputs.rows_at(tile, {**dict.fromkeys(("x", "y"), "tile"), **columns}, rows[order])
        at = np.searchsorted(sample.key, keys[order])
        X[at], place[at] = sample_matrix(table, names, "training rows"), places(table)
    return replace(sample, features=names, X=X, place=place)


def rows_of(keys: NDArray[np.uint64], there: NDArray[np.uint64]) -> NDArray[np.int64]:
    """int64 (keys,): in which rows of `there` the keys stand; each stands in one."""
    order = np.argsort(there)
    return order[np.searchsorted(there[order], keys)]


def load_sample(inputs: PartInputs, stage: str, part: str, names: tuple[str, ...]) -> Sample:
    """The sample that a part wrote, of features `names`."""
    return Sample.from_arrays(names, inputs.arrays(stage, part, SAMPLE)[0])


def survey_sample(inputs: PartInputs, names: tuple[str, ...]) -> Sample:
    """The sample of the whole survey."""
    return load_sample(inputs, "training", "all", names)


def learned_sample(here: StageInputs, names: tuple[str, ...]) -> Sample:
    """All rows that the model learns from: the survey's sample, and rows of the base model where there is one."""
    return with_base_rows(here, survey_sample(here.inputs, names))


def with_base_rows(here: StageInputs, sample: Sample) -> Sample:
    """`sample`, rows of the survey, and after it those of the base model where there is one that has its features."""
    if not here.parts(BASE_ROWS):
        return sample
    arrays, _ = here.inputs.arrays(BASE_ROWS, "all", SAMPLE)
    values = arrays["X"]  # features, and context where the base model has it
    if values.shape[1] < len(sample.features):
        return sample
    wanted = np.ascontiguousarray(values[:, : len(sample.features)])
    base = Sample.from_arrays(sample.features, {**arrays, "X": wanted})
    return join((sample, base), sample.rows + base.rows)


def base_rows_part(plan: Plan) -> tuple[Name, ...]:
    """The rows of the base model, where there is one."""
    return ((BASE_ROWS, "all"),) if plan.base is not None else ()


def grow_part(
    here: StageInputs, names: tuple[str, ...], params: TrainParams, classes: tuple[ClassDef, ...], count: int
) -> Result:
    """Some of the forest's trees, from that on which the part is named after."""
    trees = grow_trees(learned_sample(here, names), classes, int(here.part), count, params)
    arrays: dict[str, NDArray] = {}
    for number, (feature, threshold, child) in enumerate(trees, int(here.part)):
        arrays |= {f"{number:05d}-feature": feature, f"{number:05d}-threshold": threshold, f"{number:05d}-child": child}
    write_arrays(here.directory / TREES, arrays)
    return {"nodes": int(sum(len(t[0]) for t in trees))}


def _load_trees(inputs: PartInputs, batch: str) -> list[Tree]:
    arrays, _ = inputs.arrays("trees", batch, TREES)
    numbers = sorted({n.split("-")[0] for n in arrays})
    return [(arrays[f"{n}-feature"], arrays[f"{n}-threshold"], arrays[f"{n}-child"]) for n in numbers]


def permute_features(
    here: StageInputs, names: tuple[str, ...], params: TrainParams, count: int, repeats: int
) -> Result:
    """What some of the forest's trees lose when a feature is permuted."""
    sample, trees = learned_sample(here, names), _load_trees(here.inputs, here.part)
    lost, judged = drops(sample, trees, int(here.part), params.drawing, repeats)
    write_arrays(here.directory / DROPS, {"drops": lost, "judged": judged})
    return {"rows": int(judged.sum())}


def deliver_forest(
    here: StageInputs,
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    computed: Mapping[str, Any],
) -> Result:
    """The forest, delivered as the run's model."""
    trees = [tree for batch in here.parts("trees") for tree in _load_trees(here.inputs, batch)]
    lost = None
    if params.importance_repeats:
        parts = [here.inputs.arrays("importance", b, DROPS)[0] for b in here.parts("importance")]
        lost = (np.concatenate([p["drops"] for p in parts]), np.concatenate([p["judged"] for p in parts]))
    forest = with_feature_parameters(train(learned_sample(here, names), trees, params, classes, lost), computed)
    if here.parts(BASE_ROWS):
        base = here.inputs.meta(BASE_ROWS, "all")
        notes = [f"{base['rows']:,} of the training rows are the base model's", *base["remarks"]]
        forest = replace(forest, card={**forest.card, "notes": [*forest.card["notes"], *notes]})
    save_model(here.directory / MODEL, forest)
    return {"card": dict(forest.card), "trees": forest.trees, "nodes": len(forest.feature)}


def train_baseline(
    here: StageInputs,
    names: tuple[str, ...],
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    computed: Mapping[str, Any],
    block: float,
    gap: float,
) -> Result:
    """The classifier that ``train.method`` names where it is no forest, delivered as the run's model."""
    sample, places = survey_sample(here.inputs, names), folds_of_squares(block, gap)
    parts = here.parts(MACHINE_SEARCH)
    search = gather_trials(here.inputs, parts, sample, compare.rbf_svm, places) if parts else None
    model: Model = with_feature_parameters(
        train_other(sample, params, compare, classes, params.method, places, search), computed
    )
    save_model(here.directory / MODEL, model)
    return {"card": dict(model.card), "trees": None}


def try_machine(
    here: StageInputs,
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    machine: RbfSvmParams,
    scaling: str,
    block: float,
    gap: float,
    trial: tuple[float, float, int],
) -> Result:
    """How often the machine of one (C, gamma, fold) is right."""
    sample, places = survey_sample(here.inputs, names), folds_of_squares(block, gap)
    weights = machine_weights(fewer(sample, machine.max_rows, places.edge), params, classes)
    return judge(here, sample, trial, machine, scaling, weights, places)


def fit_layer(
    sample: Sample, params: TrainParams, compare: CompareParams, classes: tuple[ClassDef, ...], block: float, gap: float
) -> Any:
    """A classifier of any kind, by ``train.method``."""
    if params.method != "forest":
        return train_other(sample, params, compare, classes, params.method, folds_of_squares(block, gap))
    review(sample, classes)
    return train(sample, grow_trees(sample, classes, 0, params.trees, params), params, classes)


def with_feature_parameters(model: Any, computed: Mapping[str, Any]) -> Any:
    """`model` with what its features were computed with in its card."""
    return replace(model, card={**model.card, "computed": dict(computed)})


def trains(plan: Plan) -> bool:
    """Whether the run trains a model of its own."""
    return plan.config.survey.model is None


def forest_learns(plan: Plan) -> bool:
    """Whether the run trains a forest of our own; of two layers as the first."""
    return trains(plan) and plan.config.train.method == "forest"


def _two_layers(plan: Plan) -> bool:
    return fine_layer(plan) is not None or context_layer(plan) is not None


def _one_layer(plan: Plan) -> bool:
    return trains(plan) and not _two_layers(plan)


@dataclass(frozen=True)
class _Batch:
    """Trees that one part grows: `count` from the one that `key` names."""

    key: str
    count: int


def _batches(plan: Plan) -> list[_Batch]:
    trees = plan.config.train.trees
    return [_Batch(f"{k:05d}", min(TREES_PER_PART, trees - k)) for k in range(0, trees, TREES_PER_PART)]


def learning_arguments(plan: Plan) -> Mapping[str, Any]:
    """Arguments that all stages that learn share."""
    config = plan.config
    return {"names": config.features_asked, "params": config.train, "classes": config.classes}


def _card_arguments(plan: Plan) -> Mapping[str, Any]:
    """Arguments that stages share which write a model."""
    return {**learning_arguments(plan), "classes": plan.config.written_classes, "computed": _feature_settings(plan)}


def parameters_of(plan: Plan, names: tuple[str, ...]) -> Mapping[str, Any]:
    """What the values of the features `names` depend on (`feature_parameters`)."""
    config = plan.config
    return feature_parameters(
        names, config.features, config.ground.method, config.terrain.height, plan.layout.quantities
    )


def _feature_settings(plan: Plan) -> Mapping[str, Any]:
    return parameters_of(plan, plan.config.features_asked)


def _squares(plan: Plan) -> Mapping[str, Any]:
    """What folds of a machine's search lie apart by."""
    return {"block": plan.config.select.block, "gap": plan.config.select.gap}


_NOT_OF_A_TREE = frozenset({"trees", "importance_repeats", "base_rows"})
NOT_OF_THE_SAMPLE = frozenset(TrainParams.model_fields) - {"seed", "samples_per_class"}

DRAW_SAMPLE = Stage(
    TRAIN_SAMPLE.name,
    TRAIN_SAMPLE.version,
    "tile",
    "echo",
    draw_tile,
    when=trains,
    parts=training_tiles,
    arguments=lambda plan: {**learning_arguments(plan), "areas": plan.config.areas.boxes("train")},
    each=taught_argument,
    silent=NOT_OF_THE_SAMPLE,
    own=lambda plan: (*IDENTITY_AND_PLACE, "z", *plan.config.features_asked, *sampled_columns(plan), "reference"),
    after=(CORRECTIONS,),
    needs=corrections_here,
    named=True,
)
MERGE_SAMPLE = Stage(
    "training",
    TRAIN_SAMPLE.version,
    "survey",
    "row",
    merge_samples,
    when=trains,
    arguments=lambda plan: {**learning_arguments(plan), **({"based": True} if plan.base is not None else {})},
    silent=NOT_OF_THE_SAMPLE,
    reads=lambda plan: ("x", "y", *plan.config.features_asked),
    tiles=training_tiles,
    after=("sample",),
    needs=lambda plan, part: [(TRAIN_SAMPLE.name, t.key) for t in training_tiles(plan)],
)
GROW_TREES = Stage(
    TRAIN_TREES.name,
    TRAIN_TREES.version,
    "survey",
    "tree_row",
    grow_part,
    when=forest_learns,
    parts=_batches,
    arguments=learning_arguments,
    silent=_NOT_OF_A_TREE,
    each=lambda plan, batch: {"count": batch.count},
    after=("training", BASE_ROWS),
    needs=lambda plan, batch: (("training", "all"), *base_rows_part(plan)),
)
WEIGH_FEATURES = Stage(
    TRAIN_IMPORTANCE.name,
    TRAIN_IMPORTANCE.version,
    "survey",
    "tree_row",
    permute_features,
    when=lambda plan: forest_learns(plan) and bool(plan.config.train.importance_repeats),
    parts=_batches,
    arguments=lambda plan: {
        "names": plan.config.features_asked,
        "params": plan.config.train,
        "repeats": plan.config.train.importance_repeats,
    },
    silent=_NOT_OF_A_TREE,
    each=lambda plan, batch: {"count": batch.count},
    after=("training", "trees", BASE_ROWS),
    needs=lambda plan, batch: (("training", "all"), ("trees", batch.key), *base_rows_part(plan)),
)
TRAIN_FOREST = Stage(
    TRAIN.name,
    TRAIN.version,
    "survey",
    "tree_row",
    deliver_forest,
    when=lambda plan: _one_layer(plan) and forest_learns(plan),
    parts=lambda plan: ("model",),
    arguments=_card_arguments,
    after=("training", "trees", "importance", BASE_ROWS),
    needs=lambda plan, part: [
        ("training", "all"),
        *base_rows_part(plan),
        *(("trees", b.key) for b in _batches(plan)),
        *(("importance", b.key) for b in _batches(plan) if plan.config.train.importance_repeats),
    ],
    where="deliver",
)
TRY_MACHINES = Stage(
    MACHINE_SEARCH,
    BASELINE_VERSION,
    "survey",
    "row",
    try_machine,
    when=lambda plan: trains(plan) and searches(plan),
    parts=trials,
    arguments=lambda plan: {
        **learning_arguments(plan),
        "machine": plan.config.compare.rbf_svm,
        "scaling": plan.config.compare.scaling,
        **_squares(plan),
    },
    each=lambda plan, trial: {"trial": (trial.c, trial.gamma, trial.fold)},
    silent=frozenset(TrainParams.model_fields) - {"class_weights", "seed", "samples_per_class"} | {"c", "gamma"},
    after=("training",),
    needs=lambda plan, trial: (("training", "all"),),
)
TRAIN_BASELINE = Stage(
    TRAIN.name,
    BASELINE_VERSION,
    "survey",
    "row",
    train_baseline,
    when=lambda plan: _one_layer(plan) and not forest_learns(plan),
    parts=lambda plan: ("model",),
    arguments=lambda plan: {**_card_arguments(plan), "compare": plan.config.compare, **_squares(plan)},
    after=("training", MACHINE_SEARCH),
    needs=lambda plan, part: (("training", "all"), *((MACHINE_SEARCH, t.key) for t in trials(plan) if searches(plan))),
    where="deliver",
)
TRAIN_COARSE_FOREST = replace(
    TRAIN_FOREST, name=TRAIN_COARSE, when=lambda plan: forest_learns(plan) and _two_layers(plan), where="store"
)
TRAIN_COARSE_BASELINE = replace(
    TRAIN_BASELINE,
    name=TRAIN_COARSE,
    when=lambda plan: trains(plan) and _two_layers(plan) and not forest_learns(plan),
    where="store",
)
