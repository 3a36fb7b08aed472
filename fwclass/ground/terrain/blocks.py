"""Terrain of a cloud held whole in memory, worked on in the same blocks of the fixed global grid as a survey."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import Box, Tile, TileGrid, Window, millimetres, whole_millimetres
from fwclass.ground.raster.lattice import window_over
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import BEYOND, Terrain, terrain
from fwclass.units import QUANTUM


def terrain_by_blocks(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    ground: NDArray[np.bool_],
    noise: NDArray[np.bool_],
    params: TerrainParams,
) -> tuple[Terrain, Window]:
    """`terrain` of a whole cloud, block by block: what a survey in tiles would get.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m] of at least one point, in any order.
    ground, noise : (n,) as in `terrain`.

    Returns
    -------
    Rasters over the smallest window that holds all points, with the heights of all points in their order; the window.

    `InputError`: the points are none, or spread so far that the raster would be absurdly large.
    """
    if len(x) == 0:
        raise InputError("no points to make a terrain of", expected="at least one point", got="none")
    window = window_over(x, y, params.cell, "terrain.cell")
    whole = Terrain(
        np.full(window.shape, np.nan, np.float32),
        np.full(window.shape, np.nan, np.float32),
        np.full(window.shape, BEYOND, np.uint8),
        np.full(window.shape, np.nan, np.float32),
        np.zeros(window.shape, bool),
        np.full(window.shape, np.nan, np.float32),
        np.full(len(x), np.nan, np.float32),
    )
    mx, my = millimetres(x), millimetres(y)
    for block, rows in _with_halos(mx, my, window, params):
        core = Window.covering(block.box, params.cell)
        inside = _in_box(mx[rows], my[rows], block.box)
        part = terrain(x[rows], y[rows], z[rows], ground[rows], noise[rows], inside, core, params)
        _put(part, core, whole, window)
        whole.height[rows[inside]] = part.height
    return whole, window


def _in_box(mx: NDArray[np.int64], my: NDArray[np.int64], box: Box) -> NDArray[np.bool_]:
    """As `Box.contains`, of whole millimetres."""
    low_x, low_y, high_x, high_y = (round(v / QUANTUM) for v in box.bounds)
    return np.asarray((mx >= low_x) & (mx < high_x) & (my >= low_y) & (my < high_y))


def _with_halos(
    mx: NDArray[np.int64], my: NDArray[np.int64], window: Window, params: TerrainParams
) -> Iterator[tuple[Tile, NDArray[np.int64]]]:
    """Every block of the window that has points in it or in its halo, and the rows of these points."""
    grid, edge = TileGrid(params.block), whole_millimetres(params.block, "terrain.block")
    ix, iy = mx // edge, my // edge
    order = np.lexsort((iy, ix))
    first = np.flatnonzero(np.r_[True, (np.diff(ix[order]) != 0) | (np.diff(iy[order]) != 0)])
    owned = {(int(ix[r[0]]), int(iy[r[0]])): r for r in np.split(order, first[1:])}
    for block in grid.touching(window.box):
        box = block.box.grown(params.block_halo)
        near = [owned[t.ix, t.iy] for t in grid.touching(box) if (t.ix, t.iy) in owned]
        rows = np.concatenate([r[_in_box(mx[r], my[r], box)] for r in near]) if near else order[:0]
        if len(rows):
            yield block, rows


def _put(part: Terrain, core: Window, whole: Terrain, window: Window) -> None:
    """The cells of a block that the window has."""
    common = window.common(core)
    if common is not None:
        here, there = common.within(window), common.within(core)
        for name in ("dtm", "dsm", "support", "distance", "continued", "roughness"):
            getattr(whole, name)[here] = getattr(part, name)[there]
