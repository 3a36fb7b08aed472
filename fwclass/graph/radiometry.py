"""Stages of radiometry: the trajectories, the comparison of strips, the calibration, every tile's columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.graph.stage import Flown, Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.radiometry.calibration import Calibration, calibrate
from fwclass.radiometry.overlap import Overlap, overlap
from fwclass.radiometry.params import RadiometryParams
from fwclass.radiometry.ranges import check_pointing, pointing_error
from fwclass.radiometry.soundness import strip_sums
from fwclass.radiometry.stage import CALIBRATE, OVERLAP, RADIOMETRY, radiometry
from fwclass.read.trajectory import in_survey_time, read_trajectory, thin_trajectory
from fwclass.run.inputs import TABLE
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.store.arrays import write_arrays
from fwclass.store.atomic import read_json, write_json
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import Location
from fwclass.store.tables import write_table
from fwclass.survey.layout import FileDigests, Layout
from fwclass.units import finite_or_none

_POINTING = ("x", "y", "z", "gps_time", "beam_x", "beam_y", "beam_z")
COUNTS, CALIBRATION = "counts", "calibration.json"
SPACING = 0.1
"""Fixes closer than this [s] are thinned: a platform that turns at 2 m/s2 is 3 mm off its chord."""
FIXES = 8192
"""Fixes in a row group: some minutes of flight."""
PROBES = 5
"""Tiles, about, whose beams are held against the trajectory before any range is taken from it."""


POINTS_ALONE = (".las", ".laz")
"""Sources that end so do not tell how far the sensor was; others, and patterns that leave it open, may."""


def has_range(config: Config) -> bool:
    """Something tells how far the sensor was: an altitude, a trajectory, or a format that knows the sensor's place."""
    known = config.radiometry.platform_altitude is not None or bool(config.survey.trajectory.files)
    return known or any(not p.lower().endswith(POINTS_ALONE) for p in config.survey.sources)


def check_altitude(layout: Layout) -> None:
    """`ConfigError` for a platform below all echoes."""
    altitude = layout.config.radiometry.platform_altitude
    if has_range(layout.config) and altitude is not None and altitude <= layout.lowest:
        raise ConfigError(
            "the platform is below all echoes",
            where=f"{layout.config.path}: radiometry.platform_altitude",
            expected=f"more than {layout.lowest:.1f} m, the survey's lowest echo; it is no height above ground",
            got=f"{altitude:g} m",
            do="give the flight's height in the survey's height system",
        )


def read_flight(here: StageInputs, crs: str | None, undulation: float, times: tuple[float, float]) -> Result:
    """A file's trajectory on the time scale of a survey of `times`, sorted by time."""
    table = flight_of(here.file(), crs, undulation, times)
    write_table(here.directory / TABLE, table, FIXES)
    at = table["gps_time"]
    return {"fixes": table.rows, "begins": at[::FIXES].tolist(), "ends": float(at[-1])}


def flight_of(path: Path, crs: Any, undulation: float, times: tuple[float, float]) -> Table:
    """The trajectory in the file at `path`, thinned to `SPACING`, on the time scale of a survey of `times` [s]."""
    return in_survey_time(thin_trajectory(read_trajectory(path, crs, undulation), SPACING), *times, where=path)


def flown_by(plan: Plan, receipts: Mapping[Name, Receipt]) -> Flown:
    """When each trajectory was flown; (-inf, inf) for one that could not be read."""
    known = {}
    for part in READ_TRAJECTORY.all_parts(plan):
        receipt = receipts.get((READ_TRAJECTORY.name, part.key))
        known[part.key] = (receipt.meta["begins"][0], receipt.meta["ends"]) if receipt else (-math.inf, math.inf)
    return known


def check_trajectories(here: StageInputs, params: RadiometryParams) -> Result:
    """Refuses a trajectory that the beams of some tiles do not come from."""
    echoes = Table.concat([here.inputs.table("tile", key, _POINTING) for key in here.parts("tile")])
    flights = here.parts("trajectory")
    check_pointing(pointing_error(echoes, _trajectory(here, echoes["gps_time"]), params), ", ".join(flights))
    return {}


def _trajectory(here: StageInputs, times: Any) -> Table:
    """The declared fixes around `times`: the row groups that hold them, and one on either side.

    Where two files have the same time, the first one's.
    """
    at = times[np.isfinite(times)]
    table = Table.concat([_around(here, flight, at) for flight in here.parts("trajectory")])
    _, first = np.unique(table["gps_time"], return_index=True)
    return table.take(first)


def _around(here: StageInputs, flight: str, times: Any) -> Table:
    begins = np.array(here.inputs.meta("trajectory", flight)["begins"])
    at = np.unique(np.searchsorted(begins, times, side="right") - 1) if len(times) else np.empty(0, np.int64)
    groups = {int(g) + d for g in at for d in (-1, 0, 1)}
    return here.inputs.groups("trajectory", flight, sorted(g for g in groups if 0 <= g < len(begins)))


def compare_strips(here: StageInputs, params: RadiometryParams) -> Result:
    """What a tile says about the gains of its strips."""
    chunk = here.chunk()
    trajectory = _trajectory(here, chunk.table["gps_time"]) if here.parts("trajectory") else None
    write_arrays(here.directory / COUNTS, overlap(chunk, trajectory, params).arrays())
    return {}


