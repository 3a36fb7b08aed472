"""Echoes per tile without reading points: every file's number, spread evenly over the bounds that its header names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.grid import Box, Tile, whole_millimetres

MOST_SQUARES = 20_000_000
"""Squares of a survey's extent that are held in memory, 8 bytes each."""

KEPT = 1000.0
"""Metres of a gap between files that are held as empty squares: further than any stage reads."""

Piece = tuple[Box, float]
"""Bounds of a file [m], and how many echoes lie within."""


@dataclass(frozen=True)
class Spread:
    """Echoes of the squares of edge `size` [m] in `cols` and `rows` of the global grid, both rising.

    `counts` has shape (columns, rows). Of wide stretches without a file only `KEPT` metres are held.
    """

    size: float
    cols: NDArray[np.int64]
    rows: NDArray[np.int64]
    counts: NDArray[np.float64]

    @classmethod
    def of(cls, pieces: Sequence[Piece], size: float) -> Spread:
        """`ConfigError` where the extent has too many squares of this size."""
        whole_millimetres(size, "tile size")
        rows = [(*box.bounds, number) for box, number in pieces]
        cols, lines = held_squares([box for box, _ in pieces], size)
        shape = (len(cols), len(lines))
        if shape[0] * shape[1] > MOST_SQUARES:
            raise ConfigError(
                "the survey's extent has too many tiles of this size",
                where="tile.size",
                expected=f"at most {MOST_SQUARES:,}",
                got=f"{shape[0]:,} x {shape[1]:,} of {size:g} m",
                do="look for stray points with `fwclass info`, or choose larger tiles",
            )
        counts = np.zeros(shape)
        for xmin, ymin, xmax, ymax, number in rows:
            first_x, along = shares(xmin, xmax, size, 0)
            first_y, up = shares(ymin, ymax, size, 0)
            at_x, at_y = int(np.searchsorted(cols, first_x)), int(np.searchsorted(lines, first_y))
            counts[at_x : at_x + len(along), at_y : at_y + len(up)] += number * np.outer(along, up)
        return cls(size, cols, lines, counts)

    def grown(self, halo: float) -> NDArray[np.float64]:
        """Echoes of every square and `halo` [m] around it, evenly spread within each square."""
        return _sum_windows(_sum_windows(self.counts, halo / self.size).T, halo / self.size).T

    @cached_property
    def occupied(self) -> NDArray[np.bool_]:
        """The fullest squares, as many as hold an echo if those of each lie at random; one at least."""
        counts = self.counts.ravel()
        some = np.flatnonzero(counts)
        number = max(1, round(-np.expm1(-counts[some]).sum()))
        there = np.zeros(self.counts.shape, bool)
        there.flat[some[np.argsort(-counts[some], kind="stable")[:number]]] = True
        return there

    @property
    def number(self) -> int:
        """Number of tiles with points."""
        return int(self.occupied.sum())

    def within(self, margin: int) -> int:
        """How many squares are occupied or at most `margin` squares away from one that is."""
        return int(_near(_near(np.pad(self.occupied, margin), margin).T, margin).sum())

    def heaviest(self, count: int) -> tuple[Tile, ...]:
        """The `count` squares with most echoes, the fullest first."""
        flat = self.counts.ravel()
        there = np.flatnonzero(self.occupied)
        order = there[np.argsort(-flat[there], kind="stable")[:count]]
        return tuple(self.tile(*map(int, np.unravel_index(k, self.counts.shape))) for k in order)

    def tile(self, i: int, j: int) -> Tile:
        """The tile in column `i` and row `j` of the grid."""
        return Tile(int(self.cols[i]), int(self.rows[j]), self.size)

    def touching(self, boxes: Sequence[Box]) -> NDArray[np.bool_]:
        """Squares that share area with one of `boxes`."""
        low_x, low_y = self.cols * self.size, self.rows * self.size
        near = np.zeros(self.counts.shape, bool)
        for box in boxes:
            along = (low_x < box.xmax) & (low_x + self.size > box.xmin)
            up = (low_y < box.ymax) & (low_y + self.size > box.ymin)
            near |= np.outer(along, up)
        return near

    def squares(self) -> list[Tile]:
        """Those that are occupied."""
        return [self.tile(i, j) for i, j in np.argwhere(self.occupied).tolist()]


@lru_cache(maxsize=4)
def spread_of(pieces: tuple[Piece, ...], size: float) -> Spread:
    """`Spread.of`, remembered: blocks are the same whatever the tiles."""
    return Spread.of(pieces, size)


def held_squares(boxes: Sequence[Box], size: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of the squares of edge `size` [m] that are held for `boxes`."""
    return tuple(_occupied_squares([(b.bounds[k], b.bounds[k + 2]) for b in boxes], size) for k in range(2))  # type: ignore[return-value]


def _occupied_squares(spans: Iterable[tuple[float, float]], size: float) -> NDArray[np.int64]:
    """Numbers of the squares of edge `size` along one axis that `spans` [m] touch, and those of gaps between them:
    of the first `KEPT` metres of a wider one."""
    most = math.ceil(KEPT / size) + 1
    pieces, end = [], None
    for low, high in sorted(spans):
        first, last = math.floor(low / size), max(math.floor(low / size) + 1, math.ceil(high / size))
        if end is not None:
            pieces.append(np.arange(end, min(max(first, end), end + most)))
            first = max(first, end)
        pieces.append(np.arange(first, max(first, last)))
        end = last if end is None else max(end, last)
    return np.concatenate(pieces).astype(np.int64)


def shares(low: float, high: float, size: float, first: int) -> tuple[int, list[float]]:
    """Which part of [low, high) lies in each square: index of the first one, counted from `first`, and the shares."""
    a, b = math.floor(low / size), max(math.floor(low / size) + 1, math.ceil(high / size))
    lengths = [max(0.0, min(high, (k + 1) * size) - max(low, k * size)) for k in range(a, b)]
    total = sum(lengths)
    return a - first, [v / total for v in lengths] if total > 0 else [1.0 / (b - a)] * (b - a)


def _near(occupied: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Along the first axis: at most `margin` rows from one that is occupied."""
    near = occupied.copy()
    for step in range(1, min(margin, len(occupied) - 1) + 1):
        near[step:] |= occupied[:-step]
        near[:-step] |= occupied[step:]
    return near


def _sum_windows(counts: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Along the first axis: each row, and what lies within `reach` rows of its edges."""
    whole, part = math.floor(reach), reach - math.floor(reach)
    n = len(counts)
    total = counts.copy()
    for step in range(1, min(whole + 1, n - 1) + 1):
        weight = 1.0 if step <= whole else part
        total[step:] += weight * counts[:-step]
        total[:-step] += weight * counts[step:]
    return total
