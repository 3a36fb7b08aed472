"""Choosing features on the training areas: echoes to features of their tiles, then trials in spatial folds."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError, nearest
from fwclass.graph.stage import Plan
from fwclass.graph.stages import check_features
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.select.score import Names, Score, Trial, score
from fwclass.select.search import Search, backward, by_fscore, forward, in_given_order
from fwclass.study.select.cost import TIME_SETS, costs
from fwclass.study.select.result import plain_result, sets_to_time
from fwclass.study.select.sample import FOLD_SAMPLE, PLACE_ROWS, PLACED, TRAINING, require_own_labels, training_of
from fwclass.study.select.trials import RANK_FEATURES, TRY_FEATURES, Trials
from fwclass.walk.steps import tasks_until_labels, until_tiles

SELECTION = (PLACE_ROWS, FOLD_SAMPLE, TRY_FEATURES, TIME_SETS)
ELIMINATION = (PLACE_ROWS, FOLD_SAMPLE, RANK_FEATURES, TIME_SETS)
"""Stages by which features are chosen: forward, and backward by their importance."""


def selection(
    config: Config,
    runner: Runner,
    candidates: Names,
    method: str,
    order: Names = (),
    pick: str = "best",
    computed: Names = (),
) -> dict[str, Any]:
    """Choose among `candidates` by `method` (forward, rffs, fscore) on the training areas alone; plain data.

    `order`: forward adds the features in this order. `pick`: see `result.PICKS`. `computed`: all features that the run
    computes, where these are more: its tables have them in any case. Nothing of a test area is read but the
    neighbours of training echoes.
    """
    began = time.perf_counter()
    _check(config, candidates, order)
    plan, meta = training(config, runner, candidates, computed or candidates)
    useful = tuple(c for c in candidates if c not in meta["useless"])
    if not useful:
        raise InputError(
            "no candidate tells anything apart",
            where="--candidates",
            got="; ".join(f"{n}: {why}" for n, why in meta["useless"].items()),
            do="see why the stages that compute them found nothing, or name others",
        )
    search = _search(plan, runner, useful, method, tuple(o for o in order if o in useful), meta)
    sampled = (t for t in plan.layout.tiles if runner.is_done(PLACED, t.key))
    tile = max(sampled, key=lambda t: runner.store.rows(PLACED, t.key))
    cost = costs(runner, plan, tile, sets_to_time(search))
    return {
        "method": method,
        "survey": config.survey.name,
        "candidates": list(candidates),
        "left_out": meta["useless"],
        "notes": meta["notes"],
        "order": list(order),
        "sample": {n: meta[n] for n in ("rows", "counts", "eligible", "blocks", "by_fold", "digest")},
        "classes": [c.name for c in config.classes],
        "params": config.select.model_dump(mode="json"),
        **plain_result(search, cost, pick),
        "timed_on": tile.key,
        "seconds": round(time.perf_counter() - began, 1),
    }


def training(config: Config, runner: Runner, names: Names, computed: Names) -> tuple[Plan, dict[str, Any]]:
    """Walk until the placed sample of the training areas is there, of `names` among `computed`; what it says."""
    plan = until_tiles(Plan(config, names, computed), runner)
    tasks = [*tasks_until_labels(plan), *PLACE_ROWS.tasks(plan), *FOLD_SAMPLE.tasks(plan)]
    receipts = require_all(runner, ancestors(tasks, [(TRAINING, "all")]))
    return plan, dict(receipts[TRAINING, "all"].meta)


def _search(plan: Plan, runner: Runner, useful: Names, method: str, order: Names, meta: dict[str, Any]) -> Search:
    config, candidates = plan.config, plan.names
    weights = np.array(meta["eligible"]) / np.array(meta["counts"])

    def scored(trial: Trial) -> Score:
        return score(trial, weights, config.select.score)

    trials = Trials(runner, plan)
    if method == "forward":
        return (
            in_given_order(order, useful, trials, scored) if order else forward(useful, trials, scored, config.select)
        )
    if method == "rffs":
        return backward(useful, trials, scored, config.select)
    sample = training_of(PartInputs(runner.store), candidates)[0].sample
    at = [candidates.index(c) for c in useful]
    return by_fscore(useful, sample.X[:, at], sample.y, trials, scored)


def _check(config: Config, candidates: Names, order: Sequence[str]) -> None:
    require_own_labels(config)
    check_features(config, candidates, "--candidates")
    twice = sorted({c for c in candidates if candidates.count(c) > 1})
    if twice:
        raise ConfigError("a candidate is named twice", where="--candidates", got=", ".join(twice))
    unknown = [o for o in order if o not in candidates]
    if unknown:
        raise ConfigError(
            "the order names a feature that is no candidate",
            where="--order",
            expected=", ".join(candidates),
            got=unknown[0],
            do=nearest(unknown[0], candidates),
        )
    if config.survey.reference.kind == "none" or not config.areas.train:
        raise ConfigError(
            "features are chosen on labelled training areas, and there are none",
            where=config.path,
            do="name a reference (survey.reference) and boxes (areas.train)",
        )


def with_selected(config: Config, runner: Runner) -> tuple[dict[str, Any], Config]:
    """The selection among the survey's features, as plain data, and `config` with the set that it chose."""
    choice = selection(config, runner, config.features_asked, "rffs")
    survey = config.survey.model_copy(update={"features": tuple(choice["chosen"])})
    return choice, replace(config, survey=survey, features=config.features.model_copy(update={"also": ()}))
