"""Stages that learn from the survey's sample: trees, importances, the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.graph.context_layer import context_layer
from fwclass.graph.fine_layer import fine_layer
from fwclass.graph.loaded_models import MODEL
from fwclass.graph.machine_search import MACHINE_SEARCH, folds_of_squares, gather_trials, judge, searches, trials
from fwclass.graph.model_fit import feature_parameters
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.training_rows import (
    BASE_ROWS,
    OF_TREES,
    base_rows_part,
    learned_sample,
    learning_arguments,
    survey_sample,
    trains,
)
from fwclass.model import ClassDef, Model, Tree, assemble
from fwclass.model.density import BETWEEN, DENSITY
from fwclass.run.inputs import PartInputs
from fwclass.store.arrays import write_arrays
from fwclass.store.models import save_model
from fwclass.train.baselines.params import CompareParams, RbfSvmParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.stage import VERSION as BASELINE_VERSION
from fwclass.train.baselines.stage import machine_weights, train_other
from fwclass.train.importance import drops
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample, review
from fwclass.train.stage import TRAIN, TRAIN_IMPORTANCE, TRAIN_TREES, grow_trees, plain_card, train

TREES, DROPS = "trees", "drops"
TRAIN_COARSE = "train-coarse"

TREES_PER_PART = 10
"""Trees that one task grows; a forest does not depend on it. What a part reads and lays out takes as long as two."""


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


def measure_importance(here: StageInputs, names: tuple[str, ...], params: TrainParams, repeats: int) -> Result:
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
    forest = _with_data(here, train(learned_sample(here, names), trees, params, classes, lost), computed)
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
    model: Model = _with_data(
        here, train_other(sample, params, compare, classes, params.method, places, search), computed
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
    sample: Sample,
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    block: float,
    gap: float,
    on_trial: bool = False,
) -> Any:
    """A classifier of any kind, by ``train.method``; a forest `on_trial`, which is asked here alone, has a card without
    its own accuracy and the ranges of its features."""
    if params.method != "forest":
        return train_other(sample, params, compare, classes, params.method, folds_of_squares(block, gap))
    review(sample, classes)
    trees = grow_trees(sample, classes, 0, params.trees, params)
    return assemble(trees, plain_card(sample, classes, params)) if on_trial else train(sample, trees, params, classes)


def with_feature_parameters(model: Any, computed: Mapping[str, Any]) -> Any:
    """`model` with what its features were computed with in its card."""
    return replace(model, card={**model.card, "computed": dict(computed)})


def _with_data(here: StageInputs, model: Any, computed: Mapping[str, Any]) -> Any:
    """Likewise, and with how dense the echoes of the training areas are."""
    model, densities = with_feature_parameters(model, computed), here.inputs.meta("training", "all").get(DENSITY)
    if densities is None:
        return model
    low, middle, high = densities
    return replace(model, card={**model.card, DENSITY: middle, BETWEEN: [low, high]})


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
MEASURE_IMPORTANCE = Stage(
    TRAIN_IMPORTANCE.name,
    TRAIN_IMPORTANCE.version,
    "survey",
    "tree_row",
    measure_importance,
    when=lambda plan: forest_learns(plan) and bool(plan.config.train.importance_repeats),
    parts=_batches,
    arguments=lambda plan: {
        "names": plan.config.features_asked,
        "params": plan.config.train,
        "repeats": plan.config.train.importance_repeats,
    },
    silent=_NOT_OF_A_TREE,
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
    place="deliver",
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
    silent=OF_TREES | {"base_rows", "corrected_share", "c", "gamma"},
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
    place="deliver",
)
TRAIN_COARSE_FOREST = replace(
    TRAIN_FOREST, name=TRAIN_COARSE, when=lambda plan: forest_learns(plan) and _two_layers(plan), place="store"
)
TRAIN_COARSE_BASELINE = replace(
    TRAIN_BASELINE,
    name=TRAIN_COARSE,
    when=lambda plan: trains(plan) and _two_layers(plan) and not forest_learns(plan),
    place="store",
)
