"""The area that echoes cover, from a raster of which cells hold one, whatever the stripes that it comes in."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window

TIMES = (1, 2, 4, 8, 16, 32)
"""Cells of the raster along a square; the smallest square is taken that is wide enough for the spacing."""

WIDE = 1.5
"""Mean spacings along a square: of random points one in ten is empty then, of even ones none."""

WIDEST = 1000
"""Squares; wider gaps of a row are no matter of spacing."""


class CoveredArea:
    """Squares with an echo, and those between two of them in a row that are empty by chance. `cell`: of the raster [m].

    Squares of several sizes are counted, as the spacing of the echoes is known at the end alone.
    """

    def __init__(self, cell: float) -> None:
        self.cell = cell
        self._squares = [_Squares(k) for k in TIMES]

    def add(self, stripe: Window, occupied: NDArray[np.bool_]) -> None:
        """Take in whole rows of the raster, bool (rows, columns), those of a `stripe` beside the one before."""
        for squares in self._squares:
            squares.add(stripe, occupied)

    def plain(self) -> list[dict[str, Any]]:
        """For a receipt; `join_areas` makes it again."""
        return [squares.plain() for squares in self._squares]

    @classmethod
    def joined(cls, cell: float, rasters: Sequence[Sequence[Mapping[str, Any]]]) -> CoveredArea:
        """The area of several rasters of cells of edge `cell` [m], by what `plain` gave of each."""
        area = cls(cell)
        for raster in rasters:
            for squares, counts in zip(area._squares, raster, strict=True):
                squares.take(counts)
        return area

    def of(self, points: int, spacings: float) -> float:
        """The area [m²] where `points` [count] lie: gaps of a row no wider than so many of their mean spacings, which
        itself follows from this area, are part of it. Wider ones are voids, or lie outside."""
        area = 0.0
        for squares in self._squares:
            edge = self.cell * squares.times
            area = squares.filled(points, spacings) * edge**2
            if not points or edge >= WIDE * math.sqrt(area / points):
                break
        return area


class _Squares:
    """Squares of `times` cells of the raster."""

    def __init__(self, times: int) -> None:
        self.times, self._count, self._gaps = times, 0, Counter[int]()
        self._open: dict[tuple[int, int, int], NDArray[np.bool_]] = {}  # rows that the next stripe may belong to too

    def add(self, stripe: Window, occupied: NDArray[np.bool_]) -> None:
        low, high = stripe.row // self.times, (stripe.row + stripe.nrows - 1) // self.times
        left, right = stripe.col // self.times, (stripe.col + stripe.ncols - 1) // self.times
        rows = np.maximum(np.arange(low, high + 1) * self.times - stripe.row, 0)
        columns = np.maximum(np.arange(left, right + 1) * self.times - stripe.col, 0)
        squares = np.logical_or.reduceat(np.logical_or.reduceat(occupied, rows, axis=0), columns, axis=1)
        ends = {(row, left, right) for row in (low, high)}
        for other in self._open.keys() - ends:  # of another raster too
            self._close(self._open.pop(other)[None])
        self._close(squares[1:-1])
        for end in ends:
            self._open[end] = squares[end[0] - low] | self._open.get(end, False)

    def _close(self, squares: NDArray[np.bool_]) -> None:
        rows, columns = np.nonzero(squares)
        self._count += len(rows)
        gap = np.diff(columns)[rows[1:] == rows[:-1]] - 1
        counts = np.bincount(gap[(gap > 0) & (gap <= WIDEST)])
        self._gaps.update({int(n): int(counts[n]) for n in np.flatnonzero(counts)})

    def _close_all(self) -> None:
        for row in list(self._open):
            self._close(self._open.pop(row)[None])

    def plain(self) -> dict[str, Any]:
        self._close_all()
        return {"count": self._count, "gaps": {str(n): k for n, k in sorted(self._gaps.items())}}

    def take(self, counts: Mapping[str, Any]) -> None:
        self._count += counts["count"]
        self._gaps.update({int(n): k for n, k in counts["gaps"].items()})

    def filled(self, points: int, spacings: float) -> int:
        """Squares with an echo, and in the gaps that are no wider than `spacings`."""
        self._close_all()
        count = self._count
        while count and points:
            widest = math.ceil(spacings * math.sqrt(count / points) - 1e-9)
            wider = self._count + sum(n * k for n, k in self._gaps.items() if n <= widest)
            if wider == count:
                break
            count = wider
        return count
