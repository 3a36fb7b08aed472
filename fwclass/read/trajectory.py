"""Trajectories of the sensor: text tables and Applanix SBET files."""

from __future__ import annotations

import codecs
import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from fwclass.errors import InputError
from fwclass.formats.checks import cut_off
from fwclass.formats.last_line import check_last_line
from fwclass.paths import open_regular
from fwclass.schema import Table
from fwclass.units import ADJUSTED, GPS_WEEK, number_of

RECORD = np.dtype("<f8")
FIELDS = 17
"""Doubles of an SBET record: time, latitude, longitude, altitude, then velocities, attitude, rates."""

DAY = 86_400.0
"""s, no flight pauses for longer: times that fall back at the end of a week fall by a week, but for a pause."""

MAX_BYTES = 4 << 30
"""Largest file; ten hours at 200 Hz are 1 GB."""

FASTEST, JUMP = 500.0, 5.0
"""m/s and m: no aircraft that scans flies faster; fixes less than `JUMP` apart may have any times."""

AT_A_TIME = 65_536
"""Records of an SBET file that are read at once, 9 MB."""

HEAD_BYTES, HEAD_LINES = 65_536, 200
"""Where the heading of a text file is looked for."""

_NAMES = {
    "gps_time": ("gps_time", "gpstime", "time", "t", "gps_seconds", "gpssec", "sow", "seconds_of_week"),
    "x": ("x", "easting", "east", "e"),
    "y": ("y", "northing", "north", "n"),
    "z": ("z", "height", "h", "altitude", "alt", "elevation", "ellipsoid_height", "h_ell"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "long"),
}
_LINE = re.compile(r"\r\n|\r|\n")
_UNIT = re.compile(r"\[[^\]]*\]|\([^)]*\)")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")


def read_trajectory(path: Path, crs: Any = None, undulation: float = 0.0) -> Table:
    """Positions of the sensor over time: `gps_time` [s], `x`, `y`, `z` [m].

    Sorted by time; of fixes with equal times and places the first is kept; fixes with a missing number are left out.
    Between them nothing is made up: long gaps stay gaps.

    Two kinds of file are told by their content:

    - Text, separated by commas, semicolons, tabs or blanks. Either a heading names the columns (a time; x, y, z or
      easting, northing, height; or latitude and longitude in degrees with a height), or every line begins with time,
      x, y, z. Lines before the heading, comments (#) and further columns are passed over.
    - SBET, 17 little-endian doubles a record, angles in radians. Times that fall back to 0 at the end of a GPS week
      run on; such that fall back elsewhere are refused, as none of a flight do.

    Parameters
    ----------
    crs : what `pyproj.CRS` takes; the survey's CRS, needed where the file has latitude and longitude (WGS 84; within
        a metre the same as ITRF and ETRS89). x, y, z are taken to be in it already.
    undulation : height of the survey's zero above the ellipsoid [m], taken from all heights; the geoid's where the
        survey has heights above sea level and the trajectory ellipsoidal ones. Do not forget it: 47 m at a flying
        height of 370 m change R⁴ by 60 %.

    `InputError`: not such a file, truncated, too large, no usable fix, times that fall back (SBET), geographic without
    `crs`, or fixes that lie apart further than an aircraft flies in the time between them.
    """
    path = Path(path)
    size = path.stat().st_size
    if size == 0 or size > MAX_BYTES:
        raise InputError("an empty or too large file", where=path, expected=f"1 to {MAX_BYTES} bytes", got=size)
    with open_regular(path) as file:
        head = file.read(min(size, HEAD_BYTES))
    time, a, b, z, geographic = _text(path, head) if _CONTROL.search(head) is None else _sbet(path, size)
    known = np.isfinite(time) & np.isfinite(a) & np.isfinite(b) & np.isfinite(z)
    time, a, b, z = time[known], a[known], b[known], z[known]
    if len(time) == 0:
        raise InputError("no usable fix in the trajectory", where=path, expected="rows of time, x, y, z")
    if geographic:
        a, b, z = _project(a, b, z, crs, path)
    _require_one_flight(path, time, a, b)
    _, first = np.unique(time, return_index=True)
    return Table({"gps_time": time[first], "x": a[first], "y": b[first], "z": z[first] - undulation})


