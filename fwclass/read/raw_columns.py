"""Raw waveforms as a table: which columns and settings there are, and how they become beams.

Columns: `x`, `y`, `z` a place on the beam [m]; `dx`, `dy`, `dz` the beam's direction, away from the sensor; `samples` a
list of numbers; `spacing_ns` (or one for the file in its metadata). They may be followed by `begin_ns`, when the first
sample was taken, after the light passed the place (0 where it is the place of the first sample; the two-way time where
it is the sensor); `range_m` from the sensor to the place (0 at the sensor); `gps_time` [s]; `pulse`, where several
rows, which follow each other, are segments or channels of one; `channel`; `outgoing`, samples of the emitted pulse, and
`outgoing_begin_ns`, when the first of them was taken.

Metadata: `crs`, `spacing_ns`, `saturation` (highest sample), `step` (of samples that are no whole numbers, of which
amplitudes are then counts), `standard_gps_time` (true: GPS seconds less 10^9).

The direction's length says what it is per: about 0.15 per nanosecond (metres), 1 a unit vector, or 0.15 times the
spacing per sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from fwclass.errors import InputError
from fwclass.formats.crs import code_faults
from fwclass.formats.epsg import without_false_codes
from fwclass.formats.grid_files import names_file, without_paths
from fwclass.read.beam_source import SPACINGS, SPEEDS, BeamRows, Ragged
from fwclass.read.feet import in_metres
from fwclass.units import METRES_PER_NS, number_of

PLACE, DIRECTION = ("x", "y", "z"), ("dx", "dy", "dz")
LISTS = ("samples", "outgoing")
OPTIONAL = ("spacing_ns", "begin_ns", "range_m", "gps_time", "pulse", "channel", "outgoing", "outgoing_begin_ns")
REQUIRED = (*PLACE, *DIRECTION, "samples")
KEYS = ("crs", "spacing_ns", "saturation", "step", "standard_gps_time")

YES_OR_NO = {"": False, **dict.fromkeys(("false", "no", "0"), False), **dict.fromkeys(("true", "yes", "1"), True)}

MOST_WHOLE = 2.0**53
"""Whole numbers up to here are told apart in 64 bits with a point."""

PER_NS, UNIT, PER_SAMPLE = "metres per nanosecond", "a unit vector", "metres per sample"


@dataclass(frozen=True)
class Settings:
    """What the metadata say: `spacing` [ns], `saturation` and `step` or None, `standard` time, `crs` as text or ""."""

    spacing: float | None
    saturation: float | None
    step: float | None
    standard: bool
    crs: str

    @classmethod
    def of(cls, metadata: Mapping[str, str], path: Path) -> Settings:
        """The settings in a file's metadata; `InputError` for a value that cannot be."""
        spacing, saturation, step = (_number(metadata, key, path) for key in ("spacing_ns", "saturation", "step"))
        if spacing is not None and not SPACINGS[0] <= spacing <= SPACINGS[1]:
            raise InputError(
                "no scanner samples like this",
                where=f"{path}: metadata spacing_ns",
                expected=f"nanoseconds, {SPACINGS[0]:g} to {SPACINGS[1]:g}",
                got=f"{spacing:g}",
                do="give the time between two samples in nanoseconds",
            )
        if saturation is not None and not saturation > 0.0:
            raise InputError(
                "this is no highest sample",
                where=f"{path}: metadata saturation",
                got=f"{saturation:g}",
                expected="a number above 0, in the unit of the samples",
            )
        if step is not None and not step > 0.0:
            raise InputError(
                "this is no step",
                where=f"{path}: metadata step",
                got=f"{step:g}",
                expected="a number above 0, in the unit of the samples",
            )
        standard = metadata.get("standard_gps_time", "").lower()
        if standard not in YES_OR_NO:
            raise InputError(
                "this is neither yes nor no",
                where=f"{path}: metadata standard_gps_time",
                expected="true (GPS seconds less 10^9) or false",
                got=standard[:80],
            )
        return cls(spacing, saturation, step, YES_OR_NO[standard], metadata.get("crs", ""))

    def system(self, path: Path, faults: list[str]) -> Any:
        """The coordinate system, or None."""
        if not self.crs:
            faults.append("no usable CRS: name one in the configuration")
            return None
        try:
            if name := names_file(self.crs):  # before PROJ opens it
                raise CRSError(f"it names the file {name}")
            crs, paths = without_paths(CRS.from_user_input(self.crs))
            if paths:
                raise CRSError(f"it names the file {paths[0]}")
            crs, false = without_false_codes(crs)
            faults += code_faults(false)
        except CRSError:
            raise InputError(
                "this is not a coordinate system",
                where=f"{path}: metadata crs",
                expected="for example EPSG:25832",
                got=self.crs[:80],
            ) from None
        if crs.is_geographic:
            faults.append("the CRS is in degrees: project the file to metres first")
        return crs


