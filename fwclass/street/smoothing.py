"""Returns that answer together: the share of what is looked for is the mean of the returns around.

The shares of a frame wait in a ring of their own until those of the frames around it are there, so a frame is answered
as many frames later as its sphere reaches over. They are whole levels: means are exact, in whatever order frames come.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fwclass.street.frames import Geometry, Placed
from fwclass.street.params import StreetParams
from fwclass.street.ring import Ring, Seen
from fwclass.street.sphere_kernels import LEVELS, frame_sums

_LEAST = 1e-9
"""Of every other class: they share the rest alike where all of a return was the first one's."""


class Smoother(Ring):
    """Takes the shares of frames in order, and gives them back as means over spheres of `street.smooth` metres."""

    def __init__(
        self, geometry: Geometry, params: StreetParams, radius: float, classes: int, asked: range | None = None
    ) -> None:
        """`radius` [m]; `asked` as of `Ring`."""
        super().__init__(geometry, params.model_copy(update={"radii": (radius,), "intensity": 1.0}), asked)
        self._shares = np.zeros((self.size, geometry.scan.beams, classes))

    def put(self, frame: Placed, shares: NDArray[np.float64]) -> Iterator[Seen]:
        """As `take`, with `shares` (beams, classes), any without a return; what is given back has shares as features.

        The other classes share what the first one's mean leaves as they did.
        """
        self._shares[self._received % self.size] = shares
        levels = np.rint(np.clip(shares[:, 0], 0.0, 1.0) * (LEVELS - 1)).astype(np.int32)
        yield from self.take(replace(frame, light=levels))

    def _features(self, rows: NDArray[np.int64], middle: int, frame: Placed) -> NDArray[np.float32]:
        geometry, scan = self.geometry, self.geometry.scan
        frame_sums(
            *(self._x, self._y, self._z, self._light, self._r, self._place, rows, middle, self.params.radii[0]),
            *(scan.step, geometry.lean, scan.wraps, self.params.window == "paper", self._sums),
        )
        count = np.where(self._sums[:, 0] > 0, self._sums[:, 0], np.nan)
        first = self._sums[:, 14] / count / (LEVELS - 1.0)
        others = self._shares[middle, :, 1:] + _LEAST
        rest = (1.0 - first)[:, None] * (others / others.sum(axis=1, keepdims=True))
        return np.column_stack([first, rest]).astype(np.float32)
