"""The frames that are held: a ring in which the middle frame's spheres are complete (Li 2018, eqs. 1 and 2).

A frame's neighbourhood is the run of frames around it that lie within the largest radius along the road, at most
`most_frames` to each side. Nothing is built when a frame comes: its row in the ring is filled.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.schema import scaled
from fwclass.street.frames import Geometry, Placed
from fwclass.street.params import StreetParams
from fwclass.street.sphere_kernels import SUMS, UNIT, features_of, frame_sums

BASES = (
    *("street_height_mean", "street_height_variance", "street_height_range"),
    *("street_depth_mean", "street_depth_variance", "street_depth_range"),
    *("street_count", "street_omnivariance", "street_linearity", "street_planarity", "street_sphericity"),
)
"""The features of Li 2018, in the order of `features_of`."""

LIGHT = ("street_intensity_mean", "street_intensity_deviation")
"""Those of intensities, behind them."""


def feature_names(params: StreetParams) -> tuple[str, ...]:
    """Columns of the features, radius by radius."""
    first = "street_road_height_mean" if params.features == "height" else BASES[0]
    light = LIGHT if params.intensity is not None else ()
    return tuple(scaled(base, radius) for radius in params.radii for base in (first, *BASES[1:], *light))


@dataclass(frozen=True)
class Seen:
    """A frame whose neighbourhood is complete.

    `features`: float32 (beams, features), NaN without a return; valid until the next frame is taken. `frames`: of its
    neighbourhood, itself included. `cut`: `most_frames` ended it.
    """

    frame: Placed
    features: NDArray[np.float32]
    frames: int
    cut: bool


class Ring:
    """Takes frames in order and gives those back whose neighbourhood is complete.

    Work of a frame is bounded by ``2 × most_frames + 1`` frames, memory by half as many more, at any speed.
    """

    def __init__(self, geometry: Geometry, params: StreetParams, asked: range | None = None) -> None:
        """`asked`: only frames of these numbers, counted from the first that is taken, are given back; None for all."""
        self.geometry, self.params, self.asked = geometry, params, asked
        self.size = 3 * params.most_frames + 2
        beams = geometry.scan.beams
        self._x = np.zeros((self.size if geometry.tilted else 0, beams), np.int32)
        self._y, self._z = (np.zeros((self.size, beams), np.int32) for _ in range(2))
        self._light = np.zeros((self.size, beams), np.int32) if params.intensity is not None else None
        self._r = np.full((self.size, beams), np.nan, np.float32)
        self._place = np.zeros(self.size, np.int64)
        self._frames: list[Placed | None] = [None] * self.size
        self._reach = max(params.radii) * geometry.reach / UNIT
        self._received = self._answered = 0
        self._sums = np.zeros((beams, SUMS), np.int64)
        names = len(BASES) + (len(LIGHT) if self._light is not None else 0)
        self._out = np.empty((len(params.radii), beams, names), np.float32)

    @property
    def waiting(self) -> int:
        """Frames taken and not yet given back."""
        return self._received - self._answered

    def take(self, frame: Placed) -> Iterator[Seen]:
        """Put a frame in; frames whose neighbourhood is complete, in order. Ask for all before the next frame.

        One is given for one that comes, two as long as more than two are complete: a speed that wavers, or a vehicle
        that starts again, makes no burst.
        """
        row = self._received % self.size
        if self.geometry.tilted:
            self._x[row] = frame.x
        self._y[row], self._z[row], self._r[row] = frame.y, frame.z, frame.r
        if self._light is not None:
            self._light[row] = frame.light
        self._place[row], self._frames[row] = frame.place, frame
        self._received += 1
        released = 0
        while self._complete(self._answered):
            late = self.waiting > 2 * self.params.most_frames
            if released and not late and (released == 2 or not self._complete(self._answered + 1)):
                return
            yield from self._release(self._end(self._answered))
            released += 1

    def _complete(self, middle: int) -> bool:
        """No frame that is still to come can be of the run after `middle`."""
        if middle >= self._received:
            return False
        last = self._end(middle)
        return last < self._received - 1 or last - middle >= self.params.most_frames

    def rest(self) -> Iterator[Seen]:
        """The frames that are still waiting when no other will come."""
        while self.waiting:
            yield from self._release(self._end(self._answered))

    def _release(self, last: int) -> Iterator[Seen]:
        if self.asked is None or self._answered in self.asked:
            yield self._measure(last)
        else:
            self._answered += 1

    def _near(self, one: int, other: int) -> bool:
        return abs(int(self._place[one % self.size]) - int(self._place[other % self.size])) <= self._reach

    def _end(self, middle: int) -> int:
        """Last frame of the run that begins with `middle`, of those that are there."""
        last = middle
        while last + 1 < self._received and last - middle < self.params.most_frames and self._near(middle, last + 1):
            last += 1
        return last

    def _begin(self, middle: int) -> int:
        first = middle
        oldest = max(0, self._received - self.size, middle - self.params.most_frames)
        while first > oldest and self._near(middle, first - 1):
            first -= 1
        return first

    def _measure(self, last: int) -> Seen:
        middle = self._answered
        first = self._begin(middle)
        rows = np.arange(first, last + 1) % self.size
        frame = self._frames[middle % self.size]
        if frame is None:
            raise IndexError(middle)
        features = self._features(rows, middle % self.size, frame)
        self._answered += 1
        most = self.params.most_frames
        return Seen(frame, features, len(rows), last - middle == most or middle - first == most)

    def _features(self, rows: NDArray[np.int64], middle: int, frame: Placed) -> NDArray[np.float32]:
        geometry, scan = self.geometry, self.geometry.scan
        narrow = self.params.window == "paper"
        for k, radius in enumerate(self.params.radii):
            frame_sums(
                *(self._x, self._y, self._z, self._light, self._r, self._place, rows, middle),
                *(radius, scan.step, geometry.lean, scan.wraps, narrow, self._sums),
            )
            from_road = self.params.features == "height"
            features_of(self._sums, self._y[middle], self._z[middle], frame.road, from_road, self._out[k])
        if len(self._out) == 1:
            return self._out[0]
        return np.ascontiguousarray(np.concatenate(list(self._out), axis=1))
