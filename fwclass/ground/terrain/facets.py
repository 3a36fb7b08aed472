"""Heights of places on the triangles of a TIN, found triangle by triangle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.tin.delaunay import GHOST
from fwclass.ground.tin.tin import Tin
from fwclass.kernel import inlined, kernel
from fwclass.neighbours import sort_by_cell
from fwclass.units import QUANTUM

FEW = 2
"""A facet of at most so many more cells than one in width is looked at in its whole box."""


@dataclass(frozen=True)
class Facets:
    """Triangles of a TIN that count.

    Attributes
    ----------
    corners : int32 (m, 3) rows of the vertices, turning left.
    x, y : float64 places of the vertices, half millimetres from `origin`: whole numbers, as the middle of a cell is.
    z : float64 heights [m].
    origin : (x, y) whole millimetres in the survey's CRS.
    """

    corners: NDArray[np.int32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    origin: tuple[int, int]


def facets_of(tin: Tin, largest: float) -> Facets:
    """Triangles whose circumcircle has a radius of at most `largest` [m].

    The circle of a Delaunay triangle is empty, so its radius is how far its middle is from data; and a triangle whose
    circle lies among the points that were given is a triangle whatever lies beyond them.
    """
    x, y = 2.0 * tin.mesh.x, 2.0 * tin.mesh.y
    corners = _small(tin.mesh.vertex, int(tin.mesh.state[0]), x, y, 2.0 * largest / QUANTUM)
    return Facets(corners, x, y, tin.z, tin.origin)


def facet_heights(
    facets: Facets, window: Window, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Heights of the facets [m] at points inside `window`, in any order; NaN where there is no facet."""
    mm, west, south = _corner(facets, window)
    px, py = millimetres(x) - window.col * mm, millimetres(y) - window.row * mm
    order, start = sort_by_cell((py // mm) * window.ncols + px // mm, window.nrows * window.ncols)
    heights = np.full(len(order), np.nan)
    places = 2.0 * px[order] + west, 2.0 * py[order] + south
    grid = start, window.ncols, window.nrows, 2.0 * mm, west, south
    _points(facets.corners, facets.x, facets.y, facets.z, *places, *grid, heights)
    out = np.empty(len(heights))
    out[order] = heights
    return out


def facet_raster(facets: Facets, window: Window) -> NDArray[np.float64]:
    """As `facet_heights`, at the cell centres of `window`: shape ``window.shape``, row 0 in the south."""
    mm, west, south = _corner(facets, window)
    out = np.full(window.shape, np.nan)
    _centres(facets.corners, facets.x, facets.y, facets.z, 2.0 * mm, west, south, out)
    return out


def _corner(facets: Facets, window: Window) -> tuple[int, float, float]:
    """Edge of a cell [mm], and the window's corner in half millimetres from the facets' origin."""
    mm = whole_millimetres(window.cell, "cell")
    return mm, 2.0 * (window.col * mm - facets.origin[0]), 2.0 * (window.row * mm - facets.origin[1])


@inlined
def _reach(xa, ya, xb, yb, low, high, left, right):  # type: ignore[no-untyped-def]
    """Range of x of the part of an edge between two heights, joined to the range so far."""
    if max(ya, yb) < low or min(ya, yb) > high:
        return left, right
    x0, x1 = xa, xb
    if ya != yb:
        t0 = min(max((low - ya) / (yb - ya), 0.0), 1.0)
        t1 = min(max((high - ya) / (yb - ya), 0.0), 1.0)
        x0, x1 = xa + t0 * (xb - xa), xa + t1 * (xb - xa)
    return min(left, min(x0, x1)), max(right, max(x0, x1))


@inlined
def _span(ax, ay, bx, by, cx, cy, low, high):  # type: ignore[no-untyped-def]
    """Range of x of a triangle between two heights, a unit wider than it is for what rounding may take."""
    left, right = np.inf, -np.inf
    left, right = _reach(ax, ay, bx, by, low, high, left, right)
    left, right = _reach(bx, by, cx, cy, low, high, left, right)
    left, right = _reach(cx, cy, ax, ay, low, high, left, right)
    return left - 1.0, right + 1.0


@inlined
def _edge(ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """u, v, w of u x + v y + w, twice the area of the triangle from an edge to (x, y): exact, as all are integers."""
    return ay - by, bx - ax, (by - ay) * ax - (bx - ax) * ay


@kernel
def _small(vertex, n, x, y, largest):  # type: ignore[no-untyped-def]
    """Corners of the triangles without a ghost whose circumcircle's radius is at most `largest`."""
    out = np.empty((n, 3), np.int32)
    count = 0
    for t in range(n):
        a, b, c = vertex[3 * t], vertex[3 * t + 1], vertex[3 * t + 2]
        if a == GHOST or b == GHOST or c == GHOST:
            continue
        area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        ab = (x[b] - x[a]) ** 2 + (y[b] - y[a]) ** 2
        bc = (x[c] - x[b]) ** 2 + (y[c] - y[b]) ** 2
        ca = (x[a] - x[c]) ** 2 + (y[a] - y[c]) ** 2
        if ab * bc * ca <= (2.0 * largest * area) ** 2:
            out[count, 0], out[count, 1], out[count, 2] = a, b, c
            count += 1
    return out[:count]


@inlined
def _extent(a, b, c):  # type: ignore[no-untyped-def]
    low, high = (a, b) if a < b else (b, a)
    low = c if c < low else low
    high = c if c > high else high
    return low, high


@kernel
def _points(corners, vx, vy, vz, px, py, start, ncols, nrows, cell, west, south, out):  # type: ignore[no-untyped-def]
    """`out` at places sorted by cell; on an edge the lower of the two facets' values, which differ by rounding."""
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        ax, ay, bx, by, cx, cy = vx[a], vy[a], vx[b], vy[b], vx[c], vy[c]
        low, high = _extent(ay, by, cy)
        left, right = _extent(ax, bx, cx)
        first, last = max(int(np.floor((low - south) / cell)), 0), min(int(np.floor((high - south) / cell)), nrows - 1)
        c0, c1 = max(int(np.floor((left - west) / cell)), 0), min(int(np.floor((right - west) / cell)), ncols - 1)
        if first > last or c0 > c1:
            continue
        az, bz, cz = vz[a], vz[b], vz[c]
        ua, va, wa = _edge(bx, by, cx, cy)
        ub, vb, wb = _edge(cx, cy, ax, ay)
        uc, vc, wc = _edge(ax, ay, bx, by)
        wide = c1 - c0 > FEW and last > first
        for r in range(first, last + 1):
            if wide:
                left, right = _span(ax, ay, bx, by, cx, cy, south + r * cell, south + (r + 1) * cell)
                c0 = max(int(np.floor((left - west) / cell)), 0)
                c1 = min(int(np.floor((right - west) / cell)), ncols - 1)
                if c0 > c1:
                    continue
            for j in range(start[r * ncols + c0], start[r * ncols + c1 + 1]):
                x, y = px[j], py[j]
                to_a, to_b, to_c = ua * x + va * y + wa, ub * x + vb * y + wb, uc * x + vc * y + wc
                if (to_a >= 0) & (to_b >= 0) & (to_c >= 0):
                    value = (to_a * az + to_b * bz + to_c * cz) / (to_a + to_b + to_c)
                    if not out[j] <= value:
                        out[j] = value


@kernel
def _centres(corners, vx, vy, vz, cell, west, south, out):  # type: ignore[no-untyped-def]
    """`out` at the middle of every cell."""
    nrows, ncols = out.shape
    west, south = west + 0.5 * cell, south + 0.5 * cell
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        ay, by, cy = vy[a], vy[b], vy[c]
        low, high = _extent(ay, by, cy)
        first, last = max(int(np.ceil((low - south) / cell)), 0), min(int(np.floor((high - south) / cell)), nrows - 1)
        if first > last:
            continue
        ax, bx, cx = vx[a], vx[b], vx[c]
        left, right = _extent(ax, bx, cx)
        c0, c1 = max(int(np.ceil((left - west) / cell)), 0), min(int(np.floor((right - west) / cell)), ncols - 1)
        if c0 > c1:
            continue
        az, bz, cz = vz[a], vz[b], vz[c]
        ua, va, wa = _edge(bx, by, cx, cy)
        ub, vb, wb = _edge(cx, cy, ax, ay)
        uc, vc, wc = _edge(ax, ay, bx, by)
        wide = c1 - c0 > FEW
        for r in range(first, last + 1):
            y = south + r * cell
            if wide:
                left, right = _span(ax, ay, bx, by, cx, cy, y, y)
                c0 = max(int(np.ceil((left - west) / cell)), 0)
                c1 = min(int(np.floor((right - west) / cell)), ncols - 1)
            for k in range(c0, c1 + 1):
                x = west + k * cell
                to_a, to_b, to_c = ua * x + va * y + wa, ub * x + vb * y + wb, uc * x + vc * y + wc
                if (to_a >= 0) & (to_b >= 0) & (to_c >= 0):
                    value = (to_a * az + to_b * bz + to_c * cz) / (to_a + to_b + to_c)
                    if not out[r, k] <= value:
                        out[r, k] = value
