"""One walk over the neighbours of every wanted point: exact sums, then the features of the neighbourhood."""

from __future__ import annotations

import math

import numpy as np

from fwclass.features.eigen import eigenvalues, normal
from fwclass.kernel import kernel

SUMS = 12
"""Sums of a neighbourhood, exact integers: Σx, Σy, Σz, Σxx, Σxy, Σxz, Σyy, Σyz, Σzz, range of z, first and last
echoes; coordinates in millimetres relative to the point."""

SHAPE = (
    "inclination", "echo_ratio", "linearity", "planarity", "sphericity", "roughness",
    "height_std", "height_range", "height_above_lowest", "density", "first_share", "last_share",
)  # fmt: skip
"""Columns of the result of `walk`, in order; the unit normal follows them."""


@kernel
def walk(x, y, z, first, last, wanted, start, ncols, nrows, radius, out):  # type: ignore[no-untyped-def]
    """Features of the wanted points among all points.

    Parameters
    ----------
    x, y, z : float64 whole millimetres, sorted by cells of edge `radius` [mm] as in `CellIndex`; `start` its offsets.
    first, last : float64 1 or 0, the echo is the first, the last of its pulse.
    wanted : int64, row of `out` of every sorted point, −1 where none is wanted.
    out : float32 (wanted points, len(SHAPE) + 3), `SHAPE` and the normal.

    The point itself and points at the same place count as neighbours; one at exactly `radius` does.
    """
    square = np.empty(len(x), np.float64)
    near = np.empty(len(x), np.uint64)
    sums = np.empty(SUMS)
    limit = float(radius * radius)
    for row in range(nrows):
        for col in range(ncols):
            cell = row * ncols + col
            for i in range(start[cell], start[cell + 1]):
                if wanted[i] >= 0:
                    m, n, lowest = _gather(x, y, z, start, ncols, nrows, row, col, i, limit, square, near)
                    _add(x, y, z, first, last, i, near[:n], sums)
                    _finish(float(n), float(m), sums, -float(lowest), radius, out[wanted[i]])


@kernel
def _gather(x, y, z, start, ncols, nrows, row, col, i, limit, square, near):  # type: ignore[no-untyped-def]
    """Counts in cylinder and sphere, and the lowest relative z in the cylinder; `near` gets the sphere.

    Two loops without branches: the first becomes vector code, and whether a candidate is near is a coin toss
    that no processor predicts. The sums are of integers, as only those may be reordered.
    """
    px, py, pz = x[i], y[i], z[i]
    m, n, lowest = 0, 0, np.int64(0)
    for r in range(max(row - 1, 0), min(row + 2, nrows)):
        begin, end = start[r * ncols + max(col - 1, 0)], start[r * ncols + min(col + 2, ncols)]
        xs, ys, zs = x[begin:end], y[begin:end], z[begin:end]
        for k in range(end - begin):
            dx, dy, dz = xs[k] - px, ys[k] - py, zs[k] - pz
            flat = dx * dx + dy * dy
            m += flat <= limit
            below = np.int64(dz if flat <= limit else 0.0)
            lowest = below if below < lowest else lowest
            square[k] = flat + dz * dz
        for k in range(end - begin):
            near[n] = np.uint64(begin + k)
            n += square[k] <= limit
    return m, n, lowest


@kernel
def _add(x, y, z, first, last, i, near, sums):  # type: ignore[no-untyped-def]
    """The sums over the points `near` point i, relative to it."""
    px, py, pz = x[i], y[i], z[i]
    sx = sy = sz = xx = xy = xz = yy = yz = zz = low = high = firsts = lasts = 0.0
    for j in near:
        dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
        sx += dx
        sy += dy
        sz += dz
        xx += dx * dx
        xy += dx * dy
        xz += dx * dz
        yy += dy * dy
        yz += dy * dz
        zz += dz * dz
        low = dz if dz < low else low
        high = dz if dz > high else high
        firsts += first[j]
        lasts += last[j]
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = sx, sy, sz, xx, xy, xz
    sums[6], sums[7], sums[8], sums[9], sums[10], sums[11] = yy, yz, zz, high - low, firsts, lasts


@kernel
def _finish(n, m, sums, above, radius, out):  # type: ignore[no-untyped-def]
    """The features from the sums; n² times the covariance is a difference of exact integers."""
    sx, sy, sz, square = sums[0], sums[1], sums[2], n * n
    a, b, c = (n * sums[3] - sx * sx) / square, (n * sums[4] - sx * sy) / square, (n * sums[5] - sx * sz) / square
    d, e, f = (n * sums[6] - sy * sy) / square, (n * sums[7] - sy * sz) / square, (n * sums[8] - sz * sz) / square
    l1, l2, l3 = eigenvalues(a, b, c, d, e, f)
    out[12:15] = np.nan
    out[2:6] = np.nan
    if n >= 3.0 and l1 > 0.0:
        out[12], out[13], out[14] = normal(a, b, c, d, e, f, l1, l2, l3)
        out[2] = (l1 - l2) / l1
        out[3] = (l2 - l3) / l1
        out[4] = l3 / l1
        out[5] = math.sqrt(l3) * 0.001
    out[0] = math.degrees(math.acos(min(1.0, out[14]))) if out[14] >= 0.0 else np.nan
    out[1] = n / m
    out[6] = math.sqrt(f) * 0.001
    out[7] = sums[9] * 0.001
    out[8] = above * 0.001
    out[9] = m / (math.pi * (radius * 0.001) ** 2)
    out[10] = sums[10] / n
    out[11] = sums[11] / n
