"""The surface of a TIN: Delaunay triangles between points, and heights on them by linear interpolation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.tin.delaunay import Mesh, empty_mesh, insert_all, is_ghost, locate, spatial_order
from fwclass.ground.tin.predicates import SPAN, orientation
from fwclass.kernel import kernel
from fwclass.units import QUANTUM


@dataclass(frozen=True)
class Tin:
    """A triangulated surface; the same for every order of the points that it was made of.

    Attributes
    ----------
    mesh : triangles over the points, millimetres from `origin`; none where all points lie on one line.
    z : float64 (n,) heights of the mesh's points [m].
    origin : (x, y) of the mesh's zero, whole millimetres in the survey's CRS.
    """

    mesh: Mesh
    z: NDArray[np.float64]
    origin: tuple[int, int]

    @property
    def empty(self) -> bool:
        """Whether there is no triangle at all."""
        return int(self.mesh.state[0]) == 0


def tin_of(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> Tin:
    """The Delaunay TIN of points [m], which are rounded to millimetres; of points at one place the lowest counts.

    Points that are too few, or on one line, give an empty TIN. `InputError` where they span more than 33 km.
    """
    order, px, py, origin = unique_points(x, y, z)
    mesh = empty_mesh(px, py)
    insert_all(mesh, np.arange(len(order)))
    return Tin(mesh, np.ascontiguousarray(z[order], np.float64), origin)


def unique_points(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], tuple[int, int]]:
    """The lowest point of every place: (rows along Morton's curve, x, y [mm] from the origin, origin [mm])."""
    ix, iy = millimetres(x), millimetres(y)
    if len(ix) == 0:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0), (0, 0)
    origin = int(ix.min()), int(iy.min())
    ix, iy = ix - origin[0], iy - origin[1]
    order = spatial_order(ix, iy)
    lowest = order[_lowest_of_equals(ix, iy, np.asarray(z, np.float64), order)]
    return lowest, ix[lowest].astype(np.float64), iy[lowest].astype(np.float64), origin


def tin_heights(tin: Tin, qx: NDArray[np.float64], qy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights [m] of the surface at places [m], (m,); places are rounded to half millimetres.

    NaN outside the hull and where a place is not finite.
    """
    out = np.full(len(qx), np.nan)
    hx, hy = _half_millimetres(qx, tin.origin[0]), _half_millimetres(qy, tin.origin[1])
    near = (np.abs(hx) <= SPAN) & (np.abs(hy) <= SPAN)
    rows = np.flatnonzero(near)
    if tin.empty or len(rows) == 0:
        return out
    rows = rows[spatial_order(hx[rows].astype(np.int64), hy[rows].astype(np.int64))]
    out[rows] = _heights(*tin.mesh[:4], tin.z, hx[rows], hy[rows])
    return out


def tin_raster(tin: Tin, window: Window) -> NDArray[np.float64]:
    """Heights [m] at the centres of a window's cells, (nrows, ncols); exactly what `tin_heights` gives there."""
    out = np.full(window.shape, np.nan)
    mm = whole_millimetres(window.cell, "cell")
    hx = (np.arange(window.ncols) + window.col) * mm + mm / 2.0 - tin.origin[0]
    hy = (np.arange(window.nrows) + window.row) * mm + mm / 2.0 - tin.origin[1]
    if not tin.empty:
        _raster(*tin.mesh[:4], tin.z, hx, hy, float(SPAN), out)
    return out


def _half_millimetres(metres: NDArray[np.float64], origin: int) -> NDArray[np.float64]:
    """Coordinates in mm from `origin`, whole or half; NaN stays."""
    return np.rint(np.asarray(metres, np.float64) * (2.0 / QUANTUM)) / 2.0 - origin


@kernel
def _lowest_of_equals(x, y, z, order):  # type: ignore[no-untyped-def]
    """Positions in `order` (equal places side by side) of the lowest point of every place."""
    out = np.empty(len(order), np.int64)
    count = -1
    for i in range(len(order)):
        p = order[i]
        q = order[out[count]] if count >= 0 else p
        if count < 0 or x[p] != x[q] or y[p] != y[q]:
            count += 1
            out[count] = i
        elif z[p] < z[q]:
            out[count] = i
    return out[: count + 1]


@kernel
def _side(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """True where p, moved by almost nothing east and by nothing against that north, lies left of a to b."""
    turn = orientation(ax, ay, bx, by, px, py)
    if turn != 0.0:
        return turn > 0.0
    return by < ay or (by == ay and bx > ax)


@kernel
def _settle(x, y, vertex, twin, px, py, t):  # type: ignore[no-untyped-def]
    """Of the triangles that share the edge or vertex on which p lies, the one that does not hang on the walk."""
    tied = True
    turns = 0
    while tied and turns < 64:
        tied = False
        for k in range(3):
            e = 3 * t + k
            a, b = vertex[e], vertex[3 * t + (k + 1) % 3]
            if not _side(x[a], y[a], x[b], y[b], px, py):
                s = twin[e] // 3
                if not is_ghost(vertex, s):
                    t = s
                    tied = True
                    break
        turns += 1
    return t


@kernel
def plane_height(x, y, vertex, z, t, px, py):  # type: ignore[no-untyped-def]
    """Height of triangle t's plane at p, in the unit of `z` (points,); counted from its heaviest vertex, so that a
    vertex has its own height."""
    a, b, c = vertex[3 * t], vertex[3 * t + 1], vertex[3 * t + 2]
    wa = orientation(x[b], y[b], x[c], y[c], px, py)
    wb = orientation(x[c], y[c], x[a], y[a], px, py)
    wc = orientation(x[a], y[a], x[b], y[b], px, py)
    area = wa + wb + wc
    if wa >= wb and wa >= wc:
        return z[a] + (wb * (z[b] - z[a]) + wc * (z[c] - z[a])) / area
    if wb >= wc:
        return z[b] + (wc * (z[c] - z[b]) + wa * (z[a] - z[b])) / area
    return z[c] + (wa * (z[a] - z[c]) + wb * (z[b] - z[c])) / area


@kernel
def longest_edge(x, y, vertex, t):  # type: ignore[no-untyped-def]
    """Length of the longest edge of a triangle [mm]."""
    most = 0.0
    for k in range(3):
        a, b = vertex[3 * t + k], vertex[3 * t + (k + 1) % 3]
        square = (x[a] - x[b]) ** 2 + (y[a] - y[b]) ** 2
        most = square if square > most else most
    return np.sqrt(most)


@kernel
def _height_at(x, y, vertex, twin, z, px, py, t):  # type: ignore[no-untyped-def]
    """(height or NaN, triangle to go on from) at p, which is looked for from triangle t."""
    t = locate(x, y, vertex, twin, px, py, t)
    if is_ghost(vertex, t):
        return np.nan, t
    t = _settle(x, y, vertex, twin, px, py, t)
    return plane_height(x, y, vertex, z, t, px, py), t


@kernel
def _heights(x, y, vertex, twin, z, px, py):  # type: ignore[no-untyped-def]
    out = np.empty(len(px))
    t = 0
    for i in range(len(px)):
        out[i], t = _height_at(x, y, vertex, twin, z, px[i], py[i], t)
    return out


@kernel
def _raster(x, y, vertex, twin, z, px, py, span, out):  # type: ignore[no-untyped-def]
    first = t = 0
    for j in range(len(py)):
        t = first
        for i in range(len(px)):
            if abs(px[i]) <= span and abs(py[j]) <= span:
                out[j, i], t = _height_at(x, y, vertex, twin, z, px[i], py[j], t)
            if i == 0:
                first = t
