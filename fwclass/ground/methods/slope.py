"""The slope based filter, exactly: no point near by lies lower than terrain can fall. Vosselman 2000."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.methods.params import SlopeParams
from fwclass.ground.methods.undercut import not_undercut
from fwclass.neighbours import CellIndex

LEAF = 1.0
"""Least edge of a cell [m] of the search; it changes the time, never a flag."""

EMPTY = np.int64(1) << 60
"""Height of a cell without points."""


def slope(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: SlopeParams
) -> NDArray[np.bool_]:
    """Ground among points: those that no other within `radius` [m] undercuts.

    A point at distance d undercuts another if it lies more than slope × d + tolerance lower. All points are looked
    at, not the lowest of a raster: the answer is that of the definition, in whole millimetres.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized.

    Source: Vosselman 2000, eq. 1 with the linear Δh_max and a constant for measurement errors.
    """
    radius = round((params.radius or 0.0) * 1000)
    index = CellIndex.build(x, y, z, _leaf(x, y))
    values, firsts, rows, cols = _pyramid(index, radius)
    ground = np.empty(len(x), bool)
    kept = np.empty(len(x), bool)
    not_undercut(
        index.x,
        index.y,
        index.z,
        index.start,
        values,
        firsts,
        rows,
        cols,
        index.cell,
        radius,
        params.slope,
        params.tolerance * 1000.0,
        kept,
    )
    ground[index.order] = kept
    return ground


def _leaf(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Edge [m] of cells that hold a few points each where points are few."""
    wide, high = float(np.ptp(x)), float(np.ptp(y))
    spacing = max(math.sqrt(wide * high / len(x)), (wide + high) / len(x))
    return float(max(LEAF, math.ceil(spacing)))


def _pyramid(
    index: CellIndex, radius: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Lowest z by cell, by 2 × 2 cells and so on up to cells of about `radius`: values, and each level's place."""
    level = np.full((index.nrows, index.ncols), EMPTY)
    filled = np.flatnonzero(np.diff(index.start))
    level.reshape(-1)[filled] = np.minimum.reduceat(index.z, index.start[filled])
    levels = [level]
    while index.cell << (len(levels) - 1) < radius and max(level.shape) > 1:
        level = np.pad(level, [(0, n % 2) for n in level.shape], constant_values=EMPTY)
        level = level.reshape(level.shape[0] // 2, 2, level.shape[1] // 2, 2).min((1, 3))
        levels.append(level)
    firsts = np.cumsum([0] + [v.size for v in levels[:-1]])
    shapes = np.array([v.shape for v in levels], np.int64)
    return np.concatenate([v.reshape(-1) for v in levels]), firsts, shapes[:, 0].copy(), shapes[:, 1].copy()
