"""A sorted cell grid over millimetre coordinates, and the search that other kernels build on.

Cells hang on the survey's origin, and rows keep their order inside a cell, so the walk over a point's neighbours
meets them in the same order however the survey was cut into tiles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import millimetres
from fwclass.kernel import kernel

CROWDED = 2_000
"""With more points than this in a cell the nearest is looked for in small cells first."""

AT_A_TIME = 20_000
"""Points that one call of a kernel looks from in a crowd: between two calls an interrupt is heeded."""

MAX_CELLS = 1 << 28
"""A grid above this many cells (2 GiB of offsets) is refused before it is allocated."""

FEW_CELLS = 1 << 20
"""So many cells (8 MiB of offsets) may always have an offset each, whatever they hold."""

CELLS_PER_POINT = 16
"""With more cells than `FEW_CELLS` and than this a point, indexed or looking, empty ones have no offset."""

MAX_NUMBER = 1 << 62
"""Cells of the widest grid whose cells can be numbered."""


Points = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""x, y, z [m] of echoes or of points of a cloud; NaN where one has no place."""


@dataclass(frozen=True)
class CellIndex:
    """Points sorted by square cells, numbered ``row * ncols + col``.

    Attributes
    ----------
    order : int64 (n,), input row of every sorted point.
    start : int64 (ncols * nrows + 1,); cell k holds sorted points ``start[k]`` up to ``start[k + 1]``.
        With `occupied`: int64 (len(occupied) + 1,), of these cells alone.
    occupied : int64, numbers of the cells that hold a point, rising; empty where `start` has all cells.
    x, y, z : float32 or int64 millimetres relative to (`x0`, `y0`, `z0`), sorted; exact integers.
    ncols, nrows : cells of the index.
    cell : edge of a cell [mm].
    """

    order: NDArray[np.int64]
    start: NDArray[np.int64]
    x: NDArray[np.int64]
    y: NDArray[np.int64]
    z: NDArray[np.int64]
    ncols: int
    nrows: int
    cell: int
    x0: int
    y0: int
    z0: int
    occupied: NDArray[np.int64]

    @classmethod
    def build(
        cls,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        z: NDArray[np.float64],
        cell: float,
        asked: int | None = None,
    ) -> CellIndex:
        """Index points with coordinates in metres by cells of edge `cell` [m].

        With `asked`, the number of points that neighbours are looked for of, memory grows with these and the indexed
        points alone: where most cells are empty, only the others have an offset.
        """
        edge = round(cell * 1000)
        if len(x) == 0:
            none = np.empty(0, np.int64)
            return cls(none, np.zeros(2, np.int64), none, none, none, 1, 1, edge, 0, 0, 0, none)
        col, row = millimetres(x), millimetres(y)
        col //= edge
        row //= edge
        col0, row0 = int(col.min()), int(row.min())
        ncols, nrows = int(col.max()) - col0 + 1, int(row.max()) - row0 + 1
        sparse = asked is not None and ncols * nrows > max(FEW_CELLS, CELLS_PER_POINT * (len(x) + asked))
        most = MAX_NUMBER if sparse else MAX_CELLS
        if ncols * nrows > most:
            raise InputError(
                "the points spread too far for a neighbour grid",
                expected=f"at most {most} cells of {cell} m",
                got=f"{ncols} x {nrows} cells",
                do="remove outlying points, use smaller tiles or a larger radius",
            )
        row -= row0
        row *= ncols
        row += col
        row -= col0
        number = row
        del col, row  # of a whole survey in one index each is a share of what a worker may hold
        if sparse:
            order = np.argsort(number, kind="stable")
            occupied, first = np.unique(number[order], return_index=True)
            start = np.append(first, len(order))
        else:
            order, start = sort_by_cell(number, ncols * nrows)
            occupied = np.empty(0, np.int64)
        del number
        x0, y0, z0 = col0 * edge, row0 * edge, int(millimetres(np.asarray(z, np.float64).min()))
        sorted_x, sorted_y, sorted_z = (_relative(v, order, o) for v, o in ((x, x0), (y, y0), (z, z0)))
        return cls(order, start, sorted_x, sorted_y, sorted_z, ncols, nrows, edge, x0, y0, z0, occupied)


def _relative(values: NDArray[np.float64], order: NDArray[np.int64], origin: int) -> NDArray[np.int64]:
    """Coordinates [m] in another order, as millimetres from `origin` [mm]."""
    out = millimetres(values)[order]
    out -= origin
    return out


@kernel
def sort_by_cell(cell, n_cells):  # type: ignore[no-untyped-def]
    """Stable counting sort of points by cell number, `cell` int64 (points,) from 0: int64 (points,), the rows in order
    of cells, and int64 (n_cells + 1,), where each cell begins."""
    start = np.zeros(n_cells + 2, np.int64)
    for c in cell:
        start[c + 2] += 1
    for c in range(n_cells):
        start[c + 2] += start[c + 1]
    order = np.empty(len(cell), np.int64)
    for i in range(len(cell)):  # start[c + 1] runs from the first of cell c to the first of the next
        c = cell[i]
        order[start[c + 1]] = i
        start[c + 1] += 1
    return order, start[:-1]


