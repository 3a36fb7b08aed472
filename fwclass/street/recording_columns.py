"""Columns of a recording, the same for every door: a row a frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError, nearest
from fwclass.street.frames import Frame, Scan

MOST_BEAMS = 30_000
"""Of a frame; scanners have up to 25 200."""

MOST_FRAMES = 1 << 63
"""Numbers of frames lie below, as those of a stream do: they are kept in 64 bits."""

FULL = 1.01
"""Turns that beams may go around: a step more than one."""

NUMBERS = ("frame", "time", "speed", "place", "angle_min", "angle_increment", "range_min", "range_max")
LISTS = ("ranges", "labels", "intensities")
COLUMNS = (*NUMBERS, *LISTS)
"""frame: number; time [s]; speed [m/s]; place along the road [m]; angle_min, angle_increment [rad]; range_min,
range_max [m]; ranges [m] per beam; labels: class codes per beam, 0 none; intensities per beam."""


def check_columns(names: Iterable[str], path: Path) -> None:
    """`InputError` for a column that is none of `COLUMNS`, or one that is missing."""
    present = list(names)
    for name in present:
        if name not in COLUMNS:
            raise InputError(
                "a column is unknown",
                where=f"{path}: column {name[:80]}",
                expected=", ".join(COLUMNS),
                got=name[:80],
                do=f"{nearest(name, COLUMNS)}, or leave it out",
            )
    if twice := sorted({n for n in present if present.count(n) > 1}):
        raise InputError("a column is there twice", where=path, got=", ".join(twice), do="remove one of them")
    lacking = [n for n in ("time", "ranges") if n not in present]
    if lacking:
        raise InputError(
            "a column is missing", where=path, expected="time, ranges", got=", ".join(present), do=f"write {lacking[0]}"
        )


def scan_of(numbers: Mapping[str, float], scan: Scan, beams: int) -> Scan:
    """`scan` with what a frame says itself; an angle [rad] that is missing is the recording's."""

    def value_of(name: str, other: float) -> float:
        value = numbers.get(name, math.nan)
        return value if math.isfinite(value) else other

    return replace(
        scan,
        beams=beams,
        first=value_of("angle_min", scan.first),
        step=value_of("angle_increment", scan.step),
        range_min=value_of("range_min", scan.range_min),
        range_max=value_of("range_max", scan.range_max),
    )


def frame_of(
    at: int,
    numbers: Mapping[str, float],
    ranges: NDArray[np.float32],
    labels: NDArray[np.uint8] | None,
    scan: Scan,
    path: Path | str,
    intensities: NDArray[np.float32] | None = None,
) -> Frame:
    """A frame from row `at`: `ranges` (beams,) [m], `scan` what holds where the row is silent. Beams stand by growing
    angle: those that turn downwards are turned round."""
    if not 0 < len(ranges) <= MOST_BEAMS:
        raise InputError(
            "a frame has no beams, or more than any scanner",
            where=f"{path}: row {at + 1}",
            expected=f"1 to {MOST_BEAMS} ranges",
            got=len(ranges),
            do="write the recording again",
        )
    for what, values in (("label", labels), ("intensity", intensities)):
        if values is not None and len(values) != len(ranges):
            raise InputError(
                f"a frame has not one {what} for every beam",
                where=f"{path}: row {at + 1}",
                expected=len(ranges),
                got=len(values),
                do="write the recording again",
            )
    number = numbers.get("frame", math.nan)
    if abs(number) >= MOST_FRAMES:
        raise InputError(
            "a frame has a number that none has",
            where=f"{path}: row {at + 1}",
            expected="less than 2^63",
            got=f"{number:g}",
            do="write the numbers again, or leave the column out",
        )
    own = scan_of(numbers, scan, len(ranges))
    if own.step < 0:  # a driver's way to say that the scanner hangs the other way up
        own = replace(own, first=own.first + own.step * (own.beams - 1), step=-own.step)
        ranges = ranges[::-1]
        labels = None if labels is None else labels[::-1].copy()
        intensities = None if intensities is None else intensities[::-1].copy()
    check_scan(own, f"{path}: row {at + 1}")
    return Frame(
        int(number) if math.isfinite(number) else at,
        numbers["time"],
        own,
        np.ascontiguousarray(ranges, np.float32),
        numbers.get("speed", math.nan),
        numbers.get("place", math.nan),
        labels,
        intensities,
    )


def class_codes(values: NDArray[Any], where: str) -> NDArray[np.uint8]:
    """Labels (beams,) of a frame as class codes; `InputError` for one that is none."""
    wrong = ~((values >= 0) & (values <= 255) & (values == np.floor(values)))
    if wrong.any():
        raise InputError(
            "a label is no class code",
            where=where,
            expected="whole numbers from 0 (none) to 255",
            got=values[wrong][0],
            do="write the labels again",
        )
    return np.asarray(values.astype(np.uint8))


def check_scan(scan: Scan, where: str) -> None:
    """`InputError` for beams that no scanner has."""
    if not 0 < scan.step <= math.pi:
        raise InputError(
            "beams have no step",
            where=where,
            expected="an angle_increment above 0, in radians",
            got=scan.step,
            do="give it in the recording, or leave it out: street.scanner's holds then",
        )
    turn = 2.0 * math.pi
    if scan.step * (scan.beams - 1) > FULL * turn or abs(scan.first) > FULL * turn:
        raise InputError(
            "the beams go more than once around",
            where=where,
            expected="angle_min and angle_increment in radians",
            got=f"{scan.beams} beams from {scan.first:g} by {scan.step:g}",
            do="if these are degrees: multiply them by 0.0174533",
        )


def settings_of(settings: Mapping[str, Any], scan: Scan) -> Scan:
    """`scan` with what the file's own settings say."""
    numbers = {}
    for name in ("angle_min", "angle_increment", "range_min", "range_max"):
        try:
            numbers[name] = float(settings.get(name, math.nan))
        except (TypeError, ValueError):
            numbers[name] = math.nan
    return scan_of(numbers, scan, scan.beams)
