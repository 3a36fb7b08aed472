"""Choosing the scales of a second layer on the training areas: forward, a scale at a time, in folds of squares."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.classify.shares import answer
from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.graph.fine_layer import FineLayer, fine_layer
from fwclass.graph.learn import fit_layer
from fwclass.graph.machine_search import folds_of_squares
from fwclass.graph.refine import MERGED
from fwclass.graph.stages import LEARNING
from fwclass.graph.training_rows import load_sample
from fwclass.model import ClassDef
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Task
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.select.params import SelectParams
from fwclass.select.score import Names, Trial, score
from fwclass.select.search import forward
from fwclass.select.work import scale_of
from fwclass.store.atomic import digest_of
from fwclass.study.keys import plain
from fwclass.study.select.cost import costs
from fwclass.study.select.result import plain_result, sets_to_time
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.search import Folding, search
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.walk.steps import plan_with_features, tasks_of, tasks_until_labels, until_tiles

SCALES, MACHINE, TRIAL = "scales", "scale-machine", "scale-trial"
VERSION = 1


def scale_selection(config: Config, runner: Runner, pick: str = "best") -> dict[str, Any]:
    """Choose among ``classify.refine.scales`` on the second layer's training rows; plain data, as `selection` gives.

    A scale is named by its first share (``eigenvalue_1_r30`` is 0.3 m). C and gamma of an RBF SVM are searched once,
    with all scales.
    """
    began = time.perf_counter()
    if not config.classify.refine.between:
        raise ConfigError(
            "scales are chosen for a second layer, and there is none",
            where=f"{config.path}: classify.refine.between",
            do='--set "classify.refine.between=[building, vegetation]"',
        )
    plan = until_tiles(plan_with_features(config), runner)
    receipts = require_all(runner, ancestors(tasks_until_labels(plan) + tasks_of(plan, LEARNING), [(MERGED, "all")]))
    layer = fine_layer(plan)
    if layer is None:
        raise ConfigError("there is no second layer", where="classify.refine")
    trials = _Trials(config, runner, layer)
    search_ = forward(trials.labels, trials, lambda t: score(t, np.ones(2), config.select.score), config.select)
    sampled = [t for t in plan.layout.tiles if runner.is_done("refine-sample", t.key)]
    tile = max(sampled, key=lambda t: (int(receipts["refine-sample", t.key].meta["rows"]), t.key))
    cost = costs(runner, plan.layout, tile, sets_to_time(search_))
    sample = trials.sample
    result = plain_result(search_, cost, pick)
    return {
        "method": SCALES,
        "survey": config.survey.name,
        "candidates": list(trials.labels),
        "left_out": {},
        "notes": [trials.folding.note] if trials.folding.note else [],
        "sample": {
            "rows": sample.rows,
            "counts": sample.counts.tolist(),
            "eligible": sample.eligible.tolist(),
            "blocks": trials.folding.blocks,
            "digest": sample.digest,
        },
        "classes": list(config.classify.refine.between),
        "params": plain(config.select),
        "refine": plain(config.classify.refine),
        **result,
        "scales": [_metres(n) for n in result["chosen"]],
        "timed_on": tile.key,
        "seconds": round(time.perf_counter() - began, 1),
    }


def _metres(label: str) -> float:
    scale = scale_of(label)
    if scale is None:
        raise ValueError(f"{label} has no scale")
    return float(scale.metres)


class _Trials:
    """`select.score.Evaluate` of sets of scales: sets × folds are parts that any worker can make."""

    def __init__(self, config: Config, runner: Runner, layer: FineLayer) -> None:
        self.config, self.runner, self.layer = config, runner, layer
        refine = config.classify.refine
        self.labels: Names = tuple(n for n in refine.shares if n.startswith("eigenvalue_1_"))
        self.classes = tuple(next(c for c in config.classes if c.name == name) for name in refine.between)
        trees = {"method": refine.method, "trees": config.select.trees}
        self.train = config.train.model_copy(update=trees)
        self.rows = config.compare.rbf_svm.search_rows if refine.method == "rbf-svm" else 0
        self.sample, self.folding = load_folded(PartInputs(runner.store), layer, self.rows, config.select)
        self.compare = self._machine()

    def _machine(self) -> CompareParams:
        compare: CompareParams = self.config.compare
        svm = compare.rbf_svm
        if not self.rows or len(svm.c) * len(svm.gamma) == 1:
            return compare
        params = {"compare": plain(compare), **self._folds()}
        work = partial(search_machine, self.layer, self.rows, self.config.select, compare)
        meta = require_all(self.runner, [Task(MACHINE, "all", VERSION, params, work, needs=((MERGED, "all"),))])
        best = meta[MACHINE, "all"].meta
        one = svm.model_copy(update={"c": (best["c"],), "gamma": (best["gamma"],)})
        return compare.model_copy(update={"rbf_svm": one})

    def _folds(self) -> dict[str, Any]:
        return {n: plain(self.config.select)[n] for n in ("block", "gap", "folds")}

    def __call__(self, subsets: Sequence[Names], ranked: bool = False) -> list[Trial]:
        folds = range(self.config.select.folds)
        tasks = {(s, f): self._task(s, f) for s in subsets for f in folds}
        receipts = require_all(self.runner, list(tasks.values()))
        trials = []
        for s in subsets:
            matrices = np.array([receipts[tasks[s, f].name].meta["matrix"] for f in folds], np.int64)
            trials.append(Trial(s, matrices, None))
        return trials

    def _task(self, subset: Names, fold: int) -> Task:
        params = {"train": plain(self.train), "compare": plain(self.compare), "scales": list(subset), **self._folds()}
        work = partial(
            try_scales, subset, fold, self.layer, self.rows, self.config.select, self.train, self.compare, self.classes
        )
        part = f"{digest_of(list(subset))[:16]}-{fold:02d}"
        return Task(TRIAL, part, VERSION, params, work, needs=((MERGED, "all"),))


def load_folded(inputs: PartInputs, layer: FineLayer, rows: int, select: SelectParams) -> tuple[Sample, Folding]:
    """The second layer's training rows (`rows` of them, 0 for all), and their folds."""
    sample = load_sample(inputs, MERGED, "all", layer.names)
    sample = fewer(sample, rows, select.block) if rows else sample
    return sample, folds_of_squares(select.block, select.gap).folding(sample, select.folds)


