"""Eigenvalues and normals of many neighbourhoods in closed form, and what lies along a normal.

`shapes` is float64 (SHAPES, K): eigenvalues of the covariance (divided by N) L1 ≥ L2 ≥ L3 ≥ 0 [mm2], the upward unit
normal NX, NY, NZ. With fewer than three echoes or all at one place everything is NaN, on a line the normal is.

No sum is reordered and no product fused here, so a neighbourhood's values do not depend on its place in the batch.
"""

from __future__ import annotations

import math

import numpy as np

from fwclass.features.moments import XX, XY, XZ, YY, YZ, ZZ, N, X, Y, Z
from fwclass.kernel import inlined, kernel

L1, L2, L3, NX, NY, NZ = range(6)
SHAPES = 6

BATCH = 64
"""Neighbourhoods that are solved side by side."""

_IN = ZZ + 1
_ROWS = _IN + SHAPES

LINE = 1e-6
"""A second eigenvalue below this share of the first is a line (1 mm across 1 m), which has no normal."""

TIE = 1e-7
"""Two eigenvalues closer than this share of the first are equal: no direction is the smallest one's own. The closed
form tells two that coincide apart by 1e-8, a square root of float64's step."""

_THIRD = (
    0.5000000000000013,
    0.5773502691889575,
    -0.1111111110507166,
    0.053458355989094555,
    -0.032921764773545505,
    0.02286772514011433,
    -0.017065799041273644,
    0.013342078844840349,
    -0.010718048410521661,
    0.008627152009629468,
    -0.006685757210009395,
    0.004717665253841037,
    -0.0028372969185197815,
    0.0013520990894976843,
    -0.0004677925120737922,
    0.0001029417612297566,
    -1.0717360546616264e-05,
)
_ARC = (
    1.5707963267948954,
    -0.21460183660187016,
    0.0890486224827293,
    -0.05079281201774951,
    0.0336812353558885,
    -0.02437368784838835,
    0.018666998230892108,
    -0.01485549555846364,
    0.012087253096122543,
    -0.009820294014830859,
    0.007661320572693916,
    -0.005430949568544352,
    0.0032761874730474934,
    -0.0015642150160591383,
    0.0005417741454842837,
    -0.00011928566563673716,
    1.2420512885138354e-05,
)


@inlined
def _polynomial(s, c):  # type: ignore[no-untyped-def]
    """Σ c_i s^i of seventeen coefficients, by fours (Estrin's way: the steps do not wait for each other)."""
    q = s * s
    r = q * q
    one = (c[0] + c[1] * s) + q * (c[2] + c[3] * s)
    two = (c[4] + c[5] * s) + q * (c[6] + c[7] * s)
    three = (c[8] + c[9] * s) + q * (c[10] + c[11] * s)
    four = (c[12] + c[13] * s) + q * (c[14] + c[15] * s)
    return one + r * (two + r * (three + r * (four + r * c[16])))


@inlined
def third_angle(s):  # type: ignore[no-untyped-def]
    """cos(2/3 arccos s) for s in [0, 1], to 2e-15; a polynomial, as no vector code calls a cosine."""
    return _polynomial(s, _THIRD)


@inlined
def arc_cosine(s):  # type: ignore[no-untyped-def]
    """arccos s for s in [0, 1], to 2e-15 rad."""
    return math.sqrt(1.0 - s) * _polynomial(s, _ARC)


@kernel
def shapes(moments, out):  # type: ignore[no-untyped-def]
    """Eigenvalues (Smith 1961) and normals of the neighbourhoods `moments` (MOMENTS, K) to `out` (SHAPES, K)."""
    first_shapes(moments, moments.shape[1], out)


@kernel
def first_shapes(moments, columns, out):  # type: ignore[no-untyped-def]
    """As `shapes`, of the first `columns` neighbourhoods."""
    # One array of constant stride for everything: the compiler then sees that no write meets a read.
    work = np.empty((_ROWS, BATCH))
    for begin in range(0, columns, BATCH):
        size = min(BATCH, columns - begin)
        work[:_IN] = 1.0
        for row in range(_IN):
            for k in range(size):
                work[row, k] = moments[row, begin + k]
        _solve(work.reshape(-1))
        for row in range(SHAPES):
            for k in range(size):
                out[row, begin + k] = work[_IN + row, k]


