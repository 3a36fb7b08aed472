"""What every workflow begins with: echoes in tiles, then their heights, features, radiometry and labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from fwclass.conf import Config
from fwclass.graph import ground, sources
from fwclass.graph import tiles as of_tiles
from fwclass.graph.layout import Layout, Survey
from fwclass.graph.quantities import check_learned, joint
from fwclass.graph.radiometry import Flown, flown_by, radiometry_tasks, trajectory_tasks
from fwclass.graph.reference import check_polygons
from fwclass.graph.survey import check_widths, gather
from fwclass.graph.thin import thin_tasks
from fwclass.run.runner import Runner, require_all, stop_if_nothing
from fwclass.run.tasks import Tasks


@dataclass(frozen=True)
class Tiled:
    """A survey whose echoes lie in tiles.

    `where`: which chunks, and which tiles, every strip's echoes came from; `flown`: when each trajectory was.
    """

    survey: Survey
    layout: Layout
    where: tuple[Mapping[int, tuple[str, ...]], Mapping[int, tuple[str, ...]]]
    flown: Flown


def until_tiles(
    config: Config, runner: Runner, names: tuple[str, ...], learned: Mapping[str, Any] | None = None
) -> Tiled:
    """Walk the stages up to the tiles; `names` are the columns that will be decided by, `learned` the card of the model
    that does."""
    survey = gather(config, runner)
    quantities = joint(survey.quantities, names, f"{config.path}: survey.sources")
    for note in check_learned(learned, survey.quantities, config.survey.model) if learned else ():
        runner.display.say(f"note: {note}")
    polygons = require_all(runner, sources.polygon_tasks(config, survey))
    indexed = require_all(runner, sources.index_tasks(config, survey.strips))
    survey = replace(survey, strips=tuple(s for s in survey.strips if sources.index_name(s) in indexed))
    chunks = sources.chunk_tasks(config, survey.strips, indexed)
    splits = runner.do(chunks + sources.cloud_tasks(config, survey.reference))
    check_widths(config, names, splits, runner.store)
    tiled = runner.do(sources.tile_tasks(config, splits))
    stop_if_nothing(runner, {name: receipt for name, receipt in tiled.items() if name[0] == "tile"})
    layout = replace(Layout.of(config, {**tiled, **polygons}), quantities=quantities)
    check_polygons(config, polygons.values(), layout.box)
    flights = trajectory_tasks(layout, survey)
    return Tiled(survey, layout, sources.where(chunks, splits), flown_by(flights, runner.do(flights)))


def until_labels(tiled: Tiled, names: tuple[str, ...]) -> Tasks:
    """Ground, heights, those of `names` that are features of a neighbourhood, radiometry; labels where there are."""
    layout = tiled.layout
    tasks = ground.ground_tasks(layout) + thin_tasks(layout) + of_tiles.feature_tasks(layout, names)
    tasks += radiometry_tasks(layout, tiled.flown)
    if layout.config.survey.reference.kind != "none":
        tasks += of_tiles.label_tasks(layout)
    return tasks
