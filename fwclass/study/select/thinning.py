"""Accuracy and time if a share of the echoes is classified (Xiong 2018), in spatial folds of the training areas."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.features.names import Asked
from fwclass.features.stage import FEATURE_COMPUTATION, features
from fwclass.graph.areas import within
from fwclass.graph.stage import Plan
from fwclass.graph.stages import check_features
from fwclass.grid import Box, Tile
from fwclass.model import ClassDef, class_index, sample_matrix
from fwclass.publish.selection_curves import draw_rates
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Task
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.schema import Table, canonical_key
from fwclass.select.folds import check_folds, spatial_folds
from fwclass.select.params import SelectParams
from fwclass.select.score import Names, Trial, as_good, score
from fwclass.stage import Chunk
from fwclass.store.atomic import digest_of
from fwclass.study.keys import needs_of, plain, plain_classes
from fwclass.study.select.cost import computed_names, microseconds
from fwclass.study.select.sample import require_own_labels
from fwclass.study.select.trials import predict
from fwclass.survey.layout import Layout
from fwclass.thin.follow import index_of_followed
from fwclass.thin.params import ThinParams
from fwclass.thin.sample import THIN, covering, uniform
from fwclass.train.params import TrainParams
from fwclass.train.stage import TRAIN_TREES, candidates, grow_trees
from fwclass.walk.steps import tasks_until_labels, until_tiles

THINNING = "thinning"
RATE, RATE_COST = "select-rate", "select-rate-cost"
"""Stages: a rate's folds, and what features cost at every rate."""

_FEW = 50
"""Echoes that kernels are warmed up on before they are timed."""

_TABLE = dict.fromkeys(("strip", "pulse", "echo_number", "x", "y", "z"), "tile")


def rate_tasks(layout: Layout, names: Names) -> list[Task]:
    """A part per rate, and the timing of the features."""
    config = layout.config
    boxes = config.areas.boxes("train")
    columns = layout.columns(names)
    train = config.train.model_copy(update={"trees": config.select.trees})
    chosen = tuple(t for t in layout.tiles if any(t.box.touches(b) for b in boxes))
    needs = tuple(n for t in chosen for n in needs_of({**columns, "reference": "label"}, (t.key,)))
    params = {
        **plain(train),
        "select": plain(config.select),
        "classes": plain_classes(config),
        "features": list(names),
        "areas": [list(b.bounds) for b in boxes],
    }
    keys, version, tasks = tuple(t.key for t in chosen), 1000 * THIN.version + TRAIN_TREES.version, []
    for rate in config.select.rates:
        thin = config.thin.model_copy(update={"rate": rate})
        work = partial(at_rate, keys, columns, names, boxes, thin, train, config.select, config.classes)
        tasks.append(Task(RATE, f"{rate:g}", version, {**params, "thin": plain(thin)}, work, needs))
    return tasks


def cost_task(layout: Layout, tile: Tile, names: Names) -> Task:
    """How long features take for a share of a tile's echoes, at every rate."""
    config = layout.config
    names = computed_names(names)
    asked = Asked.of(names)
    around = config.features.model_copy(update={"noise_counts": True})  # candidates may need no filter of it
    halo = asked.halo(around)
    columns = layout.columns(asked.columns(around))
    present = layout.around(tile.box.grown(halo), layout.keys)
    params = {**around.model_dump(mode="json"), "select": plain(config.select), "names": list(names)}
    work = partial(_time_rates, tile, halo, columns, present, names, around, config.select)
    return Task(
        RATE_COST, digest_of(params)[:16], FEATURE_COMPUTATION.version, params, work, needs=needs_of(columns, present)
    )


def _time_rates(
    tile: Tile,
    halo: float,
    columns: Mapping[str, str],
    present: tuple[str, ...],
    names: Names,
    params: Any,
    select: SelectParams,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    whole = inputs.chunk(tile, halo, columns, present)
    echoes = whole.core[: select.timing_echoes]
    works = []
    for rate in select.rates:
        core = echoes[np.floor(np.arange(0, len(echoes), 1.0 / rate)).astype(np.int64)]
        works.append(partial(features, Chunk(whole.table, core, tile), names, params))
    return {"microseconds": microseconds(works, select.timing_repeats, len(echoes))}


def at_rate(
    tiles: tuple[str, ...],
    columns: Mapping[str, str],
    names: Names,
    boxes: tuple[Box, ...],
    thin: ThinParams,
    train: TrainParams,
    select: SelectParams,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Labelled echoes of the training areas, thinned; every block classified by a forest of the other folds' sample,
    and every echo by its nearest sampled one."""
    table = _read_labelled(tiles, columns, boxes, classes, inputs)
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
            some, table["reference"][rows], canonical_key(table)[rows], folds.trains(f)[rows], train, classes
        )
        trained.append(sample.rows)
        if f == 0:  # untimed: what is compiled at its first call
            predict(X[:1], grow_trees(sample, classes, 0, 1, train), names, classes)
        began = time.process_time()
        trees = grow_trees(sample, classes, 0, train.trees, train)
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


def _read_labelled(
    tiles: tuple[str, ...],
    columns: Mapping[str, str],
    boxes: tuple[Box, ...],
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
) -> Table:
    """Labelled rows of the training areas, in canonical order."""
    wanted = {**_TABLE, **columns, "reference": "label"}
    parts = []
    for key in tiles:
        table = inputs.rows(key, wanted).select(wanted)
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
    return measure_rates(config, runner, plan.layout, names, tasks_until_labels(plan))


def measure_rates(
    config: Config, runner: Runner, layout: Layout, names: Names, labels: Sequence[Task] = ()
) -> dict[str, Any]:
    """The same where the tiles are there; `labels` are the tasks until all labels are, where they may not be."""
    rates = rate_tasks(layout, names)
    receipts = require_all(runner, ancestors([*labels, *rates], [t.name for t in rates]))
    boxes = config.areas.boxes("train")
    trained = [t for t in layout.tiles if any(t.box.touches(b) for b in boxes)]
    largest = max(trained, key=lambda t: (runner.store.rows("tile", t.key), t.key))
    timing = cost_task(layout, largest, names)
    cost = require_all(runner, [timing])[timing.name].meta
    return plain_curve(config, names, {r: receipts[RATE, f"{r:g}"].meta for r in config.select.rates}, cost)


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
        "params": plain(config.select),
        "thin": plain(config.thin),
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
