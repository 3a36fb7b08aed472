"""Points that lie far from all others: seldom part of a survey, and what makes rasters absurdly large."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import TileGrid
from fwclass.pieces import linked_groups
from fwclass.read.cloud import PointCloud

APART = 256.0
"""Edge of the squares [m] that are looked at: stray points have at least one empty square around theirs."""

FEW, SHARE, OF_LARGEST = 3, 0.001, 0.1
"""A group is stray with so few points, or such a share of all, and at most such a share of the largest group."""


def stray_points(cloud: PointCloud, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rows of the shown points in small groups that are at least `APART` from all others."""
    rows = np.flatnonzero(shown)
    ix, iy = TileGrid(APART).indices(cloud.x[rows], cloud.y[rows])
    keys, square = np.unique(ix * (1 << 32) + iy, return_inverse=True)
    if len(keys) < 2:
        return rows[:0]
    from scipy.spatial import cKDTree  # it takes a while to load

    row = keys + (1 << 31) >> 32
    pairs = cKDTree(np.column_stack([row, keys - (row << 32)])).query_pairs(1.5, p=np.inf, output_type="ndarray")
    own = linked_groups(len(keys), pairs[:, 0], pairs[:, 1])[square.reshape(-1)]
    counts = np.bincount(own)
    few = (counts <= max(FEW, SHARE * len(rows))) & (counts <= OF_LARGEST * counts.max())
    return rows[few[own]]


def describe_stray(cloud: PointCloud, rows: NDArray[np.int64]) -> str:
    """How many points they are and where, in the file's own unit; ``""`` for none."""
    if not len(rows):
        return ""
    unit = cloud.units.xy
    x, y = cloud.x[rows] / unit, cloud.y[rows] / unit
    many = "1 point lies" if len(rows) == 1 else f"{len(rows):,} points lie"
    return f"{many} far from all others, at {_range('x', x)}, {_range('y', y)}"


def _range(name: str, values: NDArray[np.float64]) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{name} {low:.2f}" if low == high else f"{name} {low:.2f} to {high:.2f}"
