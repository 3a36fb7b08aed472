"""Choosing the scales of a second layer on the training areas: forward, a scale at a time, in folds of squares."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fwclass.classify.shares import answer
from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.graph.fine_layer import FineLayer, fine_layer
from fwclass.graph.learn import fit_layer
from fwclass.graph.machine_search import folds_of_squares
from fwclass.graph.refine import MERGED
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.stages import LEARNING
from fwclass.graph.training_rows import load_sample
from fwclass.model import ClassDef
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.select.score import Names, Trial, score
from fwclass.select.search import forward
from fwclass.select.work import scale_of
from fwclass.study.select.cost import costs
from fwclass.study.select.result import plain_result, sets_to_time
from fwclass.study.select.sample import folding
from fwclass.study.select.trials import TRY_FEATURES
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.search import Folding, search
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.walk.steps import plan_with_features, tasks_of, tasks_until_labels, until_tiles

SCALES = "scales"
VERSION = 2


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
    trials = _Trials(plan, runner, layer)
    search_ = forward(trials.labels, trials, lambda t: score(t, np.ones(2), config.select.score), config.select)
    sampled = [t for t in plan.layout.tiles if runner.is_done("refine-sample", t.key)]
    tile = max(sampled, key=lambda t: (int(receipts["refine-sample", t.key].meta["rows"]), t.key))
    cost = costs(runner, plan, tile, sets_to_time(search_))
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
        "params": config.select.model_dump(mode="json"),
        "refine": config.classify.refine.model_dump(mode="json"),
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

    def __init__(self, plan: Plan, runner: Runner, layer: FineLayer) -> None:
        config = plan.config
        self.plan, self.runner = plan, runner
        self.labels: Names = tuple(n for n in config.classify.refine.shares if n.startswith("eigenvalue_1_"))
        self.sample, self.folding = load_folded(PartInputs(runner.store), layer.names, **_rows(plan))
        self._search_machine()

    def _search_machine(self) -> None:
        compare: CompareParams = self.plan.config.compare
        svm = compare.rbf_svm
        if not _rows(self.plan)["rows"] or len(svm.c) * len(svm.gamma) == 1:
            return
        best = require_all(self.runner, SEARCH_MACHINE.tasks(self.plan))[SEARCH_MACHINE.name, "all"].meta
        one = svm.model_copy(update={"c": (best["c"],), "gamma": (best["gamma"],)})
        config = replace(self.plan.config, compare=compare.model_copy(update={"rbf_svm": one}))
        self.plan = replace(self.plan, config=config)

    def __call__(self, subsets: Sequence[Names], ranked: bool = False) -> list[Trial]:
        folds = range(self.plan.config.select.folds)
        tasks = {(s, f): TRY_SCALES.task(self.plan, (s, f)) for s in subsets for f in folds}
        receipts = require_all(self.runner, list(tasks.values()))
        trials = []
        for s in subsets:
            matrices = np.array([receipts[tasks[s, f].name].meta["matrix"] for f in folds], np.int64)
            trials.append(Trial(s, matrices, None))
        return trials


def load_folded(
    inputs: PartInputs, names: Names, rows: int, block: float, gap: float, folds: int
) -> tuple[Sample, Folding]:
    """The second layer's training rows (`rows` of them, 0 for all), and their folds."""
    sample = load_sample(inputs, MERGED, "all", names)
    sample = fewer(sample, rows, block) if rows else sample
    return sample, folds_of_squares(block, gap).folding(sample, folds)


def search_machine(
    here: StageInputs, names: Names, rows: int, block: float, gap: float, folds: int, compare: CompareParams
) -> dict[str, Any]:
    """C and gamma with all scales."""
    sample, folded = load_folded(here.inputs, names, rows, block, gap, folds)
    return search(sample, folded, compare.rbf_svm, compare.scaling, None)


def try_scales(
    here: StageInputs,
    subset: Names,
    fold: int,
    names: Names,
    rows: int,
    block: float,
    gap: float,
    folds: int,
    train: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
) -> dict[str, Any]:
    """A second layer by some scales from the rows outside `fold`: its confusion matrix inside."""
    sample, folded = load_folded(here.inputs, names, rows, block, gap, folds)
    ends = {label.rpartition("_")[2] for label in subset}
    shares = ("eigenvalue_1_", "eigenvalue_2_", "eigenvalue_3_")
    at = [k for k, n in enumerate(sample.features) if not n.startswith(shares) or n.rpartition("_")[2] in ends]
    X = np.ascontiguousarray(sample.X[:, at])
    some = Sample(
        tuple(sample.features[k] for k in at), X, sample.y, sample.key, sample.hash, sample.eligible, place=sample.place
    )
    learns, held_out = some.take(folded.learns[fold]), some.take(np.asarray(folded.fold == fold))
    matrix = np.zeros((2, 2), np.int64)
    if (learns.counts > 0).all() and held_out.rows:
        model = fit_layer(learns, train, compare, classes, block, gap, on_trial=True)
        answers, _ = answer(held_out.X, model)
        np.add.at(matrix, (held_out.y, answers), 1)
    return {"matrix": matrix.tolist()}


def _rows(plan: Plan) -> dict[str, Any]:
    config = plan.config
    few = config.compare.rbf_svm.search_rows if config.classify.refine.method == "rbf-svm" else 0
    return {"rows": few, **folding(plan)}


def _arguments(plan: Plan) -> dict[str, Any]:
    layer = fine_layer(plan)
    return {"names": layer.names if layer else (), "compare": plan.config.compare, **_rows(plan)}


def _trial_arguments(plan: Plan) -> dict[str, Any]:
    config, refine = plan.config, plan.config.classify.refine
    return {
        **_arguments(plan),
        "train": config.train.model_copy(update={"method": refine.method, "trees": config.select.trees}),
        "classes": tuple(next(c for c in config.classes if c.name == name) for name in refine.between),
    }


SEARCH_MACHINE = Stage(
    "scale-machine",
    VERSION,
    "survey",
    "part",
    search_machine,
    arguments=_arguments,
    after=(MERGED,),
    needs=lambda plan, part: ((MERGED, "all"),),
)
TRY_SCALES = replace(
    TRY_FEATURES,
    name="scale-trial",
    version=VERSION,
    function=try_scales,
    arguments=_trial_arguments,
    after=(MERGED,),
    needs=lambda plan, part: ((MERGED, "all"),),
)