def _require_one_flight(path: Path, time: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    """`InputError` where the fixes, by their times, jump: two flights, or two sensors, with the same times."""
    order = np.argsort(time, kind="stable")
    step = np.hypot(np.diff(x[order]), np.diff(y[order]))
    jumps = np.flatnonzero((step > JUMP) & (step > FASTEST * np.diff(time[order])))
    if not len(jumps):
        return
    before, after = order[jumps[0]], order[jumps[0] + 1]
    raise InputError(
        "the trajectory is at two places at one time",
        where=path,
        expected=f"fixes that an aircraft reaches one after the other, at {FASTEST:g} m/s or less",
        got=f"{len(jumps)} jumps; the first of {step[jumps[0]]:,.1f} m from {time[before]:.3f} to {time[after]:.3f} s",
        do="give every flight, and every sensor, a file of its own (survey.trajectory.files), or take the outliers out",
    )


def thin_trajectory(trajectory: Table, spacing: float) -> Table:
    """`trajectory` with about two fixes per `spacing` seconds: the first and the last of every slot of that length.

    The slots count from time 0, so it does not matter what else the trajectory holds; ends of gaps stay as they are. A
    platform that turns at 2 m/s² is 3 mm off its chord between fixes of 0.1 s.
    """
    slot = np.floor(trajectory["gps_time"] / spacing)
    change = np.diff(slot) > 0
    return trajectory.take(np.concatenate([[True], change]) | np.concatenate([change, [True]]))


def in_survey_time(trajectory: Table, first: float, last: float, where: object) -> Table:
    """`trajectory` on the time scale of a survey whose echoes lie in [first, last] (`gps_time`, [s]).

    LAS has two scales: seconds of the GPS week and adjusted standard GPS time. Trajectories have these or GPS seconds
    since 1980. If the times do not overlap as they stand, the trajectory is moved by the whole weeks, or the 10⁹ s,
    that bring it over the survey.

    `InputError`: nothing makes the times overlap, several weeks do, or the survey has no times.
    """
    if not (np.isfinite(first) and np.isfinite(last)) or last < first:
        raise InputError("the survey's echoes have no GPS times", where=where, do="give a platform altitude instead")
    begin, end = float(trajectory["gps_time"][0]), float(trajectory["gps_time"][-1])
    if end >= first and begin <= last:
        return trajectory
    fitting = [m for m in _moves(begin, end, first, last) if end + m >= first and begin + m <= last]
    if len(fitting) == 1:
        return trajectory.with_columns({"gps_time": trajectory["gps_time"] + fitting[0]})
    raise InputError(
        "several weeks of the survey fit the trajectory's seconds of the week"
        if fitting
        else "the trajectory and the survey have no time in common",
        where=where,
        expected=f"GPS times from {first:.3f} to {last:.3f} s (the survey's echoes)",
        got=f"{begin:.3f} to {end:.3f} s (the trajectory)",
        do="name the trajectory of this flight; its times must be GPS seconds of the week (of a survey flown within "
        "one), GPS seconds since 1980, or adjusted standard GPS time (not UTC, not Unix time)",
    )


def _moves(begin: float, end: float, first: float, last: float) -> list[float]:
    """Moves between the time scales that make sense for these times [s], ascending."""
    weekly = 2.0 * GPS_WEEK  # seconds of a week run on where a flight does
    moves = {-ADJUSTED}
    if begin >= 0.0 and end < weekly:  # to adjusted standard time
        low, high = ((t + ADJUSTED) // GPS_WEEK for t in (first, last))
        moves |= {(low + k) * GPS_WEEK - ADJUSTED for k in range(-1, int(min(high - low, 2.0)) + 1)}
    if first >= 0.0 and last < weekly:  # to seconds of a week, from seconds since 1980 or adjusted ones
        offset = 0.0 if begin >= ADJUSTED else ADJUSTED
        moves |= {offset - ((begin + offset) // GPS_WEEK + k) * GPS_WEEK for k in (0, 1)}
    return sorted(moves)


def _project(
    lon: NDArray[np.float64], lat: NDArray[np.float64], z: NDArray[np.float64], crs: Any, path: Path
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Degrees to the survey's CRS; heights stay as they are."""
    if crs is None:
        raise InputError(
            "the trajectory has latitude and longitude, and the survey's CRS is not known",
            where=path,
            do="name the survey's CRS, or give the trajectory in the survey's coordinates",
        )
    try:
        flat = CRS.from_user_input(crs).to_2d()
        if not flat.is_projected:
            raise InputError("the survey's CRS is not in metres", where=path, expected="a projected CRS", got=flat.name)
        x, y = Transformer.from_crs("EPSG:4326", flat, always_xy=True).transform(lon, lat, errcheck=False)
    except (CRSError, ProjError) as fault:
        raise InputError("the survey's CRS cannot be used", where=path, got=str(fault)) from None
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("the trajectory lies outside the survey's CRS", where=path, do="check the survey's CRS")
    return x, y, z


_Columns = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], bool]


def _sbet(path: Path, size: int) -> _Columns:
    """Time, longitude and latitude [deg], altitude of an SBET file."""
    if size % (FIELDS * RECORD.itemsize):
        raise InputError(
            "neither a text table nor a whole SBET file",
            where=path,
            expected=f"text, or records of {FIELDS * RECORD.itemsize} bytes",
            got=f"{size} bytes",
            do="copy the file again, or export the trajectory as text with a heading",
        )
    time, lat, lon, z = _first_fields(path, size // (FIELDS * RECORD.itemsize))
    with np.errstate(invalid="ignore"):
        good = (np.abs(lat) <= np.pi / 2) & (np.abs(lon) <= 2 * np.pi) & (np.abs(z) < 1e5) & (time >= 0) & (time < 1e10)
        good &= np.abs(lat) + np.abs(lon) > 1e-9  # zeros, and doubles of the other byte order
    if not good.all():
        bad = int(np.argmin(good))
        raise InputError(
            "not an SBET file",
            where=path,
            expected="time [s], latitude and longitude [rad], altitude [m] in every record",
            got=f"record {bad}: {time[bad]:g}, {lat[bad]:g}, {lon[bad]:g}, {z[bad]:g}",
            do="check that the file is a smoothed best estimate of trajectory, or export it as text with a heading",
        )
    fall = np.diff(time, prepend=time[:1])
    new_week = np.abs(fall + GPS_WEEK) < DAY
    if ((fall < 0) & ~new_week).any():
        at = int(np.argmax((fall < 0) & ~new_week))
        raise InputError(
            "the times of an SBET file fall back",
            where=path,
            expected="records in the order of their times, which begin anew at the end of a GPS week alone",
            got=f"record {at}: {time[at]:.3f} s after {time[at - 1]:.3f} s",
            do="give flights that were joined as files of their own (survey.trajectory.files), or export it again",
        )
    return time + np.cumsum(new_week) * GPS_WEEK, np.degrees(lon), np.degrees(lat), z, True


def _first_fields(path: Path, records: int) -> NDArray[np.float64]:
    """float64 (4, records), time, latitude, longitude and altitude; read, as a map of a file that is cut off meanwhile
    ends the process."""
    fields, length = np.empty((4, records)), FIELDS * RECORD.itemsize
    with open_regular(path) as file:
        for at in range(0, records, AT_A_TIME):
            count = min(AT_A_TIME, records - at)
            data = file.read(count * length)
            if len(data) < count * length:
                raise cut_off(path, records * length, at * length + len(data))
            fields[:, at : at + count] = np.frombuffer(data, RECORD).reshape(count, FIELDS)[:, :4].T
    return fields


def _text(path: Path, head: bytes) -> _Columns:
    """Time, x, y, z (or longitude, latitude [deg], height) of a text table."""
    skip, delimiter, columns, geographic = _layout(path, head)
    check_last_line(path)
    encoding = "utf-8-sig" if head.startswith(codecs.BOM_UTF8) else "latin-1"
    try:
        with (
            open_regular(path) as file,
            io.TextIOWrapper(file, encoding) as text,  # of a name numpy would unpack .gz, .bz2 and .xz
            warnings.catch_warnings(action="ignore", category=UserWarning),  # "no data" is told better further up
        ):
            values = np.loadtxt(text, delimiter=delimiter, skiprows=skip, usecols=columns, ndmin=2)
    except (ValueError, IndexError, OverflowError) as fault:
        raise InputError(
            "a line of the trajectory is no row of numbers",
            where=path,
            expected="the columns of the heading, or time x y z, on every line",
            got=f"{fault} (counted after line {skip})",
            do="correct the line, or export the trajectory again",
        ) from None
    time, a, b, z = (np.ascontiguousarray(values[:, k]) for k in range(4))
    if geographic and (np.nanmax(np.abs(a), initial=0.0) > 360.0 or np.nanmax(np.abs(b), initial=0.0) > 90.0):
        raise InputError("latitude and longitude are not in degrees", where=path, expected="decimal degrees")
    return time, a, b, z, geographic


def _layout(path: Path, head: bytes) -> tuple[int, str | None, Sequence[int], bool]:
    """Lines to pass over, delimiter (None: blanks), columns of time and place, and whether the place is in degrees."""
    lines = _LINE.split(head.removeprefix(codecs.BOM_UTF8).decode("latin-1"))[:HEAD_LINES]
    for number, line in enumerate(lines):
        delimiter = next((mark for mark in ",;\t" if mark in line), None)
        words = line.strip().split(delimiter)
        if len(words) >= 4 and all(_is_number(word) for word in words[:4]):
            return number, delimiter, (0, 1, 2, 3), False
        words = _UNIT.sub("", line).strip().lstrip("#").strip().split(delimiter)
        heading = _heading([word.strip(' "').lower().replace(" ", "_") for word in words])
        if heading is not None:
            return number + 1, delimiter, *heading
    raise InputError(
        "no trajectory in this file",
        where=path,
        expected="a heading with a time and x, y, z (or latitude, longitude, height), or rows of time x y z",
        got=lines[0][:80],
    )


def _heading(words: list[str]) -> tuple[Sequence[int], bool] | None:
    at = {name: next((words.index(w) for w in spellings if w in words), None) for name, spellings in _NAMES.items()}
    for horizontal, geographic in ((("x", "y"), False), (("longitude", "latitude"), True)):
        columns = [at[name] for name in ("gps_time", *horizontal, "z")]
        if None not in columns:
            return [c for c in columns if c is not None], geographic
    return None


def _is_number(word: str) -> bool:
    try:
        number_of(word)
    except ValueError:
        return False
    return True
