"""Parts of radiometry: the trajectories, the comparison of strips, the calibration, every tile's columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import partial

from fwclass.errors import ConfigError
from fwclass.graph.layout import Layout, Survey, has_range, needs_of, plain
from fwclass.graph.work import radiometry
from fwclass.grid import Tile
from fwclass.radiometry.stage import CALIBRATE, OVERLAP, RADIOMETRY
from fwclass.run.part import Name, Task
from fwclass.run.tasks import Tasks
from fwclass.store.receipts import Receipt

Flown = Mapping[str, tuple[float, float]]
"""First and last time of every trajectory, on the survey's time scale [s]."""

TRAJECTORY_VERSION = 3
"""Raised when the same file would give other fixes."""

PROBES = 5
"""Tiles, about, whose beams are held against the trajectory before any range is taken from it."""


def radiometry_tasks(layout: Layout, flown: Flown) -> Tasks:
    """All parts of radiometry; none where nothing tells how far the sensor was.

    A tile reads the trajectories that were flown while a strip passed it, so another one leaves it alone.
    """
    config = layout.config
    if not has_range(config):
        return Tasks()
    _check_altitude(layout)
    probed = _pointing_tasks(layout, flown)
    checked: tuple[Name, ...] = tuple(t.name for t in probed)
    columns = layout.columns(RADIOMETRY.reads)
    compared = config.radiometry.balance or config.radiometry.target is not None
    params = plain(config.radiometry)
    halo, here = OVERLAP.halo(config.radiometry), layout.keys

    def overlapping(tile: Tile) -> Task:
        within = tile.box.grown(halo)
        present = layout.around(within, here)
        flights = _flights(layout, flown, present)
        return Task(
            "overlap",
            tile.key,
            OVERLAP.version,
            params,
            partial(radiometry.compared, tile, halo, columns, present, flights, config.radiometry),
            needs=(*needs_of(columns, present), *_needed(flights), *checked),
            within=within,
        )

    keys = tuple(t.key for t in layout.tiles) if compared else ()
    calibration = Task(
        "calibrate",
        "all",
        CALIBRATE.version,
        params,
        partial(radiometry.calibrated, keys, config.radiometry),
        needs=tuple(("overlap", k) for k in keys),
    )

    def measured(tile: Tile) -> Task:
        flights = _flights(layout, flown, (tile.key,))
        return Task(
            "radiometry",
            tile.key,
            RADIOMETRY.version,
            params,
            partial(radiometry.measured, tile, columns, flights, config.radiometry),
            needs=(*needs_of(columns, (tile.key,)), ("calibrate", "all"), *_needed(flights), *checked),
        )

    before = Tasks.held(probed) + Tasks.of("overlap", layout.tiles if compared else (), overlapping)
    return before + Tasks.held([calibration]) + Tasks.of("radiometry", layout.tiles, measured)


def _check_altitude(layout: Layout) -> None:
    """`ConfigError` for a platform below all echoes."""
    altitude = layout.config.radiometry.platform_altitude
    if altitude is not None and altitude <= layout.lowest:
        raise ConfigError(
            "the platform is below all echoes",
            where=f"{layout.config.path}: radiometry.platform_altitude",
            expected=f"more than {layout.lowest:.1f} m, the survey's lowest echo; it is no height above ground",
            got=f"{altitude:g} m",
            do="give the flight's height in the survey's height system",
        )


def trajectory_tasks(layout: Layout, survey: Survey) -> list[Task]:
    """One part for every file of the trajectory; they tell when it was flown, which the rest is planned by."""
    undulation, made = layout.config.survey.trajectory.undulation, []
    params = {"undulation": undulation, "crs": survey.crs, "times": layout.times}
    for file, digests in survey.trajectory:
        work = partial(radiometry.flown, file, survey.crs, undulation, layout.times)
        made.append(Task("trajectory", file.stem, TRAJECTORY_VERSION, params, work, external=digests))
    return made


def flown_by(tasks: Iterable[Task], done: Mapping[Name, Receipt]) -> Flown:
    """When each trajectory was flown; (-inf, inf) for one that could not be read."""
    found = {}
    for task in tasks:
        receipt = done.get(task.name)
        times = (receipt.meta["begins"][0], receipt.meta["ends"]) if receipt else (-math.inf, math.inf)
        found[task.part] = times
    return found


def _pointing_tasks(layout: Layout, flown: Flown) -> list[Task]:
    if not flown:
        return []
    probes = tuple(t.key for t in layout.tiles[:: max(1, len(layout.tiles) // PROBES)])
    flights = _flights(layout, flown, probes)
    work = partial(radiometry.pointing, flights, probes, layout.config.radiometry)
    needs = (*(("tile", key) for key in probes), *_needed(flights))
    return [Task("pointing", "all", 1, plain(layout.config.radiometry), work, needs=needs)] if flights else []


def _flights(layout: Layout, flown: Flown, tiles: Iterable[str]) -> tuple[str, ...]:
    """The trajectories that a strip over one of `tiles` may be told by."""
    gap = layout.config.radiometry.max_time_gap
    passes = [one for key in tiles for one in layout.passes[key]]
    return tuple(
        name
        for name, (begin, end) in flown.items()
        if any(begin <= last + gap and end >= first - gap for first, last in passes)
    )


def _needed(flights: Iterable[str]) -> tuple[Name, ...]:
    return tuple(("trajectory", name) for name in flights)