@kernel
def _solve(w):  # type: ignore[no-untyped-def]
    """Rows L1 … NZ, after the first `_IN`, of a full batch from the moments N … ZZ.

    The largest or the smallest eigenvalue, whichever stands apart, is taken from the cosine; where that is the largest,
    the other two are the roots of what is left, as their difference drowns in the cosine's rounding on a line.
    """
    for k in range(BATCH):
        n, x, y, z = w[N * BATCH + k], w[X * BATCH + k], w[Y * BATCH + k], w[Z * BATCH + k]
        share = 1.0 / (n * n)
        a, b = (n * w[XX * BATCH + k] - x * x) * share, (n * w[XY * BATCH + k] - x * y) * share
        c, d = (n * w[XZ * BATCH + k] - x * z) * share, (n * w[YY * BATCH + k] - y * y) * share
        e, f = (n * w[YZ * BATCH + k] - y * z) * share, (n * w[ZZ * BATCH + k] - z * z) * share
        mean = (a + d + f) * (1.0 / 3.0)
        p, q, r = a - mean, d - mean, f - mean
        spread = (p * p + q * q + r * r + 2.0 * (b * b + c * c + e * e)) * (1.0 / 6.0)
        scale = math.sqrt(spread)
        half = (p * (q * r - e * e) - b * (b * r - e * c) + c * (b * e - q * c)) / (2.0 * scale * spread)
        half = half if half < 1.0 else 1.0
        half = half if half > -1.0 else -1.0
        half = half if spread > 0.0 else 0.0
        l1 = mean + 2.0 * scale * third_angle(math.sqrt(0.5 + 0.5 * half))
        l3 = mean - 2.0 * scale * third_angle(math.sqrt(0.5 - 0.5 * half))
        minors = (a * d - b * b) + (a * f - c * c) + (d * f - e * e)
        product = (a * (d * f - e * e) - b * (b * f - e * c) + c * (b * e - d * c)) / l1
        product = product if product > 0.0 else 0.0
        total = (minors - product) / l1
        total = total if total > 0.0 else 0.0
        root = 0.25 * total * total - product
        upper = 0.5 * total + math.sqrt(root if root > 0.0 else 0.0)
        lower = product / upper if upper > 0.0 else 0.0
        lower = lower if lower < 0.5 * total else 0.5 * total  # both are rounding on a line
        l3 = lower if half > 0.0 else l3
        l3 = l3 if l3 > 0.0 else 0.0
        l2 = upper if half > 0.0 else 3.0 * mean - l1 - l3
        l2 = l2 if l2 < l1 else l1
        l2 = l2 if l2 > l3 else l3
        l3 = l3 if l3 < l2 else l2
        # the normal is the longest cross product of two rows of the matrix minus l3: they span its complement
        a, d, f = a - l3, d - l3, f - l3
        u, v, t = b * e - c * d, c * b - a * e, a * d - b * b
        long = u * u + v * v + t * t
        g, h, i = b * f - c * e, c * c - a * f, a * e - b * c
        size = g * g + h * h + i * i
        u, v, t = (g if size > long else u), (h if size > long else v), (i if size > long else t)
        long = size if size > long else long
        g, h, i = d * f - e * e, e * c - b * f, b * e - c * d
        size = g * g + h * h + i * i
        u, v, t = (g if size > long else u), (h if size > long else v), (i if size > long else t)
        long = size if size > long else long
        shaped = n >= 3.0 and l1 > 0.0
        upright = shaped and l2 > LINE * l1 and l2 - l3 > TIE * l1 and long > 0.0
        turn = 1.0 / math.sqrt(long)
        turn = turn if t >= 0.0 else -turn
        w[(_IN + L1) * BATCH + k] = l1 if shaped else np.nan
        w[(_IN + L2) * BATCH + k] = l2 if shaped else np.nan
        w[(_IN + L3) * BATCH + k] = l3 if shaped else np.nan
        w[(_IN + NX) * BATCH + k] = u * turn if upright else np.nan
        w[(_IN + NY) * BATCH + k] = v * turn if upright else np.nan
        w[(_IN + NZ) * BATCH + k] = t * turn if upright else np.nan


@kernel
def along_normal(x, y, z, u, v, w):  # type: ignore[no-untyped-def]
    """Least and greatest place of echoes (x, y, z) [mm] along the unit vector (u, v, w) [mm]; the second pass.

    Places are taken in steps of 1/128 mm (whole numbers have a vector minimum, floats have not).
    """
    u, v, w = np.float32(128.0 * u), np.float32(128.0 * v), np.float32(128.0 * w)
    low, high = np.int32(2**31 - 1), np.int32(-(2**31))
    for k in range(len(x)):
        place = np.int32(np.float32(x[k]) * u + np.float32(y[k]) * v + np.float32(z[k]) * w)
        low = min(low, place)
        high = max(high, place)
    return low / 128.0, high / 128.0
