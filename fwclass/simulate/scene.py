"""What stands in the scene: a terrain raster, convex solids, crowns, and a grid to find them by.

Coordinates are metres relative to the scene's south-west corner and to its base height.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.kernel import kernel

GROUND, LOW, MEDIUM, HIGH, BUILDING, ARTIFICIAL = 2, 3, 4, 5, 6, 64
"""Class codes of the reference."""

GRASS, ASPHALT, SOIL, WATER = 0, 1, 2, 3
"""Ground covers."""

ELLIPSOID, CONE, BOX = 0, 1, 2
"""Shapes of crowns."""


LONGEST_SHADOW = 24.0
"""Furthest that a beam can travel sideways beneath the top of the highest thing [m]."""


class Scene(NamedTuple):
    """Everything a beam can meet, as arrays.

    Attributes
    ----------
    size, margin : edge of the survey area and width of the terrain around it [m].
    step : spacing of the terrain's nodes [m].
    height : float32 (n, n), terrain at the nodes [m], row 0 in the south.
    cover : uint8 (m, m), ground cover of cells of one metre.
    albedo : float32 (m, m), diffuse reflectance of those cells.
    herbs : float32 (m, m), mean height of the herb layer of those cells [m].
    roughness : float64 (4,), standard deviation of the surface within a footprint, per cover [m].
    plane_start : int64 (solids + 1,), rows of `planes` of every solid.
    planes : float64 (p, 4), half-spaces n·x ≤ d as (nx, ny, nz, d), n outward and of unit length.
    solid_class, solid_albedo, solid_open : class code, reflectance and share of rays that pass, per solid.
    crown : float64 (crowns, 10): shape, x, y, bottom, top, half-length, half-width, cos, sin, leaf area density.
    crown_albedo : float64 (crowns,).
    box : float64 (solids + crowns, 6): xmin, ymin, zmin, xmax, ymax, zmax.
    cell : edge of a cell of the index [m].
    start, item : int64, the things (solids, then crowns) whose box touches each cell.
    ceiling : float64 per cell, top of the highest thing within `LONGEST_SHADOW`, -inf where there is none.
    clump : float64 (256,), relative leaf densities of the voxels of a crown, of mean one.
    gap : float64 (6,): centre x, y, cos, sin, half-length, half-width of the place cut out of the survey.
    key : uint64 of the scene's own random stream.
    """

    size: float
    margin: float
    step: float
    height: NDArray[np.float32]
    cover: NDArray[np.uint8]
    albedo: NDArray[np.float32]
    herbs: NDArray[np.float32]
    roughness: NDArray[np.float64]
    plane_start: NDArray[np.int64]
    planes: NDArray[np.float64]
    solid_class: NDArray[np.uint8]
    solid_albedo: NDArray[np.float64]
    solid_open: NDArray[np.float64]
    crown: NDArray[np.float64]
    crown_albedo: NDArray[np.float64]
    box: NDArray[np.float64]
    cell: float
    start: NDArray[np.int64]
    item: NDArray[np.int64]
    ceiling: NDArray[np.float64]
    clump: NDArray[np.float64]
    gap: NDArray[np.float64]
    key: np.uint64


@kernel
def terrain(height, margin, step, x, y):  # type: ignore[no-untyped-def]
    """Height of the terrain at (x, y), bilinear between nodes and constant beyond them [m]."""
    fx = min(max((x + margin) / step, 0.0), height.shape[1] - 1.001)
    fy = min(max((y + margin) / step, 0.0), height.shape[0] - 1.001)
    j, i = int(fx), int(fy)
    fx -= j
    fy -= i
    south = height[i, j] + (height[i, j + 1] - height[i, j]) * fx
    north = height[i + 1, j] + (height[i + 1, j + 1] - height[i + 1, j]) * fx
    return south + (north - south) * fy


@kernel
def in_gap(gap, x, y):  # type: ignore[no-untyped-def]
    """Whether (x, y) lies in the rotated rectangle that was cut out of the survey."""
    dx, dy = x - gap[0], y - gap[1]
    return abs(dx * gap[2] + dy * gap[3]) < gap[4] and abs(dy * gap[2] - dx * gap[3]) < gap[5]


@kernel
def _fill(box, cell, side, start, item, ceiling):  # type: ignore[no-untyped-def]
    """Counting sort of the boxes into cells; with an empty `item` only `start` is counted."""
    for t in range(len(box)):
        j0 = min(max(int(box[t, 0] / cell), 0), side - 1)
        i0 = min(max(int(box[t, 1] / cell), 0), side - 1)
        j1 = min(max(int(box[t, 3] / cell), 0), side - 1)
        i1 = min(max(int(box[t, 4] / cell), 0), side - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                c = i * side + j
                if len(item):
                    item[start[c]] = t
                start[c] += 1
                ceiling[c] = max(ceiling[c], box[t, 5])


def index(
    box: NDArray[np.float64], size: float, cell: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """`start` (cells + 1,), `item` and `ceiling` (cells,) [m] of a `Scene` whose things have these boxes (things, 6)
    [m]; by cell, then thing."""
    side = int(np.ceil(size / cell))
    ceiling = np.full(side * side, -np.inf)
    count = np.zeros(side * side, np.int64)
    _fill(box, cell, side, count, np.empty(0, np.int64), ceiling)
    start = np.concatenate([np.zeros(1, np.int64), np.cumsum(count)])
    item = np.empty(start[-1], np.int64)
    if len(item):
        _fill(box, cell, side, start[:-1].copy(), item, ceiling)
    reach = 2 * math.ceil(LONGEST_SHADOW / cell) + 1
    ceiling = scipy.ndimage.maximum_filter(ceiling.reshape(side, side), reach, mode="constant", cval=-np.inf).ravel()
    return start, item, np.ascontiguousarray(ceiling)
