"""Where the classes of files lie, and the straight line that best parts a training area from a test area."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box

CELL = 10.0
"""m, the finest cells that classes are counted in: a training area need not be drawn finer."""

MOST_CELLS = 500_000
"""Cells, counted once for every class in them, that are kept; beyond it cells are doubled. Four stay."""

SHARES = (0.25, 0.65)
"""Least and greatest share of the labelled points that may train: half, give or take what classes ask for."""


@dataclass
class ClassPlaces:
    """Points by cell of a grid and class code: `counts[column, row, code]`; `cell` [m] doubles where too many are
    occupied."""

    cell: float = CELL
    counts: Counter[tuple[int, int, int]] = field(default_factory=Counter)

    def add(self, x: NDArray[np.float64], y: NDArray[np.float64], codes: NDArray[np.uint8]) -> None:
        """Count points (n,) at `x`, `y` [m] with class `codes`."""
        column, row = (np.floor(v / self.cell).astype(np.int64) for v in (x, y))
        keys, some = np.unique(np.column_stack([column, row, codes]), axis=0, return_counts=True)
        self.counts.update({(i, j, code): n for (i, j, code), n in zip(keys.tolist(), some.tolist(), strict=True)})
        while len(self.counts) > MOST_CELLS:
            finer, self.counts, self.cell = self.counts, Counter(), 2.0 * self.cell
            for (i, j, code), n in finer.items():
                self.counts[i // 2, j // 2, code] += n

    @property
    def area(self) -> float:
        """m2 of the occupied cells."""
        return len({(i, j) for i, j, _ in self.counts}) * self.cell**2

    def of(self, classes: Sequence[Sequence[int]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Cells (n, 2) that hold points of `classes` (codes of each), a cell once for each class, and points (n,
        classes) in them."""
        index = {code: k for k, codes in enumerate(classes) for code in codes}
        squares = [(i, j, index[code], n) for (i, j, code), n in self.counts.items() if code in index]
        table = np.array(squares, np.int64).reshape(-1, 4)
        points = np.zeros((len(table), len(classes)), np.int64)
        points[np.arange(len(table)), table[:, 2]] = table[:, 3]
        return table[:, :2], points


class AreaSplit(NamedTuple):
    """A training box [m], and per class the points inside it and those further than `gap` [m] from it."""

    box: Box
    gap: float
    train: NDArray[np.int64]
    test: NDArray[np.int64]

    @property
    def balance(self) -> float:
        """The smaller side's share of the class that is shared out worst, 0 to 0.5."""
        total = np.maximum(1, self.train + self.test)
        return float((np.minimum(self.train, self.test) / total).min())


def best_split(places: ClassPlaces, classes: Sequence[Sequence[int]], bounds: Box, gap: float) -> AreaSplit | None:
    """The line along an axis whose one side is the training area, so that every class lies well on both sides.

    Parameters
    ----------
    places : where the points are.
    classes : codes of each class.
    bounds : of all points [m].
    gap : m, between the training box and what is tested.

    Returns the most balanced one whose training side has a share within `SHARES`; None where no line leaves any class
    points on both sides.
    """
    splits = (s for s in _splits(places, classes, bounds, gap) if (s.train > 0).any() and (s.test > 0).any())
    return max(splits, key=lambda s: (_two_sided(s), s.balance), default=None)


def _two_sided(split: AreaSplit) -> int:
    """Classes that lie on both sides."""
    return int(((split.train > 0) & (split.test > 0)).sum())


def _splits(places: ClassPlaces, classes: Sequence[Sequence[int]], bounds: Box, gap: float) -> Iterator[AreaSplit]:
    cells, counts = places.of(classes)
    if not len(cells):
        return
    apart = int(np.ceil(gap / places.cell))
    total = max(1, int(counts.sum()))
    for axis in (0, 1):
        lines, own = np.unique(cells[:, axis], return_inverse=True)
        along = np.zeros((len(lines), counts.shape[1]), np.int64)
        np.add.at(along, own.reshape(-1), counts)
        below = np.vstack([np.zeros_like(along[:1]), along.cumsum(axis=0)])
        # between these a cut changes no count: files with places far apart cost no more than others
        cuts = np.unique(np.concatenate([lines + 1, lines + 1 - apart, lines + 1 + apart]))
        cuts = cuts[(cuts > lines[0]) & (cuts <= lines[-1])]
        at, ahead, behind = (below[np.searchsorted(lines, cuts + shift)] for shift in (0, apart, -apart))
        for cut, low, later, earlier in zip(cuts.tolist(), at, ahead, behind, strict=True):
            high = below[-1] - low
            sides = ((low, below[-1] - later, None, cut * places.cell), (high, earlier, cut * places.cell, None))
            for train, test, begin, end in sides:
                if SHARES[0] <= train.sum() / total <= SHARES[1]:
                    yield AreaSplit(_side(bounds, axis, begin, end), gap, train, test)


def _side(bounds: Box, axis: int, begin: float | None, end: float | None) -> Box:
    """The part of `bounds` between two lines across an axis; a missing one is the end of the bounds."""
    ends: list[float] = list(bounds.bounds)
    if begin is not None:
        ends[axis] = begin
    if end is not None:
        ends[axis + 2] = end
    return Box(*ends)


def outer_box(bounds: Iterable[Sequence[float]]) -> Box:
    """The box [m] around bounds (xmin, ymin, zmin, xmax, ymax, zmax), in whole metres, points on its edge inside."""
    ends = np.array(list(bounds), np.float64)
    low, high = np.floor(ends[:, :2].min(axis=0)), np.floor(ends[:, 3:5].max(axis=0)) + 1.0
    return Box(*low.tolist(), *high.tolist())
