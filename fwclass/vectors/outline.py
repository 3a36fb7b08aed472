"""Outlines of cells as rings of corners, and what is held of rings: area, simplification, validity."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fwclass.vectors.outline_kernels import edges_meet, fill_small, join_corners, kept_corners, trace_rings

Ring = NDArray[np.float64]
"""(corners, 2): x, y; the last one is not the first again. Outlines run counterclockwise, holes clockwise."""

Cells = NDArray[np.bool_]
"""A mask with an empty margin of a cell, row 0 in the south."""

MOST_EDGES = 3000
"""Of a polygon whose edges are held against each other; one with more keeps the outline of its cells."""


def mask_of(rows: NDArray[np.integer], cols: NDArray[np.integer]) -> tuple[Cells, int, int]:
    """Cells by global row and column, (cells,) each, as a mask, bool (rows, columns); row and column of its first cell,
    which is in the margin."""
    low_r, low_c = int(rows.min()) - 1, int(cols.min()) - 1
    mask = np.zeros((int(rows.max()) - low_r + 2, int(cols.max()) - low_c + 2), bool)
    mask[rows - low_r, cols - low_c] = True
    return mask, low_r, low_c


def fill_holes(mask: Cells, least: int) -> Cells:
    """`mask` with holes of fewer than `least` cells filled, and cells that touch by a corner alone joined by a third,
    so that no ring meets itself."""
    mask = mask.copy()
    fill_small(mask, least)
    join_corners(mask)
    return mask


def rings(mask: Cells) -> list[NDArray[np.int64]]:
    """Rings around the cells of `mask` and its holes: every corner of a cell on the way, (corners, 2) as column and
    row; outlines counterclockwise, holes clockwise. The mask comes from `fill_holes`."""
    points, first = trace_rings(mask)
    return sorted((points[a:b] for a, b in pairwise(first.tolist())), key=lambda ring: -abs(area(ring)))


def following(ring: NDArray) -> NDArray:
    """What comes next of the corners of a `ring`, (corners, 2), or of one of their axes, (corners,); behind the last
    the first."""
    return np.concatenate([ring[1:], ring[:1]])


def corners(ring: NDArray) -> NDArray:
    """The corners, (corners, 2), of a `ring`, (points, 2), where it turns; cells' sides alone, which are exact."""
    ahead, behind = following(ring) - ring, ring - np.roll(ring, 1, axis=0)
    return ring[ahead[:, 0] * behind[:, 1] != ahead[:, 1] * behind[:, 0]]


def area(ring: NDArray) -> float:
    """Signed area of a ring, (corners, 2), positive where it runs counterclockwise, in its unit squared."""
    x, y = (ring - ring[0]).T
    return float(0.5 * (x * following(y) - y * following(x)).sum())


def simplify(ring: Ring, tolerance: float) -> NDArray[np.int64]:
    """Indices of the corners of `ring`, (corners, 2), that stay (Douglas and Peucker 1973): none lies further than
    `tolerance`, in the ring's unit, from the ring through them. It begins at the two corners that are furthest apart
    from the middle and from each other."""
    return np.flatnonzero(kept_corners(ring, tolerance))


def cover(polygon: list[Ring], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Cells of a raster of `shape` whose middles lie in a polygon of rings in its columns and rows."""
    flips = np.zeros((shape[0], shape[1] + 1), np.int64)
    middles = np.arange(shape[0]) + 0.5
    for ring in polygon:
        x0, y0 = ring.T
        x1, y1 = following(x0), following(y0)
        crossed = (y0[:, None] <= middles) != (y1[:, None] <= middles)
        edge, row = np.nonzero(crossed)
        at = x0[edge] + (middles[row] - y0[edge]) * (x1[edge] - x0[edge]) / (y1[edge] - y0[edge])
        np.add.at(flips, (row, np.clip(np.ceil(at - 0.5), 0, shape[1]).astype(np.int64)), 1)
    return np.asarray(np.cumsum(flips, axis=1)[:, :-1] % 2 == 1)


def sound(polygon: list[Ring]) -> bool:
    """Whether rings make a valid polygon: the first runs counterclockwise around all others, which run clockwise, and
    no two edges meet but neighbours at their corner."""
    if any(len(ring) < 3 for ring in polygon) or sum(map(len, polygon)) > MOST_EDGES:
        return False
    if area(polygon[0]) <= 0.0 or any(area(hole) >= 0.0 for hole in polygon[1:]):
        return False
    begin = np.concatenate(polygon)
    ahead = np.arange(1, len(begin) + 1)
    last = np.cumsum([len(ring) for ring in polygon]) - 1
    ahead[last] = np.r_[0, ahead[last[:-1]]]
    if edges_meet(begin, ahead):
        return False
    return all(_inside(hole[0], polygon[0]) for hole in polygon[1:])


def _inside(point: NDArray[np.float64], ring: Ring) -> bool:
    (x, y), (x0, y0), (x1, y1) = point, ring.T, following(ring).T
    crossed = (y0 <= y) != (y1 <= y)
    at = x0[crossed] + (y - y0[crossed]) * (x1[crossed] - x0[crossed]) / (y1[crossed] - y0[crossed])
    return bool((at > x).sum() % 2)