def calibrate_strips(here: StageInputs, params: RadiometryParams) -> Result:
    """The gains of the strips and the constant of the survey."""
    tiles = here.parts("overlap")
    calibration = calibrate((Overlap.from_arrays(here.inputs.arrays("overlap", t, COUNTS)[0]) for t in tiles), params)
    facts = calibration.to_json()
    write_json(here.directory / CALIBRATION, facts)
    return {"calibration": facts}


def measure_radiometry(here: StageInputs, params: RadiometryParams) -> Result:
    """Radiometric columns of a tile's echoes."""
    chunk = here.chunk()
    trajectory = _trajectory(here, chunk.table["gps_time"]) if here.parts("trajectory") else None
    calibration = Calibration.from_json(read_json(here.inputs.path("calibrate", "all", CALIBRATION)))
    table = radiometry(chunk, trajectory, calibration, params)
    error = pointing_error(chunk.table, trajectory, params) if trajectory is not None else float("nan")
    own = chunk.table.select((*_POINTING, "strip")).take(chunk.core)
    return table, {
        "sums": strip_sums(own, trajectory, table, np.isfinite(own["beam_x"]), params),
        "without_range": int(np.isnan(table["range"]).sum()),
        "pointing_error": finite_or_none(error),
    }


@dataclass(frozen=True)
class _Flight:
    """A file of the trajectory."""

    key: str
    path: Location
    digests: FileDigests


def _params(plan: Plan) -> Mapping[str, Any]:
    return {"params": plan.config.radiometry}


def _has_range(plan: Plan) -> bool:
    return has_range(plan.config)


def _compares(plan: Plan) -> bool:
    wanted = plan.config.radiometry.balance or plan.config.radiometry.target is not None
    return has_range(plan.config) and wanted


def _over(plan: Plan, tiles: Iterable[str]) -> list[Name]:
    """The trajectories that a strip over one of `tiles` may be told by: another one leaves them alone."""
    gap = plan.config.radiometry.max_time_gap
    passes = [one for key in tiles for one in plan.layout.passes[key]]
    return [
        ("trajectory", name)
        for name, (begin, end) in plan.flown.items()
        if any(begin <= last + gap and end >= first - gap for first, last in passes)
    ]


def _probes(plan: Plan) -> tuple[str, ...]:
    tiles = plan.layout.tiles
    return tuple(t.key for t in tiles[:: max(1, len(tiles) // PROBES)])


def has_pointing(plan: Plan) -> bool:
    """Some trajectory was flown over the probes, and its beams can be held against it; asked once for a plan."""
    return has_range(plan.config) and bool(plan.flown) and bool(_over(plan, _probes(plan)))


def _pointing_parts(plan: Plan) -> list[Name]:
    return [("pointing", "all")] if plan.pointing else []


def _overlap_needs(plan: Plan, tile: Any) -> list[Name]:
    box = tile.box.grown(OVERLAP.halo(plan.config.radiometry))
    return [*_over(plan, plan.layout.around(box, plan.layout.keys)), *_pointing_parts(plan)]


READ_TRAJECTORY = Stage(
    "trajectory",
    3,
    "file",
    "part",
    read_flight,
    when=lambda plan: bool(plan.config.survey.trajectory.files),
    parts=lambda plan: [_Flight(path.stem, path, digests) for path, digests in plan.survey.trajectory],
    after=("tile",),
    arguments=lambda plan: {
        "crs": plan.survey.crs,
        "undulation": plan.config.survey.trajectory.undulation,
        "times": plan.layout.times,
    },
    source=lambda plan, part: (part.path, part.digests),
)
CHECK_POINTING = Stage(
    "pointing",
    1,
    "survey",
    "part",
    check_trajectories,
    when=lambda plan: bool(plan.config.survey.trajectory.files) if plan.tiled is None else plan.pointing,
    arguments=_params,
    after=("tile", "trajectory"),
    needs=lambda plan, part: [*(("tile", key) for key in _probes(plan)), *_over(plan, _probes(plan))],
)
COMPARE_STRIPS = Stage(
    OVERLAP.name,
    OVERLAP.version,
    "tile",
    "echo",
    compare_strips,
    when=_compares,
    arguments=_params,
    reads=OVERLAP.reads,
    halo=lambda plan: OVERLAP.halo(plan.config.radiometry),
    after=("trajectory", "pointing"),
    needs=_overlap_needs,
)
CALIBRATE_STRIPS = Stage(
    CALIBRATE.name,
    CALIBRATE.version,
    "survey",
    "part",
    calibrate_strips,
    when=_has_range,
    arguments=_params,
    after=("overlap",),
    needs=lambda plan, part: [("overlap", t.key) for t in COMPARE_STRIPS.all_parts(plan)],
)
MEASURE_RADIOMETRY = Stage(
    RADIOMETRY.name,
    RADIOMETRY.version,
    "tile",
    "echo",
    measure_radiometry,
    when=_has_range,
    arguments=_params,
    own=RADIOMETRY.reads,
    writes=RADIOMETRY.writes,
    after=("calibrate", "trajectory", "pointing"),
    needs=lambda plan, tile: [(CALIBRATE.name, "all"), *_over(plan, (tile.key,)), *_pointing_parts(plan)],
)
