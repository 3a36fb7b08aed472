"""What a model says of the returns of frames, each frame once those around it are there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.shares import answer
from fwclass.model import Model
from fwclass.model.ranges import RangeCounter
from fwclass.street.answers import Answer, make_answer
from fwclass.street.frames import Geometry, Placed
from fwclass.street.params import StreetParams
from fwclass.street.ring import Ring, Seen
from fwclass.street.smoothing import Smoother


def halo(params: StreetParams) -> int:
    """Frames to both sides that an answer may reach over."""
    return params.most_frames * (1 if params.smooth is None else 2)


def classify_frame(
    one: Seen, model: Model, outside: RangeCounter | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Index of the class, and shares of the classes, of a frame's returns in the order of the beams; `outside` counts
    features that leave what the model has seen."""
    here = ~np.isnan(one.frame.r)
    if not here.any():
        return np.empty(0, np.int64), np.empty((0, len(model.codes)))
    if outside is not None:
        outside.add(one.features[here])
    return answer(one.features[here], model)


@dataclass
class Answering:
    """One frame in, those that it completes out with their answers, in order; the same for every source.

    `asked`: as of `Ring`. `most`: frames of a neighbourhood, that of the largest sphere. `cut`: frames whose
    neighbourhood `most_frames` ended. `outside`: features that leave what the model has seen. All of frames that are
    asked for.
    """

    model: Model
    params: StreetParams
    geometry: Geometry
    asked: range | None = None

    def __post_init__(self) -> None:
        self.most = self.cut = 0
        self.outside = RangeCounter.of(self.model.card, self.model.features)
        around, self._smoother, self._smoothing_reaches_further = self.asked, None, False
        if self.params.smooth is not None:
            around, inner = self._wider()
            classes = len(self.model.codes)
            self._smoother = Smoother(self.geometry, self.params, self.params.smooth, classes, inner)
            self._smoothing_reaches_further = self.params.smooth > max(self.params.radii)
        self._ring = Ring(self.geometry, self.params, around)
        self._at = around.start if around is not None else 0

    def _wider(self) -> tuple[range | None, range | None]:
        """Frames whose shares those that are asked for need, and which of these are asked for."""
        if self.asked is None:
            return None, None
        first = max(0, self.asked.start - self.params.most_frames)
        return (
            range(first, self.asked.stop + self.params.most_frames),
            range(self.asked.start - first, self.asked.stop - first),
        )

    def take(self, frame: Placed) -> Iterator[tuple[Placed, Answer]]:
        """The frames that this one completes."""
        for one in self._ring.take(frame):
            yield from self._answered(one)

    def rest(self) -> Iterator[tuple[Placed, Answer]]:
        """Those that still wait when no other comes."""
        for one in self._ring.rest():
            yield from self._answered(one)
        if self._smoother is not None:
            yield from map(self._smoothed, self._smoother.rest())

    def _answered(self, one: Seen) -> Iterator[tuple[Placed, Answer]]:
        counted = self.asked is None or self._at in self.asked
        self._at += 1
        if counted and not self._smoothing_reaches_further:
            self._count(one)
        winner, shares = classify_frame(one, self.model, self.outside if counted else None)
        if self._smoother is None:
            yield self._answer(one.frame, winner, shares)
            return
        of_beams = np.zeros((len(one.frame.r), len(self.model.codes)))
        of_beams[~np.isnan(one.frame.r)] = shares
        yield from map(self._smoothed, self._smoother.put(one.frame, of_beams))

    def _count(self, one: Seen) -> None:
        self.most, self.cut = max(self.most, one.frames), self.cut + int(one.cut)

    def _smoothed(self, one: Seen) -> tuple[Placed, Answer]:
        if self._smoothing_reaches_further:
            self._count(one)
        shares = one.features[~np.isnan(one.frame.r)].astype(np.float64)
        return self._answer(one.frame, shares.argmax(axis=1), shares)

    def _answer(self, frame: Placed, winner: NDArray[np.int64], shares: NDArray[np.float64]) -> tuple[Placed, Answer]:
        sure = np.take_along_axis(shares, winner[:, None], axis=1)[:, 0]
        return frame, make_answer(frame, self.model.codes[winner], sure)
