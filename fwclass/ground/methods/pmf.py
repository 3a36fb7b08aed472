"""The progressive morphological filter (PMF) on a raster of lowest heights. Zhang et al. 2003."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.methods.params import PmfParams
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import lowest, window_over
from fwclass.ground.raster.opening import disk_opening
from fwclass.ground.raster.surface import domain


def pmf(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: PmfParams) -> NDArray[np.bool_]:
    """Ground among points: those that no opening leaves further below them than its height difference.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized.

    Source: Zhang et al. 2003, with disks; windows and height differences as in PDAL's filters.pmf, but for the last
    window, which is `max_window_size` and not the next power of two. Empty cells are filled by a membrane. A point
    is compared with the bilinear surface at its place, not with its cell's value, so that a slope inside a cell is
    no height difference.
    """
    window = window_over(x, y, params.cell_size, "pmf.cell_size", margin=2)
    low = lowest(x, y, z, window)
    steps = windows(params)
    inside = domain(np.isfinite(low), steps[-1][0])
    surface = np.where(inside, fill_gaps(low), np.nan)
    allowed = np.full(window.shape, np.inf)
    for radius, difference in steps:
        surface = disk_opening(surface, radius)
        allowed = np.fmin(allowed, surface + difference)
    return z <= bilinear(np.where(inside, allowed, np.nan), window, x, y)


def windows(params: PmfParams) -> list[tuple[int, float]]:
    """Radius [cells] and greatest height difference [m] of every opening, Zhang et al. 2003, eq. 4, 5 and 7.

    A window is 2 × radius + 1 cells wide. The first difference is `initial_distance`, the others grow with the step
    between two windows: slope × (w_k − w_(k−1)) × cell + initial_distance, at most `max_distance`.
    """
    largest = max(1, math.ceil(((params.max_window_size or 0.0) - 1.0) / 2.0))
    radii = [1]
    while radii[-1] < largest:
        grown = 2 * radii[-1] if params.exponential else radii[-1] + 2
        radii.append(min(grown, largest))
    steps = [0.0] + [2.0 * (b - a) * params.cell_size for a, b in zip(radii, radii[1:], strict=False)]
    return [
        (r, min(params.slope * step + params.initial_distance, params.max_distance))
        for r, step in zip(radii, steps, strict=True)
    ]
