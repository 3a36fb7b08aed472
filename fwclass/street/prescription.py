"""From crown returns to a prescription: segments along the road, each side by itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from fwclass.street.answers import Answer
from fwclass.street.params import StreetParams
from fwclass.street.sphere_kernels import UNIT

STRAY = (2.0, 98.0)
"""% of a segment's crown returns that lie below and above its band: single ones may be wrong."""


@dataclass(frozen=True)
class Segment:
    """A piece of road with crown beside it.

    Attributes
    ----------
    side : left or right. begin, end : along the road [m].
    low, high : of the crown above the road [m], without the outermost 2 % (`STRAY`). near, far : from the track [m],
        likewise. returns : of crowns. volume : of the voxels that hold one [m3].
    density : returns / volume [1/m3]. speed : of the vehicle [m/s], NaN where it stood.
    nozzle : by which the nozzle trails the scanner [m].
    seconds : until the nozzle is at `begin`, counted from when the last frame of the segment is answered; below 0, the
        nozzle has passed: it must trail further, or the spheres be smaller.
    """

    side: str
    begin: float
    end: float
    low: float
    high: float
    near: float
    far: float
    returns: int
    volume: float
    density: float
    speed: float
    nozzle: float
    seconds: float

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Columns, in order."""
        return tuple(f.name for f in fields(cls))

    def line(self) -> str:
        """For the CSV file."""
        values = [getattr(self, n) for n in self.names()]
        return ",".join(v if isinstance(v, str) else str(v) if isinstance(v, int) else f"{v:.3f}" for v in values)


SPLIT, HALF = 21, 1 << 20
"""Bits of y and of z in a key of a return, in units of `UNIT`, and the zero of either: up to 1 km is told apart."""

HELD = 200_000
"""Returns that are held before equal ones are counted together, as of a vehicle that stands."""

MOST = 1_000_000
"""Different returns of a segment; of more, y and z are rounded down to twice the unit, and so on."""


@dataclass
class _Open:
    """What is known of a segment that the scanner is in; returns of one voxel along the road, y and z are counted."""

    base: int
    first: tuple[float, float]
    last: tuple[float, float]
    keys: list[NDArray[np.int64]] = field(default_factory=list)
    counts: list[NDArray[np.int64]] = field(default_factory=list)
    held: int = 0
    kept: int = 0

    def add(self, cell: int, y: NDArray[np.float32], z: NDArray[np.float32]) -> None:
        """Returns at `y` and `z` [m] in the voxel `cell` along the road."""
        keys = np.full(len(y), cell - self.base, np.int64)
        for axis in (y, z):
            units = np.rint(axis.astype(np.float64) / UNIT).clip(-HALF, HALF - 1).astype(np.int64)
            keys = (keys << SPLIT) | (units + HALF)
        self.keys.append(keys)
        self.counts.append(np.ones(len(keys), np.int64))
        self.held += len(keys)
        if self.held > max(HELD, 2 * self.kept):
            self.count()

    def count(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Different keys, ascending, and how many returns have each."""
        keys, counts = (np.concatenate(v) if v else np.empty(0, np.int64) for v in (self.keys, self.counts))
        for bits in range(SPLIT):
            even = ((1 << SPLIT) - 1) >> bits << bits
            keys, which = np.unique(keys & (-1 << 2 * SPLIT | even << SPLIT | even), return_inverse=True)
            counts = np.bincount(which, counts, len(keys)).astype(np.int64)
            if len(keys) <= MOST:
                break
        self.keys, self.counts, self.held, self.kept = [keys], [counts], len(keys), len(keys)
        return keys, counts

    def returns(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Voxel along the road, y and z [m] of different returns, and how many there are of each."""
        keys, counts = self.count()
        of_axes = (((keys >> bits) & ((1 << SPLIT) - 1)) - HALF for bits in (SPLIT, 0))
        y, z = (units.astype(np.float64) * UNIT for units in of_axes)
        return np.asarray((keys >> 2 * SPLIT) + self.base, np.int64), y, z, counts


def percentiles(values: NDArray[np.float64], counts: NDArray[np.int64], of: tuple[float, ...]) -> list[float]:
    """As `numpy.percentile` of `values` (n,), each as often as `counts` (n,) says."""
    order = np.argsort(values, kind="stable")
    ends = np.cumsum(counts[order])
    quantiles = []
    for share in of:
        at = (int(ends[-1]) - 1) * (share / 100.0)
        low = math.floor(at)
        a, b = (float(values[order][np.searchsorted(ends, min(k, ends[-1] - 1), "right")]) for k in (low, low + 1))
        quantiles.append(b - (b - a) * (1.0 - (at - low)) if at - low >= 0.5 else a + (b - a) * (at - low))
    return quantiles


class Prescriber:
    """Takes answers in order; gives segments when the scanner has left them. Holds one segment of road, in memory that
    does not grow while the vehicle stands."""

    def __init__(self, params: StreetParams, crown: int) -> None:
        self.params, self.crown = params.prescription, crown
        self._height, self._reach = params.mounting.height, max(params.radii)
        self._number = 0
        self._open: _Open | None = None

    def take(self, answer: Answer) -> Iterator[Segment]:
        """The segments that this answer shows to be left."""
        number, cell = (math.floor(answer.place / v) for v in (self.params.segment, self.params.voxel))
        if number != self._number:
            yield from self.rest()
        here, now = self._open, (answer.time, answer.place)
        if here is None:
            base = math.floor(number * self.params.segment / self.params.voxel) - 1
            here = self._open = _Open(base, now, now)
        self._number, here.last = number, now
        crown = answer.classification == self.crown
        if crown.any():
            here.add(cell, answer.y[crown], answer.z[crown])

    def rest(self) -> Iterator[Segment]:
        """The segments that the scanner was in when answers ended."""
        here, self._open = self._open, None
        if here is None or not here.held:
            return
        x, y, z, counts = here.returns()
        for side, of in (("left", y >= 0), ("right", y < 0)):
            if int(counts[of].sum()) >= self.params.fewest:
                yield self._segment(side, here, x[of], np.abs(y[of]), z[of] + self._height, counts[of])

    def _segment(self, side: str, here: _Open, x: NDArray, y: NDArray, z: NDArray, counts: NDArray) -> Segment:
        edge, number, returns = self.params.voxel, self._number, int(counts.sum())
        cells = np.concatenate([x[:, None], np.floor(np.stack([y, z], axis=1) / edge).astype(np.int64)], axis=1)
        volume = len(np.unique(cells, axis=0)) * edge**3
        seconds = here.last[0] - here.first[0]
        speed = (here.last[1] - here.first[1]) / seconds if seconds > 0 else math.nan
        begin, end = number * self.params.segment, (number + 1) * self.params.segment
        way = begin + self.params.nozzle - (end + self._reach)
        left = way / speed if speed > 0 else math.nan
        low, high, near, far = (v for of in (z, y) for v in percentiles(of, counts, STRAY))
        return Segment(
            side, begin, end, low, high, near, far, returns, volume, returns / volume, speed, self.params.nozzle, left
        )


def segments(answers: Iterable[Answer], params: StreetParams, crown: int) -> Iterator[Segment]:
    """The prescription of a whole recording."""
    prescriber = Prescriber(params, crown)
    for one in answers:
        yield from prescriber.take(one)
    yield from prescriber.rest()
