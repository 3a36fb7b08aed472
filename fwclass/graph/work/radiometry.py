"""Work of the parts of radiometry: the trajectory, the comparison of strips, the calibration, the columns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.grid import Tile
from fwclass.radiometry.stage import (
    Calibration,
    Overlap,
    RadiometryParams,
    calibrate,
    check_pointing,
    overlap,
    pointing_error,
    radiometry,
)
from fwclass.read.trajectory import in_survey_time, read_trajectory, thinned
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.schema import Table
from fwclass.stage import Chunk
from fwclass.store.arrays import write_arrays
from fwclass.store.atomic import read_json, write_json
from fwclass.store.remote_file import Location
from fwclass.store.tables import write_table

_POINTING = ("x", "y", "z", "gps_time", "beam_x", "beam_y", "beam_z")
COUNTS, CALIBRATION = "counts.zarr", "calibration.json"
SPACING = 0.1
"""Fixes closer than this [s] are thinned: a platform that turns at 2 m/s2 is 3 mm off its chord."""
FIXES = 8192
"""Fixes in a row group: some minutes of flight."""


def flown(
    file: Location, crs: str | None, undulation: float, times: tuple[float, float], inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """A file's trajectory on the time scale of a survey of `times`, sorted by time."""
    path = inputs.local(file)
    table = in_survey_time(thinned(read_trajectory(path, crs, undulation), SPACING), *times, where=path)
    write_table(directory / TABLE, table, FIXES)
    at = table["gps_time"]
    return {"fixes": table.rows, "begins": at[::FIXES].tolist(), "ends": float(at[-1])}


def pointing(
    flights: tuple[str, ...], probes: tuple[str, ...], params: RadiometryParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Refuses a trajectory that the beams of the tiles `probes` do not come from."""
    echoes = Table.concat([inputs.table("tile", key, _POINTING) for key in probes])
    trajectory = _trajectory(inputs, flights, echoes["gps_time"])
    check_pointing(pointing_error(echoes, trajectory, params), ", ".join(flights))
    return {}


def _trajectory(inputs: PartInputs, flights: tuple[str, ...], times: Any) -> Table:
    """The fixes of `flights` around `times`: the row groups that hold them, and one on either side.

    Where two files have the same time, the first one's.
    """
    table = Table.concat([_around(inputs, flight, times[np.isfinite(times)]) for flight in flights])
    _, first = np.unique(table["gps_time"], return_index=True)
    return table.take(first)


def _around(inputs: PartInputs, flight: str, times: Any) -> Table:
    begins = np.array(inputs.meta("trajectory", flight)["begins"])
    at = np.unique(np.searchsorted(begins, times, side="right") - 1) if len(times) else np.empty(0, np.int64)
    wanted = {int(g) + d for g in at for d in (-1, 0, 1)}
    return inputs.groups("trajectory", flight, sorted(g for g in wanted if 0 <= g < len(begins)))


def compared(
    tile: Tile,
    halo: float,
    columns: Mapping[str, str],
    present: tuple[str, ...],
    flights: tuple[str, ...],
    params: RadiometryParams,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """What a tile says about the gains of its strips."""
    chunk = inputs.chunk(tile, halo, columns, present)
    trajectory = _trajectory(inputs, flights, chunk.table["gps_time"]) if flights else None
    found = overlap(chunk, trajectory, params)
    write_arrays(directory / COUNTS, found.arrays())
    return {}


def calibrated(tiles: tuple[str, ...], params: RadiometryParams, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """The gains of the strips and the constant of the survey."""
    found = calibrate((Overlap.from_arrays(inputs.arrays("overlap", t, COUNTS)[0]) for t in tiles), params)
    facts = found.to_json()
    write_json(directory / CALIBRATION, facts)
    return {"calibration": facts}


def measured(
    tile: Tile,
    columns: Mapping[str, str],
    flights: tuple[str, ...],
    params: RadiometryParams,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Radiometric columns of a tile's echoes."""
    chunk: Chunk = inputs.chunk(tile, 0.0, columns, (tile.key,))
    trajectory = _trajectory(inputs, flights, chunk.table["gps_time"]) if flights else None
    calibration = Calibration.from_json(read_json(inputs.path("calibrate", "all", CALIBRATION)))
    table = radiometry(chunk, trajectory, calibration, params)
    write_table(directory / TABLE, table)
    error = pointing_error(chunk.table, trajectory, params) if trajectory is not None else float("nan")
    return {
        "without_range": int(np.isnan(table["range"]).sum()),
        "pointing_error": error if np.isfinite(error) else None,
    }
