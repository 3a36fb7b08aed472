"""Polygons whose outlines cross themselves, as bow ties do: what is inside is not what their corners' order means."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.label.polygons import Polygons

MOST_PAIRS = 10**8
"""Pairs of edges of one polygon that are side by side; of one with more, which nobody draws, nothing is said."""

AT_ONCE = 4_000_000
"""Pairs that are held at a time, some 500 MB."""


def crossing_parts(polygons: Polygons) -> NDArray[np.bool_]:
    """bool (parts,): two edges of the polygon cross, not only touch; exact."""
    crosses = np.zeros(polygons.parts, bool)
    ends = np.zeros(len(polygons.x), bool)
    ends[polygons.ring_start[1:] - 1] = True
    points = polygons.ring_start[polygons.part_start]
    for part in np.flatnonzero(np.diff(points) > 4):  # a triangle has no edges that could
        edges = np.arange(points[part], points[part + 1])
        crosses[part] = _crosses(polygons.x, polygons.y, edges[~ends[edges]])
    return crosses


def _crosses(x: NDArray[np.int64], y: NDArray[np.int64], edges: NDArray[np.int64]) -> bool:
    """Whether two of `edges` cross: from point `edges` to the next one [mm]."""
    low, high = np.minimum(y[edges], y[edges + 1]), np.maximum(y[edges], y[edges + 1])
    order = np.argsort(low, kind="stable")
    edges, low, high = edges[order], low[order], high[order]
    until = np.searchsorted(low, high, side="left")  # behind an edge those that begin below its end
    pairs = np.cumsum(np.maximum(until - np.arange(len(edges)) - 1, 0))
    if not len(edges) or pairs[-1] > MOST_PAIRS:
        return False
    begin = 0
    while begin < len(edges):
        before = pairs[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(pairs, before + AT_ONCE, side="right")))
        rows = np.arange(begin, end)
        count = np.maximum(until[rows] - rows - 1, 0)
        first = np.repeat(rows, count)
        second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
        if _any_cross(x, y, edges[first], edges[second]):
            return True
        begin = end
    return False


def _any_cross(x: NDArray[np.int64], y: NDArray[np.int64], one: NDArray[np.int64], other: NDArray[np.int64]) -> bool:
    beside = (np.minimum(x[one], x[one + 1]) < np.maximum(x[other], x[other + 1])) & (
        np.minimum(x[other], x[other + 1]) < np.maximum(x[one], x[one + 1])
    )
    one, other = one[beside], other[beside]
    apart = _side(x, y, one, other) * _side(x, y, one, other + 1) < 0
    return bool((apart & (_side(x, y, other, one) * _side(x, y, other, one + 1) < 0)).any())


def _side(
    x: NDArray[np.int64], y: NDArray[np.int64], edge: NDArray[np.int64], point: NDArray[np.int64]
) -> NDArray[np.int64]:
    """On which side of the edges the points lie: -1, 0 or 1."""
    across = (x[edge + 1] - x[edge]) * (y[point] - y[edge]) - (y[edge + 1] - y[edge]) * (x[point] - x[edge])
    return np.sign(across)
