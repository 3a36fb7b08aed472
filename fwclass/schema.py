"""Every column, declared once, and the table that holds columns.

The stages, the store, the LAS extra bytes, the GeoParquet metadata and the manual all read these records.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fwclass.errors import InputError, nearest


@dataclass(frozen=True)
class Column:
    """One column of any table.

    Attributes
    ----------
    name : the field's standard term; neighbourhood features carry their scale, as in ``echo_ratio_r100``.
    dtype : numpy dtype as text.
    unit : SI or field unit; "" for counts, codes and fractions.
    meaning : one sentence.
    null : the value that says "no value"; None where every row has one.
    low, high : range of valid values, or None.
    source : paper and equation, or the format's field.
    las : name as a LAS extra byte, or "" if the column has a field of its own in LAS or is not published.
    """

    name: str
    dtype: str
    unit: str
    meaning: str
    null: float | None = None
    low: float | None = None
    high: float | None = None
    source: str = ""
    las: str = ""


NAN = float("nan")

_DECLARED = (
    # who an echo is; (strip, pulse, echo_number) is unique and the canonical order
    Column("strip", "u2", "", "index of the source file in the survey's sorted list"),
    Column("pulse", "u4", "", "index of the pulse in its strip, in order of first appearance in the file"),
    Column("echo_number", "u1", "", "place of the echo in its pulse, 1 is nearest to the sensor", low=1),
    Column("number_of_echoes", "u1", "", "echoes of the pulse", low=1),
    Column("origin", "u1", "", "0 fitted to a waveform, 1 vendor return without usable packet, 2 read as an echo"),
    # where it is
    Column("x", "f8", "m", "easting in the survey's CRS, whole millimetres"),
    Column("y", "f8", "m", "northing in the survey's CRS, whole millimetres"),
    Column("z", "f8", "m", "height in the survey's CRS, whole millimetres"),
    Column("gps_time", "f8", "s", "time of the pulse as the source gives it", null=NAN),
    Column("beam_x", "f4", "", "unit vector from sensor to target, east", null=NAN, low=-1, high=1),
    Column("beam_y", "f4", "", "unit vector from sensor to target, north", null=NAN, low=-1, high=1),
    Column("beam_z", "f4", "", "unit vector from sensor to target, up (negative)", null=NAN, low=-1, high=1),
    # what the waveform says
    Column(
        "amplitude",
        "f4",
        "DN",
        "height of the fitted echo above the baseline",
        null=NAN,
        low=0,
        las="fw amplitude",
    ),
    Column("width", "f4", "ns", "echo width, full width at half maximum", null=NAN, low=0, las="echo width"),
    Column("time", "f4", "ns", "time of the echo in its waveform, from the first sample", null=NAN),
    Column("baseline", "f4", "DN", "level of the waveform without echoes", null=NAN),
    Column("misfit", "f4", "", "reduced chi-square of the pulse's fit", null=NAN, low=0),
    Column(
        "fit_flags",
        "u1",
        "",
        "1 saturated, 2 overlapping, 4 poor fit, 8 at the segment's edge, 16 vendor return kept, "
        "32 far from the vendor's returns",
    ),
    Column("source_class", "u1", "", "class code of the nearest return of the pulse in the source file"),
    Column("intensity", "u2", "", "intensity of the nearest return of the pulse in the source file"),
    # returns, as read
    Column("return_number", "u1", "", "vendor's return number; 0 occurs in faulty files"),
    Column("number_of_returns", "u1", "", "vendor's number of returns of the pulse"),
    Column("location", "f4", "ns", "vendor's return location in the waveform, from the first sample", null=NAN),
    Column("has_packet", "bool", "", "the return's waveform packet could be read"),
    Column("vendor_amplitude", "f4", "dB", "extra byte `Amplitude` of the source", null=NAN),
    Column("vendor_width", "f4", "ns", "extra byte `Pulse width` of the source", null=NAN),
    # pulses, as read
    Column("anchor_x", "f8", "m", "easting of the pulse's anchor return"),
    Column("anchor_y", "f8", "m", "northing of the pulse's anchor return"),
    Column("anchor_z", "f8", "m", "height of the pulse's anchor return"),
    Column("anchor_time", "f4", "ns", "return location of the anchor return"),
    Column(
        "step_x",
        "f8",
        "m/ns",
        "stored beam vector, east; P(t) = P_anchor + (anchor_time - t) step",
        source="LAS 1.4 R15",
    ),
    Column("step_y", "f8", "m/ns", "stored beam vector, north"),
    Column("step_z", "f8", "m/ns", "stored beam vector, up"),
    Column("sample_spacing", "f4", "ns", "time between samples", low=0),
    Column("saturation", "f4", "DN", "highest value that the digitiser can record"),
    # ground
    Column("ground", "bool", "", "the ground filter took the echo for ground"),
    Column(
        "height_above_ground",
        "f4",
        "m",
        "z minus the terrain model under the echo",
        null=NAN,
        las="HeightAboveGround",
    ),
    # neighbourhood features; the name in the tables carries the radius
    Column(
        "zc",
        "f4",
        "m",
        "z minus the lowest z of the 12 m x 10 m cell",
        null=NAN,
        low=0,
        source="Fan 2013, 2.1",
        las="zc",
    ),
    Column(
        "inclination",
        "f4",
        "deg",
        "angle between local normal and vertical",
        null=NAN,
        low=0,
        high=90,
        source="Fan 2013, 2.2",
        las="inclination",
    ),
    Column(
        "echo_ratio",
        "f4",
        "",
        "echoes in the sphere / echoes in the vertical cylinder",
        null=NAN,
        low=0,
        high=1,
        source="Fan 2013, eq. 2",
        las="echo ratio",
    ),
    Column(
        "backscatter",
        "f4",
        "",
        "backscatter coefficient gamma, uncalibrated unless a constant is given",
        null=NAN,
        low=0,
        source="Fan 2013, eq. 3",
        las="backscatter",
    ),
    Column(
        "linearity",
        "f4",
        "",
        "(l1 - l2) / l1 of the neighbourhood's covariance, l1 >= l2 >= l3",
        null=NAN,
        low=0,
        high=1,
        source="Demantke 2011",
    ),
    Column(
        "planarity",
        "f4",
        "",
        "(l2 - l3) / l1 of the neighbourhood's covariance",
        null=NAN,
        low=0,
        high=1,
        source="Demantke 2011",
    ),
    Column(
        "sphericity",
        "f4",
        "",
        "l3 / l1 of the neighbourhood's covariance",
        null=NAN,
        low=0,
        high=1,
        source="Demantke 2011",
    ),
    Column(
        "roughness",
        "f4",
        "m",
        "root mean square distance of the neighbours from their fitted plane",
        null=NAN,
        low=0,
        source="Shi 2019, plane residual",
    ),
    Column(
        "height_std",
        "f4",
        "m",
        "standard deviation of z in the sphere",
        null=NAN,
        low=0,
        source="Xiong 2018; Shi 2019, HV",
    ),
    Column(
        "height_range",
        "f4",
        "m",
        "highest minus lowest z in the sphere",
        null=NAN,
        low=0,
        source="Xiong 2018",
    ),
    Column("height_above_lowest", "f4", "m", "z minus the lowest z in the vertical cylinder", null=NAN, low=0),
    Column("density", "f4", "1/m2", "echoes in the vertical cylinder per area of its circle", null=NAN, low=0),
    Column(
        "first_share",
        "f4",
        "",
        "share of first echoes, single ones included, in the sphere",
        null=NAN,
        low=0,
        high=1,
        source="Xiong 2018, EBI",
    ),
    Column(
        "last_share",
        "f4",
        "",
        "share of last echoes, single ones included, in the sphere",
        null=NAN,
        low=0,
        high=1,
        source="Xiong 2018, EGI",
    ),
    # classes
    Column("reference", "u1", "", "reference class code; 0 is none"),
    Column("classification", "u1", "", "class code given by the forest"),
    Column("confidence", "f4", "", "share of the forest's votes for the class", low=0, high=1, las="confidence"),
)

COLUMNS: dict[str, Column] = {c.name: c for c in _DECLARED}
_SCALED = re.compile(r"^(?P<base>[a-z_]+)_r(?P<cm>\d+)$")

IDENTITY = ("strip", "pulse", "echo_number")


def column(name: str) -> Column:
    """The record of `name`; ``echo_ratio_r100`` is ``echo_ratio`` over a radius of 100 cm."""
    if name in COLUMNS:
        return COLUMNS[name]
    found = _SCALED.match(name)
    if found and found["base"] in COLUMNS:
        base = COLUMNS[found["base"]]
        las = f"{base.las} r{found['cm']}" if base.las else ""
        return replace(base, name=name, las=las, meaning=f"{base.meaning}; radius {int(found['cm']) / 100:g} m")
    raise KeyError(f"no column {name!r}; {nearest(name, COLUMNS)}")


def scaled(base: str, radius: float) -> str:
    """Name of feature `base` at `radius` [m]: ``scaled('echo_ratio', 1.0)`` is ``echo_ratio_r100``."""
    return f"{base}_r{round(radius * 100)}"


class Table(Mapping[str, NDArray]):
    """Equal-length numpy columns of declared names and dtypes.

    A column of another dtype is converted if no value changes its meaning (any numeric dtype to the declared one);
    an undeclared name or a length that differs is an error of the program, a `ValueError` or `KeyError`.
    """

    __slots__ = ("_columns", "_rows")

    def __init__(self, columns: Mapping[str, ArrayLike]) -> None:
        self._columns: dict[str, NDArray] = {}
        rows: int | None = None
        for name, values in columns.items():
            array = np.ascontiguousarray(values, dtype=column(name).dtype)
            if array.ndim != 1:
                raise ValueError(f"column {name!r} has shape {array.shape}, expected one dimension")
            if rows is not None and len(array) != rows:
                raise ValueError(f"column {name!r} has {len(array)} rows, the others {rows}")
            rows = len(array)
            self._columns[name] = array
        self._rows = rows or 0

    def __getitem__(self, name: str) -> NDArray:
        try:
            return self._columns[name]
        except KeyError:
            raise KeyError(f"this table has no column {name!r}; {nearest(name, self._columns)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns, as for any mapping; `rows` is the number of rows."""
        return len(self._columns)

    @property
    def rows(self) -> int:
        return self._rows

    def select(self, names: Iterable[str]) -> Table:
        return Table({n: self[n] for n in names})

    def take(self, index: NDArray) -> Table:
        """Rows by integer index, boolean mask or slice-like array."""
        return Table({n: v[index] for n, v in self._columns.items()})

    def with_columns(self, columns: Mapping[str, ArrayLike]) -> Table:
        return Table({**self._columns, **columns})

    @classmethod
    def empty(cls, names: Iterable[str]) -> Table:
        return cls({n: np.empty(0, column(n).dtype) for n in names})

    @classmethod
    def concat(cls, tables: Iterable[Table]) -> Table:
        """Rows of all tables, in order; all must have the same columns."""
        parts = list(tables)
        if not parts:
            raise ValueError("nothing to concatenate")
        names = list(parts[0])
        for part in parts[1:]:
            if list(part) != names:
                raise ValueError(f"tables differ in columns: {names} and {list(part)}")
        return cls({n: np.concatenate([p[n] for p in parts]) for n in names})


def canonical_key(table: Table) -> NDArray[np.uint64]:
    """(strip, pulse, echo_number) as one sortable integer; unique in a survey."""
    strip = table["strip"].astype(np.uint64) << np.uint64(40)
    pulse = table["pulse"].astype(np.uint64) << np.uint64(8)
    return np.asarray(strip | pulse | table["echo_number"].astype(np.uint64), np.uint64)


def require(table: Table, names: Iterable[str], where: object) -> None:
    """`InputError` naming the first column that `table` lacks."""
    for name in names:
        if name not in table:
            raise InputError(
                f"column {name!r} is missing",
                where=where,
                expected=", ".join(names),
                got=", ".join(table),
                do="re-run the stage that writes it, or use data that has it",
            )
