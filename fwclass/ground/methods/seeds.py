"""Points from which a TIN of the ground is grown."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import cells_of, lowest, window_over
from fwclass.ground.raster.opening import disk_opening
from fwclass.ground.raster.surface import domain, low_limit
from fwclass.kernel import kernel
from fwclass.units import QUANTUM

_MARGIN = 2
"""Cells around those of the cloud."""
_BESIDE = 1000.0
"""mm outside of the cloud's box, where points that close the TIN stand."""
_NEAREST = 3
"""Seeds that such a point takes its height from."""
_SLIDES = 4
"""Steps in which squares as large as a cell slide over one along each axis."""


class Cloud(NamedTuple):
    """Points that differ in x, y, in a canonical order.

    Attributes
    ----------
    x, y : float64 (n,) coordinates [m].
    z : float64 (n,) heights [mm].
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]


def plausible(cloud: Cloud, cell: float, slope: float, setting: str) -> NDArray[np.bool_]:
    """Points (n,) that are not further below their surroundings than slope × cell [m]; the others are outliers."""
    window = window_over(cloud.x, cloud.y, cell, setting, _MARGIN)
    surface = fill_gaps(lowest(*cloud, window) / 1000.0)
    flat, _ = cells_of(cloud.x, cloud.y, window)
    return cloud.z >= 1000.0 * low_limit(surface, cell, slope).reshape(-1)[flat]


def sliding_seeds(cloud: Cloud, usable: NDArray[np.bool_], res: float, setting: str) -> NDArray[np.int64]:
    """The lowest usable point of every square of `res` [m] that slides over the cloud by a quarter of its edge.

    A grid of such squares is Axelsson's (2000); sliding takes away that its seeds, and whether a terrace gets one,
    hang on where the grid lies. A square with only one of its four columns or rows in the cloud is not looked at:
    what is lowest in so narrow a strip may be a roof. Of a square's equally low points at most one in each
    sixteenth of it is a seed.
    """
    window = window_over(cloud.x, cloud.y, max(round(res / _SLIDES, 3), QUANTUM), setting)
    flat, _ = cells_of(cloud.x, cloud.y, window)
    rows = _lowest_of_cells(flat, usable, *cloud, math.prod(window.shape))
    low = np.full(window.shape, np.inf)
    low.reshape(-1)[flat[rows]] = cloud.z[rows]
    return rows[(low == _slid(low)).reshape(-1)[flat[rows]]]


def _slid(low: NDArray[np.float64]) -> NDArray[np.float64]:
    """The highest of the lowest values in the squares that hold each cell and at least two rows and columns."""
    squares = sliding_window_view(np.pad(low, _SLIDES - 2, constant_values=np.inf), (_SLIDES, _SLIDES)).min((2, 3))
    return sliding_window_view(np.pad(squares, 1, constant_values=-np.inf), (_SLIDES, _SLIDES)).max((2, 3))


def lowest_of_cells(cloud: Cloud, cell: float, setting: str) -> NDArray[np.int64]:
    """The lowest point of every cell of the global grid of `cell` [m], rising."""
    window = window_over(cloud.x, cloud.y, cell, setting)
    flat, _ = cells_of(cloud.x, cloud.y, window)
    return _lowest_of_cells(flat, np.ones(len(flat), bool), *cloud, math.prod(window.shape))


def find_opened_seeds(
    cloud: Cloud, usable: NDArray[np.bool_], res: float, cell: float, tolerance: float, setting: str
) -> NDArray[np.int64]:
    """The lowest usable point of every cell [m] that an opening with a disk of `res` across leaves where it is.

    An opening takes away what is narrower than the disk: buildings and trees, and sharp ridges, which are found
    later. Slopes and hollows stay. A cell is a seed where it lies at most `tolerance` [m] higher than before
    (Zhao et al. 2016).
    """
    window = window_over(cloud.x, cloud.y, cell, setting, _MARGIN)
    flat, _ = cells_of(cloud.x, cloud.y, window)
    rows = _lowest_of_cells(flat, usable, *cloud, math.prod(window.shape))
    height = np.full(window.shape, np.nan)
    height.reshape(-1)[flat[rows]] = cloud.z[rows] / 1000.0
    off = height - disk_opening(_fill_surveyed(height, window, res), math.ceil(res / 2.0 / cell))
    return np.sort(rows[off.reshape(-1)[flat[rows]] <= tolerance])


def _fill_surveyed(height: NDArray[np.float64], window: Window, res: float) -> NDArray[np.float64]:
    """The surface with its gaps filled, NaN beyond the surveyed area."""
    return np.where(domain(np.isfinite(height), res / 2.0 / window.cell), fill_gaps(height), np.nan)


def stand_ins(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], seeds: NDArray[np.int64], step: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Points around the box of all points, about `step` apart, so that every point lies inside the TIN: (x, y, z).

    All lengths in mm. They stand a metre outside and are as high as the nearest seeds.
    """
    low_x, high_x, low_y, high_y = x.min() - _BESIDE, x.max() + _BESIDE, y.min() - _BESIDE, y.max() + _BESIDE
    along_x = np.rint(np.linspace(low_x, high_x, math.ceil((high_x - low_x) / step) + 1))
    along_y = np.rint(np.linspace(low_y, high_y, math.ceil((high_y - low_y) / step) + 1))[1:-1]
    bx = np.r_[along_x, along_x, np.full(len(along_y), low_x), np.full(len(along_y), high_x)]
    by = np.r_[np.full(len(along_x), low_y), np.full(len(along_x), high_y), along_y, along_y]
    count = min(_NEAREST, len(seeds))
    neighbours = scipy.spatial.cKDTree(np.c_[x[seeds], y[seeds]]).query(np.c_[bx, by], np.arange(1, count + 1))
    weight, near = 1.0 / np.asarray(neighbours[0]), np.asarray(neighbours[1])
    return bx, by, (z[seeds][near] * weight).sum(axis=1) / weight.sum(axis=1)


@kernel
def _lowest_of_cells(flat, usable, x, y, z, cells):  # type: ignore[no-untyped-def]
    """The lowest usable point of every cell that has one, rising; of equals the one further west, then south."""
    lowest = np.full(cells, -1, np.int64)
    for i in range(len(flat)):
        if not usable[i]:
            continue
        j = lowest[flat[i]]
        if j >= 0 and z[i] == z[j]:
            lower = x[i] < x[j] or (x[i] == x[j] and y[i] < y[j])
        else:
            lower = j < 0 or z[i] < z[j]
        if lower:
            lowest[flat[i]] = i
    return np.sort(lowest[lowest >= 0])
