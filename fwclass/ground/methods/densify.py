"""Densification of a TIN by the points that lie near its triangles: the loop that PTD and IPTD share.

All lengths are millimetres, heights too. Every round looks at the triangles that the last round altered; of the
points that may join one of them, the one at the lowest angle does, and all join at once. So the order of points
cannot matter, and a point whose triangle is as it was is not looked at again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.tin.delaunay import Mesh, insert_one, is_ghost, locate
from fwclass.ground.tin.tin import longest_edge
from fwclass.kernel import kernel

ROUGHNESS = 50.0
"""Added to heights above a triangle when points compete [mm]: of those that differ by noise, the one far from all
vertices wins, and triangles keep a good shape."""


class Limits(NamedTuple):
    """When a point may join; lengths in mm.

    Attributes
    ----------
    distance : greatest distance to the triangle's plane.
    sine : of the greatest angle between the plane and the line to a vertex.
    spacing : a triangle without a longer edge takes no points.
    steep : rise over run of a triangle above which a point may join by its mirror image.
    """

    distance: float
    sine: float
    spacing: float
    steep: float


def densify(
    mesh: Mesh,
    z: NDArray[np.float64],
    inserted: NDArray[np.bool_],
    stand_ins: int,
    limits: Limits,
    candidates: NDArray[np.bool_] | None = None,
) -> int:
    """Add points to `mesh` until none may join; the number of rounds that it took.

    Parameters
    ----------
    mesh : over all points, with some of them in it and all others inside its hull; is added to.
    z : (n,) heights [mm]; the last `stand_ins` are of points that are none, and follow their neighbours.
    inserted : (n,) points that are in the mesh; is added to.
    candidates : (n,) only these may join; None: all.
    """
    busy = inserted.copy() if candidates is None else inserted | ~candidates
    where = np.zeros(len(z), np.int32)
    best = np.full(len(mesh.changed), -1, np.int32)
    score = np.empty(len(mesh.changed))
    mesh.state[2] += 1
    mesh.changed[: int(mesh.state[0])] = mesh.state[2]
    _enter(*mesh, where, busy)
    rounds = 0
    while _round(*mesh, z, where, busy, *limits, best, score):
        _follow(*mesh, z, len(z) - stand_ins)
        rounds += 1
    inserted |= busy if candidates is None else busy & candidates
    return rounds


@kernel
def _enter(x, y, vertex, twin, changed, state, where, inserted):  # type: ignore[no-untyped-def]
    t = state[1]
    for i in range(len(where)):
        if not inserted[i]:
            t = locate(x, y, vertex, twin, x[i], y[i], t)
            where[i] = t


@kernel
def _plane(x, y, vertex, z, t):  # type: ignore[no-untyped-def]
    """Slope to the east and to the north of a triangle's plane."""
    a, b, c = vertex[3 * t], vertex[3 * t + 1], vertex[3 * t + 2]
    ux, uy, uz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    vx, vy, vz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
    area = ux * vy - uy * vx
    return (uz * vy - vz * uy) / area, (ux * vz - vx * uz) / area


@kernel
def _nearest_vertex(x, y, vertex, z, t, px, py, pz):  # type: ignore[no-untyped-def]
    """(vertex, distance) nearest in space to p; the angle at it is the largest of the three."""
    near = -1
    least = np.inf
    for k in range(3):
        v = vertex[3 * t + k]
        square = (x[v] - px) ** 2 + (y[v] - py) ** 2 + (z[v] - pz) ** 2
        if square < least:
            least = square
            near = v
    return near, np.sqrt(least)


@kernel
def _fits(x, y, vertex, z, t, east, north, px, py, pz, distance, sine):  # type: ignore[no-untyped-def]
    """(p is near enough to triangle t, whose plane rises by `east` and `north`; sine of its angle, to compare)."""
    a = vertex[3 * t]
    off = (pz - z[a] - east * (px - x[a]) - north * (py - y[a])) / np.sqrt(1.0 + east * east + north * north)
    if abs(off) > distance:
        return False, 0.0
    _, length = _nearest_vertex(x, y, vertex, z, t, px, py, pz)
    return abs(off) <= sine * length, (off + ROUGHNESS) / length


