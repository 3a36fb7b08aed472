"""Cross-validation of sets of features, as parts: one forest per set and fold; a trial is made once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.classify.vote import walkable, winners
from fwclass.model import FORMAT, ClassDef, assemble
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Task
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.run.tasks import Tasks
from fwclass.select.score import Names, Trial, score
from fwclass.store.atomic import digest_of
from fwclass.study.keys import plain, plain_classes
from fwclass.study.select.sample import TRAINING, sample_tasks, training_of
from fwclass.survey.layout import Layout
from fwclass.train.importance import importance
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import TRAIN_TREES, grow_trees

TRIAL, RANKED = "select-trial", "select-ranked"
"""Stages: a trial, and one with importances."""

VERSION = 1


class Trials:
    """`select.score.Evaluate` on a runner: sets × folds are parts that any worker can make."""

    def __init__(self, runner: Runner, config: Any, candidates: Names) -> None:
        self.runner, self.config, self.candidates = runner, config, candidates
        self.train: TrainParams = config.train.model_copy(update={"trees": config.select.trees})

    def __call__(self, subsets: Sequence[Names], ranked: bool = False) -> list[Trial]:
        """The trials of `subsets`, in their order."""
        stage = RANKED if ranked else TRIAL
        tasks = {(s, f): self._task(stage, s, f) for s in subsets for f in range(self.config.select.folds)}
        receipts = require_all(self.runner, list(tasks.values()))
        trials = []
        for s in subsets:
            metas = [receipts[tasks[s, f].name].meta for f in range(self.config.select.folds)]
            weight = np.mean([m["importance"] for m in metas], axis=0) if ranked else None
            trials.append(Trial(s, np.array([m["matrix"] for m in metas], np.int64), weight))
        return trials

    def _task(self, stage: str, subset: Names, fold: int) -> Task:
        select = self.config.select
        folding = {n: plain(select)[n] for n in ("block", "gap", "folds")}
        params = {
            **plain(self.train),
            **folding,
            "classes": plain_classes(self.config),
            "features": list(subset),
            "repeats": select.repeats if stage == RANKED else None,
        }
        repeats = select.repeats if stage == RANKED else 0
        work = partial(try_features, subset, fold, self.candidates, self.train, self.config.classes, repeats)
        part = f"{digest_of(list(subset))[:16]}-{fold:02d}"
        return Task(stage, part, VERSION * 1000 + TRAIN_TREES.version, params, work, needs=((TRAINING, "all"),))


def cross_validate(config: Any, runner: Runner, layout: Layout, before: Tasks, names: Names) -> dict[str, Any]:
    """How a forest by `names` answers in squares of the training areas that it did not see; plain data, shares 0 to 1.

    `before`: tasks until labels and features are there. `InputError` where the training areas have too few squares.
    """
    tasks = [*before, *sample_tasks(layout, names)]
    meta = require_all(runner, ancestors(tasks, [(TRAINING, "all")]))[TRAINING, "all"].meta
    (trial,) = Trials(runner, config, names)([names])
    figures = score(trial, np.array(meta["eligible"]) / np.array(meta["counts"]), "overall").plain()
    folding = {n: plain(config.select)[n] for n in ("folds", "block", "gap")}
    return (
        {n: figures[n] for n in ("accuracy", "accuracy_std", "kappa", "kappa_std")}
        | folding
        | {"squares": meta["blocks"]}
    )


def try_features(
    subset: Names,
    fold: int,
    candidates: Names,
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    repeats: int,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """A forest by `subset` from the rows outside `fold`: its confusion matrix inside, and its importances."""
    placed, folds = training_of(inputs, candidates)
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
