"""Whether a reference cloud lies where the echoes are: where its heights differ least from theirs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box, Window, millimetres, whole_millimetres
from fwclass.neighbours import Points

CELL = 2.0
"""m, edge of the cells whose highest points are compared."""

REACH = 5
"""Cells that the cloud is moved by at most, each way."""

HALO = CELL * (REACH + 1)
"""m around a tile that its comparison reads."""

APART = 2_000
"""mm from which on heights are counted as differing by this: other surfaces, things that came and went."""

CONTRAST = 20.0
"""Of the least mean difference to that of the median displacement [m], times the root of the number of cells: from here
on offsets came out within 0.2 m in five public tiles of 0.12 to 42 echoes/m2 whose clouds had the echoes' heights."""

MOVES = 2 * REACH + 1


@dataclass(frozen=True)
class CloudOffset:
    """Where the points of a cloud would have to be to fit the echoes best.

    Attributes
    ----------
    x, y : what they would have to be moved by [m].
    edge : it is the largest displacement that was tried, at least one way: they may lie further off.
    least, unmoved : mean difference of the highest points in a cell there, and where the points lie [m].
    """

    x: float
    y: float
    edge: bool
    least: float
    unmoved: float


def compare_heights(echoes: Points, cloud: Points, box: Box) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How much the highest echo of a cell and the highest point of the cell that comes to lie on it differ, by how many
    cells the cloud is moved to the east (row) and to the north (column).

    Sums are of whole millimetres: those of all tiles are the same whatever the tiles are.

    Parameters
    ----------
    echoes, cloud : x, y and z [m], (n,) and (m,), all that lie within `HALO` of `box`.
    box : of a tile, which has the cells whose lower left corner lies in it.

    Returns
    -------
    Sums of the differences [mm], at most `APART` each, and the number of cells, int64 (`MOVES`, `MOVES`) each.
    """
    edge = whole_millimetres(CELL, "the cells of reference clouds")
    col, row, end_col, end_row = (-(-v // edge) for v in millimetres(np.array(box.bounds)).tolist())
    window = Window(CELL, col, row, end_col - col, end_row - row)
    here, there = _highest(echoes, window, edge), _highest(cloud, window.grown(REACH), edge)
    sums, counts = np.zeros((2, MOVES, MOVES), np.int64)
    for east in range(MOVES):
        for north in range(MOVES):
            moved = there[MOVES - 1 - north :, MOVES - 1 - east :][: window.nrows, : window.ncols]
            both = (here > NOTHING) & (moved > NOTHING)
            sums[east, north] = np.minimum(np.abs(here[both] - moved[both]), APART).sum()
            counts[east, north] = both.sum()
    return sums, counts


NOTHING = np.iinfo(np.int64).min
"""Height of a cell without a point."""


def _highest(points: Points, window: Window, edge: int) -> NDArray[np.int64]:
    """The highest of the points in every cell of `window` [mm], int64 (rows, columns)."""
    col, row = millimetres(points[0]) // edge - window.col, millimetres(points[1]) // edge - window.row
    inside = (col >= 0) & (col < window.ncols) & (row >= 0) & (row < window.nrows)
    highest = np.full(window.shape, NOTHING)
    np.maximum.at(highest, (row[inside], col[inside]), millimetres(points[2][inside]))
    return highest


def offset_of_cloud(sums: NDArray[np.int64], counts: NDArray[np.int64]) -> CloudOffset | None:
    """Where the cloud fits best; None where that cannot be told: too few cells, or a country as flat one way as the
    other.

    sums, counts : those of `compare_heights`, of all tiles added up, int64 (`MOVES`, `MOVES`) each.
    """
    if not counts.all():
        return None
    mean = sums / counts / 1000
    at = np.unravel_index(int(mean.argmin()), mean.shape)
    least = float(mean[at])
    if (float(np.median(mean)) - least) * float(counts[at]) ** 0.5 < CONTRAST:
        return None
    i, j = map(int, at)
    x, y = (k - REACH + _between(line, k) for k, line in ((i, mean[:, j]), (j, mean[i])))
    edge = any(k in (0, MOVES - 1) for k in (i, j))
    return CloudOffset(x * CELL, y * CELL, edge, least, float(mean[REACH, REACH]))


def _between(line: NDArray[np.float64], k: int) -> float:
    """Where two equally steep sides through the least value, at `k`, and its neighbours meet, from `k`; 0 at an end."""
    if not 0 < k < len(line) - 1:
        return 0.0
    before, here, after = line[k - 1 : k + 2].tolist()
    steepest = max(before - here, after - here)
    return 0.5 * (before - after) / steepest if steepest > 0 else 0.0
