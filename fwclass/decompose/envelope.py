"""How low and how high the returns of a strip lie: what echoes that no return explains are held against."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.schema import Table

_HALF = 1 << 31


@dataclass(frozen=True)
class Envelope:
    """The lower envelope of a strip's returns, by cells of the global grid that hold one.

    Attributes
    ----------
    cell : edge of a cell [m].
    keys : int64 (n,), ascending, of the cells.
    lowest : (n,) height of the lowest return in each and in the eight around it [m].
    bottom, top : height of the lowest and highest return of the strip [m]; NaN without one.
    """

    cell: float
    keys: NDArray[np.int64]
    lowest: NDArray[np.float64]
    bottom: float
    top: float

    @classmethod
    def nothing(cls, cell: float) -> Envelope:
        """The envelope of a strip without returns, with cells of edge `cell` [m]: all heights are NaN."""
        return cls(cell, np.empty(0, np.int64), np.empty(0), np.nan, np.nan)

    @classmethod
    def of(cls, parts: Iterable[Table], cell: float) -> Envelope:
        """The envelope of the returns (``x, y, z`` [m]) of all chunks of a strip, in any order."""
        keys, lowest = np.empty(0, np.int64), np.empty(0)
        bottom, top = np.nan, np.nan
        for table in parts:
            z = table["z"]
            if len(z):
                own, least = _lowest(_keys(table["x"], table["y"], cell), z)
                keys, lowest = _lowest(np.concatenate([keys, own]), np.concatenate([lowest, least]))
                bottom, top = float(np.fmin(bottom, z.min())), float(np.fmax(top, z.max()))
        around = [(dx << 32) + dy for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        smooth = np.minimum.reduce([_value(keys, lowest, keys + step) for step in around]) if len(keys) else lowest
        return cls(cell, keys, smooth, bottom, top)

    def below(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lowest return within one to two cells of every place [m]; the strip's lowest where there is none."""
        lowest = _value(self.keys, self.lowest, _keys(x, y, self.cell))
        return np.where(np.isfinite(lowest), lowest, self.bottom)


def _keys(x: NDArray[np.float64], y: NDArray[np.float64], cell: float) -> NDArray[np.int64]:
    column, row = (np.clip(np.floor(v / cell), -_HALF / 2, _HALF / 2).astype(np.int64) for v in (x, y))
    return (column << 32) + row + _HALF


def _lowest(keys: NDArray[np.int64], z: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    order = np.lexsort((z, keys))
    cells, first = np.unique(keys[order], return_index=True)
    return cells, z[order][first]


def _value(keys: NDArray[np.int64], values: NDArray[np.float64], wanted: NDArray[np.int64]) -> NDArray[np.float64]:
    """`values` by key, infinity where there is none."""
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, values[at], np.inf) if len(keys) else np.full(len(wanted), np.inf)
