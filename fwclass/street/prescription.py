"""From crown returns to a prescription: segments along the road, each side by itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from fwclass.street.answers import Answer
from fwclass.street.params import StreetParams

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


@dataclass
class _Open:
    """What is known of a segment that the scanner is in."""

    y: list[NDArray] = field(default_factory=list)
    z: list[NDArray] = field(default_factory=list)
    x: list[NDArray] = field(default_factory=list)
    first: tuple[float, float] = (math.nan, math.nan)
    last: tuple[float, float] = (math.nan, math.nan)


class Prescriber:
    """Takes answers in order; gives segments when the scanner has left them. Holds one segment of road."""

    def __init__(self, params: StreetParams, crown: int) -> None:
        self.params, self.crown = params.prescription, crown
        self._height, self._reach = params.mounting.height, max(params.radii)
        self._number: int | None = None
        self._open = _Open()

    def take(self, answer: Answer) -> Iterator[Segment]:
        """The segments that this answer shows to be left."""
        number = math.floor(answer.place / self.params.segment)
        if self._number is not None and number != self._number:
            yield from self._closed()
        self._number = number
        here = self._open
        if math.isnan(here.first[0]):
            here.first = (answer.time, answer.place)
        here.last = (answer.time, answer.place)
        crown = answer.classification == self.crown
        if crown.any():
            here.y.append(answer.y[crown].astype(float))
            here.z.append(answer.z[crown].astype(float))
            here.x.append(np.full(int(crown.sum()), answer.place))

    def rest(self) -> Iterator[Segment]:
        """The segments that the scanner was in when answers ended."""
        if self._number is not None:
            yield from self._closed()

    def _closed(self) -> Iterator[Segment]:
        here, number = self._open, self._number or 0
        self._open, self._number = _Open(), None
        if not here.y:
            return
        x, y, z = (np.concatenate(v) for v in (here.x, here.y, here.z))
        for side, of in (("left", y >= 0), ("right", y < 0)):
            if int(of.sum()) >= self.params.fewest:
                yield self._segment(side, number, here, x[of], np.abs(y[of]), z[of] + self._height)

    def _segment(self, side: str, number: int, here: _Open, x: NDArray, y: NDArray, z: NDArray) -> Segment:
        edge = self.params.voxel
        cells = np.floor(np.stack([x, y, z], axis=1) / edge).astype(np.int64)
        volume = len(np.unique(cells, axis=0)) * edge**3
        seconds = here.last[0] - here.first[0]
        speed = (here.last[1] - here.first[1]) / seconds if seconds > 0 else math.nan
        begin, end = number * self.params.segment, (number + 1) * self.params.segment
        way = begin + self.params.nozzle - (end + self._reach)
        left = way / speed if speed > 0 else math.nan
        low, high, near, far = (float(v) for of in (z, y) for v in np.percentile(of, STRAY))
        return Segment(
            side, begin, end, low, high, near, far, len(x), volume, len(x) / volume, speed, self.params.nozzle, left
        )


def segments(answers: Iterable[Answer], params: StreetParams, crown: int) -> Iterator[Segment]:
    """The prescription of a whole recording."""
    prescriber = Prescriber(params, crown)
    for one in answers:
        yield from prescriber.take(one)
    yield from prescriber.rest()
