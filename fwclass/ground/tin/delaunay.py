"""Delaunay triangulation of points on the millimetre grid, exact, and open for more points.

Points are inserted one by one (Lawson 1977): a walk finds the triangle, which is split in three, and edges
are flipped until every circumcircle is empty. The outside is triangles too: every edge of the hull has a ghost
triangle with the vertex `GHOST`. Half-edge 3t + k is the edge k of triangle t and starts at its vertex k.

The set of triangles is a function of the set of points alone (`predicates.in_circle`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.ground.tin.predicates import SPAN, in_circle, orientation
from fwclass.kernel import kernel

GHOST = -1
"""The vertex at infinity."""

_CORNERS = 3


class Mesh(NamedTuple):
    """A triangulation that can take more points, up to all of `x`, `y`.

    Attributes
    ----------
    x, y : float64 (n,) whole millimetres from any origin, in the order of `spatial_order` for speed.
    vertex : int32 (6 n,) point at which a half-edge starts, or `GHOST`; triangles turn left.
    twin : int32 (6 n,) the half-edge on the other side.
    changed : int32 (2 n,) round in which a triangle was last made or altered.
    state : int64 (3,) number of triangles with ghosts, a triangle that was made last, the round.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    vertex: NDArray[np.int32]
    twin: NDArray[np.int32]
    changed: NDArray[np.int32]
    state: NDArray[np.int64]


def spatial_order(x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
    """Order of points [mm] along Morton's curve, equal points side by side; a function of the coordinates."""
    if len(x) == 0:
        return np.zeros(0, np.int64)
    return np.argsort(_morton(x - x.min(), y - y.min()), kind="stable")


def empty_mesh(x: NDArray[np.float64], y: NDArray[np.float64]) -> Mesh:
    """A mesh of no triangles over points (x, y) (points,) [mm, whole] that differ from each other.

    `InputError` where they lie further apart than `SPAN`.
    """
    if len(x):
        span = max(float(np.ptp(x)), float(np.ptp(y)))
        if span > SPAN:
            raise InputError(
                "the points to triangulate lie too far apart",
                where="triangulation",
                expected=f"at most {SPAN / 1e6:.1f} km",
                got=f"{span / 1e6:.1f} km",
                do="work in smaller blocks, or remove stray points",
            )
    size = 2 * max(len(x), 2)
    arrays = np.empty(3 * size, np.int32), np.empty(3 * size, np.int32), np.zeros(size, np.int32)
    return Mesh(
        np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64), *arrays, np.zeros(3, np.int64)
    )


def insert_all(mesh: Mesh, which: NDArray[np.int64]) -> None:
    """Insert the points `which`; while all of them lie on one line there are no triangles.

    They go in rounds, each of four times as many points drawn at random and each in the order given (Amenta, Choi and
    Rote 2003): no set of points is slow, such as two rows far apart. What is drawn hangs on their number alone.
    """
    which = which[_rounds(len(which))]
    if mesh.state[0] == 0:
        third = int(_first_off_line(mesh.x, mesh.y, which)) if len(which) >= _CORNERS else 0
        if third == 0:
            return
        _begin(*mesh, which[0], which[1], which[third])
    _insert(*mesh, which)


