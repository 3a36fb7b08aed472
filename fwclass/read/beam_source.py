"""Waveforms that a file has as rows, each with a beam of its own: what the readers of such formats give, and what one
pass over a file tells of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.read.base import Source
from fwclass.units import METRES_PER_NS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SPEEDS = (0.9, 1.1)
"""Shortest and longest beam vector, over what light travels there and back in a nanosecond of air."""

SPACINGS = (0.01, 100.0)
"""No laser scanner samples faster or slower [ns]."""

LATEST = 1e7
"""No waveform begins later than this after its anchor [ns]: 1500 km."""

LONGEST = 100_000
"""Samples of a waveform at most."""

LARGEST = 1e15
"""No sample is larger, whatever its unit."""

TOP = 65_535
"""Highest sample that is kept [DN]."""

FAULTS = (
    "",
    "no finite place",
    "no sane beam vector",
    "no sane sample spacing",
    "no sane time of the first sample",
    "no samples",
    "samples that are no numbers",
    f"more than {LONGEST} samples",
    "no waveform: the file says that it is not to be used",
)
"""What a row lacks; the index is the code in `BeamRows.fault`."""

OVERLAPPING = "waveforms that begin before the one before them ends, left out"

DAMAGED = (*FAULTS[1:-1], OVERLAPPING)
"""Those of a row that should be whole, and by itself."""

LIMITS = tuple(2.0**bits - 1.0 for bits in range(8, 17))
"""Highest values of digitisers [DN]."""


@dataclass(frozen=True)
class Ragged:
    """Lists of numbers, one a row: row i has ``values[offsets[i]:offsets[i + 1]]``."""

    values: NDArray
    offsets: Ints

    @classmethod
    def none(cls, rows: int) -> Ragged:
        """`rows` empty lists."""
        return cls(np.empty(0), np.zeros(rows + 1, np.int64))

    @classmethod
    def of_table(cls, table: NDArray) -> Ragged:
        """Rows (n, m) of one length."""
        return cls(np.ascontiguousarray(table).reshape(-1), np.arange(len(table) + 1, dtype=np.int64) * table.shape[1])

    @property
    def lengths(self) -> Ints:
        """Values of every row, int64 (rows,)."""
        return np.diff(self.offsets)

    def take(self, rows: NDArray) -> Ragged:
        """Rows by number or truth value."""
        rows = np.flatnonzero(rows) if rows.dtype == bool else rows
        sizes = self.lengths[rows]
        ends = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        return Ragged(self.values[np.arange(ends[-1]) + np.repeat(self.offsets[rows] - ends[:-1], sizes)], ends)

    def per_row(self, function: Any, empty: float) -> Floats:
        """`function` (a ufunc) reduced over every row; `empty` where there is none."""
        out = np.full(len(self.offsets) - 1, empty)
        full = np.flatnonzero(self.lengths)
        if len(full):
            out[full] = function.reduceat(self.values, self.offsets[:-1][full])
        return out


@dataclass(frozen=True)
class BeamRows:
    """Consecutive waveforms as a file has them, in its order.

    Attributes
    ----------
    pulse : (n,) what tells pulses apart; rows of one pulse follow each other.
    anchor : (n, 3) a place on the beam [m], `step` (n, 3) the beam up towards the sensor [m/ns].
    begin : (n,) time of the first sample after the anchor was passed [ns].
    anchor_range : (n,) distance from the sensor to the anchor [m], NaN where it is not known.
    spacing : (n,) [ns]. `time` : (n,) [s], NaN where it is not known. `channel` : (n,) of the receiver.
    samples, outgoing : numbers as they stand there. `outgoing_begin` : (n,) [ns] after the anchor's time origin.
    unusable : bool (n,), the file says so.
    """

    pulse: Ints
    anchor: Floats
    step: Floats
    begin: Floats
    anchor_range: Floats
    spacing: Floats
    time: Floats
    channel: Ints
    samples: Ragged
    outgoing: Ragged
    outgoing_begin: Floats
    unusable: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.pulse)

    def take(self, rows: Any) -> BeamRows:
        """The rows of an index, a mask or a slice."""
        rows = np.arange(len(self))[rows]
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        values = {n: v.take(rows) if isinstance(v, Ragged) else v[rows] for n, v in values.items()}
        return BeamRows(**values)

    @staticmethod
    def joined(parts: list[BeamRows]) -> BeamRows:
        """`parts` one after the other."""
        if len(parts) == 1:
            return parts[0]
        whole: dict[str, Any] = {}
        for f in fields(BeamRows):
            values = [getattr(p, f.name) for p in parts]
            if isinstance(values[0], Ragged):
                ends = np.concatenate([[0], np.cumsum(np.concatenate([v.lengths for v in values]))])
                whole[f.name] = Ragged(np.concatenate([v.values for v in values]), ends.astype(np.int64))
            else:
                whole[f.name] = np.concatenate(values)
        return BeamRows(**whole)

    @property
    def fault(self) -> NDArray[np.uint8]:
        """(n,) codes of `FAULTS`; of several the first."""
        with np.errstate(all="ignore"):
            length = np.sqrt((self.step**2).sum(axis=1)) / METRES_PER_NS
            least, most = self.samples.per_row(np.minimum, 0.0), self.samples.per_row(np.maximum, 0.0)
            sane = (
                np.isfinite(self.anchor).all(axis=1) & (np.abs(self.anchor) < 1e8).all(axis=1),
                (length >= SPEEDS[0]) & (length <= SPEEDS[1]),
                (self.spacing >= SPACINGS[0]) & (self.spacing <= SPACINGS[1]),
                np.abs(self.begin) <= LATEST,
                self.samples.lengths > 0,
                (least > -LARGEST) & (most < LARGEST),
                self.samples.lengths <= LONGEST,
                ~self.unusable,
            )
        code = np.zeros(len(self), np.uint8)
        for number in range(len(sane), 0, -1):
            code[~sane[number - 1]] = number
        return code

    def ends(self) -> tuple[Floats, Floats]:
        """Places of the first and last samples (n, 3) [m]."""
        lasts = self.begin + np.maximum(0, self.samples.lengths - 1) * self.spacing
        return self.anchor - self.begin[:, None] * self.step, self.anchor - lasts[:, None] * self.step


class Layout(Protocol):
    """How the rows of one format are read."""

    @property
    def n_rows(self) -> int:
        """Rows of the file, one a waveform."""
        ...

    @property
    def timed(self) -> bool:
        """Whether the file says when first samples were taken, or its format does."""
        return True

    def blocks(self) -> Iterator[BeamRows]:
        """All rows, a bounded number at a time."""

    def read(self, first: int, last: int) -> BeamRows:
        """Rows [first, last)."""


@dataclass(frozen=True)
class Scaling:
    """From samples as they stand there to whole digitiser counts: DN = (sample - low) / step, rounded.

    `top` is where they are saturated [DN].
    """

    low: float
    step: float
    top: float

    @property
    def exact(self) -> bool:
        """The samples are whole numbers that are kept as they are."""
        return self.step == 1.0 and self.low == 0.0

    def counts(self, samples: NDArray) -> NDArray[np.uint16]:
        """`samples` as the counts of a digitiser, uint16 of the same shape."""
        if self.exact and samples.dtype.kind in "iu":
            return samples.astype(np.uint16)
        return np.clip(np.rint((samples - self.low) / self.step), 0.0, TOP).astype(np.uint16)


@dataclass
class Census:
    """What one pass over a file adds up."""

    faults: Ints = field(default_factory=lambda: np.zeros(len(FAULTS), np.int64))
    low: Floats = field(default_factory=lambda: np.full(3, np.inf))
    high: Floats = field(default_factory=lambda: np.full(3, -np.inf))
    rows: int = 0
    pulses: int = 0
    samples: int = 0
    gps: tuple[float, float] = (np.inf, -np.inf)
    lengths: tuple[int, int] = (LONGEST, 0)
    spacing: tuple[float, float] = (np.inf, -np.inf)
    values: tuple[float, float] = (np.inf, -np.inf)
    whole: bool = True
    outgoing: int = 0
    channels: set[int] = field(default_factory=set)
    starts: list[Ints] = field(default_factory=list)
    last: int | None = None
    ascending: bool = True

    def add(self, rows: BeamRows) -> None:
        """Count a block of rows; blocks come in the file's order."""
        new = np.empty(len(rows), bool)
        new[1:] = rows.pulse[1:] != rows.pulse[:-1]
        new[:1] = self.last is None or rows.pulse[:1] != self.last
        if len(rows):
            self.ascending &= bool(
                (np.diff(rows.pulse) >= 0).all() and (self.last is None or rows.pulse[0] >= self.last)
            )
            self.last = int(rows.pulse[-1])
        self.starts.append(np.flatnonzero(new) + self.rows)
        self.rows, self.pulses = self.rows + len(rows), self.pulses + int(new.sum())
        fault = rows.fault
        self.faults += np.bincount(fault, minlength=len(FAULTS))
        self.outgoing += int((rows.outgoing.lengths > 0).sum())
        known = rows.time[np.isfinite(rows.time)]
        self.gps = _wider(self.gps, known)
        good = rows if not fault.any() else rows.take(fault == 0)
        if not len(good):
            return
        self.samples += int(good.samples.offsets[-1])
        self.lengths = _wider(self.lengths, good.samples.lengths)  # type: ignore[assignment]
        self.spacing = _wider(self.spacing, good.spacing)
        self.values = _wider(self.values, good.samples.values)
        self.whole &= good.samples.values.dtype.kind in "iu" or bool(
            (good.samples.values == np.rint(good.samples.values)).all()
        )
        self.channels |= set(np.unique(good.channel)[:100].tolist())
        for place in good.ends():
            self.low, self.high = np.minimum(self.low, place.min(axis=0)), np.maximum(self.high, place.max(axis=0))

    def first_rows(self) -> Ints:
        """Row at which every pulse begins, and behind the last one the number of rows."""
        return np.concatenate([*self.starts, [self.rows]]).astype(np.int64)

    def scaling(self, saturation: float | None, levels: float, step: float | None = None) -> Scaling:
        """Whole samples that fit 16 bits as they are; others in steps of `step`, and where that is None or leaves no
        room in 16 bits of a power of two, at most `levels` of them."""
        low, high = self.values if self.samples else (0.0, 0.0)
        top = saturation if saturation is not None else next((v for v in LIMITS if high == v), None)
        if self.whole and low >= 0.0 and high <= TOP:
            return Scaling(0.0, 1.0, float(top if top is not None else TOP))
        low = min(low, 0.0) if self.whole else low
        span = max(high - low, 1e-300)
        if self.whole and span <= TOP:
            step = 1.0
        elif step is None or span > TOP * step:
            step = float(2.0 ** np.ceil(np.log2(span / levels)))
        return Scaling(low, step, TOP if top is None else min(float(TOP), max(1.0, (top - low) / step)))


