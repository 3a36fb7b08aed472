"""Measures of the neighbourhoods of core rows in a sorted grid, at any number of radii at once.

A job is a measure (a feature without its scale) at one radius. Work goes by batches of `BATCH` core rows, in the order
of the cells. There are two ways to the sums of a batch:

- At several radii, or where a measure needs the neighbours themselves, the neighbours of each core row are found once,
  ordered by the shells between the radii, and summed shell by shell; sums of a larger radius start from those of the
  smaller.
- At one radius, where sums are enough (`NeighbourhoodRequest.at_once`), they are taken straight from the candidates of
  a cell, which count as zero where they are too far away (`within`).

Then shapes, the second pass along the normal and the measures of all jobs are taken of the whole batch (`settle`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.features import eigen
from fwclass.features.attributes import Attributes
from fwclass.features.gather import (
    LANES,
    candidates,
    carry,
    compact,
    count_within,
    distances,
    fill,
    fill_values,
    order,
    shells,
)
from fwclass.features.moments import AMPLITUDE, CYLINDER, INTENSITY, WIDTH
from fwclass.features.settle import settle
from fwclass.features.sums import rank_heights, sum_heights, sum_kinds, sum_places, sum_values, sum_wide
from fwclass.features.within import sum_within
from fwclass.kernel import kernel

BATCH = 5 * eigen.BATCH
"""Core rows whose sums are settled together."""

STRIDE = BATCH + 8
"""Places between two moments of an echo: no power of two, which would crowd them into few lines of the cache."""


class Grid(NamedTuple):
    """The sorted echoes: see `gather.Points`; `wanted` int32, place among the core rows of every sorted echo, −1 for
    none; `half`: see `gather.window`."""

    x: NDArray[np.int32]
    y: NDArray[np.int32]
    z: NDArray[np.int32]
    start: NDArray[np.int64]
    ncols: int
    nrows: int
    cell: int
    half: NDArray[np.int64]
    wanted: NDArray[np.int32]


class NeighbourhoodRequest(NamedTuple):
    """What is asked of one pass over the grid.

    Attributes
    ----------
    radii : int64 (Q,), rising [mm].
    limits : float64 (Q,), their squares; bounds : the same but the last, filled up with infinity to a multiple of four.
    cylinder : the neighbourhoods are vertical cylinders, not spheres.
    optimal : of every core row only the radius of lowest eigenentropy counts; jobs then have radius number 0.
    shape, extent : bool (Q,), shapes, extents along the normal are needed at the radius.
    powers, among, ranks : powers of heights, counts in the cylinder, percentiles are needed.
    at_once : one radius, and nothing needs the neighbours themselves: see `within`.
    jobs : int64 (J, 3), radius number, code of the measure, row of the result.
    """

    radii: NDArray[np.int64]
    limits: NDArray[np.float64]
    bounds: NDArray[np.float64]
    cylinder: bool
    optimal: bool
    shape: NDArray[np.bool_]
    extent: NDArray[np.bool_]
    powers: bool
    among: bool
    ranks: bool
    at_once: bool
    jobs: NDArray[np.int64]


class Scratch(NamedTuple):
    """Room for the candidates of one cell, and what becomes of them for one echo.

    Attributes
    ----------
    x, y, z : float32, relative to the first echo of the cell [mm]; carried : what they carry, as the grid's.
    flat, square : float64, squared distances [mm2]; distance : those of the neighbours.
    picked : float64 (4, m), see `within`; without room unless its sums are taken.
    near, ordered : uint32, places of the neighbours among the candidates; shell : uint64, theirs.
    places : uint64 (Q,), starts or ends of the shells.
    values : int32, tally : int64 (BUCKETS + 1,), for percentiles.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    carried: Attributes
    flat: NDArray[np.float64]
    square: NDArray[np.float64]
    distance: NDArray[np.float64]
    picked: NDArray[np.float64]
    near: NDArray[np.uint32]
    ordered: NDArray[np.uint32]
    shell: NDArray[np.uint64]
    places: NDArray[np.uint64]
    values: NDArray[np.int32]
    tally: NDArray[np.int64]

    @classmethod
    def of(cls, size: int, asked: NeighbourhoodRequest, buckets: int, values: Attributes) -> Scratch:
        """Room for `size` candidates, for those that fill them up and for what they carry of `values`."""
        size += LANES
        x, y, z = (np.empty(size, np.float32) for _ in range(3))
        flat, square, distance = (np.empty(size) for _ in range(3))
        near, ordered = (np.empty(size + 1, np.uint32) for _ in range(2))
        ranked = np.empty(size, np.int32)
        shell, places = np.empty(size, np.uint64), np.empty(len(asked.radii), np.uint64)
        tally = np.empty(buckets + 1, np.int64)
        picked = np.empty((4, size if asked.at_once else 0))
        carried = values.room(size)
        return cls(x, y, z, carried, flat, square, distance, picked, near, ordered, shell, places, ranked, tally)


