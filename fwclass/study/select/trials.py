"""Cross-validation of sets of features, as parts: one forest per set and fold; a trial is made once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fwclass.classify.vote import walkable, winners
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.model import FORMAT, ClassDef, assemble
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.run.tasks import Tasks
from fwclass.select.score import Names, Trial, score
from fwclass.store.atomic import digest_of
from fwclass.study.select.sample import FOLD_SAMPLE, PLACE_ROWS, TRAINING, folding, selection_rows, training_of
from fwclass.train.importance import importance
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import TRAIN_TREES, grow_trees

VERSION = 2


class Trials:
    """`select.score.Evaluate` on a runner: sets × folds are parts that any worker can make. The plan's names are the
    candidates."""

    def __init__(self, runner: Runner, plan: Plan) -> None:
        self.runner, self.plan = runner, plan

    def __call__(self, subsets: Sequence[Names], ranked: bool = False) -> list[Trial]:
        """The trials of `subsets`, in their order."""
        folds, stage = range(self.plan.config.select.folds), RANK_FEATURES if ranked else TRY_FEATURES
        tasks = {(s, f): stage.task(self.plan, (s, f)) for s in subsets for f in folds}
        receipts = require_all(self.runner, list(tasks.values()))
        trials = []
        for s in subsets:
            metas = [receipts[tasks[s, f].name].meta for f in folds]
            weight = np.mean([m["importance"] for m in metas], axis=0) if ranked else None
            trials.append(Trial(s, np.array([m["matrix"] for m in metas], np.int64), weight))
        return trials


def cross_validate(plan: Plan, runner: Runner, before: Tasks) -> dict[str, Any]:
    """How a forest by the plan's names answers in squares of the training areas that it did not see; plain data, shares
    0 to 1.

    `before`: tasks until labels and features are there. `InputError` where the training areas have too few squares.
    """
    tasks = [*before, *PLACE_ROWS.tasks(plan), *FOLD_SAMPLE.tasks(plan)]
    meta = require_all(runner, ancestors(tasks, [(TRAINING, "all")]))[TRAINING, "all"].meta
    (trial,) = Trials(runner, plan)([plan.names])
    figures = score(trial, np.array(meta["eligible"]) / np.array(meta["counts"]), "overall").plain()
    return (
        {n: figures[n] for n in ("accuracy", "accuracy_std", "kappa", "kappa_std")}
        | folding(plan)
        | {"squares": meta["blocks"]}
    )


def try_features(
    here: StageInputs,
    subset: Names,
    fold: int,
    candidates: Names,
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    repeats: int = 0,
) -> dict[str, Any]:
    """A forest by `subset` from the rows outside `fold`: its confusion matrix inside, and its importances."""
    placed, folds = training_of(here.inputs, candidates)
    sample = columns_of(placed.sample, subset)
    training, judged = sample.take(folds.trains(fold)), folds.judged(fold)
    trees = grow_trees(training, classes, 0, params.trees, params)
    answers = predict(sample.X[judged], trees, subset, classes)
    n = len(classes)
    matrix = np.bincount(sample.y[judged].astype(np.int64) * n + answers, minlength=n * n).reshape(n, n)
    plain: dict[str, Any] = {"matrix": matrix.tolist()}
    if repeats:
        lost = importance(training, trees, n, params.drawing, repeats)
        plain["importance"] = np.asarray(lost, np.float64).mean(axis=1).tolist()
    return plain


def columns_of(sample: Sample, subset: Names) -> Sample:
    """The sample with only the columns of `subset`."""
    at = [sample.features.index(name) for name in subset]
    X = np.ascontiguousarray(sample.X[:, at])
    return Sample(subset, X, sample.y, sample.key, sample.hash, sample.eligible)


def predict(X: Any, trees: Any, names: Names, classes: Sequence[ClassDef]) -> Any:
    """Index of the class with most votes, int64 (rows,)."""
    card = {"format": FORMAT, "features": list(names), "classes": [c.plain() for c in classes]}
    if len(X) == 0:
        return np.empty(0, np.int64)
    return winners(X, walkable(assemble(trees, card))).astype(np.int64)


def _arguments(plan: Plan) -> dict[str, Any]:
    config = plan.config
    return {
        "candidates": plan.names,
        "params": config.train.model_copy(update={"trees": config.select.trees}),
        "classes": config.classes,
    }


def _part_name(part: tuple[Names, int]) -> str:
    subset, fold = part
    return f"{digest_of(list(subset))[:16]}-{fold:02d}"


TRY_FEATURES = Stage(
    "select-trial",
    VERSION * 1000 + TRAIN_TREES.version,
    "survey",
    "tree_row",
    try_features,
    parts=lambda plan: (),
    number=lambda plan: plan.config.select.folds * len(plan.names) * (len(plan.names) + 1) // 2,
    load=lambda plan: selection_rows(plan.config) * plan.config.select.trees,
    part_name=_part_name,
    arguments=_arguments,
    each=lambda plan, part: {"subset": part[0], "fold": part[1]},
    after=(TRAINING,),
    needs=lambda plan, part: ((TRAINING, "all"),),
)
"""A part is a set of features and a fold; which sets there are the search decides: forward, so many at most."""
RANK_FEATURES = replace(
    TRY_FEATURES,
    name="select-ranked",
    number=lambda plan: plan.config.select.folds * len(plan.names),
    arguments=lambda plan: {**_arguments(plan), "repeats": plan.config.select.repeats},
)
"""Likewise, with the importance of every feature; backward, a set for every size at most."""
