"""Accuracy and time if a share of the echoes is classified (Xiong 2018), in spatial folds of the training areas."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import features
from fwclass.graph.areas import IDENTITY_AND_PLACE, training_tiles, within
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.stages import check_features
from fwclass.graph.training_rows import sample_rows
from fwclass.grid import Box, Tile
from fwclass.model import ClassDef, class_index, sample_matrix
from fwclass.publish.selection_curves import draw_rates
from fwclass.run.part import Task
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.schema import Table, canonical_key
from fwclass.select.folds import check_folds, spatial_folds
from fwclass.select.params import SelectParams
from fwclass.select.score import Names, Trial, as_good, score
from fwclass.stage import Chunk
from fwclass.study.select.cost import TIME_SETS, computed_names, microseconds, on_tile
from fwclass.study.select.sample import require_own_labels
from fwclass.study.select.trials import predict
from fwclass.thin.follow import index_of_followed
from fwclass.thin.params import ThinParams
from fwclass.thin.sample import THIN, covering, uniform
from fwclass.train.params import TrainParams
from fwclass.train.stage import TRAIN_TREES, candidates, grow_trees
from fwclass.walk.steps import tasks_until_labels, until_tiles

THINNING = "thinning"
RATE = "select-rate"

_FEW = 50
"""Echoes that kernels are warmed up on before they are timed."""


def time_rates(
    here: StageInputs,
    params: FeaturesParams,
    tile: Tile,
    halo: float,
    names: Names,
    rates: tuple[float, ...],
    repeats: int,
    echoes: int,
) -> dict[str, Any]:
    """How long features take for a share of a tile's echoes, at every rate [us per echo]."""
    whole = here.inputs.chunk(tile, halo, here.columns, here.present)
    core = whole.core[:echoes]
    works = []
    for rate in rates:
        some = core[np.floor(np.arange(0, len(core), 1.0 / rate)).astype(np.int64)]
        works.append(partial(features, Chunk(whole.table, some, tile), names, params))
    return {"microseconds": microseconds(works, repeats, len(core))}


def at_rate(
    here: StageInputs,
    names: Names,
    areas: tuple[Box, ...],
    thin: ThinParams,
    params: TrainParams,
    select: SelectParams,
    classes: tuple[ClassDef, ...],
) -> dict[str, Any]:
    """Labelled echoes of the training areas, thinned; every block classified by a forest of the other folds' sample,
    and every echo by its nearest sampled one."""
    table = _read_labelled(here, areas, classes)
    x, y, z = (table[n] for n in "xyz")
    reference = class_index(table["reference"], classes).astype(np.uint8)
    folds = spatial_folds(x, y, reference, select.block, select.gap, select.folds)
    key = canonical_key(table)
    _warm(x, y, z, key, thin)
    began = time.process_time()
    sampled = covering(x, y, z, key, uniform(x, y, z, key, thin), thin.reach)
    seconds = {"sample": time.process_time() - began, "train": 0.0, "vote": 0.0}
    notes = check_folds(folds, np.where(sampled, reference, 255).astype(np.uint8), tuple(c.name for c in classes))
    rows = np.flatnonzero(sampled)
    some = table.select(names).take(rows)
    X = sample_matrix(some, names, THINNING)
    answers = np.zeros(len(rows), np.int64)
    trained = []
    for f in range(select.folds):
        judged = folds.judged(f)[rows]
        sample = candidates(
            some, table["reference"][rows], canonical_key(table)[rows], folds.trains(f)[rows], params, classes
        )
        trained.append(sample.rows)
        if f == 0:  # untimed: what is compiled at its first call
            predict(X[:1], grow_trees(sample, classes, 0, 1, params), names, classes)
        began = time.process_time()
        trees = grow_trees(sample, classes, 0, params.trees, params)
        seconds["train"] += time.process_time() - began
        began = time.process_time()
        answers[judged] = predict(X[judged], trees, names, classes)
        seconds["vote"] += time.process_time() - began
    began = time.process_time()
    followed = index_of_followed((x, y, z), sampled, thin.reach)
    seconds["follow"] = time.process_time() - began
    return {
        "matrices": _matrices(reference, answers[followed], folds.fold, select.folds, len(classes)),
        "rows": table.rows,
        "kept": len(rows),
        "trained": trained,
        "seconds": seconds,
        "notes": list(notes),
    }


def _warm(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], key: NDArray[np.uint64], thin: ThinParams
) -> None:
    """Thin a few echoes, untimed: what is compiled at its first call does not count."""
    x, y, z, key = x[:_FEW], y[:_FEW], z[:_FEW], key[:_FEW]
    covering(x, y, z, key, uniform(x, y, z, key, thin), thin.reach)
    index_of_followed((x, y, z), np.arange(len(x)) % 2 == 0, thin.reach)


def _read_labelled(here: StageInputs, boxes: tuple[Box, ...], classes: tuple[ClassDef, ...]) -> Table:
    """Labelled rows of the training areas, in canonical order."""
    parts = []
    for key in here.present:
        table = here.inputs.rows(key, here.columns)
        parts.append(table.take(within(table, boxes) & (class_index(table["reference"], classes) >= 0)))
    whole = Table.concat(parts)
    return whole.take(np.argsort(canonical_key(whole), kind="stable"))


def _matrices(
    reference: NDArray[np.uint8], answers: NDArray[np.int64], fold: NDArray[np.int16], folds: int, n: int
) -> list[list[list[int]]]:
    cell = (fold.astype(np.int64) * n + reference) * n + answers
    return np.bincount(cell, minlength=folds * n * n).reshape(folds, n, n).tolist()


