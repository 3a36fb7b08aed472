"""Sums over the echoes of a neighbourhood, exact whatever their order.

Everything that is added up is a whole number: coordinates in millimetres relative to the echo that the neighbourhood
belongs to, amplitude and width in steps of `STEP`, counts. Whole numbers below 2^53 are exact in float64 in any order,
so vector code, other cells, tiles and halos, or another order of rows never change a bit. Where a sum of squares or
fourth powers would pass that bound, each term is rounded to a step that follows from the neighbourhood alone, 2^-53 of
the most that the sum can be: again whole numbers, again exact (`wide_heights`, `wide_squares`).

`moments` is float64 (MOMENTS, K): one column a neighbourhood, one row a sum; the rows are the constants below. Rows
that no asked measure needs stay as they are.

==========================================  ===================================================================
N                                           echoes, the echo itself included
X Y Z XX XY XZ YY YZ ZZ                     sums and sums of products of the relative coordinates [mm, mm2]
ZZZ ZZZZ                                    sums of third and fourth powers of the relative z
LOW HIGH                                    least and greatest relative z [mm]
SINGLE FIRST INTERMEDIATE                   echoes that are the only, the first, an intermediate one of their pulse
AMPLITUDE, WIDTH, INTENSITY (+0, +1, +2)    echoes with a value, its sum and sum of squares [steps]
CYLINDER                                    echoes of the vertical cylinder of the sphere's radius
AREA                                        area of the circle or cell [m2]
REACH                                       distance of the furthest echo [mm]
NEAR FAR                                    least and greatest place along the normal [mm]: the second pass
PERCENTILE (+0 ... +6)                      relative z at the percentiles `PERCENTILES` [mm]
==========================================  ===================================================================
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fwclass.kernel import kernel, vectorised

N, X, Y, Z, XX, XY, XZ, YY, YZ, ZZ, ZZZ, ZZZZ = range(12)
LOW, HIGH, SINGLE, FIRST, INTERMEDIATE = range(12, 17)
AMPLITUDE, WIDTH, INTENSITY = 17, 20, 23
CYLINDER, AREA, REACH, NEAR, FAR = range(26, 31)
PERCENTILE = 31
PERCENTILES = (5, 10, 25, 50, 75, 90, 95)
MOMENTS = PERCENTILE + len(PERCENTILES)

STEP = 1.0 / 1024.0
"""Amplitude [DN] and width [ns] are taken in steps of this; intensity is whole already."""

EXACT = 2.0**52
"""A sum of whole numbers of one sign is exact, in any order, as long as it is below this."""


@vectorised
def add_places(x, y, z, moments):  # type: ignore[no-untyped-def]
    """Add the sums X … ZZ and N of echoes at (x, y, z) to `moments` (MOMENTS,)."""
    sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
    for k in range(len(x)):
        dx, dy, dz = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
        sx += dx
        sy += dy
        sz += dz
        xx += dx * dx
        xy += dx * dy
        xz += dx * dz
        yy += dy * dy
        yz += dy * dz
        zz += dz * dz
    moments[N] += float(len(x))
    moments[X] += sx
    moments[Y] += sy
    moments[Z] += sz
    moments[XX] += xx
    moments[XY] += xy
    moments[XZ] += xz
    moments[YY] += yy
    moments[YZ] += yz
    moments[ZZ] += zz


@vectorised
def add_heights(z, moments):  # type: ignore[no-untyped-def]
    """Add N, Z and ZZ of `z` [mm] alone to `moments` (MOMENTS,): a cylinder has no covariance."""
    sz = zz = 0.0
    for k in range(len(z)):
        dz = np.float64(z[k])
        sz += dz
        zz += dz * dz
    moments[N] += float(len(z))
    moments[Z] += sz
    moments[ZZ] += zz


@vectorised
def add_powers(z, moments):  # type: ignore[no-untyped-def]
    """Add ZZZ [mm³] and ZZZZ [mm⁴] of `z` [mm] to `moments` (MOMENTS,)."""
    third = fourth = 0.0
    for k in range(len(z)):
        dz = np.float64(z[k])
        square = dz * dz
        third += square * dz
        fourth += square * square
    moments[ZZZ] += third
    moments[ZZZZ] += fourth


@vectorised
def widen_range(z, moments):  # type: ignore[no-untyped-def]
    """Let LOW and HIGH [mm] hold `z` too; whole numbers, as a minimum of floats is no vector code."""
    low, high = np.int32(moments[LOW]), np.int32(moments[HIGH])
    for k in range(len(z)):
        dz = np.int32(z[k])
        low = min(low, dz)
        high = max(high, dz)
    moments[LOW] = low
    moments[HIGH] = high


@kernel
def wide_heights(z, moments):  # type: ignore[no-untyped-def]
    """Set ZZ, ZZZ and ZZZZ of all of `z` [mm] where they may pass `EXACT`; LOW, HIGH and N of `moments` stand."""
    size = max(-moments[LOW], moments[HIGH])
    count = float(len(z))
    two, three, four = _unit(count * size * size), _unit(count * size**3), _unit(count * (size * size) * (size * size))
    second = third = fourth = 0.0
    for k in range(len(z)):
        dz = np.float64(z[k])
        square = dz * dz
        second += np.rint(square / two)
        third += np.rint(square * dz / three)
        fourth += np.rint(square * square / four)
    moments[ZZ], moments[ZZZ], moments[ZZZZ] = second * two, third * three, fourth * four


@kernel
def _unit(most):  # type: ignore[no-untyped-def]
    """The power of two, at least 1, in steps of which sums up to `most` stay below `EXACT`."""
    return 2.0 ** max(0.0, math.ceil(math.log2(max(most, 1.0) / EXACT)) + 1.0)


@kernel
def add_kinds(kinds, at, moments):  # type: ignore[no-untyped-def]
    """Add SINGLE, FIRST and INTERMEDIATE [counts] of the echoes `at` (rows of `kinds`, see `packed_kinds`)."""
    packed = np.int64(0)
    for k in range(len(at)):
        packed += kinds[at[k]]
    moments[SINGLE] += float(packed & 0x1FFFFF)
    moments[FIRST] += float((packed >> 21) & 0x1FFFFF)
    moments[INTERMEDIATE] += float(packed >> 42)


def packed_kinds(number: ArrayLike, count: ArrayLike) -> NDArray[np.int64]:
    """int64 (echoes,) with 1 in the 21-bit field of the echo's kind: single, first, intermediate; 0 is a last echo."""
    place, echoes = np.asarray(number, np.int64), np.asarray(count, np.int64)
    several = echoes > 1
    first, last = several & (place <= 1), several & (place >= echoes) & (place > 1)
    between = several & ~first & ~last
    return (~several).astype(np.int64) | first.astype(np.int64) << 21 | between.astype(np.int64) << 42


