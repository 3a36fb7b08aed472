"""Places where many echoes are unsure: the work list."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import millimetres
from fwclass.pieces import linked_groups

SHOWN = 0.8
"""Share of a place's echoes that its size is told of, so that one far echo does not make it large."""

PARTS = 1_000_000
"""Of a confidence of 1: sums of whole numbers do not depend on the order of what is added."""


@dataclass(frozen=True)
class UnsureCluster:
    """Unsure echoes that lie together.

    Attributes
    ----------
    echoes : how many.
    x, y, z, size : their middle, and how wide they are [m].
    box : xmin, ymin, xmax, ymax of the squares that they lie in [m].
    confidence : their mean, 0 to 1.
    classes : (code, echoes) of the classes that they were given, the most frequent first.
    """

    echoes: int
    x: float
    y: float
    z: float
    size: float
    box: tuple[float, float, float, float]
    confidence: float
    classes: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class WorkList:
    """Attributes
    ----------
    places : the largest first.
    cell : edge of the squares [m].
    squares : int64 (n, 2), column and row of the squares of all `places`.
    number : (n,), which of `places` each square belongs to.
    total : how many places there are, those that are not listed among them.
    """

    places: tuple[UnsureCluster, ...]
    cell: float
    squares: NDArray[np.int64]
    number: NDArray[np.int64]
    total: int = 0

    def of(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int64]:
        """(rows,), which of `places` unsure echoes at `x`, `y` belong to; -1 for none."""
        number_of = dict(zip(map(tuple, self.squares.tolist()), self.number.tolist(), strict=True))
        squares, at = np.unique(_squares(x, y, self.cell), axis=0, return_inverse=True)
        place = np.array([number_of.get((i, j), -1) for i, j in squares.tolist()], np.int64)
        return np.asarray(place[at.ravel()], np.int64)


class UnsureEchoes:
    """Counts unsure echoes, added tile by tile, in squares of a global grid with edge `cell` [m]; those of one square
    of edge `place` [m] at most are one place.

    What `work_list` gives follows from the echoes alone, not from tiles or their order; memory is that of the squares.
    """

    def __init__(self, cell: float, place: float) -> None:
        self.cell, self._across = cell, max(1, int(place / cell + 1e-9))  # no wider than `place`
        self._keys = [np.empty((0, 3), np.int64)]
        self._sums = [np.empty((0, 5), np.int64)]

    @property
    def echoes(self) -> int:
        """How many were added."""
        return sum(int(sums[:, 0].sum()) for sums in self._sums)

    def add(
        self,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        z: NDArray[np.float64],
        confidence: NDArray[np.float32],
        code: NDArray[np.uint8],
    ) -> None:
        """Unsure echoes of a tile: places [m], confidence, class code."""
        squares = _squares(x, y, self.cell)
        at = [millimetres(v) - self._corner(squares, k) for k, v in enumerate((x, y))]
        sure = np.rint(confidence.astype(np.float64) * PARTS).astype(np.int64)
        sums = np.stack([np.ones(len(x), np.int64), *at, millimetres(z), sure], axis=1)
        keys, sums = _sum_by_key(np.c_[squares, code.astype(np.int64)], sums)
        self._keys.append(keys)
        self._sums.append(sums)

    def work_list(self, most: int) -> WorkList:
        """Clusters of unsure echoes, the largest first, at most so many.

        Squares that touch, by a corner too, are one place, but for what a coarser grid parts: where every square of a
        town has an unsure echo, the town is no place that one look can judge. Middle and width are those of the
        squares' mean echoes, weighted by their number.
        """
        keys, sums = _sum_by_key(np.concatenate(self._keys), np.concatenate(self._sums))
        if not len(keys):
            return WorkList((), self.cell, keys[:, :2], keys[:, 0])
        squares, own = np.unique(keys[:, :2], axis=0, return_inverse=True)
        cluster = _join_squares(squares, self._across)[own.ravel()]
        count = np.bincount(cluster, weights=sums[:, 0])
        largest = np.argsort(-count, kind="stable")[:most]
        order = np.argsort(cluster, kind="stable")
        first, last = (np.searchsorted(cluster[order], largest, side=side) for side in ("left", "right"))
        rows = [order[a:b] for a, b in zip(first, last, strict=True)]
        number = np.repeat(np.arange(len(rows)), [len(r) for r in rows])
        places = tuple(self._cluster(keys[r], sums[r]) for r in rows)
        return WorkList(places, self.cell, keys[np.concatenate(rows), :2], number, len(count))

    def _corner(self, squares: NDArray[np.int64], axis: int) -> NDArray[np.int64]:
        """West or south border of squares [mm]."""
        return millimetres(np.asarray(squares[:, axis] * self.cell, np.float64))

    def _cluster(self, keys: NDArray[np.int64], sums: NDArray[np.int64]) -> UnsureCluster:
        """The place of some squares by class."""
        classes = np.bincount(keys[:, 2], weights=sums[:, 0]).astype(np.int64)
        codes = [c for c in np.argsort(-classes, kind="stable").tolist() if classes[c]]
        squares, sums = _sum_by_key(keys[:, :2], sums)
        n = sums[:, 0]
        x, y = ((self._corner(squares, k) + sums[:, 1 + k] / n) / 1000 for k in (0, 1))
        mx, my, mz = (_quantile(v, n, 0.5) for v in (x, y, sums[:, 3] / n / 1000))
        far = _quantile(np.hypot(x - mx, y - my), n, SHOWN)
        low, high = squares.min(axis=0) * self.cell, (squares.max(axis=0) + 1) * self.cell
        return UnsureCluster(
            int(n.sum()),
            mx,
            my,
            mz,
            max(self.cell, 2.0 * far),
            (float(low[0]), float(low[1]), float(high[0]), float(high[1])),
            float(sums[:, 4].sum() / n.sum() / PARTS),
            tuple((code, int(classes[code])) for code in codes),
        )


def _squares(x: NDArray[np.float64], y: NDArray[np.float64], cell: float) -> NDArray[np.int64]:
    return np.floor(np.stack([x, y], axis=1) / cell).astype(np.int64)


def _sum_by_key(keys: NDArray[np.int64], sums: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of `sums` added up by key; keys ascend."""
    if not len(keys):
        return keys, sums
    order = np.lexsort(keys.T[::-1])
    keys = keys[order]
    first = np.flatnonzero(np.append(True, (keys[1:] != keys[:-1]).any(axis=1)))
    return keys[first], np.add.reduceat(sums[order], first, axis=0)


def _quantile(values: NDArray[np.float64], weights: NDArray[np.int64], q: float) -> float:
    """The least value up to which there is a share `q` of the weights."""
    order = np.argsort(values, kind="stable")
    up_to = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(up_to, q * up_to[-1])]])


def _join_squares(squares: NDArray[np.int64], across: int) -> NDArray[np.int32]:
    """The cluster of every square, inside one block of `across` × `across` of them; `squares` ascend."""
    block = squares // across
    low = squares.min(axis=0) - 1
    width = int(squares[:, 1].max() - low[1]) + 2
    key = (squares[:, 0] - low[0]) * width + squares[:, 1] - low[1]
    pairs = []
    for step in (1, width - 1, width, width + 1):
        at = np.searchsorted(key, key + step)
        there = np.flatnonzero((at < len(key)) & (key[np.minimum(at, len(key) - 1)] == key + step))
        there = there[(block[there] == block[at[there]]).all(axis=1)]
        pairs.append(np.c_[there, at[there]])
    edges = np.concatenate(pairs)
    return linked_groups(len(key), edges[:, 0], edges[:, 1]).astype(np.int32)
