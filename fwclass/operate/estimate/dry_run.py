"""A few tiles of a survey, the fullest ones, all the way to their files: what `fwclass plan --dry-run` measures."""

from __future__ import annotations

from fwclass.conf import Config
from fwclass.errors import InputError
from fwclass.graph.walk import deciding, until_report, until_tiles
from fwclass.graph.workflow import after_tiles
from fwclass.operate.estimate.trial import Trial, whole_tiles
from fwclass.run.runner import Runner
from workflows.classification import classification


def trial(asked: Trial, runner: Runner, count: int, halo: float) -> tuple[str, ...]:
    """Run the `count` tiles with most echoes of those that are whole; return their keys, the fullest first."""
    config: Config = asked.config
    plan = until_tiles(deciding(config), runner)
    tiles = plan.layout.tiles
    whole = whole_tiles([t.key for t in tiles], [t.box for t in tiles], asked.left, halo)
    if not whole:
        raise InputError(
            "no tile of the dry run is whole",
            where="--dry-run",
            got=f"{len(tiles)} tiles at the edges of its files",
            do="--dry-run with more tiles, or smaller tile.size",
        )
    chosen = tuple(sorted(whole, key=lambda key: (-_rows(runner, key), key))[:count])
    until_report(plan, runner, after_tiles(classification.stages), frozenset(chosen))
    return chosen


def _rows(runner: Runner, key: str) -> int:
    receipt = runner.store.receipt("tile", key)
    return int(receipt.meta["rows"]) if receipt else 0