def thinning(config: Config, runner: Runner, names: Names) -> dict[str, Any]:
    """The curve over ``select.rates`` on the training areas, for a classifier by `names`; plain data."""
    require_own_labels(config)
    config = replace(config, thin=config.thin.model_copy(update={"rate": 1.0}))  # all features are there then
    check_features(config, names, "survey.features or --candidates")
    plan = until_tiles(Plan(config, names, names), runner)
    return measure_rates(plan, runner, tasks_until_labels(plan))


def measure_rates(plan: Plan, runner: Runner, labels: Sequence[Task] = ()) -> dict[str, Any]:
    """The same where the tiles are there, for the plan's names; `labels` are the tasks until all labels are, where they
    may not be."""
    config, select = plan.config, plan.config.select
    rates = AT_RATE.tasks(plan)
    receipts = require_all(runner, ancestors([*labels, *rates], [t.name for t in rates]))
    largest = max(training_tiles(plan), key=lambda t: (runner.store.rows("tile", t.key), t.key))
    names = computed_names(plan.names)
    more = {"names": names, "rates": select.rates, "repeats": select.timing_repeats, "echoes": select.timing_echoes}
    (timing,) = on_tile(TIME_RATES, plan, largest, names, more).tasks(plan)
    cost = require_all(runner, [timing])[timing.name].meta
    return plain_curve(config, plan.names, {r: receipts[RATE, f"{r:g}"].meta for r in select.rates}, cost)


def plain_curve(
    config: Any, names: Names, metas: Mapping[float, Mapping[str, Any]], cost: Mapping[str, Any]
) -> dict[str, Any]:
    """The curve: plain data."""
    steps, scores = [], []
    for rate, micro in zip(config.select.rates, cost["microseconds"], strict=True):
        meta = metas[rate]
        trial = Trial(names, np.array(meta["matrices"], np.int64))
        scores.append(score(trial, np.ones(len(config.classes)), config.select.score))
        plainly = scores[-1].plain()
        each = {n: round(1e6 * s / meta["rows"], 3) for n, s in meta["seconds"].items() if n != "train"}
        spent = {"features": micro, **each}
        steps.append(
            {
                "rate": rate,
                "kept": meta["kept"],
                "rows": meta["rows"],
                "trained": round(float(np.mean(meta["trained"]))),
                **{n: plainly[n] for n in ("accuracy", "accuracy_std", "kappa", "kappa_std", "folds")},
                "train_seconds": round(meta["seconds"]["train"] / config.select.folds, 3),
                "microseconds": {**spent, "total": round(sum(spent.values()), 3)},
            }
        )
    best = max(scores, key=lambda s: s.value)
    good = [r for r, s in zip(config.select.rates, scores, strict=True) if as_good(s, best)]
    notes = {f"rate {r:g}: {text}": None for r in config.select.rates for text in metas[r]["notes"]}
    return {
        "method": THINNING,
        "survey": config.survey.name,
        "features": list(names),
        "steps": steps,
        "lowest": min(good),
        "notes": list(notes),
        "params": config.select.model_dump(mode="json"),
        "thin": config.thin.model_dump(mode="json"),
    }


def setting(result: Mapping[str, Any]) -> str:
    """YAML for a configuration."""
    return f"thin:\n  rate: {result['lowest']:g}\n"


def describe_thinning(result: Mapping[str, Any]) -> str:
    """The curve as a table."""
    lines = [
        f"thinning: {result['steps'][0]['rows']:,} echoes of the training areas, {result['params']['folds']} folds",
        *(f"note: {text}" for text in result["notes"]),
        "",
        f"{'rate':>6} {'sampled':>9} {'trained':>8}  {'accuracy':>12}  {'kappa':>12}  {'train s':>8}  "
        "us/echo: features + vote + follow",
    ]
    for s in result["steps"]:
        acc, kappa = (f"{100 * s[n]:.1f} ± {100 * s[f'{n}_std']:.1f}" for n in ("accuracy", "kappa"))
        m = s["microseconds"]
        lines.append(
            f"{s['rate']:>6g} {s['kept']:>9,} {s['trained']:>8,}  {acc:>12}  {kappa:>12}  {s['train_seconds']:>8.2f}  "
            f"{m['total']:8.2f} = {m['features']:.2f} + {m['vote']:.2f} + {m['sample'] + m['follow']:.2f}"
        )
    lines.append(
        f"lowest rate that is as good as the best within one standard error: --set thin.rate={result['lowest']:g}"
    )
    return "\n".join(lines)


def draw(result: Mapping[str, Any]) -> bytes:
    """The picture of a thinning curve, PNG."""
    return draw_rates(result["steps"], result["lowest"], f"{result['survey']}: thinning (Xiong 2018)")


AT_RATE = Stage(
    RATE,
    1000 * THIN.version + TRAIN_TREES.version,
    "survey",
    "tree_row",
    at_rate,
    parts=lambda plan: plan.config.select.rates,
    load=lambda plan: plan.config.select.folds * sample_rows(plan.config) * plan.config.select.trees,
    part_name=lambda rate: f"{rate:g}",
    arguments=lambda plan: {
        "names": plan.names,
        "areas": plan.config.areas.boxes("train"),
        "params": plan.config.train.model_copy(update={"trees": plan.config.select.trees}),
        "select": plan.config.select,
        "classes": plan.config.classes,
    },
    each=lambda plan, rate: {"thin": plan.config.thin.model_copy(update={"rate": rate})},
    reads=lambda plan: (*IDENTITY_AND_PLACE, "z", *plan.names, "reference"),
    tiles=training_tiles,
)
TIME_RATES = replace(TIME_SETS, name="select-rate-cost", function=time_rates)
THINNING_STAGES = (AT_RATE, TIME_RATES)
