"""Planes that strips see in the cells of one block, and how far those of two strips lie apart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.quality.params import PlaneParams

LEAST_SPREAD = 0.1
"""Of a cell's edge, the standard deviation of a plane's echoes along both axes: those of one scan line give no
slope."""


@dataclass(frozen=True)
class Planes:
    """Flat planes in the cells of a window, (planes,) each, in the order of cell and piece.

    Attributes
    ----------
    row, col : of the cell, int64.
    piece : number of the piece that sees it, int64.
    u, v : mean place of its echoes from the middle of the cell [mm], w : their mean height [mm], from one level for
        all; float64.
    a, b : slope to the east and north.
    residual : root mean square of its echoes from it [mm].
    edge : of a cell [mm].
    """

    row: NDArray[np.int64]
    col: NDArray[np.int64]
    piece: NDArray[np.int64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    w: NDArray[np.float64]
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    residual: NDArray[np.float64]
    edge: int

    def smooth(self, most: float) -> Planes:
        """Those with a residual of at most `most` [m]."""
        rows = self.residual <= 1000 * most
        return Planes(**{n: v if n == "edge" else v[rows] for n, v in vars(self).items()})

    def steps(self, p: NDArray[np.int64], q: NDArray[np.int64]) -> NDArray[np.float64]:
        """Height of the planes `p` less that of the planes `q`, midway between the centres of their echoes [m]."""
        du = self.u[q] - self.u[p] + self.edge * (self.col[q] - self.col[p])
        dv = self.v[q] - self.v[p] + self.edge * (self.row[q] - self.row[p])
        down = self.w[p] - self.w[q] + (self.a[p] + self.a[q]) * du / 2 + (self.b[p] + self.b[q]) * dv / 2
        return np.asarray(down / 1000)


@dataclass(frozen=True)
class PlanePairs:
    """Cells in which two pieces of strips both see a flat plane.

    Attributes
    ----------
    row, col : of the cell in its window, int32 (pairs,).
    first, second : numbers of the pieces, first < second, int32.
    dz : height of the first less that of the second, midway between the centres of their echoes [m], float64.
    weight : 2 / k in a cell that k pieces see, whose pairs are not independent; float64.
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    first: NDArray[np.int32]
    second: NDArray[np.int32]
    dz: NDArray[np.float64]
    weight: NDArray[np.float64]


