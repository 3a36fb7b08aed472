"""Contour lines of one block of a raster, by marching squares, cut where the block ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.contours.chains import chains
from fwclass.contours.smooth import NO_HEIGHT
from fwclass.grid import Window, whole_millimetres
from fwclass.units import QUANTUM

MOST = 2_000_000
"""Pieces of lines in a block; more are made by coarser steps."""

_S, _E, _N, _W = range(4)
_NONE = (-1, -1)
_ONE: tuple[tuple[int, int], ...] = (_NONE, (_S, _W), (_E, _S), (_E, _W), (_N, _E), (_S, _W), (_N, _S), (_N, _W))
_ONE += ((_W, _N), (_S, _N), (_E, _S), (_E, _N), (_W, _E), (_S, _E), (_W, _S), _NONE)
_FIRST = np.array((*_ONE, (_S, _E), (_W, _S)), np.int64)
"""Sides that a piece leads from and to, with high land on its left, by which corners are high (1 SW, 2 SE, 4 NE, 8 NW);
16 and 17 are 5 and 10 where the middle is high."""
_SECOND = np.array((*[_NONE] * 5, (_N, _E), *[_NONE] * 4, (_W, _N), *[_NONE] * 5, (_N, _W), (_E, _N)), np.int64)
"""The other piece of a square with two."""


@dataclass(frozen=True)
class Lines:
    """Pieces of contour lines with the higher land on their left, from side to side of a block, or closed.

    Attributes
    ----------
    level : int64 (n,) height over interval.
    begin, end : int64 (n, 3) on which lattice edge it begins and ends: axis (0 eastward, 1 northward), row and column
        of the global grid. With `level` they are the same whole numbers in both blocks that a line passes; of a closed
        piece both are the same.
    count : int64 (n,) its vertices.
    vertices : float64 (m, 2), those of one after the other [m]; a closed one's first vertex is its last again.
    every : lines of every `every`-th level alone are there: the block has too many.
    """

    level: NDArray[np.int64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    count: NDArray[np.int64]
    vertices: NDArray[np.float64]
    every: int


def lines(heights: NDArray[np.int64], window: Window, steps: int, index: int) -> Lines:
    """Contours of the squares between the middles of the cells of `window`.

    A level lies half a unit above its height, so that no node is on a line; through the middle of a saddle goes none,
    and the lines of two levels never meet.

    Parameters
    ----------
    heights : ``window.shape``, whole units; `NO_HEIGHT` where there is none: squares with such a corner have no lines.
    steps : interval in those units.
    index : of more than `MOST` pieces those of every `index`-th level are made, and so on.
    """
    every = 1
    while True:
        band = (heights - 1) // (steps * every)
        square, level = _levels(heights, band)
        if square is not None:
            break
        every *= max(2, index)
    level *= every
    south, west = np.divmod(square, window.ncols - 1)
    corners = [heights[south + a, west + b] for a, b in ((0, 0), (0, 1), (1, 1), (1, 0))]
    case = sum((corner > level * steps).astype(np.int64) << k for k, corner in enumerate(corners))
    middle = sum(corners) > 4 * level * steps + 2
    case = np.where(middle & (case == 5), 16, np.where(middle & (case == 10), 17, case))
    second = np.flatnonzero(_SECOND[case, 0] >= 0)
    sides = np.concatenate([_FIRST[case], _SECOND[case[second]]])
    square, level = np.concatenate([square, square[second]]), np.concatenate([level, level[second]])
    return _join(sides, square, level, heights, window, steps, every)


def _levels(heights: NDArray[np.int64], band: NDArray[np.int64]) -> tuple[NDArray[np.int64] | None, NDArray[np.int64]]:
    """Squares and levels that pass through them, a row each; no squares where they are too many."""
    known = heights != NO_HEIGHT
    parts = [(slice(a, -1 if a == 0 else None), slice(b, -1 if b == 0 else None)) for a in (0, 1) for b in (0, 1)]
    whole = np.logical_and.reduce([known[p] for p in parts])
    low, high = np.minimum.reduce([band[p] for p in parts]), np.maximum.reduce([band[p] for p in parts])
    passed = np.where(whole, high - low, 0).reshape(-1)
    total = int(passed.sum())
    if total > MOST:
        return None, passed
    square = np.repeat(np.arange(passed.size), passed)
    past = np.arange(total) - np.repeat(np.cumsum(passed) - passed, passed)
    return square, low.reshape(-1)[square] + 1 + past


def _join(
    sides: NDArray[np.int64],
    square: NDArray[np.int64],
    level: NDArray[np.int64],
    heights: NDArray[np.int64],
    window: Window,
    steps: int,
    every: int,
) -> Lines:
    """Pieces of squares, each from side to side, in chains."""
    south, west = np.divmod(square, window.ncols - 1)
    nodes, lowest = window.nrows * window.ncols, int(level.min()) if len(level) else 0
    ends = []
    for side in sides.T:
        row, col = south + (side == _N), west + (side == _E)
        axis = (side == _E) | (side == _W)
        ends.append((level - lowest) * (2 * nodes) + axis * nodes + row * window.ncols + col)
    crossing, number = np.unique(np.concatenate(ends), return_inverse=True)
    start, stop = number[: len(level)], number[len(level) :]
    after = np.full(len(crossing), -1, np.int64)
    after[start] = stop
    chain = chains(after)
    again = chain.closed.astype(np.int64)
    count = np.diff(chain.first) + again
    first = np.append(0, np.cumsum(count))
    order = np.empty(int(first[-1]), np.int64)
    order[np.arange(len(chain.order)) + np.repeat(np.cumsum(again) - again, np.diff(chain.first))] = chain.order
    order[first[1:][chain.closed] - 1] = chain.order[chain.first[:-1][chain.closed]]
    key = crossing[order]
    upon, (axis, node) = key // (2 * nodes) + lowest, np.divmod(key % (2 * nodes), nodes)
    row, col = np.divmod(node, window.ncols)
    here, there = heights[row, col], heights[row + axis, col + 1 - axis]
    part = (2 * upon * steps + 1 - 2 * here) / (2 * (there - here))
    mm = whole_millimetres(window.cell, "cell")
    x = ((window.col + col) * mm + 0.5 * mm + np.where(axis == 0, part * mm, 0.0)) * QUANTUM
    y = ((window.row + row) * mm + 0.5 * mm + np.where(axis == 1, part * mm, 0.0)) * QUANTUM
    edges = np.column_stack([axis, row + window.row, col + window.col])
    begin, end = first[:-1], first[1:] - 1
    return Lines(upon[begin], edges[begin], edges[end], count, np.column_stack([x, y]), every)
