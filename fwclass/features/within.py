"""Sums of the neighbourhoods of one radius, straight from the candidates of a cell.

Those too far away count as zero. That is more arithmetic than to pick the near ones first and add up those alone, but
all of it is done several candidates at a time, and nothing is moved.
"""

from __future__ import annotations

import numpy as np

from fwclass.features.moments import (
    AMPLITUDE,
    CYLINDER,
    EXACT,
    HIGH,
    INTENSITY,
    LOW,
    WIDTH,
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
from fwclass.features.sums import unpack_kinds
from fwclass.kernel import inlined, kernel, vectorised


@vectorised
def sum_within(  # type: ignore[no-untyped-def]
    xs,
    ys,
    zs,
    wanted,
    first,
    begin,
    last,
    x,
    y,
    z,
    kinds,
    amplitude,
    width,
    intensity,
    m,
    limit,
    level,
    among,
    shape,
    powers,
    near,
    moments,
    rows,
    filled,
):
    """Moments of the wanted ones of the sorted echoes ``begin … last - 1`` of a cell, to columns `filled` and on.

    The first `m` of `x`, `y`, `z`, relative to sorted echo `first`, and of what they carry are the candidates; those
    within the square root of `limit` [mm2] are neighbours. `near`, float64 (4, at least m), is scratch. Returns the
    echo that comes next, which is `last` unless the columns are full, and the number of columns taken.
    """
    dx, dy, dz, held = near[0], near[1], near[2], near[3]
    i = begin
    while i < last and filled < len(rows):
        if wanted[i] >= 0:
            rows[filled] = wanted[i]
            px, py, pz = np.float32(xs[i] - xs[first]), np.float32(ys[i] - ys[first]), np.float32(zs[i] - zs[first])
            if level:
                _in_cylinder(x, y, z, px, py, pz, limit, m, dz, held, moments, filled)
            else:
                _in_sphere(x, y, z, px, py, pz, limit, m, among, dx, dy, dz, held, moments, filled)
            if shape:
                _places(dx, dy, dz, m, moments, filled)
            _heights(dz, held, m, powers, moments, filled)
            if len(kinds):
                packed = np.int64(0)
                for k in range(m):
                    packed += kinds[k] if held[k] > 0.0 else np.int64(0)
                unpack_kinds(packed, moments, filled)
            if len(amplitude):
                _values(amplitude, held, m, moments, AMPLITUDE, filled)
            if len(width):
                _values(width, held, m, moments, WIDTH, filled)
            if len(intensity):
                _values(intensity, held, m, moments, INTENSITY, filled)
            filled += 1
        i += 1
    return i, filled


@inlined
def _in_sphere(x, y, z, px, py, pz, limit, m, among, dx, dy, dz, held, moments, p):  # type: ignore[no-untyped-def]
    """N, and CYLINDER where `among`; which candidates are `held` (1, else 0) and their places, zero if not held."""
    n = flat = 0.0
    for k in range(m):
        u, v, w = np.float64(x[k] - px), np.float64(y[k] - py), np.float64(z[k] - pz)
        level = u * u + v * v
        near = level + w * w <= limit
        dx[k], dy[k], dz[k] = u if near else 0.0, v if near else 0.0, w if near else 0.0
        held[k] = 1.0 if near else 0.0
        n += 1.0 if near else 0.0
        flat += 1.0 if level <= limit else 0.0
    moments[N, p] = n
    if among:
        moments[CYLINDER, p] = flat


@inlined
def _in_cylinder(x, y, z, px, py, pz, limit, m, dz, held, moments, p):  # type: ignore[no-untyped-def]
    """As `_in_sphere`, heights alone."""
    n = 0.0
    for k in range(m):
        u, v, w = np.float64(x[k] - px), np.float64(y[k] - py), np.float64(z[k] - pz)
        near = u * u + v * v <= limit
        dz[k] = w if near else 0.0
        held[k] = 1.0 if near else 0.0
        n += 1.0 if near else 0.0
    moments[N, p] = n


@inlined
def _places(dx, dy, dz, m, moments, p):  # type: ignore[no-untyped-def]
    """X, Y, XX, XY, XZ, YY and YZ."""
    sx = sy = xx = xy = xz = yy = yz = 0.0
    for k in range(m):
        u, v, w = dx[k], dy[k], dz[k]
        sx += u
        sy += v
        xx += u * u
        xy += u * v
        xz += u * w
        yy += v * v
        yz += v * w
    moments[X, p], moments[Y, p], moments[XX, p], moments[XY, p] = sx, sy, xx, xy
    moments[XZ, p], moments[YY, p], moments[YZ, p] = xz, yy, yz


@inlined
def _heights(dz, held, m, powers, moments, p):  # type: ignore[no-untyped-def]
    """Z, ZZ, LOW, HIGH and, with `powers`, ZZZ and ZZZZ."""
    sz = zz = third = fourth = 0.0
    low = high = np.int32(0)
    for k in range(m):
        w = dz[k]
        sz += w
        zz += w * w
        low = min(low, np.int32(w))
        high = max(high, np.int32(w))
    if powers:
        for k in range(m):
            square = dz[k] * dz[k]
            third += square * dz[k]
            fourth += square * square
    moments[Z, p], moments[ZZ, p], moments[ZZZ, p], moments[ZZZZ, p] = sz, zz, third, fourth
    moments[LOW, p], moments[HIGH, p] = low, high
    if zz >= EXACT or fourth >= EXACT:
        wide_heights(_pick(dz, held, m), moments[:, p])


@inlined
def _values(values, held, m, moments, row, p):  # type: ignore[no-untyped-def]
    """Count, sum and sum of squares of an attribute in steps (NaN is no value) to rows `row`, +1 and +2."""
    with_value = total = squares = 0.0
    for k in range(m):
        value = values[k]
        has = (value == value) & (held[k] > 0.0)
        value = value if has else 0.0
        with_value += 1.0 if has else 0.0
        total += value
        squares += value * value
    moments[row, p], moments[row + 1, p], moments[row + 2, p] = with_value, total, squares
    if squares >= EXACT:
        wide_squares(_pick(values, held, m), moments[:, p], row)


@kernel
def _pick(values, held, m):  # type: ignore[no-untyped-def]
    """Those of the first `m` of `values` that are `held`."""
    picked, n = np.empty(m), 0
    for k in range(m):
        if held[k] > 0.0:
            picked[n] = values[k]
            n += 1
    return picked[:n]