def planes_of(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    piece: NDArray[np.int64],
    window: Window,
    params: PlaneParams,
) -> Planes:
    """Flat planes in the cells of `window`, of echoes (x, y, z) [m] of the pieces with these numbers (from 0).

    Sums are those of whole millimetres, and exact: the order of the echoes does not count. A plane counts with
    `least` echoes, spread over the cell, a residual of at most `max_residual` and a slope of at most `max_slope`.
    """
    if not len(x):
        none, nothing = np.empty(0, np.int64), np.empty(0)
        return Planes(none, none, none, *(6 * (nothing,)), edge=0)
    mm = whole_millimetres(window.cell, "quality.planes.cell")
    mx, my, mz = millimetres(x), millimetres(y), millimetres(z)
    col, row = mx // mm - window.col, my // mm - window.row
    cell = row * window.ncols + col
    pieces = int(piece.max()) + 1
    key, at = np.unique(cell * pieces + piece, return_inverse=True)
    low = int(mz.min())
    u, v, w = (a.astype(np.float64) for a in (mx % mm - mm // 2, my % mm - mm // 2, mz - low))
    count = np.bincount(at).astype(np.float64)
    enough = count >= params.least
    mean = {n: np.bincount(at, a) / count for n, a in (("u", u), ("v", v), ("w", w))}
    pairs = {"uu": u * u, "uv": u * v, "vv": v * v, "uw": u * w, "vw": v * w, "ww": w * w}
    s = {n: np.bincount(at, a) / count - mean[n[0]] * mean[n[1]] for n, a in pairs.items()}
    det = s["uu"] * s["vv"] - s["uv"] ** 2
    trace = s["uu"] + s["vv"]
    narrow = trace / 2 - np.sqrt(np.maximum(0.0, trace**2 / 4 - det))
    spread = narrow >= (LEAST_SPREAD * mm) ** 2
    safe = np.where(spread, det, 1.0)
    a = (s["uw"] * s["vv"] - s["vw"] * s["uv"]) / safe
    b = (s["vw"] * s["uu"] - s["uw"] * s["uv"]) / safe
    square = np.maximum(0.0, s["ww"] - a * s["uw"] - b * s["vw"]) * count / np.maximum(count - 3, 1)
    good = enough & spread & (square <= (1000 * params.max_residual) ** 2)
    good &= np.hypot(a, b) <= math.tan(math.radians(params.max_slope))
    chosen = np.flatnonzero(good)
    cells, number = np.divmod(key[chosen], pieces)
    r, c = np.divmod(cells, window.ncols)
    across, up, level = (mean[n][chosen] for n in "uvw")
    return Planes(r, c, number, across, up, level, a[chosen], b[chosen], np.sqrt(square[chosen]), mm)


def cell_pairs(planes: Planes) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows of every two planes in one cell, (pairs,) each, and how many planes the cell has."""
    return _in_one_cell((planes.row << 32) + planes.col)


def plane_pairs(planes: Planes) -> PlanePairs:
    """Pairs of planes in one cell, which two pieces see."""
    i, j, of = cell_pairs(planes)
    of_both = (planes.row[i], planes.col[i], planes.piece[i], planes.piece[j])
    row, col, one, other = (n.astype(np.int32) for n in of_both)
    return PlanePairs(row, col, one, other, planes.steps(i, j), 2.0 / of[i])


def _in_one_cell(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows of every two that have the same of the `cells`, which are sorted, and how many rows each row's cell has."""
    shared = np.bincount(np.unique(cells, return_inverse=True)[1])
    first, second = [], []
    for ahead in range(1, int(shared.max(initial=1))):
        i = np.flatnonzero(cells[ahead:] == cells[:-ahead])
        first.append(i)
        second.append(i + ahead)
    i, j = (np.concatenate([np.empty(0, np.int64), *some]) for some in (first, second))
    order = np.lexsort((j, i))
    return i[order], j[order], np.repeat(shared, shared)


def low_steps(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    piece: NDArray[np.int64],
    window: Window,
    least: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """How much higher the lowest echo of one piece is than that of another, in cells of `window` that hold `least`
    echoes of both: numbers of the pieces, the lower one first, int64 (steps,), and the step [m], float64 (steps,).

    Echoes (x, y, z) [m] of the `piece` with that number, (n,) each. Unlike planes it needs nothing flat.
    """
    mm = whole_millimetres(window.cell, "quality.planes.cell")
    pieces = int(piece.max(initial=0)) + 1
    cell = (millimetres(y) // mm - window.row) * window.ncols + (millimetres(x) // mm - window.col)
    key, at, count = np.unique(cell * pieces + piece, return_inverse=True, return_counts=True)
    low = np.full(len(key), np.inf)
    np.minimum.at(low, at, z)
    many = np.flatnonzero(count >= least)
    cells, number = np.divmod(key[many], pieces)
    i, j, _ = _in_one_cell(cells)
    return number[i], number[j], low[many[i]] - low[many[j]]


def border_steps(
    planes: Planes, file: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Steps between neighbouring cells (to the east, to the north), each of which one source file alone sees.

    `file`: of every piece, int64 (pieces,). Returns the lower and the higher number of the two files, int64 (steps,),
    and how much higher the plane of the first lies [m], float64 (steps,).
    """
    cells, of = (planes.row << 32) + planes.col, file[planes.piece]
    first = np.flatnonzero(np.diff(cells, prepend=-1))
    alone = np.flatnonzero(np.minimum.reduceat(of, first) == np.maximum.reduceat(of, first)) if len(first) else first
    first, known = first[alone], cells[first[alone]]
    steps = []
    for beside in (1, 1 << 32):
        at = np.searchsorted(known, known + beside)
        there = np.flatnonzero((at < len(known)) & (known[np.minimum(at, len(known) - 1)] == known + beside))
        p, q = first[there], first[at[there]]
        steps.append((of[p], of[q], planes.steps(p, q)))
    one, other, dz = (np.concatenate([s[k] for s in steps]) for k in range(3))
    differs, swap = one != other, one > other
    low, high = np.minimum(one, other)[differs], np.maximum(one, other)[differs]
    return low, high, np.where(swap, -dz, dz)[differs]
