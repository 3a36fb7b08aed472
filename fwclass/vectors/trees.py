"""Trees from the heights of vegetation: tops by a window that grows with height, crowns by watershed."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.vectors.cells import EIGHT, Counts
from fwclass.vectors.outline import Ring, area, corners, fill_holes, mask_of, rings, simplify, sound
from fwclass.vectors.params import TreeParams
from fwclass.vectors.shapes import Shapes

COLUMNS = ("x", "y", "object_height", "object_area", "confidence", "object_echoes")

_CENTIMETRES = 100.0
_NEVER = 65_535
"""Level of cells that no crown takes; others are so many centimetres and one higher, up to 655 m above ground."""


class Canopy(NamedTuple):
    """Heights above ground of vegetation in cells, row 0 in the south [m].

    Attributes
    ----------
    top : of the highest echo; single empty cells have their highest neighbour's, 0 elsewhere.
    smooth : the same without its twigs.
    """

    top: NDArray[np.float64]
    smooth: NDArray[np.float64]


def canopy(counts: Counts, cell: float, params: TreeParams) -> Canopy:
    """The surface of vegetation by the tops of its cells (`cells.counted`)."""
    top = np.nan_to_num(counts.top.astype(np.float64), nan=0.0).clip(0.0)
    around = scipy.ndimage.grey_closing(np.pad(top, 1), footprint=EIGHT)[1:-1, 1:-1]
    top = np.where(top > 0.0, top, around)
    return Canopy(top, scipy.ndimage.gaussian_filter(top, params.smooth / cell, mode="constant", truncate=3.0))


def tops(surface: Canopy, cell: float, params: TreeParams) -> NDArray[np.int64]:
    """Row and column (trees, 2) of cells that are the highest within half the width of a crown of their height.

    Of equal ones that touch the first counts.
    """
    smooth = surface.smooth
    radius = 0.5 * np.minimum(params.width(surface.top), 2.0 * params.reach)
    radius = np.maximum(1, np.rint(radius / cell)).astype(np.int64)
    highest = (surface.top >= params.least_height) & (smooth == scipy.ndimage.maximum_filter(smooth, 3))
    labels, _ = scipy.ndimage.label(highest, EIGHT)
    places = scipy.ndimage.find_objects(labels)
    first = [(s[0].start, s[1].start + int(np.argmax(labels[s][0] == k))) for k, s in enumerate(places, 1)]
    wide = int(radius.max(initial=1))
    around, discs = np.pad(smooth, wide), {r: _disc(r) for r in np.unique(radius[highest]).tolist()}
    alone = []
    for row, col in first:
        r = int(radius[row, col])
        near = around[row + wide - r : row + wide + r + 1, col + wide - r : col + wide + r + 1]
        if near[discs[r]].max() <= smooth[row, col]:
            alone.append((row, col))
    return np.array(alone, np.int64).reshape(-1, 2)


def _disc(radius: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return np.asarray(x**2 + y**2 <= radius**2)


def crowns(surface: Canopy, tree_tops: NDArray[np.int64], cell: float, params: TreeParams) -> NDArray[np.int32]:
    """Number (from 1) of the tree that each cell belongs to, 0 for none: watersheds of the surface turned over.

    A crown has no cell lower than `params.share` of its top, and none further from it than `params.reach`.
    """
    number = len(tree_tops)
    height = np.zeros(number + 1)
    rows, cols = tree_tops.T
    height[1:] = surface.smooth[rows, cols]
    markers = np.zeros(surface.smooth.shape, np.int32)
    ground = surface.top < params.least_height * params.share
    markers[ground] = -1
    markers[rows, cols] = np.arange(1, number + 1)
    high = np.minimum(np.rint(_CENTIMETRES * surface.smooth), _NEVER - 1)
    depth = np.where(ground, _NEVER, _NEVER - 1 - high).astype(np.uint16)
    tree = np.maximum(scipy.ndimage.watershed_ift(depth, markers, EIGHT), 0).astype(np.int32)
    y, x = np.indices(tree.shape)
    at = np.concatenate([[[0, 0]], tree_tops])
    near = np.hypot(y - at[tree, 0], x - at[tree, 1]) * cell <= params.reach
    tree[~near | (surface.smooth < params.share * height[tree])] = 0
    return tree


def trees(counts: Counts, window: Window, core: Window, params: TreeParams) -> Shapes:
    """The trees whose tops lie in `core`, part of `window`: `COLUMNS` of each, by row and column of the top, and the
    outline of its crown [m]."""
    surface = canopy(counts, window.cell, params)
    places = tops(surface, window.cell, params)
    tree = crowns(surface, places, window.cell, params)
    rows, polygons = [], []
    for k, piece in enumerate(scipy.ndimage.find_objects(tree, len(places)), 1):
        row, col = places[k - 1] + (window.row, window.col)
        if piece is None or not (0 <= row - core.row < core.nrows and 0 <= col - core.col < core.ncols):
            continue
        labels, _ = scipy.ndimage.label(tree[piece] == k, EIGHT)
        at = places[k - 1] - (piece[0].start, piece[1].start)
        mine = labels == labels[at[0], at[1]]
        if mine.sum() * window.cell**2 < params.least_area:
            continue
        polygon = _outline(mine, window, piece)
        rated, percent = int(counts.rated[piece][mine].sum()), int(counts.percent[piece][mine].sum())
        low_r, low_c = np.maximum(places[k - 1] - 1, 0)
        height = float(surface.top[low_r : low_r + 3, low_c : low_c + 3].max())  # smoothing may move it by a cell
        size = sum(area(ring) for ring in polygon)
        sure = 0.01 * percent / rated if rated else math.nan
        x, y = (col + 0.5) * window.cell, (row + 0.5) * window.cell
        rows.append((x, y, height, size, sure, int(counts.echoes[piece][mine].sum())))
        polygons.append(polygon)
    if not rows:
        return Shapes.of(Table.empty(COLUMNS), [])
    return Shapes.of(Table({n: np.array(v) for n, v in zip(COLUMNS, zip(*rows, strict=True), strict=True)}), polygons)


def _outline(mine: NDArray[np.bool_], window: Window, piece: tuple[slice, ...]) -> list[Ring]:
    """The outline of a crown without holes [m]."""
    rows, cols = np.nonzero(mine)
    mask, row, col = mask_of(rows, cols)
    ring = rings(fill_holes(mask, mask.size))[0]
    plain = ring[simplify(ring.astype(np.float64), 1.0)].astype(np.float64)
    outline = plain if sound([plain]) else corners(ring).astype(np.float64)
    low = np.array([col + piece[1].start + window.col, row + piece[0].start + window.row])
    return [window.cell * (outline + low)]
