"""Points that are no surface at all: echoes far below the ground, outliers of dense data, birds and clouds.

Three rules, each with its switch. All compare whole millimetres with whole millimetres, so that neither the order
of the points nor a shift of all heights changes a flag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.params import NoiseParams
from fwclass.kernel import kernel
from fwclass.neighbours import CellIndex, sort_by_cell

LEVELS = 3
"""Sizes of cells that groups are looked for in, each twice the one before."""

SURROUNDINGS = 4
"""So many times as many points as a group has must lie around it."""

MOST_CELLS = 1 << 22
"""Cells of the search of the 3σ rule, or 64 a point where that is more; it changes the time, never a flag."""


def noise(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: NoiseParams
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

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
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
    return out


def _apart(
    index: CellIndex, heights: NDArray[np.float64], params: NoiseParams, gap: float, shape: float
) -> NDArray[np.bool_]:
    """Sorted points below a gap, at any of the sizes of cells; coarse cells see what fine ones have left."""
    below = np.zeros(len(heights), bool)
    for level in range(LEVELS):
        _below_gaps(
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


@kernel
def _below_gaps(z, start, ncols, nrows, size, cell, col0, row0, most, gap, steepest, shape, around, noise):  # type: ignore[no-untyped-def]
    """Mark points below gaps: `size` is the edge of a cell in cells of the index, heights and edges are in mm."""
    lowest = np.empty(most + 1)
    area = 9.0 * (size * cell) ** 2
    for big_r in range(row0 // size, (row0 + nrows - 1) // size + 1):
        for big_c in range(col0 // size, (col0 + ncols - 1) // size + 1):
            r0, c0 = big_r * size - row0, big_c * size - col0
            bottom = _bottom(z, start, ncols, nrows, r0, c0, size, noise)
            if bottom == np.inf or _has_company(
                z, start, ncols, nrows, r0 - size, c0 - size, 3 * size, bottom, most, gap, steepest, area, around
            ):
                continue
            total, kept = _lowest_of(z, start, ncols, nrows, r0 - size, c0 - size, 3 * size, noise, lowest)
            density = total / area
            level = _level(lowest, kept, total, density, gap + steepest / np.sqrt(density), shape, around)
            if level >= bottom:
                _mark(z, start, ncols, nrows, r0, c0, size, level, noise)


@kernel
def _bottom(z, start, ncols, nrows, r0, c0, edge, skipped):  # type: ignore[no-untyped-def]
    """Lowest point of a square of cells, inf where there is none."""
    low = np.inf
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            if z[i] < low and not skipped[i]:
                low = z[i]
    return low


@kernel
def _has_company(z, start, ncols, nrows, r0, c0, edge, bottom, most, gap, steepest, area, around):  # type: ignore[no-untyped-def]
    """Are more points within one gap above `bottom` than a group may have? Then no gap above it counts.

    A shortcut: points already found are not left out, so that it is true less often than it could be, never more.
    """
    left, right = max(c0, 0), min(c0 + edge, ncols)
    bottom_r, top_r = max(r0, 0), min(r0 + edge, nrows)
    total = 0
    for r in range(bottom_r, top_r):
        total += start[r * ncols + right] - start[r * ncols + left]
    limit = min(most, total // around)
    top = bottom + gap + steepest * np.sqrt(area / total)
    n = 0
    for r in range(bottom_r, top_r):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            n += bottom <= z[i] <= top
        if n > limit:
            return True
    return False


@kernel
def _lowest_of(z, start, ncols, nrows, r0, c0, edge, skipped, lowest):  # type: ignore[no-untyped-def]
    """Number of points in a square of `edge` cells, and how many of their lowest are in `lowest`, in order."""
    total, kept, room = 0, 0, len(lowest)
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            if skipped[i]:
                continue
            total += 1
            if kept == room and z[i] >= lowest[room - 1]:
                continue
            j = kept if kept < room else room - 1
            while j > 0 and lowest[j - 1] > z[i]:
                lowest[j] = lowest[j - 1]
                j -= 1
            lowest[j] = z[i]
            kept = kept + 1 if kept < room else room
    return total, kept


@kernel
def _level(lowest, kept, total, density, gap, shape, around):  # type: ignore[no-untyped-def]
    """Height of the highest point that lies below a gap, −inf if none does; groups above one another count apart."""
    level, since = -np.inf, 0
    for k in range(1, kept):
        step = lowest[k] - lowest[k - 1]
        few = (k - since) * around <= total - k and k - since <= max(1.0, density * (shape * step) ** 2)
        if step > gap and few:
            level, since = lowest[k - 1], k
    return level


@kernel
def _mark(z, start, ncols, nrows, r0, c0, edge, level, noise):  # type: ignore[no-untyped-def]
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            noise[i] |= z[i] <= level


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
    _sigma_rule(
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


@kernel
def _sigma_rule(x, y, z, start, ncols, nrows, radius, sigma, least, fewest, above, noise):  # type: ignore[no-untyped-def]
    """Whole numbers are added up, so that the sums do not depend on the order of the points.

    `noise` starts false; heights and lengths are in mm.
    """
    for r in range(nrows):
        r0, r1 = max(r - 1, 0), min(r + 2, nrows)
        for c in range(ncols):
            c0, c1 = max(c - 1, 0), min(c + 2, ncols)
            first, last = start[r * ncols + c], start[r * ncols + c + 1]
            if first == last:
                continue
            low, high = z[first], z[first]
            for row in range(r0, r1):
                for j in range(start[row * ncols + c0], start[row * ncols + c1]):
                    low = z[j] if z[j] < low else low
                    high = z[j] if z[j] > high else high
            for i in range(first, last):
                if high - z[i] <= least and not (above and z[i] - low > least):
                    continue
                n, total, square, lonely = -1, 0, 0, True
                # the points beside it in its cell, near it in most files, tell soonest that it is not alone
                for j in range(max(i - 1, first), min(i + 2, last)):
                    dx, dy = x[j] - x[i], y[j] - y[i]
                    lonely &= j == i or abs(z[j] - z[i]) > least or dx * dx + dy * dy > radius * radius
                if not lonely:
                    continue
                for row in range(r0, r1):
                    for j in range(start[row * ncols + c0], start[row * ncols + c1]):
                        dx, dy, dz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                        if dx * dx + dy * dy <= radius * radius:
                            n += 1
                            total += dz
                            square += dz * dz
                            lonely &= j == i or abs(dz) > least
                            if not lonely:
                                break
                    if not lonely:
                        break
                if n < fewest or not lonely:
                    continue
                mean = total / n
                deviation = np.sqrt(max(square / n - mean * mean, 0.0))
                noise[i] = (abs(mean) if above else mean) > sigma * deviation