@kernel
def _mirror_fits(x, y, vertex, twin, z, t, p, distance, sine):  # type: ignore[no-untyped-def]
    """`_fits` of the point's image behind its nearest vertex, where the ground is no steeper than the angle.

    Beyond the edge of a terrace there is ground that goes on as before; beyond the eaves there is a wall.
    """
    v, _ = _nearest_vertex(x, y, vertex, z, t, x[p], y[p], z[p])
    mx, my, mz = 2.0 * x[v] - x[p], 2.0 * y[v] - y[p], 2.0 * z[v] - z[p]
    t = locate(x, y, vertex, twin, mx, my, t)
    if is_ghost(vertex, t):
        return False
    east, north = _plane(x, y, vertex, z, t)
    if (east * east + north * north) * (1.0 - sine * sine) > sine * sine:
        return False
    return _fits(x, y, vertex, z, t, east, north, mx, my, mz, distance, sine)[0]


@kernel
def _joins(x, y, vertex, twin, z, t, east, north, p, distance, sine, steep):  # type: ignore[no-untyped-def]
    """(point p may join triangle t, sine of its angle with sign, for comparison)."""
    fits, angle = _fits(x, y, vertex, z, t, east, north, x[p], y[p], z[p], distance, sine)
    if not fits and east * east + north * north > steep * steep:
        fits = _mirror_fits(x, y, vertex, twin, z, t, p, distance, sine)
    return fits, angle


@kernel
def _round(x, y, vertex, twin, changed, state, z, where, inserted, distance, sine, spacing, steep, best, score):  # type: ignore[no-untyped-def]
    """Insert, for every altered triangle, the point at the lowest angle of those that may join; their number."""
    touched = np.empty(state[0], np.int32)
    count = 0
    last = -1
    closed = False
    east = north = 0.0
    for i in range(len(where)):
        if inserted[i] or changed[where[i]] != state[2]:
            continue
        t = locate(x, y, vertex, twin, x[i], y[i], where[i])
        where[i] = t
        if t != last:
            last = t
            closed = is_ghost(vertex, t) or longest_edge(x, y, vertex, t) < spacing
            if not closed:
                east, north = _plane(x, y, vertex, z, t)
        if closed:
            continue
        joins, angle = _joins(x, y, vertex, twin, z, t, east, north, i, distance, sine, steep)
        j = best[t]
        if joins and (j < 0 or _before(x, y, angle, score[t], i, j)):
            if j < 0:
                touched[count] = t
                count += 1
            best[t] = i
            score[t] = angle
    state[2] += 1
    for k in range(count):
        t = touched[k]
        i = best[t]
        best[t] = -1
        insert_one(x, y, vertex, twin, changed, state, i, t)
        inserted[i] = True
    return count


@kernel
def _before(x, y, mine, other, i, j):  # type: ignore[no-untyped-def]
    """True where point i goes before point j: the lower angle, of equals the one further west, then south."""
    if mine != other:
        return mine < other
    return x[i] < x[j] or (x[i] == x[j] and y[i] < y[j])


@kernel
def _follow(x, y, vertex, twin, changed, state, z, first):  # type: ignore[no-untyped-def]
    """Stand-ins (points from `first` on) with an altered triangle take the mean height of the points around them."""
    for t in range(state[0]):
        if changed[t] == state[2]:
            for k in range(3):
                if vertex[3 * t + k] >= first:
                    _take_mean(x, y, vertex, twin, z, first, 3 * t + k)


@kernel
def _take_mean(x, y, vertex, twin, z, first, e):  # type: ignore[no-untyped-def]
    """Height of the stand-in at which half-edge e starts: mean over its edges to points, weights of length⁻²."""
    a = vertex[e]
    total = weight = 0.0
    at = e
    while True:
        b = vertex[at - at % 3 + (at % 3 + 1) % 3]
        if 0 <= b < first:
            w = 1.0 / ((x[a] - x[b]) ** 2 + (y[a] - y[b]) ** 2)
            total += w * z[b]
            weight += w
        at = twin[at - at % 3 + (at % 3 + 2) % 3]
        if at == e:
            break
    if weight > 0.0:
        z[a] = total / weight