def _wider(ends: tuple[float, float], values: NDArray) -> tuple[float, float]:
    return (min(ends[0], values.min().item()), max(ends[1], values.max().item())) if len(values) else ends


@dataclass(frozen=True, kw_only=True)
class BeamSource(Source):
    """A file whose rows are waveforms with a beam each.

    `kind`: of its format, for people. `notes`: what is to be told of it that is no fault. `census`: what a pass over it
    found. `scaling`: to digitiser counts.
    """

    kind: str
    notes: tuple[tuple[str, str], ...]
    census: Census
    scaling: Scaling
    layout: Layout

    @property
    def has_waves(self) -> bool:
        return True

    @property
    def sample_dtype(self) -> str:
        return "uint16"


def turn_beams(rows: BeamRows, source: BeamSource) -> BeamRows:
    """`rows` with the horizontal parts of their beams turned round where `source` is to be read so."""
    return replace(rows, step=rows.step * (-1.0, -1.0, 1.0)) if source.mirrored else rows


def bounds_of(census: Census) -> tuple[float, float, float, float, float, float]:
    """Of the first and last samples of all usable rows; NaN without any."""
    ends = (*census.low.tolist(), *census.high.tolist())
    return ends if np.isfinite(ends).all() else (np.nan,) * 6


@lru_cache(maxsize=16)
def _count(path: Path, mark: tuple[int, int], layout: Any) -> Census:
    census = Census()
    for rows in layout.blocks():
        census.add(rows)
    return census


def census_of(path: Path, layout: Any) -> Census:
    """One pass over a file, once in a process; `layout` must be hashable, and equal where it reads alike."""
    facts = path.stat()
    census = _count(path, (facts.st_size, facts.st_mtime_ns), layout)
    if not census.ascending:
        raise InputError(
            "the rows of a pulse do not follow each other",
            where=path,
            expected="rows sorted by `pulse`, its numbers ascending",
            got=f"{census.pulses} runs of pulses that are not",
            do="sort the file by pulse, or leave the column `pulse` out",
        )
    return census
