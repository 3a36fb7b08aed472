"""Heights of roofs where their echoes are weak: planes through the strong echoes beside them, carried on.

An echo is planar where its neighbours in space lie in one plane that is no wall; a cell takes the plane of the planar
echoes nearest to it, if nearly all of them lie in one, and if that plane is known well enough so far away.
"""

from __future__ import annotations

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.decompose.params import StackParams
from fwclass.decompose.stack_candidates import Surface
from fwclass.grid import Window

Floats = NDArray[np.float64]

AROUND = 8
"""Echoes in space around one that tell whether it is planar."""
NEAREST, LEAST = 32, 12
"""Planar echoes in plan that a cell takes its plane from, at most and at least."""
WIDE = 2.0
"""None of them is further than so many times `StackParams.plane_reach`."""
LEVEL = 0.5
"""Cosine of the steepest roof, 60 degrees; what is steeper is a wall."""
BROAD = 0.05
"""Least ratio of the two variances along a plane: echoes of one scan line alone show none."""
AGREE = 0.8
"""Share of the nearest planar echoes that must lie in the plane."""
ROUNDS = 4
"""Fits, after each of which the echoes far from the plane count less."""
SURE = 3.0
"""The plane's height is known so many times better than the window that is searched around it."""


def planar(places: Floats, params: StackParams) -> NDArray[np.bool_]:
    """Which of the echoes (n, 3) [m] lie in one plane with their neighbours, none of them further than
    `params.plane_reach`."""
    if len(places) <= AROUND:
        return np.zeros(len(places), bool)
    local = places - places.min(axis=0)
    far, near = scipy.spatial.cKDTree(local).query(local, k=AROUND + 1)
    some = local[np.asarray(near)]
    some = some - some.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(some.transpose(0, 2, 1) @ some / (AROUND - 2))
    flat = values[:, 0] <= params.plane_residual**2
    broad = values[:, 1] >= BROAD * values[:, 2]
    return np.asarray(
        flat & broad & (np.abs(vectors[:, 2, 0]) >= LEVEL) & (np.asarray(far)[:, -1] <= params.plane_reach)
    )


def plane_surface(echoes: Floats, window: Window, params: StackParams) -> Surface:
    """Heights of planes through planar `echoes` (n, 3) [m], no further than `params.plane_reach` from the nearest."""
    heights = np.full(window.shape, np.nan, np.float32)
    if len(echoes) < LEAST:
        return Surface(heights, window)
    corner = echoes.min(axis=0)
    local = echoes - corner
    row, col = (v.ravel() for v in np.indices(window.shape))
    middle = np.stack([window.col + col + 0.5, window.row + row + 0.5], axis=1) * window.cell - corner[:2]
    tree, k = scipy.spatial.cKDTree(local[:, :2]), min(NEAREST, len(echoes))
    far, near = (np.asarray(v) for v in tree.query(middle, k=k, distance_upper_bound=WIDE * params.plane_reach))
    reached = np.flatnonzero((far[:, 0] <= params.plane_reach) & np.isfinite(far[:, LEAST - 1]))
    if len(reached):
        counts = np.isfinite(far[reached])
        around = local[np.where(counts, near[reached], 0)]
        heights[row[reached], col[reached]] = _heights(middle[reached], around, counts, params)
    return Surface(heights + np.float32(corner[2]), window)


def _heights(middle: Floats, near: Floats, counts: NDArray[np.bool_], params: StackParams) -> Floats:
    """Height over every middle (n, 2) of the plane through the echoes `near` it (n, k, 3) that count (n, k); NaN
    without a sure one."""
    x = np.concatenate([np.ones((*counts.shape, 1)), near[:, :, :2] - middle[:, None]], axis=2)
    weight = counts.astype(np.float64)
    for _ in range(ROUNDS):
        weighted = weight[:, :, None] * x
        normal = x.transpose(0, 2, 1) @ weighted + 1e-9 * np.eye(3)
        plane = np.linalg.solve(normal, weighted.transpose(0, 2, 1) @ near[:, :, 2:])
        off = np.abs(near[:, :, 2] - (x @ plane)[:, :, 0])
        weight = counts / (1.0 + (off / params.plane_residual) ** 2) ** 2  # Cauchy's, squared: outliers lose all
    error = params.plane_residual * np.sqrt(np.linalg.inv(normal)[:, 0, 0])
    agree = (counts & (off <= 2.0 * params.plane_residual)).sum(axis=1) / counts.sum(axis=1)
    sure = (agree >= AGREE) & (SURE * error <= params.window)
    return np.where(sure, plane[:, 0, 0], np.nan)