def search_machine(
    layer: FineLayer, rows: int, select: SelectParams, compare: CompareParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """C and gamma with all scales."""
    sample, folding = load_folded(inputs, layer, rows, select)
    return search(sample, folding, compare.rbf_svm, compare.scaling, None)


def try_scales(
    subset: Names,
    fold: int,
    layer: FineLayer,
    rows: int,
    select: SelectParams,
    train: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """A second layer by some scales from the rows outside `fold`: its confusion matrix inside."""
    sample, folding = load_folded(inputs, layer, rows, select)
    ends = {label.rpartition("_")[2] for label in subset}
    shares = ("eigenvalue_1_", "eigenvalue_2_", "eigenvalue_3_")
    at = [k for k, n in enumerate(sample.features) if not n.startswith(shares) or n.rpartition("_")[2] in ends]
    names = tuple(sample.features[k] for k in at)
    X = np.ascontiguousarray(sample.X[:, at])
    some = Sample(names, X, sample.y, sample.key, sample.hash, sample.eligible, place=sample.place)
    learns, held_out = some.take(folding.learns[fold]), some.take(np.asarray(folding.fold == fold))
    matrix = np.zeros((2, 2), np.int64)
    if (learns.counts > 0).all() and held_out.rows:
        model = fit_layer(learns, train, compare, classes, select.block, select.gap, on_trial=True)
        answers, _ = answer(held_out.X, model)
        np.add.at(matrix, (held_out.y, answers), 1)
    return {"matrix": matrix.tolist()}
