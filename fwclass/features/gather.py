"""A sorted grid over a chunk, and the echoes near one of them: vector distances, compaction, order by shells.

Sets are exact: coordinates are whole millimetres relative to the cell at hand, which float32 holds and float64 squares.

The steps are inlined into `neighbourhoods.measure_around`: called for every echo, their dozens of arguments would cost
as much as the work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import millimetres
from fwclass.kernel import inlined, kernel
from fwclass.neighbours import MAX_CELLS, sort_by_cell
from fwclass.schema import Table

LANES = 16
"""Neighbours at one radius are filled up with places of zero to a multiple of this: whole vectors, no rest."""

DEEPEST = 1 << 24
"""Heights of one chunk may differ by less than this [mm]."""

CELLS_PER_ECHO = 2.0
"""Offsets of cells take at most so many entries an echo."""

DENSE = 15.0
"""With more echoes than this in a square of the radius, cells are half the radius wide: a window of small cells holds
fewer echoes that are too far, one of large cells is copied for more echoes."""


@dataclass(frozen=True)
class Points:
    """The echoes of a chunk sorted by cells.

    Attributes
    ----------
    order : int32 (n,), row of the chunk of every sorted echo.
    x, y, z : int32 (n,), millimetres relative to the corner of the first cell and the lowest echo.
    start : int64 (ncols * nrows + 1,), first sorted echo of every cell.
    cell : edge [mm].
    """

    order: NDArray[np.int32]
    x: NDArray[np.int32]
    y: NDArray[np.int32]
    z: NDArray[np.int32]
    start: NDArray[np.int64]
    ncols: int
    nrows: int
    cell: int

    @classmethod
    def of(cls, table: Table, radius: int) -> Points:
        """Sort the echoes of `table` for spheres or cylinders of up to `radius` [mm]."""
        x, y, z = (_relative(table[name]) for name in ("x", "y", "z"))
        if int(z.max()) >= DEEPEST:
            raise InputError(
                "the heights of a chunk are too far apart for its neighbourhoods",
                expected=f"less than {DEEPEST / 1000:g} m",
                got=f"{z.max() / 1000:g} m",
                do="remove outlying echoes",
            )
        width, height = int(x.max()) + 1, int(y.max()) + 1
        dense = len(x) * radius * radius > DENSE * width * height
        cell = max(-(-radius // (2 if dense else 1)), int(np.sqrt(width * height / (CELLS_PER_ECHO * len(x)))))
        ncols, nrows = -(-width // cell), -(-height // cell)
        if ncols * nrows > MAX_CELLS:
            raise InputError(
                "the points spread too far for a neighbour grid",
                expected=f"at most {MAX_CELLS} cells of {cell} mm",
                got=f"{ncols} x {nrows} cells",
                do="remove outlying points or use smaller tiles",
            )
        order, start = sort_by_cell(y // cell * ncols + x // cell, ncols * nrows)
        order = order.astype(np.int32)
        x, y, z = (v[order].astype(np.int32) for v in (x, y, z))
        return cls(order, x, y, z, start, ncols, nrows, cell)


def _relative(metres: NDArray[np.float64]) -> NDArray[np.int64]:
    whole = millimetres(metres)
    return whole - whole.min()


@kernel
def window(cell, radius):  # type: ignore[no-untyped-def]
    """int64 (rows + 1,): columns to either side that echoes within `radius` [mm] of a cell's can be in, by row offset.

    Echoes of cells d apart are at least (d − 1) cells and 1 mm apart.
    """
    rows = (radius - 1) // cell + 1
    half = np.zeros(rows + 1, np.int64)
    for row in range(rows + 1):
        dy = (row - 1) * cell + 1 if row > 0 else 0
        while dy * dy + (half[row] * cell + 1) ** 2 <= radius * radius:
            half[row] += 1
    return half


@kernel
def most_in_window(start, ncols, nrows, half):  # type: ignore[no-untyped-def]
    """The most echoes [count] that the window of a cell holds.

    `start` (cells + 1,) are the places where the sorted echoes of a cell begin, `half` (rows,) half widths [cells].
    """
    most = 0
    reach = len(half) - 1
    for row in range(nrows):
        for col in range(ncols):
            if start[row * ncols + col] < start[row * ncols + col + 1]:
                count = 0
                for r in range(max(row - reach, 0), min(row + reach + 1, nrows)):
                    wide = half[abs(r - row)]
                    count += start[r * ncols + min(col + wide + 1, ncols)] - start[r * ncols + max(col - wide, 0)]
                most = max(most, count)
    return most


@kernel
def slices(start, ncols, nrows, half, most):  # type: ignore[no-untyped-def]
    """int64 (slices + 1,): sorted echoes, the first and one past the last among them, between which a pass meets about
    `most` candidates, however many one cell holds."""
    cuts = [np.int64(0)]
    met, reach = 0, len(half) - 1
    for row in range(nrows):
        for col in range(ncols):
            first, last = start[row * ncols + col], start[row * ncols + col + 1]
            if first < last:
                count = 0
                for r in range(max(row - reach, 0), min(row + reach + 1, nrows)):
                    wide = half[abs(r - row)]
                    count += start[r * ncols + min(col + wide + 1, ncols)] - start[r * ncols + max(col - wide, 0)]
                while met + (last - first) * count > most:
                    first += max((most - met) // count, 1)
                    cuts.append(min(first, last))
                    met = 0
                    if first >= last:
                        break
                met += max(last - first, 0) * count
    if cuts[-1] < start[-1]:
        cuts.append(start[-1])
    return np.array(cuts)


@inlined
def candidates(xs, ys, zs, start, ncols, nrows, half, row, col, first, x, y, z):  # type: ignore[no-untyped-def]
    """Copy the echoes of the window of a cell, relative to echo `first`, and far ones up to a multiple of `LANES`.

    `xs`, `ys`, `zs` int32 (echoes,) [mm]; `x`, `y`, `z` float32 (room,) [mm] are written. Returns their number.
    Places are unsigned: numba takes a negative one to count from the end, and asks every time.
    """
    m = np.uint64(0)
    reach = len(half) - 1
    x0, y0, z0 = xs[first], ys[first], zs[first]
    for r in range(max(row - reach, 0), min(row + reach + 1, nrows)):
        wide = half[abs(r - row)]
        begin = np.uint64(start[r * ncols + max(col - wide, 0)])
        count = np.int64(start[r * ncols + min(col + wide + 1, ncols)] - start[r * ncols + max(col - wide, 0)])
        for k in range(count):
            x[m + np.uint64(k)] = np.float32(np.int32(xs[begin + np.uint64(k)] - x0))
        for k in range(count):
            y[m + np.uint64(k)] = np.float32(np.int32(ys[begin + np.uint64(k)] - y0))
        for k in range(count):
            z[m + np.uint64(k)] = np.float32(np.int32(zs[begin + np.uint64(k)] - z0))
        m += np.uint64(count)
    while m % np.uint64(LANES) > np.uint64(0):
        x[m] = y[m] = z[m] = np.float32(1e12)
        m += np.uint64(1)
    return np.int64(m)


@kernel
def carry(values, start, ncols, nrows, half, row, col, to):  # type: ignore[no-untyped-def]
    """Copy what the `candidates` of a cell carry, `values` (echoes,), to `to` (room,); zero for those that fill up."""
    m = np.uint64(0)
    reach = len(half) - 1
    for r in range(max(row - reach, 0), min(row + reach + 1, nrows)):
        wide = half[abs(r - row)]
        begin = np.uint64(start[r * ncols + max(col - wide, 0)])
        count = np.int64(start[r * ncols + min(col + wide + 1, ncols)] - start[r * ncols + max(col - wide, 0)])
        for k in range(count):
            to[m + np.uint64(k)] = values[begin + np.uint64(k)]
        m += np.uint64(count)
    while m % np.uint64(LANES) > np.uint64(0):
        to[m] = 0
        m += np.uint64(1)


@inlined
def distances(x, y, z, m, px, py, pz, level, flat, square):  # type: ignore[no-untyped-def]
    """Squared distances [mm²] of the first `m` of (x, y, z) from (px, py, pz), whole numbers [mm].

    `flat` (room,) is horizontal; `square` (room,) is spatial, or horizontal where `level`, and `flat` is left alone.
    """
    if level:
        for k in range(m):
            dx, dy = np.float64(x[k] - px), np.float64(y[k] - py)
            square[k] = dx * dx + dy * dy
    else:
        for k in range(m):
            dx, dy, dz = np.float64(x[k] - px), np.float64(y[k] - py), np.float64(z[k] - pz)
            level_part = dx * dx + dy * dy
            flat[k] = level_part
            square[k] = level_part + dz * dz


@inlined
def compact(square, m, limit, near):  # type: ignore[no-untyped-def]
    """Places where the first `m` of `square` are at most `limit` [mm²], to `near` (room,); their number.

    Without a branch: whether a candidate is near is a coin toss that no processor predicts.
    """
    n = np.uint64(0)
    for k in range(m):
        near[n] = k
        n += np.uint64(square[k] <= limit)
    return np.int64(n)


@inlined
def count_within(square, m, limit):  # type: ignore[no-untyped-def]
    """How many of the first `m` of `square` [mm²] are at most `limit` [mm²]."""
    n = np.int64(0)
    for k in range(m):
        n += np.int64(1) if square[k] <= limit else np.int64(0)
    return n


@inlined
def shells(square, bounds, near, n, distance, shell, places):  # type: ignore[no-untyped-def]
    """Shell of the first `n` of `near` between the rising `bounds` [mm²], to `shell` (room,); starts of the shells to
    `places`.

    `bounds` are the squares of all radii but the last, then infinity up to a multiple of four: fewer passes.
    """
    for k in range(n):
        distance[k] = square[near[k]]
        shell[k] = 0
    for q in range(0, len(bounds), 4):
        one, two, three, four = bounds[q], bounds[q + 1], bounds[q + 2], bounds[q + 3]
        for k in range(n):
            d = distance[k]
            shell[k] += np.uint64(d > one) + np.uint64(d > two) + np.uint64(d > three) + np.uint64(d > four)
    for q in range(len(places)):
        places[q] = 0
    for k in range(n):
        places[shell[k]] += np.uint64(1)
    total = np.uint64(0)
    for q in range(len(places)):
        total += places[q]
        places[q] = total - places[q]


@inlined
def order(near, n, shell, places, ordered):  # type: ignore[no-untyped-def]
    """Put the first `n` of `near` into the order of their shells, to `ordered` (room,); the starts `places` (shells,)
    become ends."""
    for k in range(n):
        s = shell[k]
        to = places[s]
        ordered[to] = near[k]
        places[s] = to + np.uint64(1)


@inlined
def fill(x, y, z, near, n, px, py, pz, to_x, to_y, to_z, used):  # type: ignore[no-untyped-def]
    """Copy the first `n` of `near`, relative to (px, py, pz) [mm], to place `used` and on, and zero up to whole
    `LANES`.

    Returns the place behind.
    """
    for k in range(n):
        j = near[k]
        to_x[used + np.uint64(k)] = x[j] - px
        to_y[used + np.uint64(k)] = y[j] - py
    for k in range(n):
        to_z[used + np.uint64(k)] = z[near[k]] - pz
    end = used + np.uint64(n)
    while end % np.uint64(LANES) > np.uint64(0):
        to_x[end] = to_y[end] = to_z[end] = np.float32(0.0)
        end += np.uint64(1)
    return end


@inlined
def fill_values(values, near, n, to, used):  # type: ignore[no-untyped-def]
    """Copy what the first `n` of `near` carry, of `values` (candidates,), to place `used` and on of `to`."""
    for k in range(n):
        to[used + np.uint64(k)] = values[near[k]]
