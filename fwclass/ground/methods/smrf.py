"""The simple morphological filter (SMRF) on a raster of lowest heights. Pingel, Clarke & McBride 2013."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.ground.methods.params import SmrfParams
from fwclass.ground.methods.refine import restore_edges, without_company
from fwclass.ground.raster.bilinear import near_terrain
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import LowestPoints, lowest_points, window_over
from fwclass.ground.raster.opening import disk_opening
from fwclass.ground.raster.surface import domain, gradient, low_limit
from fwclass.units import QUANTUM


def smrf(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: SmrfParams
) -> NDArray[np.bool_]:
    """Ground among points: those within threshold + scalar × slope of the terrain that the openings leave.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized.

    Source: Pingel et al. 2013, with disks, without net cutting; holes are filled by a membrane (their springs).
    Beyond the paper, each with its switch: echoes far below their surroundings go before the openings, so that the
    next-lowest echo of the cell counts; the openings see nothing beyond the surveyed area; edges of cliffs and
    banks are restored.
    """
    window = window_over(x, y, params.cell, "smrf.cell", margin=2 if params.survey_edge else 0)
    corner = (window.row, window.col)
    points, low, surface = _without_low_outliers(x, y, z, window, params)
    ground = _with_edges(points, _first_ground(points.z, surface, low, params), params)
    heights = surface if np.array_equal(ground, np.isfinite(points.z)) else _filled(points.z, ground, corner)
    near = np.empty(len(x), bool)
    slope = gradient(heights, params.cell)
    near_terrain(x, y, z, heights, slope, *corner, params.cell, params.threshold, params.scalar, near)
    return near


def _filled(heights: NDArray[np.float64], known: NDArray[np.bool_], corner: tuple[int, int]) -> NDArray[np.float64]:
    """Surface of the `known` cells alone."""
    return fill_gaps(np.where(known, heights, np.nan), corner)


def _without_low_outliers(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], window: Window, params: SmrfParams
) -> tuple[LowestPoints, NDArray[np.bool_], NDArray[np.float64]]:
    """The lowest echoes that are not far below their surroundings, the cells whose lowest echo still is, and the
    surface of all cells, filled.

    Pingel leaves such a cell out of the terrain, but the openings see it (`low_first` off).
    """
    points, corner = lowest_points(x, y, z, window), (window.row, window.col)
    surface = fill_gaps(points.z, corner)
    limit = low_limit(surface, params.cell, params.low_slope)
    low = points.z < limit
    if not params.low_first:
        return points, low, surface
    radius = int(params.low_radius / params.cell)
    low = without_company(points.z, low, radius, params.low_level, params.low_companions)
    if low.any():
        points = lowest_points(x, y, z, window, np.where(low, limit, -np.inf))
        surface = fill_gaps(points.z, corner)
    return points, np.zeros(window.shape, bool), surface


def _first_ground(
    lowest: NDArray[np.float64], surface: NDArray[np.float64], low: NDArray[np.bool_], params: SmrfParams
) -> NDArray[np.bool_]:
    """Measured cells that are neither low outliers nor objects; `surface` is `lowest`, filled."""
    measured = np.isfinite(lowest)
    reach = params.window or 0.0
    if params.survey_edge:
        surface = np.where(domain(measured, reach / params.cell), surface, np.nan)
    return measured & ~low & ~objects(surface, params.cell, params.slope, reach)


def _with_edges(points: LowestPoints, ground: NDArray[np.bool_], params: SmrfParams) -> NDArray[np.bool_]:
    """`ground` with the edges of cliffs and banks, round by round inwards."""
    if not params.restore_rounds:
        return ground
    radius, tolerance, share = params.restore_radius, params.restore_tolerance, params.restore_share
    return restore_edges(points, ground, params.cell, radius, tolerance, share, params.restore_rounds)


def objects(surface: NDArray[np.float64], cell: float, slope: float, window: float) -> NDArray[np.bool_]:
    """Cells that stand out of `surface` (NaN beyond the surveyed area): buildings, trees, vehicles.

    The surface is opened with disks of 1, 2, … ⌈window / cell⌉ cells; a cell that one opening lowers by
    more than slope × radius is an object. `cell` and `window` [m], `slope` rise over run.
    """
    standing = np.zeros(surface.shape, bool)
    # whole millimetres up to 16 km are exact in float32, which halves the work
    last = np.rint(surface / QUANTUM).astype(np.float32)
    everything = math.ceil(math.hypot(*surface.shape))  # a larger disk sees no more
    for radius in range(1, min(math.ceil(window / cell), everything) + 1):
        this = disk_opening(last, radius)
        standing |= last - this > np.float32(slope * cell * radius / QUANTUM)
        last = this
    return standing