def _rounds(count: int) -> NDArray[np.int64]:
    """Places 0 to count - 1 by round: a place is in the last with 3 in 4, in the one before with 3 in 16, and so on."""
    mixed = np.arange(count, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    share = (mixed >> np.uint64(40)) + np.uint64(1)
    early = 24 - np.frexp(share.astype(np.float64))[1]
    return np.argsort(-(np.maximum(early, 0) // 2).astype(np.int16), kind="stable")


def triangles(mesh: Mesh) -> NDArray[np.int32]:
    """The triangles without ghosts, (m, 3) points, each turning left."""
    corners = mesh.vertex[: 3 * int(mesh.state[0])].reshape(-1, 3)
    return corners[(corners != GHOST).all(axis=1)]


@kernel
def _spread(v):  # type: ignore[no-untyped-def]
    v = (v | (v << 16)) & 0x0000FFFF0000FFFF
    v = (v | (v << 8)) & 0x00FF00FF00FF00FF
    v = (v | (v << 4)) & 0x0F0F0F0F0F0F0F0F
    v = (v | (v << 2)) & 0x3333333333333333
    return (v | (v << 1)) & 0x5555555555555555


@kernel
def _morton(x, y):  # type: ignore[no-untyped-def]
    out = np.empty(len(x), np.int64)
    for i in range(len(x)):
        out[i] = _spread(x[i]) | (_spread(y[i]) << 1)
    return out


@kernel
def _first_off_line(x, y, which):  # type: ignore[no-untyped-def]
    a, b = which[0], which[1]
    for i in range(2, len(which)):
        if orientation(x[a], y[a], x[b], y[b], x[which[i]], y[which[i]]) != 0.0:
            return i
    return 0


@kernel
def _put(vertex, twin, t, a, b, c, ab, bc, ca):  # type: ignore[no-untyped-def]
    """Triangle t with corners a, b, c and the half-edges on the other side of its edges."""
    e = 3 * t
    vertex[e], vertex[e + 1], vertex[e + 2] = a, b, c
    twin[e], twin[e + 1], twin[e + 2] = ab, bc, ca


@kernel
def _begin(x, y, vertex, twin, changed, state, a, b, c):  # type: ignore[no-untyped-def]
    """The first triangle and its three ghosts."""
    if orientation(x[a], y[a], x[b], y[b], x[c], y[c]) < 0.0:
        b, c = c, b
    _put(vertex, twin, 0, a, b, c, 3, 6, 9)
    _put(vertex, twin, 1, b, a, GHOST, 0, 11, 7)
    _put(vertex, twin, 2, c, b, GHOST, 1, 5, 10)
    _put(vertex, twin, 3, a, c, GHOST, 2, 8, 4)
    changed[:4] = state[2]
    state[0] = 4
    state[1] = 0


@kernel
def is_ghost(vertex, t):  # type: ignore[no-untyped-def]
    """bool: triangle number t of `vertex`, int64 of shape (3 × triangles,), is outside the hull."""
    return vertex[3 * t] < 0 or vertex[3 * t + 1] < 0 or vertex[3 * t + 2] < 0


@kernel
def real_from(vertex, twin, t):  # type: ignore[no-untyped-def]
    """t, or where t is a ghost the triangle inside its edge of the hull; `twin`, int32 (edges,), names the other side
    of every edge."""
    for k in range(3):
        if vertex[3 * t + k] == GHOST:
            return twin[3 * t + (k + 1) % 3] // 3
    return t


@kernel
def locate(x, y, vertex, twin, px, py, start):  # type: ignore[no-untyped-def]
    """Walk from triangle `start` to one that holds (px, py), its edges included, or to a ghost that sees it."""
    t = real_from(vertex, twin, start)
    came = -1
    while True:
        e = 3 * t
        a, b, c = vertex[e], vertex[e + 1], vertex[e + 2]
        if a < 0 or b < 0 or c < 0:
            return t
        if e != came and orientation(x[a], y[a], x[b], y[b], px, py) < 0.0:
            came = twin[e]
        elif e + 1 != came and orientation(x[b], y[b], x[c], y[c], px, py) < 0.0:
            came = twin[e + 1]
        elif e + 2 != came and orientation(x[c], y[c], x[a], y[a], px, py) < 0.0:
            came = twin[e + 2]
        else:
            return t
        t = came // 3


@kernel
def _conflict(x, y, v, u, w, p):  # type: ignore[no-untyped-def]
    """True where p lies in the circle of the triangle v, u, w, beyond the edge of the triangle u, v, p."""
    if w < 0:
        return orientation(x[u], y[u], x[v], y[v], x[p], y[p]) == 0.0
    if u < 0:
        return orientation(x[w], y[w], x[v], y[v], x[p], y[p]) > 0.0
    if v < 0:
        return orientation(x[u], y[u], x[w], y[w], x[p], y[p]) > 0.0
    return in_circle(x[v], y[v], x[u], y[u], x[w], y[w], x[p], y[p])


@kernel
def _split(vertex, twin, state, t, p):  # type: ignore[no-untyped-def]
    """Triangle t becomes three around p, which is their third vertex; on an edge, one is flat until it is flipped."""
    e = 3 * t
    f = 3 * state[0]
    g = f + 3
    a, b, c, bc, ca = vertex[e], vertex[e + 1], vertex[e + 2], twin[e + 1], twin[e + 2]
    _put(vertex, twin, t, a, b, p, twin[e], f + 2, g + 1)
    _put(vertex, twin, f // 3, b, c, p, bc, g + 2, e + 1)
    _put(vertex, twin, g // 3, c, a, p, ca, e + 2, f + 1)
    twin[bc], twin[ca] = f, g
    state[0] += 2


@kernel
def _flip(vertex, twin, e):  # type: ignore[no-untyped-def]
    """The edge e of u, v, p and its twin in v, u, w become the edge from w to p: u, w, p and w, v, p."""
    f = twin[e]
    s = f - f % 3
    uw, wv = s + (f - s + 1) % 3, s + (f - s + 2) % 3
    u, v, w, p = vertex[e], vertex[e + 1], vertex[wv], vertex[e + 2]
    beyond_uw, beyond_wv, vp, pu = twin[uw], twin[wv], twin[e + 1], twin[e + 2]
    _put(vertex, twin, e // 3, u, w, p, beyond_uw, s + 2, pu)
    _put(vertex, twin, s // 3, w, v, p, beyond_wv, vp, e + 1)
    twin[beyond_uw], twin[beyond_wv], twin[vp] = e, s, s + 1


@kernel
def _legalise(x, y, vertex, twin, changed, state, t, p):  # type: ignore[no-untyped-def]
    """Go once around p and flip every edge opposite to it whose far triangle has p in its circle."""
    e = 3 * t
    first = vertex[e]
    while True:
        f = twin[e]
        s = f - f % 3
        v = vertex[e + 1]
        if _conflict(x, y, v, vertex[e], vertex[s + (f - s + 2) % 3], p):
            _flip(vertex, twin, e)
            continue
        changed[e // 3] = state[2]
        e = twin[e + 1] - 2
        if v == first:
            break
    state[1] = e // 3


@kernel
def _is_corner(x, y, vertex, t, p):  # type: ignore[no-untyped-def]
    for k in range(3):
        v = vertex[3 * t + k]
        if v >= 0 and x[v] == x[p] and y[v] == y[p]:
            return True
    return False


@kernel
def insert_one(x, y, vertex, twin, changed, state, p, start):  # type: ignore[no-untyped-def]
    """Insert point p of (x, y) (points,) [mm], looked for from triangle `start`; nothing happens where a vertex lies
    there already."""
    t = locate(x, y, vertex, twin, x[p], y[p], start)
    if _is_corner(x, y, vertex, t, p):
        return
    _split(vertex, twin, state, t, p)
    _legalise(x, y, vertex, twin, changed, state, t, p)


@kernel
def _insert(x, y, vertex, twin, changed, state, which):  # type: ignore[no-untyped-def]
    for i in range(len(which)):
        insert_one(x, y, vertex, twin, changed, state, which[i], state[1])