def _number(metadata: Mapping[str, str], key: str, path: Path) -> float | None:
    if key not in metadata:
        return None
    text = metadata[key]
    try:
        value = number_of(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError("this is no number", where=f"{path}: metadata {key}", expected="a number", got=text[:80])
    return value


def check_columns(names: list[str], settings: Settings, path: Path) -> None:
    """`InputError` naming the columns that are missing or there twice."""
    missing = [n for n in REQUIRED if n not in names]
    if "spacing_ns" not in names and settings.spacing is None:
        missing.append("spacing_ns (or that in the metadata)")
    if missing:
        raise InputError(
            "columns of raw waveforms are missing",
            where=path,
            expected=", ".join((*REQUIRED, "spacing_ns")),
            got=f"no {', '.join(missing)}; there are {', '.join(names[:20])}",
            do="name the columns as docs/waveforms.md does",
        )
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError("a column is there twice", where=path, got=", ".join(twice), do="remove one of them")


def kind_of_direction(direction: NDArray[np.float64], spacing: NDArray[np.float64], path: Path) -> str:
    """`PER_NS`, `UNIT` or `PER_SAMPLE`, by the median length of the first rows' directions; `PER_NS` of no rows."""
    with np.errstate(all="ignore"):
        length = np.sqrt((direction**2).sum(axis=1))
    sound = np.isfinite(length) & np.isfinite(spacing) & (length > 0.0)
    if not sound.any():
        return PER_NS
    middle, step = float(np.median(length[sound])), float(np.median(spacing[sound]))
    for kind, expected in ((PER_NS, METRES_PER_NS), (UNIT, 1.0), (PER_SAMPLE, METRES_PER_NS * step)):
        if SPEEDS[0] <= middle / expected <= SPEEDS[1]:
            return kind
    raise InputError(
        "the directions of the beams have a length that means nothing",
        where=f"{path}: dx, dy, dz",
        expected=f"{METRES_PER_NS:.4f} (metres per nanosecond), 1 (a unit vector), or "
        f"{METRES_PER_NS * step:.4g} (metres per sample of {step:g} ns)",
        got=f"{middle:.6g} in the middle",
        do=in_metres(
            middle / METRES_PER_NS,
            "give directions in one of these; light travels 0.15 m there and back in a nanosecond",
        ),
    )


def beam_rows(
    numbers: Mapping[str, NDArray[np.float64]],
    lists: Mapping[str, Ragged],
    settings: Settings,
    direction: str,
    first: int,
    path: Path,
) -> BeamRows:
    """Rows from columns (n,); `first` is the number of the first one in its file, `path`. `InputError` for pulses or
    channels that have no whole number."""
    n = len(numbers["x"])
    nothing = np.full(n, np.nan)

    def column(name: str, otherwise: float) -> NDArray[np.float64]:
        return numbers[name] if name in numbers else np.full(n, otherwise)

    def whole(name: str, otherwise: NDArray[np.int64]) -> NDArray[np.int64]:
        if name not in numbers:
            return otherwise
        values = numbers[name] if name == "pulse" else np.nan_to_num(numbers[name], nan=-1.0)
        with np.errstate(invalid="ignore"):
            odd = np.flatnonzero(~((values == np.rint(values)) & (np.abs(values) < MOST_WHOLE)))
        if len(odd):
            raise InputError(
                f"a {name} has no whole number",
                where=f"{path}: row {first + odd[0] + 1}",
                expected=f"whole numbers below {MOST_WHOLE:.0f}",
                got="nothing" if np.isnan(values[odd[0]]) else f"{values[odd[0]]:.17g}",
                do=f"number them anew, or leave the column {name} out",
            )
        return values.astype(np.int64)

    spacing = column("spacing_ns", math.nan if settings.spacing is None else settings.spacing)
    away = np.stack([numbers[name] for name in DIRECTION], axis=1)
    with np.errstate(all="ignore"):
        if direction == UNIT:
            away = away * (METRES_PER_NS / np.sqrt((away**2).sum(axis=1, keepdims=True)))
        elif direction == PER_SAMPLE:
            away = away / spacing[:, None]
    return BeamRows(
        pulse=whole("pulse", np.arange(first, first + n)),
        anchor=np.stack([numbers[name] for name in PLACE], axis=1),
        step=-away,
        begin=column("begin_ns", 0.0),
        anchor_range=column("range_m", math.nan),
        spacing=spacing,
        time=numbers.get("gps_time", nothing),
        channel=whole("channel", np.zeros(n, np.int64)),
        samples=lists["samples"],
        outgoing=lists.get("outgoing", Ragged.none(n)),
        outgoing_begin=numbers.get("outgoing_begin_ns", nothing),
        unusable=np.zeros(n, np.bool_),
    )
