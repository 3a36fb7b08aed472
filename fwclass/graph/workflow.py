"""What a workflow is: a list of stages, and the walk that binds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fwclass.conf import Config
from fwclass.graph.area_of_interest import Area
from fwclass.graph.stage import Stage
from fwclass.graph.stages import TO_TILES
from fwclass.graph.survey import SIMULATE
from fwclass.graph.walk import deciding, until_report, until_tiles
from fwclass.run.runner import Runner

Tiles = frozenset[str] | Area | None
"""What a run is restricted to: keys of tiles, an area of interest, or nothing."""

Walk = Callable[[Config, Runner, Tiles], dict[str, Any]]


@dataclass(frozen=True)
class Workflow:
    """A workflow by its name: `what` it is for, in one sentence, its `stages` in order, and the `walk` that binds them.

    Without a `walk` of its own it goes from files to tiles, makes all stages and writes the report.
    """

    name: str
    what: str
    stages: tuple[Stage, ...]
    walk: Walk | None = None

    def __call__(self, config: Config, runner: Runner, tiles: Tiles = None) -> dict[str, Any]:
        """Make all parts and write the report; return it. `tiles`: only these, and what they need."""
        if self.walk is not None:
            return self.walk(config, runner, tiles)
        plan = until_tiles(deciding(config, self.stages), runner, self.stages)
        return until_report(plan, runner, after_tiles(self.stages), tiles)


def after_tiles(stages: tuple[Stage, ...]) -> tuple[Stage, ...]:
    """The stages that are planned by the tiles."""
    before = {id(stage) for stage in (SIMULATE, *TO_TILES)}
    return tuple(stage for stage in stages if id(stage) not in before)
