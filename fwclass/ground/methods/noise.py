"""Points that are no surface at all: echoes far below the ground, outliers of dense data, birds and clouds.

Four rules, each with its switch. All compare whole millimetres with whole millimetres, so that neither the order
of the points nor a shift of all heights changes a flag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.methods.noise_kernels import mark_below_gaps, mark_below_surfaces, mark_beyond_sigma
from fwclass.ground.methods.params import FINEST, SIZES, NoiseParams
from fwclass.neighbours import CellIndex, sort_by_cell

LEVELS = 3
"""Sizes of cells that groups are looked for in, each twice the one before."""

SURROUNDINGS = 4
"""So many times as many points as a group has must lie around it."""

MOST_CELLS = 1 << 22
"""Cells of the search of the 3σ rule, or 64 a point where that is more; it changes the time, never a flag."""


def noise(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], last: NDArray[np.bool_], params: NoiseParams
) -> NDArray[np.bool_]:
    """Points (n,) that lie on no surface.

    **low**: the points of 3 × 3 cells in order of height are cut wherever at most `points` of them lie below a gap
    that is more than `low_gap` and steeper than `steepest` over the mean spacing, if they are too few for the bottom
    of a pit as deep as the gap and `low_shape` times as wide. So a group of echoes of a beam that went astray goes,
    a ditch, a quarry, a yard between houses or a sparse survey of a steep valley stays. Cells of three sizes up to
    `cell` are looked at, for dense and for sparse data.

    **high**: the same upside down with `high_gap` and `high_shape`.

    **sigma** (Xiong 2018): a point further below the mean of the others within `sigma_radius` than `sigma` times
    their standard deviation, none of them within `sigma_least` of its own height: without this last condition a
    ground point beside a car roof or under a shrub is an outlier. The point itself takes no part in mean and
    deviation: among n points it could never be further away than (n − 1) / √n of a deviation that it makes itself,
    less than 3 up to n = 10. With fewer than `sigma_neighbours` others there is no answer; the radius does not grow
    with the spacing, because in a wider circle kerbs, ditches and bumps are what differs most. The low rule sees to
    sparse data.
    `sigma_above` applies it to both sides, as in the paper; twigs, wires and poles then count as noise.

    **surface**, of what the other rules leave: a last echo more than `surface_gap` below a surface, a layer of 0.3 m
    that holds `surface_share` of the last echoes around, where hardly another one is as low (single echoes that came
    over two surfaces, a few in a hundred of dense data, that no gap parts from each other). What a wood or a crop lets
    through has others of its height within three times that distance, and stays.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    last : (n,) the point is the last, or only, echo of its pulse.
    """
    out = np.zeros(len(x), bool)
    if len(x) == 0 or params.reach == 0.0:
        return out
    index = CellIndex.build(x, y, z, params.cell / (1 << (LEVELS - 1)))
    stray = np.zeros(len(x), bool)
    heights = index.z.astype(np.float64)
    if params.low:
        stray |= _apart(index, heights, params, params.low_gap, params.low_shape)
    if params.high:
        stray |= _apart(index, np.negative(heights, out=heights), params, params.high_gap, params.high_shape)
    order, place = index.order, [index.x, index.y, index.z]
    del heights, index
    if params.sigma_rule:
        stray |= _beyond_sigma(place, ~stray, params)
    out[order] = stray
    if params.surface:
        rows = np.flatnonzero(last & ~out)
        out[rows] = _below_surfaces(x[rows], y[rows], z[rows], params)
    return out


def _below_surfaces(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: NoiseParams
) -> NDArray[np.bool_]:
    """Which points lie alone below a surface, each asked in the finest cells that hold enough points around it."""
    out = np.zeros(len(x), bool)
    if len(x) == 0:
        return out
    index = CellIndex.build(x, y, z, FINEST)
    heights = index.z.astype(np.float64)
    judged, below = np.zeros(len(x), bool), np.zeros(len(x), bool)
    for level in range(SIZES):
        mark_below_surfaces(
            index.x,
            index.y,
            heights,
            index.start,
            index.ncols,
            index.nrows,
            1 << level,
            index.cell,
            index.x0 // index.cell,
            index.y0 // index.cell,
            params.surface_gap * 1000.0,
            params.surface_share,
            judged,
            below,
        )
    out[index.order] = below
    return out


def _apart(
    index: CellIndex, heights: NDArray[np.float64], params: NoiseParams, gap: float, shape: float
) -> NDArray[np.bool_]:
    """Sorted points below a gap, at any of the sizes of cells; coarse cells see what fine ones have left."""
    below = np.zeros(len(heights), bool)
    for level in range(LEVELS):
        mark_below_gaps(
            heights,
            index.start,
            index.ncols,
            index.nrows,
            1 << level,
            index.cell,
            index.x0 // index.cell,
            index.y0 // index.cell,
            params.points,
            gap * 1000.0,
            params.steepest,
            shape,
            SURROUNDINGS,
            below,
        )
    return below


def _beyond_sigma(place: list[NDArray[np.int64]], among: NDArray[np.bool_], params: NoiseParams) -> NDArray[np.bool_]:
    """Points further from the mean of the others around than so many of their standard deviations, `among` some alone.

    They are sorted into cells no smaller than the radius, and larger ones where there would be too many. `place`, x, y
    and z [mm] from 0, is sorted with them: a whole survey's coordinates are not held twice.
    """
    radius = round(params.sigma_radius * 1000)
    out = np.zeros(len(among), bool)
    rows = np.flatnonzero(among)
    if len(rows) == 0:
        return out
    column, number = place[0][rows], place[1][rows]
    most_x, most_y = int(column.max()), int(number.max())
    edge = radius
    while (most_x // edge + 1) * (most_y // edge + 1) > max(MOST_CELLS, 64 * len(rows)):
        edge *= 2
    ncols, nrows = most_x // edge + 1, most_y // edge + 1
    number //= edge
    number *= ncols
    column //= edge
    number += column
    del column
    order, start = sort_by_cell(number, ncols * nrows)
    del number
    order, rows = rows[order], rows[:0]
    for axis in range(3):
        place[axis] = place[axis][order]
    beyond = np.zeros(len(order), bool)
    mark_beyond_sigma(
        *place,
        start,
        ncols,
        nrows,
        radius,
        params.sigma,
        params.sigma_least * 1000.0,
        params.sigma_neighbours,
        params.sigma_above,
        beyond,
    )
    out[order] = beyond
    return out
