"""Points from which a TIN of the ground is grown."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fwclass.grid import Window
from fwclass.ground.methods.smrf import domain, low_limit
from fwclass.ground.raster.fill import filled
from fwclass.ground.raster.lattice import cells_of, lowest, window_over
from fwclass.ground.raster.opening import opened
from fwclass.kernel import kernel

_MARGIN = 2
_BESIDE = 1000.0
_NEAREST = 3


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
    surface = filled(lowest(*cloud, window) / 1000.0)
    flat, _ = cells_of(cloud.x, cloud.y, window)
    return cloud.z >= 1000.0 * low_limit(surface, cell, slope).reshape(-1)[flat]


def grid_seeds(cloud: Cloud, usable: NDArray[np.bool_], res: float, setting: str) -> NDArray[np.int64]:
    """The lowest usable point of every cell of the global grid of `res` [m] (Axelsson 2000)."""
    window = window_over(cloud.x, cloud.y, res, setting)
    flat, _ = cells_of(cloud.x, cloud.y, window)
    return _lowest_of_cells(flat, usable, *cloud, math.prod(window.shape))


def opened_seeds(
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
    off = height - opened(_surveyed(height, window, res), math.ceil(res / 2.0 / cell))
    return np.sort(rows[off.reshape(-1)[flat[rows]] <= tolerance])


def _surveyed(height: NDArray[np.float64], window: Window, res: float) -> NDArray[np.float64]:
    """The surface with its gaps filled, NaN beyond the surveyed area."""
    return np.where(domain(np.isfinite(height), res / 2.0 / window.cell), filled(height), np.nan)


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
    found = cKDTree(np.c_[x[seeds], y[seeds]]).query(np.c_[bx, by], np.arange(1, count + 1))
    weight, near = 1.0 / np.asarray(found[0]), np.asarray(found[1])
    return bx, by, (z[seeds][near] * weight).sum(axis=1) / weight.sum(axis=1)


@kernel
def _lowest_of_cells(flat, usable, x, y, z, cells):  # type: ignore[no-untyped-def]
    """The lowest usable point of every cell that has one, rising; of equals the one further west, then south."""
    found = np.full(cells, -1, np.int64)
    for i in range(len(flat)):
        if not usable[i]:
            continue
        j = found[flat[i]]
        if j >= 0 and z[i] == z[j]:
            lower = x[i] < x[j] or (x[i] == x[j] and y[i] < y[j])
        else:
            lower = j < 0 or z[i] < z[j]
        if lower:
            found[flat[i]] = i
    return np.sort(found[found >= 0])
