"""Ground in two steps: a terrain surface by blocks of a fixed global grid, then heights and flags by tile."""

from __future__ import annotations

import math
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy import ndimage

from fwclass.grid import Window
from fwclass.ground import smrf
from fwclass.ground.dtm import bilinear, cells_of, lowest
from fwclass.ground.fill import filled
from fwclass.schema import Table, require
from fwclass.stage import Chunk, Params, Stage

MEASURED, INTERPOLATED, BEYOND = 0, 1, 2
"""Values of the raster `support`."""


class GroundParams(Params):
    """Parameters of the ground filter; SMRF's carry PDAL's names.

    Attributes
    ----------
    cell : edge of a raster cell [m].
    slope : steepest terrain, rise over run.
    window : radius of the largest opening [m].
    scalar, threshold : an echo within threshold + scalar × slope [m] of the terrain is ground.
    low_slope : an echo further below the closed surface than low_slope × cell is a low outlier.
    block, block_halo : edge of a block and what is read around it [m].
    max_gap : distance from a measured ground cell up to which the terrain is interpolated [m].
    """

    cell: float = Field(gt=0)
    slope: float = Field(ge=0)
    window: float = Field(gt=0)
    scalar: float = Field(ge=0)
    threshold: float = Field(ge=0)
    low_slope: float = Field(gt=0)
    block: float = Field(gt=0)
    block_halo: float = Field(ge=0)
    max_gap: float = Field(ge=0)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for name in ("block", "block_halo"):
            cells = getattr(self, name) / self.cell
            if not math.isclose(cells, round(cells), abs_tol=1e-9):
                raise ValueError(f"{name} must be a whole number of cells of {self.cell} m")
        if 2.0 * self.window > self.block_halo:
            raise ValueError("block_halo must be at least 2 x window, the reach of the largest opening")
        if self.max_gap > self.block_halo:
            raise ValueError("max_gap must not exceed block_halo: support is decided inside a block and its halo")
        return self


def surface(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    core: Window,
    params: GroundParams,
) -> dict[str, NDArray]:
    """Terrain of one block from all echoes of the block and its halo.

    Parameters
    ----------
    x, y, z : echoes [m], in any order; those outside block + halo are left out.
    core : the block's cells; its cell is `params.cell`.

    Returns
    -------
    ``dtm`` float32 height [m], ``slope`` float32 rise over run, both NaN beyond support; ``support`` uint8:
    0 a cell with a ground echo, 1 interpolated, 2 further than `max_gap` from any cell with a ground echo.
    Arrays of `core.shape`.

    Source: Pingel et al. 2013, with disks, without net cutting; holes are filled by a membrane (their
    springs). Echoes far below their surroundings are removed first, so that the next-lowest echo of the
    cell counts.
    """
    margin = round(params.block_halo / params.cell)
    outer = Window(params.cell, core.col - margin, core.row - margin, core.ncols + 2 * margin, core.nrows + 2 * margin)
    low = _without_low_outliers(x, y, z, outer, params)
    heights, ground = smrf.terrain(low, params.cell, params.slope, params.window)
    rows, cols = core.within(outer)
    support = _support(ground, params)[rows, cols]
    slope = smrf.gradient(heights, params.cell)[rows, cols]
    beyond = support == BEYOND
    return {
        "dtm": np.where(beyond, np.nan, heights[rows, cols]).astype(np.float32),
        "slope": np.where(beyond, np.nan, slope).astype(np.float32),
        "support": support,
    }


def _without_low_outliers(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    window: Window,
    params: GroundParams,
) -> NDArray[np.float64]:
    """Lowest z by cell of the echoes that are not far below their surroundings."""
    low = lowest(x, y, z, window)
    limit = smrf.low_limit(filled(low), params.cell, params.low_slope)
    flat, inside = cells_of(x, y, window)
    keep = inside.copy()
    keep[inside] = z[inside] >= limit.reshape(-1)[flat]
    return lowest(x[keep], y[keep], z[keep], window) if keep.sum() < inside.sum() else low


def _support(ground: NDArray[np.bool_], params: GroundParams) -> NDArray[np.uint8]:
    if not ground.any():
        return np.full(ground.shape, BEYOND, np.uint8)
    distance = ndimage.distance_transform_edt(~ground, sampling=params.cell)
    out = np.where(distance <= params.max_gap, INTERPOLATED, BEYOND).astype(np.uint8)
    out[ground] = MEASURED
    return out


def ground(chunk: Chunk, rasters: dict[str, NDArray], window: Window, params: GroundParams) -> Table:
    """Ground flag and height above ground of a tile's core rows.

    Parameters
    ----------
    chunk : reads ``x, y, z``; no halo is needed.
    rasters : ``dtm``, ``slope`` of `surface`, mosaicked over `window`; NaN where there is no block.
    window : the tile's box grown by two cells.

    Returns
    -------
    ``height_above_ground``: z minus the bilinear terrain. ``ground``: |height| ≤ threshold + scalar ×
    bilinear slope. An echo whose own cell is beyond support has height NaN and is not ground; where only a
    neighbour cell is, the others carry the interpolation.
    """
    require(chunk.table, GROUND.reads, chunk.tile.key)
    x, y, z = (chunk.table[name][chunk.core] for name in ("x", "y", "z"))
    height = z - bilinear(rasters["dtm"], window, x, y)
    allowed = params.threshold + params.scalar * bilinear(rasters["slope"], window, x, y)
    return Table({"ground": np.abs(height) <= allowed, "height_above_ground": height})


GROUND_SURFACE = Stage(
    name="ground_surface",
    version=1,
    kind="block",
    function=surface,
    params=GroundParams,
    reads=("x", "y", "z"),
    halo=lambda params: float(params.block_halo),
)

GROUND = Stage(
    name="ground",
    version=1,
    kind="tile",
    function=ground,
    params=GroundParams,
    reads=("x", "y", "z"),
    writes=("ground", "height_above_ground"),
)
