"""Whether labels lie where their echoes are: where their classes would explain most of what features differ by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.hashing import hash_keys

REACH = 10
"""Cells that labels are moved by at most, each way."""

CELLS = (1_000, 2_000, 4_000)
"""Edges of cells [mm], of which the first is taken where enough cells have a neighbour."""

PAIRS = 500
"""Cells with labels that an offset is judged by at least."""

MOST = 20_000
"""Cells whose labels are moved; of more those whose numbers have the smallest hashes."""

TELLING = 8
"""Features over which the mean is taken: those that classes explain best. Most tell hardly anything."""

LEVELS = 255
"""Ranks of a feature that are told apart: whole numbers, so that sums are the same in any order."""


@dataclass(frozen=True)
class Offset:
    """The offset at which labels fit best.

    Attributes
    ----------
    x, y : what the labels would have to be moved by [m], whole cells.
    cell : edge of the cells [m].
    explained : share of the variance of the features' ranks that lies between classes there.
    unmoved : the same by the labels where they are, of the same cells: others are differently hard to tell.
    """

    x: float
    y: float
    cell: float
    explained: float
    unmoved: float


def measure_offset(
    values: NDArray[np.float32], index: NDArray[np.uint8], place: NDArray[np.int64], classes: int
) -> Offset | None:
    """The offset at which labels fit the echoes best; None where too few of them lie beside each other.

    Labels that move with a surface, as those of polygons do, are compared with the features of the cells that they
    come to lie in: correlation by displacement, as images are registered, with the correlation ratio (Roche et al.
    1998, MICCAI) in place of a product, because classes have no order.

    Parameters
    ----------
    values : float32 (rows, features), NaN for none.
    index : uint8 (rows,), the class of every row, below `classes`.
    place : int64 (rows, 2), x and y [mm].
    """
    for edge in CELLS:
        cells = _Cells(values, index, place, classes, edge)
        if len(cells.pairs(1, 0)[0]) >= PAIRS:
            break
    else:
        return None
    steps = range(-REACH, REACH + 1)
    x, y = _best({(x, y): cells.explained(x, y) for x in steps[::2] for y in steps[::2]})
    around = {(x + i, y + j): cells.explained(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    x, y = _best(around)
    size = edge / 1000
    return Offset(x * size, y * size, size, *around[x, y])


def _best(explained: Mapping[tuple[int, int], tuple[float, float]]) -> tuple[int, int]:
    """The offset by which labels explain most beyond what they explain where they are, of equal ones the shortest."""
    return max(explained, key=lambda at: (explained[at][0] - explained[at][1], -math.hypot(*at)))


class _Cells:
    """Cells with rows: their class, that of most of their rows, and the mean level of every feature."""

    def __init__(
        self, values: NDArray[np.float32], index: NDArray[np.uint8], place: NDArray[np.int64], classes: int, edge: int
    ) -> None:
        at = place // edge
        self.number, cell = np.unique(_number(at[:, 0], at[:, 1]), return_inverse=True)
        counts = np.zeros((len(self.number), classes), np.int64)
        np.add.at(counts, (cell, index), 1)
        self.label = counts.argmax(axis=1)
        self.moved = np.sort(np.argsort(hash_keys(0, self.number.view(np.uint64)))[:MOST])
        self.classes, rows = classes, counts.sum(axis=1)
        self.level = np.empty((len(self.number), values.shape[1]), np.uint8)
        for column, value in enumerate(values.T):
            self.level[:, column] = np.bincount(cell, _levels(value), len(self.number)).astype(np.int64) // rows

    def pairs(self, x: int, y: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Cells whose labels are moved, and those so many cells east and north of them, where both have rows."""
        wanted = self.number[self.moved] + _number(x, y)
        there = np.minimum(np.searchsorted(self.number, wanted), len(self.number) - 1)
        both = self.number[there] == wanted
        return self.moved[both], there[both]

    def explained(self, x: int, y: int) -> tuple[float, float]:
        """Share of the variance of the best features that classes explain when labels are moved so many cells, and when
        they stay, of the cells that have a label both ways."""
        first, second = self.pairs(x, y)
        if len(first) < PAIRS:
            return 0.0, 0.0
        level = self.level[second].astype(np.float64)  # of whole numbers: sums are exact
        mean = level.sum(axis=0) ** 2 / len(first)
        whole = (level**2).sum(axis=0) - mean
        return self._share(self.label[first], level, mean, whole), self._share(self.label[second], level, mean, whole)

    def _share(
        self,
        label: NDArray[np.int64],
        level: NDArray[np.float64],
        mean: NDArray[np.float64],
        whole: NDArray[np.float64],
    ) -> float:
        of_class = np.zeros((len(label), self.classes))
        of_class[np.arange(len(label)), label] = 1.0
        count, total = of_class.sum(axis=0), of_class.T @ level
        some = count > 0
        between = (total[some] ** 2 / count[some, None]).sum(axis=0) - mean
        share = np.divide(between, whole, out=np.zeros(len(between)), where=whole > 0)
        return float(np.sort(share)[-TELLING:].mean())


def _number(x: NDArray[np.int64] | int, y: NDArray[np.int64] | int) -> NDArray[np.int64] | int:
    return x * (1 << 32) + y


def _levels(value: NDArray[np.float32]) -> NDArray[np.float64]:
    """Whole numbers from 0 to `LEVELS`: of as many ranks, equal values the same; the middle for NaN."""
    known = np.isfinite(value)
    level = np.full(len(value), LEVELS // 2, np.float64)
    ordered = np.sort(value[known])
    steps = ordered[np.arange(1, LEVELS + 1) * len(ordered) // (LEVELS + 1)] if len(ordered) else ordered
    level[known] = np.searchsorted(steps, value[known], "right")
    return level