def steps(values: ArrayLike, step: float) -> NDArray[np.float64]:
    """`values` (any shape) as whole numbers of `step` in float64; NaN and infinity are NaN, no value."""
    whole = np.rint(np.asarray(values, np.float64) / step)
    whole[~np.isfinite(whole)] = np.nan
    return whole


@kernel
def add_values(values, at, moments, row):  # type: ignore[no-untyped-def]
    """Add count, sum and sum of squares of `values` (see `steps`, NaN is none) of echoes `at` to `moments[row:row +
    3]`."""
    count = total = squares = 0.0
    for k in range(len(at)):
        value = values[at[k]]
        has = value == value
        value = value if has else 0.0
        count += 1.0 if has else 0.0
        total += value
        squares += value * value
    moments[row] += count
    moments[row + 1] += total
    moments[row + 2] += squares


@kernel
def wide_squares(values, moments, row):  # type: ignore[no-untyped-def]
    """Set sum and sum of squares of all of `values` (n,) where they may pass `EXACT`; NaN is no value."""
    size = 0.0
    for k in range(len(values)):
        value = abs(values[k])
        size = value if value > size else size
    one, two = _unit(size * len(values)), _unit(size * size * len(values))
    total = squares = 0.0
    for k in range(len(values)):
        value = values[k]
        if value == value:
            total += np.rint(value / one)
            squares += np.rint(value * value / two)
    moments[row + 1], moments[row + 2] = total * one, squares * two
