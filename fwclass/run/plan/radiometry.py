"""Parts of radiometry: the trajectory, the comparison of strips, the calibration, every tile's columns."""

from __future__ import annotations

from functools import partial

from fwclass.errors import ConfigError
from fwclass.radiometry.stage import CALIBRATE, OVERLAP, RADIOMETRY
from fwclass.run.part import Name, Task
from fwclass.run.plan.layout import Layout, Survey, has_range, needs_of, plain
from fwclass.run.work import radiometry

PROBES = 5
"""Tiles, about, whose beams are held against the trajectory before any range is taken from it."""


def radiometry_tasks(layout: Layout, survey: Survey) -> list[Task]:
    """All parts of radiometry; none where nothing tells how far the sensor was."""
    config = layout.config
    if not has_range(config):
        return []
    _check_altitude(layout)
    made = _trajectory_tasks(layout, survey)
    flown: tuple[Name, ...] = tuple(t.name for t in made)
    columns = layout.columns(RADIOMETRY.reads)
    compared = config.radiometry.balance or config.radiometry.target is not None
    params = plain(config.radiometry)
    if compared:
        halo = OVERLAP.halo(config.radiometry)
        for tile in layout.tiles:
            present = layout.around(tile.box.grown(halo), layout.keys)
            made.append(
                Task(
                    "overlap", tile.key, OVERLAP.version, params,
                    partial(radiometry.compared, tile, halo, columns, present, bool(flown), config.radiometry),
                    needs=(*needs_of(columns, present), *flown),
                )
            )  # fmt: skip
    keys = tuple(t.key for t in layout.tiles) if compared else ()
    made.append(
        Task(
            "calibrate", "all", CALIBRATE.version, params, partial(radiometry.calibrated, keys, config.radiometry),
            needs=tuple(("overlap", k) for k in keys),
        )
    )  # fmt: skip
    for tile in layout.tiles:
        made.append(
            Task(
                "radiometry", tile.key, RADIOMETRY.version, params,
                partial(radiometry.measured, tile, columns, bool(flown), config.radiometry),
                needs=(*needs_of(columns, (tile.key,)), ("calibrate", "all"), *flown),
            )
        )  # fmt: skip
    return made


def _check_altitude(layout: Layout) -> None:
    """`ConfigError` for a platform below all echoes."""
    altitude = layout.config.radiometry.platform_altitude
    if altitude is not None and altitude <= layout.lowest:
        raise ConfigError(
            "the platform is below all echoes", where=f"{layout.config.path}: radiometry.platform_altitude",
            expected=f"more than {layout.lowest:.1f} m, the survey's lowest echo; it is no height above ground",
            got=f"{altitude:g} m", do="give the flight's height in the survey's height system",
        )  # fmt: skip


def _trajectory_tasks(layout: Layout, survey: Survey) -> list[Task]:
    if not survey.trajectory:
        return []
    undulation = layout.config.survey.trajectory.undulation
    files = tuple(path for path, _ in survey.trajectory)
    probes = tuple(t.key for t in layout.tiles[:: max(1, len(layout.tiles) // PROBES)])
    params = {"undulation": undulation, "crs": survey.crs, "times": layout.times, "probes": probes}
    work = partial(radiometry.flown, files, survey.crs, undulation, layout.times, probes, layout.config.radiometry)
    digests = tuple(d for _, some in survey.trajectory for d in some)
    needs = tuple(("tile", key) for key in probes)
    return [Task("trajectory", "all", 2, params, work, needs=needs, external=digests)]