@kernel
def _nearest(px, py, pz, x, y, z, start, occupied, ncols, nrows, cell, limit, nearest, distance):  # type: ignore[no-untyped-def]
    """Sorted row of the nearest indexed point within `limit` mm (first in walk order on a tie), -1 if none."""
    every = len(occupied) == 0
    for i in range(len(px)):
        c, r = px[i] // cell, py[i] // cell
        west, east = max(c - 1, 0), min(c + 2, ncols)
        best = limit * limit + 1
        at = -1
        for row in range(max(r - 1, 0), min(r + 2, nrows) if west < east else 0):
            first, behind = row * ncols + west, row * ncols + east
            if not every:
                first, behind = np.searchsorted(occupied, first), np.searchsorted(occupied, behind)
            for j in range(start[first], start[behind]):
                dx, dy, dz = x[j] - px[i], y[j] - py[i], z[j] - pz[i]
                if abs(dz) > limit:  # its square may be more than a whole number holds
                    continue
                d = dx * dx + dy * dy + dz * dz
                if d < best:
                    best, at = d, j
        nearest[i] = at
        distance[i] = np.sqrt(float(best)) if at >= 0 else np.nan


def nearest_within(
    points: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    among: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    limit: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For each of `points` the row of the nearest of `among` within `limit` [m], and the distance [m].

    Ties go to the point whose cell comes first (south, then west), then to the lower row of `among`.
    Rows without one get -1 and NaN.
    """
    index = CellIndex.build(*among, cell=limit, asked=len(points[0]))
    rows = np.full(len(points[0]), -1, np.int64)
    distance = np.full(len(rows), np.nan)
    if len(index.order) and len(rows) and np.diff(index.start).max() > CROWDED:
        _nearest_in_crowds(points, among, round(limit * 1000), rows, distance)
    elif len(index.order) and len(rows):
        _nearest(
            millimetres(points[0]) - index.x0,
            millimetres(points[1]) - index.y0,
            millimetres(points[2]) - index.z0,
            index.x,
            index.y,
            index.z,
            index.start,
            index.occupied,
            index.ncols,
            index.nrows,
            index.cell,
            round(limit * 1000),
            rows,
            distance,
        )
        hit = rows >= 0
        rows[hit] = index.order[rows[hit]]
    return rows, distance * 0.001


def _nearest_in_crowds(
    points: Points, among: Points, limit: int, nearest: NDArray[np.int64], distance: NDArray[np.float64]
) -> None:
    """Fill the results of `nearest_within` (`limit` and distances in mm) where cells hold many points: of equal points
    the first stands for all, and ever larger cells are looked at by those points that have found nothing yet."""
    place = np.stack([millimetres(values) for values in among])
    order = np.lexsort((np.arange(place.shape[1]), *place))
    new = np.append(True, (np.diff(place[:, order]) != 0).any(axis=0))
    rows = np.sort(order[new])
    some = (among[0][rows], among[1][rows], among[2][rows])
    edges = sorted({limit >> k for k in range(8)} - {0})
    left = np.arange(len(nearest))
    for edge in edges:
        index = CellIndex.build(*some, cell=edge / 1000, asked=len(left))
        for first in range(0, len(left), AT_A_TIME):
            part = left[first : first + AT_A_TIME]
            px, py, pz = (millimetres(values[part]) for values in points)
            at, apart = np.empty(len(part), np.int64), np.empty(len(part))
            _nearest_of_ties(
                px - index.x0,
                py - index.y0,
                pz - index.z0,
                index.x,
                index.y,
                index.z,
                index.order,
                index.start,
                index.occupied,
                index.ncols,
                index.nrows,
                index.cell,
                index.x0,
                index.y0,
                limit,
                at,
                apart,
            )
            hit = at >= 0
            nearest[part[hit]], distance[part[hit]] = rows[at[hit]], apart[hit]
        left = left[nearest[left] < 0]


@kernel
def _nearest_of_ties(px, py, pz, x, y, z, order, start, occupied, ncols, nrows, cell, x0, y0, limit, nearest, distance):  # type: ignore[no-untyped-def]
    """As `_nearest` within the edge of a cell, with input rows; of points at one distance the one that comes first by
    cells of edge `limit`, then by row."""
    every = len(occupied) == 0
    for i in range(len(px)):
        c, r = px[i] // cell, py[i] // cell
        west, east = max(c - 1, 0), min(c + 2, ncols)
        best, at, row_of, col_of = cell * cell + 1, np.int64(-1), np.int64(0), np.int64(0)
        for row in range(max(r - 1, 0), min(r + 2, nrows) if west < east else 0):
            first, behind = row * ncols + west, row * ncols + east
            if not every:
                first, behind = np.searchsorted(occupied, first), np.searchsorted(occupied, behind)
            for j in range(start[first], start[behind]):
                dx, dy, dz = x[j] - px[i], y[j] - py[i], z[j] - pz[i]
                if abs(dz) > cell:
                    continue
                d = dx * dx + dy * dy + dz * dz
                if d <= best and d <= cell * cell:
                    own_row, own_col, own = (y[j] + y0) // limit, (x[j] + x0) // limit, order[j]
                    sooner = own_row < row_of or (
                        own_row == row_of and (own_col < col_of or (own_col == col_of and own < at))
                    )
                    if d < best or sooner:
                        best, at, row_of, col_of = d, own, own_row, own_col
        nearest[i] = at
        distance[i] = np.sqrt(float(best)) if at >= 0 else np.nan
