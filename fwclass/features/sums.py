"""Sums of a block of neighbourhoods, radius after radius: `fwclass.features.moments` for many echoes in one call.

Echo p of the block has its neighbours at ``begin[p]`` and on, ordered by shells; ``ends[p, q]`` of them lie within
radius q, so the sums of a radius are those of the one before and of one shell more. All functions take
the first `count` echoes and write `moments`, float64 (Q, MOMENTS, echoes).
"""

from __future__ import annotations

import numpy as np

from fwclass.features.gather import LANES
from fwclass.features.moments import (
    EXACT,
    FIRST,
    HIGH,
    INTERMEDIATE,
    LOW,
    SINGLE,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    ZZZ,
    ZZZZ,
    N,
    X,
    Y,
    Z,
    wide_heights,
    wide_squares,
)
from fwclass.features.percentiles import percentiles
from fwclass.kernel import inlined, kernel, vectorised


@vectorised
def sum_places(x, y, z, begin, ends, count, moments):  # type: ignore[no-untyped-def]
    """N, X … ZZZZ, LOW and HIGH; those two in whole numbers, as a minimum of floats is no vector code."""
    several = ends.shape[1] > 1
    for p in range(count):
        sx = sy = sz = xx = xy = xz = yy = yz = zz = third = fourth = 0.0
        low = high = np.int32(0)
        base = np.uint64(begin[p])
        at = base
        for q in range(ends.shape[1]):
            n = ends[p, q]
            end = base + np.uint64(n if several else (n + LANES - 1) // LANES * LANES)
            for step in range(np.int64(end - at)):
                k = at + np.uint64(step)
                dx, dy, dz = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
                square = dz * dz
                sx += dx
                sy += dy
                sz += dz
                xx += dx * dx
                xy += dx * dy
                xz += dx * dz
                yy += dy * dy
                yz += dy * dz
                zz += square
                third += square * dz
                fourth += square * square
                low = min(low, np.int32(z[k]))
                high = max(high, np.int32(z[k]))
            moments[q, N, p] = n
            moments[q, X, p], moments[q, Y, p], moments[q, Z, p] = sx, sy, sz
            moments[q, XX, p], moments[q, XY, p], moments[q, XZ, p] = xx, xy, xz
            moments[q, YY, p], moments[q, YZ, p], moments[q, ZZ, p] = yy, yz, zz
            moments[q, ZZZ, p], moments[q, ZZZZ, p] = third, fourth
            moments[q, LOW, p], moments[q, HIGH, p] = low, high
            at = end


@vectorised
def sum_heights(z, begin, ends, count, moments):  # type: ignore[no-untyped-def]
    """As `sum_places`, of the heights `z` [mm] alone."""
    several = ends.shape[1] > 1
    for p in range(count):
        sz = zz = third = fourth = 0.0
        low = high = np.int32(0)
        base = np.uint64(begin[p])
        at = base
        for q in range(ends.shape[1]):
            n = ends[p, q]
            end = base + np.uint64(n if several else (n + LANES - 1) // LANES * LANES)
            for step in range(np.int64(end - at)):
                k = at + np.uint64(step)
                dz = np.float64(z[k])
                square = dz * dz
                sz += dz
                zz += square
                third += square * dz
                fourth += square * square
                low = min(low, np.int32(z[k]))
                high = max(high, np.int32(z[k]))
            moments[q, N, p], moments[q, Z, p], moments[q, ZZ, p] = n, sz, zz
            moments[q, ZZZ, p], moments[q, ZZZZ, p] = third, fourth
            moments[q, LOW, p], moments[q, HIGH, p] = low, high
            at = end


@vectorised
def sum_kinds(kinds, begin, ends, count, moments):  # type: ignore[no-untyped-def]
    """SINGLE, FIRST and INTERMEDIATE [counts] of the neighbours' `kinds`, see `moments.packed_kinds`."""
    for p in range(count):
        packed = np.int64(0)
        base = np.uint64(begin[p])
        at = base
        for q in range(ends.shape[1]):
            end = base + np.uint64(ends[p, q])
            for step in range(np.int64(end - at)):
                packed += kinds[at + np.uint64(step)]
            unpack_kinds(packed, moments[q], p)
            at = end


@inlined
def unpack_kinds(packed, moments, p):  # type: ignore[no-untyped-def]
    """The three fields [counts] of a sum of packed kinds to column `p`."""
    moments[SINGLE, p] = packed & 0x1FFFFF
    moments[FIRST, p] = (packed >> 21) & 0x1FFFFF
    moments[INTERMEDIATE, p] = packed >> 42


@vectorised
def sum_values(values, begin, ends, count, moments, row):  # type: ignore[no-untyped-def]
    """Count, sum and sum of squares of an attribute in steps (NaN is no value) to ``moments[:, row:row + 3]``."""
    for p in range(count):
        with_value = total = squares = 0.0
        base = np.uint64(begin[p])
        at = base
        for q in range(ends.shape[1]):
            end = base + np.uint64(ends[p, q])
            for step in range(np.int64(end - at)):
                value = values[at + np.uint64(step)]
                has = value == value
                value = value if has else 0.0
                with_value += 1.0 if has else 0.0
                total += value
                squares += value * value
            moments[q, row, p], moments[q, row + 1, p], moments[q, row + 2, p] = with_value, total, squares
            at = end
            if squares >= EXACT:
                wide_squares(values[base:end], moments[q, :, p], row)


@kernel
def sum_wide(z, begin, ends, count, powers, moments):  # type: ignore[no-untyped-def]
    """ZZ [mm²], ZZZ and ZZZZ anew, in coarser steps, where they are too large to be exact."""
    for p in range(count):
        for q in range(ends.shape[1]):
            if moments[q, ZZ, p] >= EXACT or (powers and moments[q, ZZZZ, p] >= EXACT):
                wide_heights(z[begin[p] : begin[p] + ends[p, q]], moments[q, :, p])


@kernel
def rank_heights(z, begin, ends, count, values, tally, moments):  # type: ignore[no-untyped-def]
    """PERCENTILE … [mm] of the neighbours' heights; `values` and `tally` are scratch, see `percentiles`."""
    for p in range(count):
        for q in range(ends.shape[1]):
            low, high = np.int64(moments[q, LOW, p]), np.int64(moments[q, HIGH, p])
            percentiles(z[begin[p] : begin[p] + ends[p, q]], low, high, values, tally, moments[q, :, p])
