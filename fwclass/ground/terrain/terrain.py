"""Terrain from ground points: rasters of the terrain and of what stands on it, and heights above ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import cells_of
from fwclass.ground.terrain.dsm import highest, without_pepper
from fwclass.ground.terrain.facets import facet_heights, facet_raster, facets_of
from fwclass.ground.terrain.nearest import nearest_height
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.roughness import roughness
from fwclass.ground.terrain.thinning import thin_points
from fwclass.ground.tin.tin import tin_of
from fwclass.neighbours import Points

MEASURED, INTERPOLATED, BEYOND = 0, 1, 2
"""Values of the raster `support`."""

NO_TERRAIN, ON_ECHOES, BETWEEN, CONTINUED, FLATTENED, ON_BREAKLINE = range(6)
"""Values of the raster `mask`; the last two are given by who flattens water and reads breaklines."""

PYRAMID = 64
"""Cells of the coarse global grid that the membrane's pyramid hangs on."""


@dataclass(frozen=True)
class Terrain:
    """Rasters of a window (row 0 in the south) and heights of points.

    Attributes
    ----------
    dtm : float32, terrain at the cell's middle [m], NaN beyond support.
    dsm : float32, highest echo of the cell [m], NaN where there is none and no small gap; ``dsm - dtm`` may be a
        little below 0, where the terrain is smoother than its echoes.
    support : uint8, 0 a cell with a ground echo, 1 interpolated, 2 further than max_gap from any such cell.
    distance : float32, from the cell's middle to that of the nearest cell with a ground echo [m], NaN beyond support.
    continued : bool, cells without a triangle or a ground echo, where a membrane goes on.
    roughness : float32, spread of the ground echoes about their plane [m], see `roughness`; NaN where they are few.
    height : float32 (n,), height above ground [m] of the points asked for, NaN where their cell is beyond support.
    """

    dtm: NDArray[np.float32]
    dsm: NDArray[np.float32]
    support: NDArray[np.uint8]
    distance: NDArray[np.float32]
    continued: NDArray[np.bool_]
    roughness: NDArray[np.float32]
    height: NDArray[np.float32]

    @property
    def mask(self) -> NDArray[np.uint8]:
        """uint8 raster, shape of `dtm`: what the terrain of a cell comes from.

        0 no terrain, 1 ground echoes of the cell, 2 a triangle between ground echoes (interpolated), 3 a membrane
        beyond all triangles (extrapolated).
        """
        between = np.where(self.continued, np.uint8(CONTINUED), np.uint8(BETWEEN))
        known = np.where(self.support == MEASURED, np.uint8(ON_ECHOES), between)
        return np.where(np.isnan(self.dtm), np.uint8(NO_TERRAIN), known)


def terrain(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    ground: NDArray[np.bool_],
    noise: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    core: Window,
    params: TerrainParams,
    knots: Points | None = None,
) -> Terrain:
    """Terrain of one block from the points of the block and its halo.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order, which does not matter; points beyond the halo are left out.
    ground : (n,) ground points.
    noise : (n,) points that are no surface: they count for neither raster, but get a height.
    inside : (n,) points whose height is asked for; they lie in `core`, others get NaN.
    core : the block's cells; its cell is `params.cell`.
    knots : places that the terrain passes through whatever echoes around say, of water's edges and of breaklines; they
        are no echoes, and make no terrain where none are near.

    Between ground points the terrain is linear on the triangles of a TIN of thinned points. Where no triangle of
    `params.largest_circle` is, a membrane continues it. Without any ground point all is NaN and beyond support.

    `ValueError`: the cells of `core` are not of `params.cell`.
    """
    if not math.isclose(core.cell, params.cell):
        raise ValueError(f"cells of {core.cell} m where terrain.cell is {params.cell} m")
    outer = _grow(core, round(params.block_halo / params.cell))
    cells, near = cells_of(x, y, outer)
    used = ground & ~noise & near
    distance = _distances(cells[used[near]], outer)
    support = _support(distance, params.max_gap)
    rows = np.flatnonzero(inside)
    has = _in_cells(x[rows], y[rows], support[core.within(outer)] != BEYOND, core)
    places = _rows_of(x, y, z, rows[has])
    work, circle = _needed_ground(distance, core, outer, params)
    echoes = _rows_of(x, y, z, np.flatnonzero(used & work.box.contains(x, y)))
    if knots is not None:
        echoes = _with_knots(echoes, knots, Window.covering(work.box, params.thin))
    floor, dtm, continued = _surface(echoes, places, core, work, circle, params)
    dtm[support[work.within(outer)] == BEYOND] = np.nan
    above = places[2] - floor
    if params.height == "nearest":
        above = nearest_height(_rows_of(x, y, z, np.flatnonzero(used)), places, outer, params.max_gap)
        above[used[rows[has]]] = 0.0
    elif params.height == "raster":
        above = places[2] - bilinear(dtm, work, *places[:2])
    height = np.full(len(rows), np.nan, np.float32)
    height[has] = above
    top = highest(cells[~noise[near]], z[near & ~noise], outer)
    return Terrain(
        dtm=dtm[core.within(work)].astype(np.float32),
        dsm=without_pepper(top, params.dsm_gap / params.cell)[core.within(outer)].astype(np.float32),
        support=support[core.within(outer)],
        distance=np.where(support == BEYOND, np.nan, distance)[core.within(outer)].astype(np.float32),
        continued=continued[core.within(work)],
        roughness=roughness(*_rows_of(x, y, z, np.flatnonzero(used)), core),
        height=height,
    )


