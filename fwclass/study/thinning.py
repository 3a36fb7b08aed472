"""The thinning curve: what accuracy and time become if only a share of the echoes is classified."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fwclass.conf import Config
from fwclass.graph.stage import Plan
from fwclass.graph.stages import check_features
from fwclass.graph.walk import until_labels, until_tiles
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.select.score import Names
from fwclass.study.select.thinning import RATE, cost_task, plain_curve, rate_tasks


def thinning(config: Config, runner: Runner, names: Names) -> dict[str, Any]:
    """The curve over ``select.rates`` on the training areas, for a classifier by `names`; plain data."""
    config = replace(config, thin=config.thin.model_copy(update={"rate": 1.0}))  # all features are there then
    check_features(config, names, "survey.features or --candidates")
    plan = until_tiles(Plan(config, names, names), runner)
    layout = plan.layout
    rates = rate_tasks(layout, names)
    wanted = ancestors([*until_labels(plan), *rates], [t.name for t in rates])
    receipts = require_all(runner, wanted)
    boxes = config.areas.boxes("train")
    trained = [t for t in layout.tiles if any(t.box.touches(b) for b in boxes)]
    timing = cost_task(layout, max(trained, key=lambda t: _echoes(runner, t.key)), names)
    cost = require_all(runner, [timing])[timing.name].meta
    return plain_curve(config, names, {r: receipts[RATE, f"{r:g}"].meta for r in config.select.rates}, cost)


def _echoes(runner: Runner, key: str) -> int:
    receipt = runner.store.receipt("tile", key)
    return int(receipt.meta["rows"]) if receipt else 0
