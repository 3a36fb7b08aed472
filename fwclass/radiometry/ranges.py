"""Where the sensor was, and how far every echo is from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.radiometry.params import RadiometryParams
from fwclass.schema import Table

BEAM = ("beam_x", "beam_y", "beam_z")


def ranges(echoes: Table, trajectory: Table | None, params: RadiometryParams) -> NDArray[np.float64]:
    """Distance from the sensor to every echo [m]; the first of these that is known, else NaN.

    1. `beam_range`, where the source tells the sensor's place;
    2. the distance from the trajectory's position at the echo's `gps_time`;
    3. (platform_altitude − z) / −beam_z, for a beam that points down from above the echo.
    """
    out = echoes["beam_range"].astype(np.float64)
    out[~(out > 0.0)] = np.nan
    if trajectory is not None:
        rows = np.flatnonzero(np.isnan(out))
        away = offsets(echoes, trajectory, rows, params.max_time_gap)
        out[rows] = np.sqrt((away**2).sum(axis=1))
        out[out == 0.0] = np.nan
    if params.platform_altitude is not None:
        down = -echoes["beam_z"].astype(np.float64)
        drop = params.platform_altitude - echoes["z"]
        plumb = np.isnan(out) & (down > 0.0) & (drop > 0.0)
        np.divide(drop, down, out=out, where=plumb)
    out[~np.isfinite(out)] = np.nan
    return out


def positions(trajectory: Table, gps_time: NDArray[np.float64], max_gap: float) -> NDArray[np.float64]:
    """Position at every time, shape (n, 3) [m]; NaN before the first and after the last fix, and in longer gaps.

    Linear between fixes: off by at most a Δt² / 8 at an acceleration a, 3 cm at 2 m/s² between fixes of 0.35 s.
    `trajectory` is sorted by `gps_time`, without repetitions, as `read_trajectory` gives it.
    """
    out = np.full((len(gps_time), 3), np.nan)
    at = trajectory["gps_time"]
    if len(at) == 0:
        return out
    after = np.searchsorted(at, gps_time, side="right")
    exact = (after > 0) & (at[np.maximum(after, 1) - 1] == gps_time)
    low = np.clip(after - 1, 0, len(at) - 1)
    high = np.clip(after, 0, len(at) - 1)
    gap = at[high] - at[low]
    inside = (after > 0) & (after < len(at)) & (gap > 0.0) & (gap <= max_gap)
    share = np.divide(gps_time - at[low], gap, out=np.zeros(len(gap)), where=inside)
    known = inside | exact
    for k, axis in enumerate("xyz"):
        place = trajectory[axis]
        out[known, k] = (place[low] + share * (place[high] - place[low]))[known]
    return out


ASTRAY = 10.0
"""Angle between beams and the lines to the trajectory [deg] above which they do not belong together; below it a clock
of another time scale (18 s are some degrees) is still told by the angle alone."""


def check_pointing(angle: float, where: object) -> None:
    """`InputError` where `pointing_error` [degrees] says that a trajectory cannot be the survey's."""
    if angle > ASTRAY:
        raise InputError(
            "the trajectory does not belong to the survey: the beams do not come from it",
            where=where,
            expected=f"beams and lines from the trajectory within {ASTRAY:g} degrees (median)",
            got=f"{angle:.1f} degrees",
            do="check the trajectory's coordinate system and the survey's, its axes and units, its heights, its times",
        )


def with_beams(echoes: Table, trajectory: Table | None, params: RadiometryParams) -> Table:
    """`echoes` with beams along the line from the trajectory where their source has none, as points without waveforms
    do; a position at their time is all that is needed."""
    missing = np.flatnonzero(~np.isfinite(np.stack([echoes[name] for name in BEAM], axis=1)).all(axis=1))
    if trajectory is None or not len(missing):
        return echoes
    away = offsets(echoes, trajectory, missing, params.max_time_gap)
    with np.errstate(invalid="ignore", divide="ignore"):
        away /= np.sqrt((away**2).sum(axis=1, keepdims=True))
    beams = {name: echoes[name].copy() for name in BEAM}
    for k, name in enumerate(BEAM):
        beams[name][missing] = away[:, k]
    return echoes.with_columns(beams)


def pointing_error(echoes: Table, trajectory: Table, params: RadiometryParams) -> float:
    """Median angle between the beams and the lines from trajectory to echoes [deg]; NaN where none can be compared.

    A trajectory that belongs to the survey gives a fraction of a degree (lever arm, attitude). Some degrees are the
    sign of another time scale (UTC is 18 s behind GPS), another height system or another CRS.
    """
    away = offsets(echoes, trajectory, np.arange(echoes.rows), params.max_time_gap)
    beam = np.stack([echoes[name] for name in BEAM], axis=1).astype(np.float64)
    across = np.sqrt((np.cross(beam, away) ** 2).sum(axis=1))
    angle = np.degrees(np.arctan2(across, (beam * away).sum(axis=1)))
    angle = angle[np.isfinite(angle)]
    return float(np.median(angle)) if len(angle) else float("nan")


def offsets(echoes: Table, trajectory: Table, rows: NDArray[np.int64], max_gap: float) -> NDArray[np.float64]:
    """From the sensor to the echoes `rows`, shape (n, 3) [m]."""
    at = positions(trajectory, echoes["gps_time"][rows], max_gap)
    return np.stack([echoes[axis][rows] for axis in "xyz"], axis=1) - at