class Batch(NamedTuple):
    """The neighbourhoods of `BATCH` core rows.

    Attributes
    ----------
    x, y, z : neighbours relative to their core row [mm], one after another, from the nearest shell to the furthest; at
        a single radius followed by zero up to a multiple of `LANES`.
    carried : what the neighbours carry.
    begin : int64 (BATCH,), first neighbour of every core row; ends : int64 (BATCH, Q), how many lie within each radius.
    rows : uint64 (BATCH,), row of the result.
    moments, shape : float64 (Q, MOMENTS, STRIDE), (Q, SHAPES, STRIDE).
    measured : float32 (BATCH,).
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    carried: Attributes
    begin: NDArray[np.int64]
    ends: NDArray[np.int64]
    rows: NDArray[np.uint64]
    moments: NDArray[np.float64]
    shape: NDArray[np.float64]
    measured: NDArray[np.float32]


@kernel
def measure_around(grid, values, asked, scratch, batch, begin_at, end_at, out, chosen):  # type: ignore[no-untyped-def]
    """The jobs of `asked` for the core rows to `out`, float32 (jobs, core rows).

    Only those among the sorted echoes ``begin_at … end_at - 1``: between two calls Python heeds an interrupt.

    `chosen` is float32 (core rows,) for the optimal radius [m], empty where there is no choice.
    """
    # Names for all: an array that is taken out of a tuple within the loop is counted, and that waits for the memory.
    xs, ys, zs, start, half, wanted = grid.x, grid.y, grid.z, grid.start, grid.half, grid.wanted
    x, y, z, flat, square = scratch.x, scratch.y, scratch.z, scratch.flat, scratch.square
    distance, near, shell = scratch.distance, scratch.near, scratch.shell
    kinds, amplitude, width, intensity = scratch.carried
    to_x, to_y, to_z = batch.x, batch.y, batch.z
    to_kinds, to_amplitude, to_width, to_intensity = batch.carried
    begin, ends, rows, moments = batch.begin, batch.ends, batch.rows, batch.moments
    limits, bounds, ncols, nrows = asked.limits, asked.bounds, grid.ncols, grid.nrows
    room, level, among, count = len(batch.x), asked.cylinder, asked.among, len(asked.limits)
    ordered, places, at_once, picked = scratch.ordered, scratch.places, asked.at_once, scratch.picked
    shape, powers = asked.shape[0], asked.powers
    filled, used = 0, np.uint64(0)
    for row in range(nrows):
        if start[row * ncols + ncols] <= begin_at or start[row * ncols] >= end_at:
            continue
        for col in range(ncols):
            first, last = max(start[row * ncols + col], begin_at), min(start[row * ncols + col + 1], end_at)
            while first < last and wanted[first] < 0:
                first += 1
            if first >= last:
                continue
            m = candidates(xs, ys, zs, start, ncols, nrows, half, row, col, first, x, y, z)
            if len(kinds):
                carry(values.kinds, start, ncols, nrows, half, row, col, kinds)
            if len(amplitude):
                carry(values.amplitude, start, ncols, nrows, half, row, col, amplitude)
            if len(width):
                carry(values.width, start, ncols, nrows, half, row, col, width)
            if len(intensity):
                carry(values.intensity, start, ncols, nrows, half, row, col, intensity)
            at = first
            while at_once and at < last:
                at, filled = sum_within(
                    xs,
                    ys,
                    zs,
                    wanted,
                    first,
                    at,
                    last,
                    x,
                    y,
                    z,
                    kinds,
                    amplitude,
                    width,
                    intensity,
                    m,
                    limits[0],
                    level,
                    among,
                    shape,
                    powers,
                    picked,
                    moments[0],
                    rows,
                    filled,
                )
                if filled == BATCH:
                    _finish(asked, scratch, batch, filled, out, chosen)
                    filled = 0
            for i in range(at, last):
                if wanted[i] < 0:
                    continue
                if filled == BATCH or np.int64(used) + m > room:
                    _finish(asked, scratch, batch, filled, out, chosen)
                    filled, used = 0, np.uint64(0)
                px, py, pz = np.float32(xs[i] - xs[first]), np.float32(ys[i] - ys[first]), np.float32(zs[i] - zs[first])
                distances(x, y, z, m, px, py, pz, level, flat, square)
                if among:
                    for q in range(count):
                        moments[q, CYLINDER, filled] = count_within(flat, m, limits[q])
                n = compact(square, m, limits[count - 1], near)
                begin[filled], rows[filled] = used, wanted[i]
                own = near
                if count > 1:
                    shells(square, bounds, near, n, distance, shell, places)
                    order(near, n, shell, places, ordered)
                    own = ordered
                    for q in range(count):
                        ends[filled, q] = places[q]
                else:
                    ends[filled, 0] = n
                if len(kinds):
                    fill_values(kinds, own, n, to_kinds, used)
                if len(amplitude):
                    fill_values(amplitude, own, n, to_amplitude, used)
                if len(width):
                    fill_values(width, own, n, to_width, used)
                if len(intensity):
                    fill_values(intensity, own, n, to_intensity, used)
                used = fill(x, y, z, own, n, px, py, pz, to_x, to_y, to_z, used)
                filled += 1
    _finish(asked, scratch, batch, filled, out, chosen)


@kernel
def _finish(asked, scratch, batch, filled, out, chosen):  # type: ignore[no-untyped-def]
    """Sums, unless they stand already, and measures of the first `filled` neighbourhoods of the batch."""
    if not asked.at_once:
        x, y, z, begin, ends, moments = batch.x, batch.y, batch.z, batch.begin, batch.ends, batch.moments
        kinds, amplitude, width, intensity = batch.carried
        if asked.shape.any():
            sum_places(x, y, z, begin, ends, filled, moments)
        else:
            sum_heights(z, begin, ends, filled, moments)
        sum_wide(z, begin, ends, filled, asked.powers, moments)
        if asked.ranks:
            rank_heights(z, begin, ends, filled, scratch.values, scratch.tally, moments)
        if len(kinds):
            sum_kinds(kinds, begin, ends, filled, moments)
        if len(amplitude):
            sum_values(amplitude, begin, ends, filled, moments, AMPLITUDE)
        if len(width):
            sum_values(width, begin, ends, filled, moments, WIDTH)
        if len(intensity):
            sum_values(intensity, begin, ends, filled, moments, INTENSITY)
    settle(asked, batch, filled, out, chosen)
