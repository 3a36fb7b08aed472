"""Eigenvalues and normal of symmetric 3 × 3 matrices in closed form."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel

LINE = 1e-6
"""A second eigenvalue below this share of the first is a line (1 mm across 1 m), which has no normal."""

TIE = 1e-9
"""Two eigenvalues closer than this share of the first are equal: no direction is the smallest one's own."""


@kernel
def eigenvalues(a, b, c, d, e, f):  # type: ignore[no-untyped-def]
    """λ1 ≥ λ2 ≥ λ3 ≥ 0 of [[a, b, c], [b, d, e], [c, e, f]], positive semi-definite (Smith 1961)."""
    mean = (a + d + f) / 3.0
    x, y, z = a - mean, d - mean, f - mean
    spread = (x * x + y * y + z * z + 2.0 * (b * b + c * c + e * e)) / 6.0
    if spread <= 0.0:
        return mean, mean, mean
    p = math.sqrt(spread)
    half = (x * (y * z - e * e) - b * (b * z - e * c) + c * (b * e - y * c)) / (2.0 * p * spread)
    angle = math.acos(min(1.0, max(-1.0, half))) / 3.0
    l1 = mean + 2.0 * p * math.cos(angle)
    l3 = mean + 2.0 * p * math.cos(angle + 2.0 * math.pi / 3.0)
    l2 = 3.0 * mean - l1 - l3
    return l1, min(l1, max(l2, 0.0)), max(min(l2, l3), 0.0)


@kernel
def normal(a, b, c, d, e, f, l1, l2, l3):  # type: ignore[no-untyped-def]
    """Unit eigenvector of λ3, pointing up (z ≥ 0); NaN where there is none of its own: see `LINE` and `TIE`.

    It is the longest of the cross products of the rows of the matrix minus λ3, as those rows span its
    complement.
    """
    if not (l1 > 0.0) or l2 <= LINE * l1 or l2 - l3 <= TIE * l1:
        return np.nan, np.nan, np.nan
    a, d, f = a - l3, d - l3, f - l3
    x, y, z = b * e - c * d, c * b - a * e, a * d - b * b
    best = x * x + y * y + z * z
    u, v, w = b * f - c * e, c * c - a * f, a * e - b * c
    length = u * u + v * v + w * w
    if length > best:
        x, y, z, best = u, v, w, length
    u, v, w = d * f - e * e, e * c - b * f, b * e - c * d
    length = u * u + v * v + w * w
    if length > best:
        x, y, z, best = u, v, w, length
    if not (best > 0.0):
        return np.nan, np.nan, np.nan
    scale = 1.0 / math.sqrt(best) if z >= 0.0 else -1.0 / math.sqrt(best)
    return x * scale, y * scale, z * scale
