"""Outlines of cells as rings of corners, and what is held of rings: area, simplification, validity."""

from __future__ import annotations

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.vectors.outline_kernels import mark_corners

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
    labels, number = scipy.ndimage.label(~mask)
    sizes = np.bincount(labels.ravel(), minlength=number + 1)
    small = sizes < least
    small[[0, labels[0, 0]]] = False
    mask = mask | small[labels]
    while True:
        a, b, c, d = mask[:-1, :-1], mask[:-1, 1:], mask[1:, :-1], mask[1:, 1:]
        rising, falling = a & d & ~b & ~c, b & c & ~a & ~d
        if not (rising.any() or falling.any()):
            return mask
        mask = mask.copy()
        mask[:-1, 1:] |= rising
        mask[:-1, :-1] |= falling


def rings(mask: Cells) -> list[NDArray[np.int64]]:
    """Rings around the cells of `mask` and its holes: every corner of a cell on the way, (corners, 2) as column and
    row; outlines counterclockwise, holes clockwise. The mask comes from `fill_holes`."""
    inner = mask[1:-1, 1:-1]
    sides = (
        (inner & ~mask[:-2, 1:-1], (0, 0), (1, 0)),
        (inner & ~mask[1:-1, 2:], (1, 0), (1, 1)),
        (inner & ~mask[2:, 1:-1], (1, 1), (0, 1)),
        (inner & ~mask[1:-1, :-2], (0, 1), (0, 0)),
    )
    after: dict[tuple[int, int], tuple[int, int]] = {}
    for there, first, last in sides:
        for r, c in (np.argwhere(there) + 1).tolist():
            after[c + first[0], r + first[1]] = (c + last[0], r + last[1])
    out = []
    while after:
        begin, at = after.popitem()
        ring = [begin]
        while at != begin:
            ring.append(at)
            at = after.pop(at)
        lowest = ring.index(min(ring))
        out.append(np.array(ring[lowest:] + ring[:lowest], np.int64))
    return sorted(out, key=lambda r: (-abs(area(r)), r[0].tolist()))


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
    begin = int(np.argmax(((ring - ring.mean(axis=0)) ** 2).sum(axis=1)))
    turned = np.roll(ring, -begin, axis=0)
    far = int(np.argmax(((turned - turned[0]) ** 2).sum(axis=1)))
    closed = np.concatenate([turned, turned[:1]])
    stays = np.zeros(len(closed), bool)
    stays[[0, far, -1]] = True
    mark_corners(closed, stays, tolerance)
    return np.sort((np.flatnonzero(stays[:-1]) + begin) % len(ring))


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
    end = np.concatenate([following(ring) for ring in polygon])
    if _crossing(begin, end, [len(ring) for ring in polygon]):
        return False
    return all(_inside(hole[0], polygon[0]) for hole in polygon[1:])


def _crossing(begin: Ring, end: Ring, lengths: list[int]) -> bool:
    """Whether two edges that are no neighbours share a point, or two neighbours run back over each other."""
    along = end - begin
    number = len(begin)
    ahead = np.arange(1, number + 1)
    first = 0
    for length in lengths:
        ahead[first + length - 1] = first
        first += length
    apart = np.ones((number, number), bool)
    for other in (np.arange(number), ahead):
        apart[np.arange(number), other] = apart[other, np.arange(number)] = False

    def side(k: Ring) -> NDArray[np.float64]:
        """Side of every edge's line that each of the points lies on."""
        to = k[None, :, :] - begin[:, None, :]
        return np.sign(along[:, None, 0] * to[:, :, 1] - along[:, None, 1] * to[:, :, 0])

    across = side(begin) * side(end) <= 0
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    boxes = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    if (across & across.T & boxes & apart).any():
        return True
    then = along[ahead]
    back = (along[:, 0] * then[:, 1] == along[:, 1] * then[:, 0]) & ((along * then).sum(axis=1) <= 0)
    return bool(back.any())


def _inside(point: NDArray[np.float64], ring: Ring) -> bool:
    (x, y), (x0, y0), (x1, y1) = point, ring.T, following(ring).T
    crossed = (y0 <= y) != (y1 <= y)
    at = x0[crossed] + (y - y0[crossed]) * (x1[crossed] - x0[crossed]) / (y1[crossed] - y0[crossed])
    return bool((at > x).sum() % 2)
