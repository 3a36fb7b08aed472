"""Parts of radiometry: the trajectory, the comparison of strips, the calibration, every tile's columns."""

from __future__ import annotations

from functools import partial

from fwclass.radiometry.stage import CALIBRATE, OVERLAP, RADIOMETRY
from fwclass.run.part import Name, Task
from fwclass.run.plan.layout import Layout, Survey, has_range, needs_of, plain
from fwclass.run.work import radiometry


def radiometry_tasks(layout: Layout, survey: Survey) -> list[Task]:
    """All parts of radiometry; none where nothing tells how far the sensor was."""
    config = layout.config
    if not has_range(config):
        return []
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


def _trajectory_tasks(layout: Layout, survey: Survey) -> list[Task]:
    if not survey.trajectory:
        return []
    undulation = layout.config.survey.trajectory.undulation
    files = tuple(path for path, _ in survey.trajectory)
    params = {"undulation": undulation, "crs": survey.crs, "times": layout.times}
    work = partial(radiometry.flown, files, survey.crs, undulation, layout.times)
    digests = tuple(d for _, some in survey.trajectory for d in some)
    return [Task("trajectory", "all", 1, params, work, external=digests)]