def _with_knots(echoes: Points, knots: Points, window: Window) -> Points:
    """Echoes and knots in `window`, without the echoes in cells of a knot: thinning takes the mean of a cell."""
    cells, near = cells_of(*knots[:2], window)
    has_knot = np.zeros(math.prod(window.shape), bool)
    has_knot[cells] = True
    own, _ = cells_of(*echoes[:2], window)
    rest = ~has_knot[own]
    rows = np.flatnonzero(near)
    x, y, z = (np.concatenate([e[rest], k[rows]]) for e, k in zip(echoes, knots, strict=True))
    return x, y, z


def _grow(window: Window, by: int) -> Window:
    return Window(window.cell, window.col - by, window.row - by, window.ncols + 2 * by, window.nrows + 2 * by)


def _rows_of(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], rows: NDArray[np.int64]) -> Points:
    return x[rows], y[rows], z[rows]


def _distances(cells: NDArray[np.int64], window: Window) -> NDArray[np.float64]:
    """Distance [m] from the middle of every cell to that of the nearest of `cells`, infinite where there are none."""
    if len(cells) == 0:
        return np.full(window.shape, np.inf)
    empty = np.ones(window.shape, bool)
    empty.reshape(-1)[cells] = False
    return np.asarray(scipy.ndimage.distance_transform_edt(empty, sampling=window.cell), np.float64)


def _support(distance: NDArray[np.float64], max_gap: float) -> NDArray[np.uint8]:
    out = np.where(distance <= max_gap, INTERPOLATED, BEYOND).astype(np.uint8)
    out[distance == 0] = MEASURED
    return out


def _in_cells(
    x: NDArray[np.float64], y: NDArray[np.float64], wanted: NDArray[np.bool_], window: Window
) -> NDArray[np.bool_]:
    """Points whose own cell of `window` is wanted."""
    cells, there = cells_of(x, y, window)
    there[there] = wanted.reshape(-1)[cells]
    return there


def _needed_ground(
    distance: NDArray[np.float64], core: Window, outer: Window, params: TerrainParams
) -> tuple[Window, float]:
    """The cells whose ground points decide the triangles of `core`, and the largest circle that counts [m].

    Where no place around is further from ground than `far`, no empty circle is larger, so every triangle over the
    core has its corners within twice that of it, and there is one everywhere. Most halos shrink by this to some metres;
    the triangles stay the same. Otherwise the whole halo is needed.
    """
    largest = params.largest_circle
    around = _grow(core, math.ceil(largest / core.cell) + 2)
    if around.common(outer) != around:
        return outer, largest
    # places lie anywhere in their cells, and a thinned point anywhere in the cell that it is the mean of
    far = float(distance[around.within(outer)].max()) + math.sqrt(2.0) * (core.cell + params.thin)
    if far >= largest:
        return outer, largest
    work = _grow(core, math.ceil((2.0 * far + params.thin) / core.cell) + 2)
    return work.common(outer) or outer, far


def _surface(
    ground: Points, places: Points, core: Window, window: Window, circle: float, params: TerrainParams
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Terrain [m] at the points `places`, which lie in `core`, and at the middle of every cell of `window`; the cells
    that only the membrane reaches.

    Off the triangles the raster has the mean of a cell's ground points, and where there are none a membrane. Points
    there take the value of the raster: of what is known of it, where their own cell is.
    """
    points = thin_points(*ground, window, params.thin)
    means = _means(*points, window)
    surface = tin_of(*points)
    del points  # beside the triangles of a large block each array counts
    facets = facets_of(surface, circle)
    known = facet_raster(facets, window)
    known = np.where(np.isnan(known), means, known)
    raster = _continue_gaps(known, window, params.max_gap)
    floor = facet_heights(facets, core, *places[:2])
    for heights in (known, raster):
        off = np.isnan(floor)
        floor[off] = bilinear(heights, window, places[0][off], places[1][off])
    return floor, raster, np.isnan(known)


def _continue_gaps(known: NDArray[np.float64], window: Window, gap: float) -> NDArray[np.float64]:
    """`known` with its gaps filled by a membrane, which ends at the height of the nearest known cell `gap` [m] away.

    Without such an end the membrane beyond the survey's border would hang on where the array ends. The array begins
    at a corner of a coarse global grid, so that the membrane's pyramid has the same cells in every block: what its
    fixed number of sweeps leaves undone is the same too.
    """
    if not np.isnan(known).all():
        empty = np.isnan(known)
        distance, (row, col) = scipy.ndimage.distance_transform_edt(empty, sampling=window.cell, return_indices=True)
        known = np.where(distance > gap, known[row, col], known)
    south, west = window.row % PYRAMID, window.col % PYRAMID
    around = np.pad(known, ((south, 0), (west, 0)), constant_values=np.nan)
    return fill_gaps(around)[south:, west:]


def _means(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], window: Window
) -> NDArray[np.float64]:
    """Mean height by cell, NaN where there is none; the points come in one order whatever the input's was."""
    cells, inside = cells_of(x, y, window)
    size = math.prod(window.shape)
    number = np.bincount(cells, minlength=size)
    total = np.bincount(cells, weights=z[inside], minlength=size)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan).reshape(window.shape)
