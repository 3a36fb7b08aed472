"""The cloth simulation filter (CSF). Zhang et al. 2016."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.methods.cloth import START, TILE, drop_cloth, nearest_heights, without_holes
from fwclass.ground.methods.params import CsfParams
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.lattice import window_over
from fwclass.ground.raster.surface import gradient
from fwclass.units import QUANTUM

MARGIN = 4
"""Particles around the points, at least: the cloth's edge should not end where the points do."""


def csf(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: CsfParams) -> NDArray[np.bool_]:
    """Ground among points: those near a cloth that fell on the cloud turned upside down.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order; worked on in whole millimetres.
    params : sized.

    `InputError` where the extent asks for an absurd number of particles.

    Source: Zhang et al. 2016 and the parameters of their program. What differs: the particles are the cell centres
    of the global raster; the inner constraints are passes of running means instead of pairs one after the other; the
    cloth starts from the lowest points nearby and every piece of it comes to rest by itself, so that an answer does
    not depend on what lies far away; the distance of a ground point may grow with the cloth's slope (`scalar`).
    """
    window = _in_whole_tiles(window_over(x, y, params.cloth_resolution, "csf.cloth_resolution", margin=MARGIN))
    cell = whole_millimetres(params.cloth_resolution, "csf.cloth_resolution")
    up = millimetres(z)
    up -= up.min()
    across, along = millimetres(x) - window.col * cell, millimetres(y) - window.row * cell
    heights = without_holes(nearest_heights(across, along, up, cell, *window.shape))
    cloth = drop_cloth(
        heights,
        max(1, round(START / params.cloth_resolution)),
        params.rigidness,
        params.iterations,
        params.time_step,
        params.slope_smooth,
    )
    apart: NDArray[np.float64] = bilinear(cloth, window, x, y) + up
    limit: NDArray[np.float64] | float = params.class_threshold
    if params.scalar:
        slope = gradient(cloth, cell)
        limit = params.class_threshold + params.scalar * bilinear(slope, window, x, y)
    return np.abs(apart) < limit / QUANTUM


def _in_whole_tiles(window: Window) -> Window:
    """The window of whole tiles of the global raster that holds `window`."""
    col, row = window.col // TILE * TILE, window.row // TILE * TILE
    ncols, nrows = window.col + window.ncols - col, window.row + window.nrows - row
    return Window(window.cell, col, row, -(-ncols // TILE) * TILE, -(-nrows // TILE) * TILE)
