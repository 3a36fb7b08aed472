"""Trees from the heights of vegetation: tops where their surface bulges most at the scale of a crown of its height, or
sticks out of the round crowns of these, and the cells nearest to them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.vectors.cells import EIGHT, Counts, Passage, highest_around
from fwclass.vectors.outline import area
from fwclass.vectors.outline_kernels import cells_around, crown_outline
from fwclass.vectors.params import TreeParams
from fwclass.vectors.shapes import Shapes
from fwclass.vectors.surface_kernels import add_bulge, add_level, add_round_crown, smooth

COLUMNS = ("x", "y", "object_height", "object_area", "confidence", "object_echoes")

_LEVELS = 8
"""Scales that the surface is looked at in."""

_TRUNCATE = 3.0
"""Deviations after which a Gaussian ends."""

_WAYS = 16
"""Directions from a top that the surface is looked at in."""

_MOST = 3.0
"""Echoes of vegetation that a pulse is taken to have at most; more come of cells where few pulses end."""

_ASIDE = 2
"""Cells that the highest echo of a tree lies from its top at most."""


class Canopy(NamedTuple):
    """Heights above ground of vegetation in cells, row 0 in the south [m].

    Attributes
    ----------
    surface : of the highest echo, 0 where there is none, without its pits (`without_pits`).
    smooth : that without its twigs.
    bulge : how much it is higher than around it, at the scale of a crown of its height (`bulge`).
    """

    surface: NDArray[np.float64]
    smooth: NDArray[np.float64]
    bulge: NDArray[np.float64]


def canopy(counts: Counts, cell: float, params: TreeParams) -> Canopy:
    """The surface of vegetation by the tops of its cells of edge `cell` [m] (`cells.count_cells`); 0 for none."""
    top = np.nan_to_num(counts.top.astype(np.float64), nan=0.0).clip(0.0)
    surface = without_pits(top, cell, params.pit)
    smooth = _smoothed(surface, params.smooth / cell)
    return Canopy(surface, smooth, bulge(surface, smooth, cell, params))


def without_pits(top: NDArray[np.float64], cell: float, radius: float) -> NDArray[np.float64]:
    """The surface that a ball of `radius` [m] does not fall below, as it rolls over `top` [m]: pits between leaves are
    closed, and gaps between crowns stay where they are wider than the ball."""
    wide = int(radius / cell)
    y, x = cell * np.mgrid[-wide : wide + 1, -wide : wide + 1]
    under = radius**2 - x**2 - y**2
    ball = np.sqrt(np.maximum(under, 0.0)) - radius
    closed = scipy.ndimage.grey_closing(np.pad(top, wide), footprint=under >= 0.0, structure=ball)
    return np.asarray(closed[wide : wide + top.shape[0], wide : wide + top.shape[1]])


def bulge(
    surface: NDArray[np.float64], smooth: NDArray[np.float64], cell: float, params: TreeParams
) -> NDArray[np.float64]:
    """The surface's Laplacian turned over, normalised by scale [m] (Lindeberg 1998, equation 22).

    The scale is the deviation of the Gaussian that it is taken after: `params.scale` of the `smooth` height,
    `params.widest` at most; between `_LEVELS` scales values are linear.
    """
    out = np.zeros_like(surface)
    scales, level = _scales(params.scale * smooth, cell, params.widest)
    for k, scale in enumerate(scales):
        add_bulge(out, _smoothed(surface, scale / cell), level, k, (scale / cell) ** 2)
    return out


def _scales(wanted: NDArray[np.float64], cell: float, widest: float) -> tuple[list[float], NDArray[np.float64]]:
    """Scales [m] up to `widest`, and which of them cells want, float64 (rows, columns), that want some scale [m]:
    between two where it is no whole number."""
    scales = np.linspace(min(cell, widest), widest, _LEVELS)
    return scales.tolist(), np.interp(wanted, scales, np.arange(_LEVELS))


def _smoothed(surface: NDArray[np.float64], deviation: float) -> NDArray[np.float64]:
    """After a Gaussian of `deviation` [cells]."""
    away = np.arange(int(_TRUNCATE * deviation + 0.5) + 1)
    weights = np.exp(-0.5 / deviation**2 * away**2)
    return np.asarray(smooth(surface, weights / np.concatenate([weights[:0:-1], weights]).sum()))


def tops(surface: Canopy, cell: float, params: TreeParams) -> NDArray[np.int64]:
    """Row and column (trees, 2) of cells that bulge most within half the width of a crown of their height.

    Of equal ones that touch the first counts.
    """
    value = surface.bulge
    radius = 0.5 * np.minimum(params.width(surface.surface), 2.0 * params.reach)
    radius = np.maximum(1, np.rint(radius / cell)).astype(np.int64)
    most = (surface.surface >= params.least_height) & (value > 0.0) & (value == scipy.ndimage.maximum_filter(value, 3))
    labels, _ = scipy.ndimage.label(most, EIGHT)
    places = scipy.ndimage.find_objects(labels)
    first = [(s[0].start, s[1].start + int(np.argmax(labels[s][0] == k))) for k, s in enumerate(places, 1)]
    wide = int(radius.max(initial=1))
    around, discs = np.pad(value, wide), {r: _disc(r) for r in np.unique(radius[most]).tolist()}
    alone = []
    for row, col in first:
        r = int(radius[row, col])
        near = around[row + wide - r : row + wide + r + 1, col + wide - r : col + wide + r + 1]
        if near[discs[r]].max() <= value[row, col]:
            alone.append((row, col))
    return np.array(alone, np.int64).reshape(-1, 2)


def round_crowns(
    surface: NDArray[np.float64], tree_tops: NDArray[np.int64], cell: float, params: TreeParams
) -> NDArray[np.float64]:
    """Height of the crowns of `tree_tops` as far as they are round [m], 0 where there is none.

    So far from its top a crown is as high as the `surface` [m] is in `params.round` of all directions at most, and
    never higher than nearer to it.
    """
    out = np.zeros_like(surface)
    turn = 2.0 * np.pi * np.arange(_WAYS)[:, None] / _WAYS
    around = np.arange(int(params.reach / cell) + 1)
    ways = np.rint(np.stack([around * np.sin(turn), around * np.cos(turn)], axis=2)).astype(np.int64)
    for row, col in tree_tops.tolist():
        wide = int(min(params.reach, params.spread * surface[row, col]) / cell)
        add_round_crown(out, surface, row, col, wide, ways, int(params.round * (_WAYS - 1)))
    return out


def tops_beside(
    surface: Canopy, passage: Passage, tree_tops: NDArray[np.int64], cell: float, params: TreeParams
) -> NDArray[np.int64]:
    """Row and column (trees, 2) of cells where the surface sticks out most of the round crowns of `tree_tops`: trees on
    the shoulder of a taller one, which the surface does not bulge over.

    What sticks out [m] is smoothed by `params.blur` of the height, and weighted by the distance from the nearest top as
    a share of the height and by the square of `depth`; it is `params.beside` at least then, and the most within half
    the width of the narrowest crown.
    """
    over = np.maximum(surface.smooth - round_crowns(surface.smooth, tree_tops, cell, params), 0.0)
    value = np.zeros_like(over)
    scales, level = _scales(params.blur * surface.smooth, cell, params.widest)
    for k, scale in enumerate(scales):
        add_level(value, _smoothed(over, scale / cell), level, k)
    away = np.full(over.shape, params.reach)
    if len(tree_tops):
        others = np.ones(over.shape, bool)
        others[tuple(tree_tops.T)] = False
        away = np.minimum(away, cell * scipy.ndimage.distance_transform_edt(others))
    high = surface.surface >= params.least_height
    value *= away / np.maximum(surface.smooth, params.least_height) * depth(passage, cell, params) ** 2
    disc = _disc(max(1, round(params.narrowest / cell)))
    most = (value >= params.beside) & (value == scipy.ndimage.maximum_filter(value, footprint=disc, mode="constant"))
    return np.argwhere(most & high)


def depth(passage: Passage, cell: float, params: TreeParams) -> NDArray[np.float64]:
    """float64 (rows, columns): how much vegetation pulses meet around each cell of `cell` [m], 0 to `_MOST`: the share
    of them that do not come through, times echoes of vegetation a pulse; 0 where no pulse ends. Where two crowns stand
    over each other both are higher."""
    pulses, through, echoes = (
        _smoothed(some.astype(np.float64), params.around / cell)
        for some in (passage.pulses, passage.through, passage.echoes)
    )
    some = pulses > 0.0
    stopped = 1.0 - np.divide(through, pulses, out=np.ones_like(pulses), where=some).clip(max=1.0)
    return np.asarray(stopped * np.divide(echoes, pulses, out=np.zeros_like(pulses), where=some).clip(max=_MOST))


def _around(row: int, col: int, wide: int) -> tuple[slice, slice]:
    """The cells up to `wide` rows and columns from one, as far as there are any."""
    return slice(max(0, row - wide), row + wide + 1), slice(max(0, col - wide), col + wide + 1)


def _disc(radius: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return np.asarray(x**2 + y**2 <= radius**2)


def crowns(surface: Canopy, tree_tops: NDArray[np.int64], cell: float, params: TreeParams) -> NDArray[np.int32]:
    """int32 (rows, columns): number, from 1, of the tree that each cell of `cell` [m] belongs to, 0 for none: that of
    the nearest of the `tree_tops` int64 (trees, 2), row and column, the first of equal ones (Silva et al. 2016).

    A crown has no cell lower than `params.share` of its top, and none further from it than `params.spread` of its
    height and `params.reach`.
    """
    tree = np.zeros(surface.smooth.shape, np.int32)
    nearest = np.full(tree.shape, np.inf)
    place = np.indices(tree.shape)
    heights = surface.smooth[tree_tops[:, 0], tree_tops[:, 1]]
    for k, ((row, col), height) in enumerate(zip(tree_tops.tolist(), heights.tolist(), strict=True), 1):
        wide = int(min(params.reach, params.spread * height) / cell)
        part = _around(row, col, wide)
        far = (place[0][part] - row) ** 2 + (place[1][part] - col) ** 2
        mine = (far < nearest[part]) & (far <= wide**2) & (surface.smooth[part] >= params.share * height)
        tree[part][mine], nearest[part][mine] = k, far[mine]
    return tree


def _cropped(counts: Counts, passage: Passage, window: Window, params: TreeParams) -> tuple[Counts, Passage, Window]:
    """`counts`, `passage` and `window` without what lies further from all vegetation than a cell can see."""
    near = math.ceil((2.0 * params.reach + 2.0 * _TRUNCATE * max(params.widest, params.around)) / window.cell)
    high = counts.top > 0.0
    part = []
    for axis in (0, 1):
        some = np.flatnonzero(high.any(axis=1 - axis))
        first, last = (int(some[0]), int(some[-1])) if len(some) else (0, 0)
        part.append(slice(max(0, first - near), min(high.shape[axis], last + near + 1)))
    rows, cols = part
    inner = Window(
        window.cell, window.col + cols.start, window.row + rows.start, cols.stop - cols.start, rows.stop - rows.start
    )
    return counts.within((rows, cols)), passage.within((rows, cols)), inner


def trees(table: Table, counts: Counts, passage: Passage, window: Window, core: Window, params: TreeParams) -> Shapes:
    """The trees whose tops lie in `core`, part of `window`: `COLUMNS` of each, by row and column of the top, and the
    outline of its crown [m].

    The height is that of the highest echo of `table` within `_ASIDE` cells of the top, of the surface where none is.
    """
    counts, passage, window = _cropped(counts, passage, window, params)
    surface = canopy(counts, window.cell, params)
    places = tops(surface, window.cell, params)
    places = np.concatenate([places, tops_beside(surface, passage, places, window.cell, params)])
    seen = core.grown(math.ceil(2.0 * params.reach / window.cell))  # what may share cells with a crown of the core
    at = places + np.array([window.row - seen.row, window.col - seen.col])
    places = places[((at >= 0) & (at < (seen.nrows, seen.ncols))).all(axis=1)]
    places = places[np.lexsort((places[:, 1], places[:, 0]))]
    tree = crowns(surface, places, window.cell, params)
    highest = highest_around(table, window, params.codes, places, _ASIDE)
    highest = np.where(np.isnan(highest), surface.surface[tuple(places.T)], highest)
    rows, polygons = [], []
    met, cells = np.zeros(tree.shape, bool), np.empty((tree.size, 2), np.int64)
    for k, (first_row, first_col) in enumerate(places.tolist()):
        row, col = first_row + window.row, first_col + window.col
        if not (0 <= row - core.row < core.nrows and 0 <= col - core.col < core.ncols):
            continue
        part = cells[: cells_around(tree, met, cells, first_row, first_col)]
        mine = tuple(part.T)
        echoes = int(counts.echoes[mine].sum())
        if echoes < params.least_echoes:
            continue
        outline = window.cell * (crown_outline(part) + np.array([window.col, window.row]))
        size = area(outline)
        if size < params.least_area:
            continue
        rated, percent = int(counts.rated[mine].sum()), int(counts.percent[mine].sum())
        sure = 0.01 * percent / rated if rated else math.nan
        x, y = (col + 0.5) * window.cell, (row + 0.5) * window.cell
        rows.append((x, y, float(highest[k]), size, sure, echoes))
        polygons.append([outline])
    if not rows:
        return Shapes.of(Table.empty(COLUMNS), [])
    return Shapes.of(Table({n: np.array(v) for n, v in zip(COLUMNS, zip(*rows, strict=True), strict=True)}), polygons)
