"""From crown returns to a prescription: segments along the road, each side by itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from fwclass.street.answers import Answer
from fwclass.street.frames import Geometry
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
        likewise. returns : of crowns. volume : of the voxels that hold one, what lies in the segment [m3].
    density : returns / volume [1/m3]. speed : of the vehicle beside it [m/s], NaN where it stood or was not yet.
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
"""Different returns of the segments that are held; of more, y and z are rounded down to twice the unit, and so on."""

LEAST = 20_000
"""Different returns that one side of a segment may have, however many are held."""

_Seen = tuple[float, float]
"""Time [s] and place [m] of a frame."""

NOWHERE: _Seen = (math.nan, math.nan)

WORD = 6
"""Sides of 2^5 segments are remembered in the bits of one number: an hour at 1 m/s takes 50 kB at most."""

AHEAD = 10.0
"""m that a vehicle may go back before what lies ahead of it is written."""


@dataclass
class _Open:
    """What is known of one side of a segment that is not written; returns of one voxel along the road, y and z are
    counted. `share`: as many segments are held at a time, and have as much less memory each."""

    base: int
    share: int = 1
    keys: list[NDArray[np.int64]] = field(default_factory=list)
    counts: list[NDArray[np.int64]] = field(default_factory=list)
    held: int = 0
    kept: int = 0

    def add(self, cells: NDArray[np.int64], y: NDArray[np.float32], z: NDArray[np.float32]) -> None:
        """Returns at `y` and `z` [m] in the voxels `cells` along the road."""
        keys = cells - self.base
        for axis in (y, z):
            units = np.rint(axis.astype(np.float64) / UNIT).clip(-HALF, HALF - 1).astype(np.int64)
            keys = (keys << SPLIT) | (units + HALF)
        self.keys.append(keys)
        self.counts.append(np.ones(len(keys), np.int64))
        self.held += len(keys)
        if self.held > max(HELD // self.share, 2 * self.kept):
            self.count()

    def count(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Different keys, ascending, and how many returns have each."""
        keys, counts = (np.concatenate(v) if v else np.empty(0, np.int64) for v in (self.keys, self.counts))
        for bits in range(SPLIT):
            even = ((1 << SPLIT) - 1) >> bits << bits
            keys, which = np.unique(keys & (-1 << 2 * SPLIT | even << SPLIT | even), return_inverse=True)
            counts = np.bincount(which, counts, len(keys)).astype(np.int64)
            if len(keys) <= max(MOST // self.share, min(MOST, LEAST)):
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
    """Takes answers in order; gives segments when no return of a later frame can lie in them. Holds what the scanner
    reaches along the road, in memory that does not grow while the vehicle stands.

    Each side of a segment is given once: `again` counts the crown returns of a vehicle that went back and saw written
    ones anew. `geometry` of a scanner that is not at right angles to the road.
    """

    def __init__(self, params: StreetParams, crown: int, geometry: Geometry | None = None) -> None:
        self.params, self.crown, self.again = params.prescription, crown, 0
        self._height = params.mounting.height
        self._reach = max(params.radii) * (1.0 if geometry is None else geometry.reach)
        self._offsets = tuple((0.0, 0.0) if geometry is None else geometry.offsets(left) for left in (True, False))
        self._reached: tuple[tuple[int, int], ...] = ()
        self._open: dict[int, _Open] = {}
        self._passed: dict[int, tuple[_Seen, _Seen]] = {}
        self._written: dict[int, int] = {}

    def take(self, answer: Answer) -> Iterator[Segment]:
        """The segments that this answer shows to be left."""
        edge, now = self.params.segment, (answer.time, answer.place)
        reached = tuple(
            (math.floor((answer.place - behind) / edge), math.floor((answer.place + ahead + AHEAD) / edge))
            for behind, ahead in self._offsets
        )
        if reached != self._reached:
            self._reached = reached
            yield from self._leave()
        number = math.floor(answer.place / edge)
        self._passed[number] = (self._passed.get(number, (now,))[0], now)
        crown = answer.classification == self.crown
        if crown.any():
            self._add(answer.along[crown], answer.y[crown], answer.z[crown])

    def _add(self, along: NDArray[np.float64], y: NDArray[np.float32], z: NDArray[np.float32]) -> None:
        keys = 2 * np.floor(along / self.params.segment).astype(np.int64) + (y < 0)
        cells = np.floor(along / self.params.voxel).astype(np.int64)
        for key in np.unique(keys).tolist():
            of = keys == key
            if self._written.get(key >> WORD, 0) >> key % (1 << WORD) & 1:
                self.again += int(of.sum())
                continue
            if key not in self._open:
                self._open[key] = _Open(math.floor((key // 2) * self.params.segment / self.params.voxel) - 1)
            here = self._open[key]
            here.share = len(self._open)
            here.add(cells[of], y[of], z[of])

    def _leave(self) -> Iterator[Segment]:
        """The segments that the scanner reaches no more."""
        left = [k for k in self._open if not self._reached[k % 2][0] <= k // 2 <= self._reached[k % 2][1]]
        yield from self._close(left)
        low, high = (f(ends[k] for ends in self._reached) for k, f in ((0, min), (1, max)))
        for number in [n for n in self._passed if not low <= n <= high]:
            del self._passed[number]

    def rest(self) -> Iterator[Segment]:
        """The segments that were not left when answers ended."""
        yield from self._close(list(self._open))

    def _close(self, keys: list[int]) -> Iterator[Segment]:
        for key in sorted(keys):
            x, y, z, counts = self._open.pop(key).returns()
            if int(counts.sum()) >= self.params.fewest:
                self._written[key >> WORD] = self._written.get(key >> WORD, 0) | 1 << key % (1 << WORD)
                yield self._segment(key, x, np.abs(y), z + self._height, counts)

    def _segment(self, key: int, x: NDArray, y: NDArray, z: NDArray, counts: NDArray) -> Segment:
        (number, right), edge, returns = divmod(key, 2), self.params.voxel, int(counts.sum())
        cells = np.concatenate([x[:, None], np.floor(np.stack([y, z], axis=1) / edge).astype(np.int64)], axis=1)
        begin, end = number * self.params.segment, (number + 1) * self.params.segment
        along = np.unique(cells, axis=0)[:, 0] * edge
        volume = float(np.maximum(np.minimum(along + edge, end) - np.maximum(along, begin), UNIT).sum()) * edge**2
        first, last = self._passed.get(number, (NOWHERE, NOWHERE))
        seconds = last[0] - first[0]
        speed = (last[1] - first[1]) / seconds if seconds > 0 else math.nan
        way = begin + self.params.nozzle - (end + self._offsets[right][0] + self._reach)
        left = way / speed if speed > 0 else math.nan
        low, high, near, far = (v for of in (z, y) for v in percentiles(of, counts, STRAY))
        side, nozzle = ("left", "right")[right], self.params.nozzle
        return Segment(side, begin, end, low, high, near, far, returns, volume, returns / volume, speed, nozzle, left)


def segments(
    answers: Iterable[Answer], params: StreetParams, crown: int, geometry: Geometry | None = None
) -> tuple[list[Segment], int]:
    """The prescription of a whole recording, and `Prescriber.again`."""
    prescriber = Prescriber(params, crown, geometry)
    given: list[Segment] = []
    for one in answers:
        given += prescriber.take(one)
    given += prescriber.rest()
    return given, prescriber.again


def seen_again(returns: int) -> list[str]:
    """What to say of `Prescriber.again`."""
    if not returns:
        return []
    return [
        f"the vehicle went back: {returns:,} crown returns of segments that were written before are in none, as "
        "each is written once"
    ]
