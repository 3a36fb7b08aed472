"""Right-angled outlines: the direction of a building's walls, and its rings brought onto it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.vectors.outline import Ring, area, simplify

_STEP = 1.0
"""Of the directions that are tried [deg]."""

_NEAR = 20.0
"""Walls as near as this to the best of them make it exact [deg]."""


def middles(ring: NDArray[np.int64]) -> Ring:
    """The middles, (corners, 2) [cells], of the sides of cells along a `ring`, (corners, 2) [cells]: a slanting wall's
    steps lie half a cell about it at most."""
    return np.asarray(0.5 * (ring + np.roll(ring, -1, axis=0)), np.float64)


def direction(walls: list[Ring]) -> float:
    """Direction that most of the walls' length lies along or across [rad, 0 to pi / 2].

    `walls` are rings of corners. The one of least length times deviation is taken, and then the mean of the walls near
    it, by length squared: long walls are known best.
    """
    along = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in walls])
    length, angle = np.hypot(*along.T), np.arctan2(along[:, 1], along[:, 0])
    tried = np.radians(np.arange(0.0, 90.0, _STEP))
    off = np.abs(np.sin(2.0 * (angle[:, None] - tried)))  # 0 along and across, 1 between
    best = tried[int(np.argmin((length[:, None] * off).sum(axis=0)))]
    turned = (angle - best + math.pi / 4) % (math.pi / 2) - math.pi / 4
    near = np.abs(turned) <= math.radians(_NEAR)
    if near.any():
        best += float(np.average(turned[near], weights=length[near] ** 2))
    return float(best % (math.pi / 2))


def right_angled(points: Ring, angle: float, tolerance: float, shortest: float) -> Ring | None:
    """A ring with walls along and across `angle` [rad] alone, as near to `points` as may be; None where there is none.

    Each run of simplified edges that lie along, or across, becomes one wall at the median of its points. A wall shorter
    than `shortest` between two others is taken into theirs, the shortest first.
    """
    c, s = math.cos(angle), math.sin(angle)
    turned = points @ np.array([[c, -s], [s, c]])
    stays = simplify(turned, tolerance)
    if len(stays) < 3:
        return None
    walls = _join_short(_walls(turned, stays), shortest)
    if len(walls) < 4:
        return None
    level = [float(np.median(turned[_rows(w, len(turned)), w[0]])) for w in walls]
    ring = np.empty((len(walls), 2))
    for k, (axis, _, _) in enumerate(walls):
        ring[k, axis], ring[k, 1 - axis] = level[k], level[k - 1]
    if area(ring) * area(points) <= 0.0:
        return None
    return ring @ np.array([[c, s], [-s, c]])


Wall = tuple[int, int, int]
"""Axis whose value is constant along it (0: x, 1: y), first point, and number of points after it."""


def _walls(ring: Ring, stays: NDArray[np.int64]) -> list[Wall]:
    """Edges between the corners that stay, each along the axis that it is nearer to."""
    out: list[Wall] = []
    for a, b in zip(stays, np.roll(stays, -1), strict=True):
        along = np.abs(ring[b] - ring[a])
        out.append((int(along[1] < along[0]), int(a), int((b - a) % len(ring))))
    return out


def _join_short(walls: list[Wall], shortest: float) -> list[Wall]:
    """Neighbours of one axis made one, and then the shortest of all walls, as long as it is too short."""
    walls = _merge_axes(walls)
    while len(walls) > 4:
        k = min(range(len(walls)), key=lambda k: (walls[k][2], walls[k][1]))
        if walls[k][2] >= shortest:
            break
        axis = 1 - walls[k][0]
        walls = _merge_axes([*walls[:k], (axis, *walls[k][1:]), *walls[k + 1 :]])
    return walls


def _merge_axes(walls: list[Wall]) -> list[Wall]:
    out: list[Wall] = []
    for axis, first, number in walls:
        if out and out[-1][0] == axis:
            out[-1] = (axis, out[-1][1], out[-1][2] + number)
        else:
            out.append((axis, first, number))
    if len(out) > 1 and out[0][0] == out[-1][0]:
        axis, first, number = out.pop()
        out[0] = (axis, first, number + out[0][2])
    return out


def _rows(wall: Wall, points: int) -> NDArray[np.int64]:
    _, first, number = wall
    return (first + np.arange(number + 1)) % points
