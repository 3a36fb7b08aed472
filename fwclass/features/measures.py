"""From the sums of neighbourhoods to their features, the same for every kind of neighbourhood.

How a kind of neighbourhood comes to its features, for a batch of K of them:

1. fill `moments` (MOMENTS, K), see `fwclass.features.moments`; `needs(bases)` tells which of its parts;
2. ``shapes(moments, shape)`` where `Needs.shape`;
3. where `Needs.extent`, set NEAR and FAR with ``along_normal`` (`fwclass.features.eigen`), the second pass;
4. ``measure(CODE[base], moments, shape, out)`` for every base; `out` is float32 (K,).

All are relative to the echo that the neighbourhood belongs to: heights, roughness. The words for each stand in
`fwclass.columns.FEATURES`, the arithmetic here, where the order of the tuples of bases gives their codes. Values that
do not exist are NaN: see `fwclass.features.stage.features`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fwclass.features.eigen import L1, L2, L3, NX, NY, NZ, arc_cosine
from fwclass.features.moments import (
    AMPLITUDE,
    AREA,
    CYLINDER,
    FAR,
    FIRST,
    HIGH,
    INTENSITY,
    INTERMEDIATE,
    LOW,
    NEAR,
    PERCENTILE,
    PERCENTILES,
    REACH,
    SINGLE,
    STEP,
    WIDTH,
    ZZ,
    ZZZ,
    ZZZZ,
    N,
    X,
    Y,
    Z,
)
from fwclass.kernel import inlined, kernel
from fwclass.units import QUANTUM

_COUNTS = ("count", "density", "reach", "echo_ratio")
_HEIGHTS = (
    *("height_range", "height_std", "height_variance", "height_skewness", "height_kurtosis"),
    *("height_above_mean", "height_above_lowest", "height_below_highest"),
)
_RANKS = tuple(f"height_above_p{p:02d}" for p in PERCENTILES)
_EIGEN = (
    *("eigenvalue_1", "eigenvalue_2", "eigenvalue_3", "eigenvalue_sum"),
    *("linearity", "planarity", "sphericity", "anisotropy"),
    *("surface_variation", "omnivariance", "eigenentropy", "plane_std"),
)
_NORMAL = ("verticality", "inclination", "roughness", "plane_range", "normal_x", "normal_y", "normal_z")
_KINDS = ("single_share", "first_share", "intermediate_share", "last_share", "egi", "ebi", "evi")
_VALUES = ("amplitude_mean", "amplitude_std", "width_mean", "width_std", "intensity_mean", "intensity_std")

BASES = (*_COUNTS, *_HEIGHTS, *_RANKS, *_EIGEN, *_NORMAL, *_KINDS, *_VALUES)
CODE = {base: code for code, base in enumerate(BASES)}
"""Number of every base that `measure` knows."""

COUNT, DENSITY, FURTHEST, ECHO_RATIO = (CODE[base] for base in _COUNTS)
(
    HEIGHT_RANGE,
    HEIGHT_STD,
    HEIGHT_VARIANCE,
    HEIGHT_SKEWNESS,
    HEIGHT_KURTOSIS,
    ABOVE_MEAN,
    ABOVE_LOWEST,
    BELOW_HIGHEST,
) = (CODE[base] for base in _HEIGHTS)
ABOVE_RANK = CODE[_RANKS[0]]
(
    SHARE_1,
    SHARE_2,
    SHARE_3,
    EIGENVALUE_SUM,
    LINEARITY,
    PLANARITY,
    SPHERICITY,
    ANISOTROPY,
    SURFACE_VARIATION,
    OMNIVARIANCE,
    EIGENENTROPY,
    PLANE_STD,
) = (CODE[base] for base in _EIGEN)
VERTICALITY, INCLINATION, ROUGHNESS, PLANE_RANGE, NORMAL_X = (CODE[base] for base in _NORMAL[:5])
SINGLES, FIRSTS, BETWEENS, LASTS, EGI, EBI, EVI = (CODE[base] for base in _KINDS)
VALUES = CODE[_VALUES[0]]


@dataclass(frozen=True)
class Needs:
    """Parts of the moments that some bases are computed from.

    Attributes
    ----------
    shape : X … ZZ, and the shapes.
    powers : ZZZ, ZZZZ.
    extent : NEAR, FAR (and the shapes).
    kinds : SINGLE, FIRST, INTERMEDIATE.
    amplitude, width, intensity : the attribute's three rows.
    cylinder : CYLINDER.
    percentiles : PERCENTILE.
    """

    shape: bool
    powers: bool
    extent: bool
    kinds: bool
    amplitude: bool
    width: bool
    intensity: bool
    cylinder: bool
    percentiles: bool


def needs(bases: Iterable[str]) -> Needs:
    """What `bases` need besides N, Z, ZZ, LOW and HIGH, which are always there."""
    wanted = set(bases)
    return Needs(
        shape=bool(wanted & {*_EIGEN, *_NORMAL}),
        powers=bool(wanted & {"height_skewness", "height_kurtosis"}),
        extent="plane_range" in wanted,
        kinds=bool(wanted & set(_KINDS)),
        amplitude=bool(wanted & {"amplitude_mean", "amplitude_std"}),
        width=bool(wanted & {"width_mean", "width_std"}),
        intensity=bool(wanted & {"intensity_mean", "intensity_std"}),
        cylinder="echo_ratio" in wanted,
        percentiles=bool(wanted & set(_RANKS)),
    )


@kernel
def measure(code, m, s, out):  # type: ignore[no-untyped-def]
    """Base number `code` of neighbourhoods with moments `m` (MOMENTS, K) and shapes `s` (SHAPES, K) to `out` (K,)."""
    if code < HEIGHT_RANGE:
        _counts(code, m, out)
    elif code < ABOVE_RANK:
        _heights(code, m, out)
    elif code < SHARE_1:
        _scale(m[PERCENTILE + code - ABOVE_RANK], -QUANTUM, out)
    elif code < VERTICALITY:
        _eigen(code, s[L1], s[L2], s[L3], out)
    elif code < SINGLES:
        _normal(code, m, s, out)
    elif code < VALUES:
        _kinds(code, m, out)
    else:
        _values(code - VALUES, m, out)


@kernel
def _scale(values, unit, out):  # type: ignore[no-untyped-def]
    for k in range(len(out)):
        out[k] = values[k] * unit + 0.0  # no minus zero


@kernel
def _counts(code, m, out):  # type: ignore[no-untyped-def]
    n = m[N]
    if code == COUNT:
        _scale(n, 1.0, out)
    elif code == FURTHEST:
        _scale(m[REACH], QUANTUM, out)
    else:
        among = m[AREA] if code == DENSITY else m[CYLINDER]
        for k in range(len(out)):
            out[k] = n[k] / among[k]


@inlined
def _variance(n, z, zz):  # type: ignore[no-untyped-def]
    """Population variance of the heights [mm2]: n² times it is a difference of whole numbers."""
    spread = n * zz - z * z
    return (spread if spread > 0.0 else 0.0) / (n * n)


@kernel
def _heights(code, m, out):  # type: ignore[no-untyped-def]
    n, z, zz, low, high = m[N], m[Z], m[ZZ], m[LOW], m[HIGH]
    if code == HEIGHT_RANGE:
        for k in range(len(out)):
            out[k] = (high[k] - low[k]) * QUANTUM
    elif code == HEIGHT_STD:
        for k in range(len(out)):
            out[k] = math.sqrt(_variance(n[k], z[k], zz[k])) * QUANTUM
    elif code == HEIGHT_VARIANCE:
        for k in range(len(out)):
            out[k] = _variance(n[k], z[k], zz[k]) * (QUANTUM * QUANTUM)
    elif code == ABOVE_MEAN:
        for k in range(len(out)):
            out[k] = -z[k] / n[k] * QUANTUM
    elif code == ABOVE_LOWEST:
        _scale(low, -QUANTUM, out)
    elif code == BELOW_HIGHEST:
        _scale(high, QUANTUM, out)
    else:
        _standard_moments(code, m, out)


@kernel
def _standard_moments(code, m, out):  # type: ignore[no-untyped-def]
    """Skewness or kurtosis from the sums of powers about the echo."""
    n, z, zz, zzz, zzzz, low, high = m[N], m[Z], m[ZZ], m[ZZZ], m[ZZZZ], m[LOW], m[HIGH]
    for k in range(len(out)):
        one, two, three, four = z[k] / n[k], zz[k] / n[k], zzz[k] / n[k], zzzz[k] / n[k]
        variance = _variance(n[k], z[k], zz[k])
        if code == HEIGHT_SKEWNESS:
            value = (three - 3.0 * one * two + 2.0 * one * one * one) / (variance * math.sqrt(variance))
        else:
            value = four - 4.0 * one * three + 6.0 * one * one * two - 3.0 * one * one * one * one
            value = value / (variance * variance)
        out[k] = 0.0 if high[k] == low[k] else value


@kernel
def _eigen(code, l1, l2, l3, out):  # type: ignore[no-untyped-def]
    if code in (SHARE_1, SHARE_2, SHARE_3, SURFACE_VARIATION):
        part = l1 if code == SHARE_1 else l2 if code == SHARE_2 else l3
        for k in range(len(out)):
            out[k] = part[k] / (l1[k] + l2[k] + l3[k])
    elif code == EIGENVALUE_SUM:
        for k in range(len(out)):
            out[k] = (l1[k] + l2[k] + l3[k]) * (QUANTUM * QUANTUM)
    elif code == OMNIVARIANCE:
        for k in range(len(out)):
            out[k] = (l1[k] * l2[k] * l3[k]) ** (1.0 / 3.0) * (QUANTUM * QUANTUM)
    elif code == EIGENENTROPY:
        for k in range(len(out)):
            out[k] = entropy(l1[k], l2[k], l3[k])
    elif code == PLANE_STD:
        for k in range(len(out)):
            out[k] = math.sqrt(l3[k]) * QUANTUM
    else:
        high = l2 if code == PLANARITY else l3 if code == SPHERICITY else l1
        low = l2 if code == LINEARITY else l3
        for k in range(len(out)):
            out[k] = (high[k] if code == SPHERICITY else high[k] - low[k]) / l1[k]


@kernel
def entropy(l1, l2, l3):  # type: ignore[no-untyped-def]
    """−Σ s ln s [nat] of the shares of three eigenvalues [m²], of which the first is above 0; 0 ln 0 is 0."""
    total = l1 + l2 + l3
    entropy = -(l1 / total) * math.log(l1 / total)
    if l2 > 0.0:
        entropy -= l2 / total * math.log(l2 / total)
    if l3 > 0.0:
        entropy -= l3 / total * math.log(l3 / total)
    return max(entropy, 0.0) if entropy == entropy else np.nan


@kernel
def _normal(code, m, s, out):  # type: ignore[no-untyped-def]
    u, v, w = s[NX], s[NY], s[NZ]
    if code >= NORMAL_X:
        _scale(s[NX + code - NORMAL_X], 1.0, out)
    elif code == VERTICALITY:
        for k in range(len(out)):
            out[k] = max(1.0 - w[k], 0.0) if w[k] == w[k] else np.nan
    elif code == INCLINATION:
        for k in range(len(out)):
            up = w[k] if w[k] < 1.0 else 1.0
            out[k] = arc_cosine(up) * (180.0 / math.pi) if w[k] == w[k] else np.nan
    elif code == ROUGHNESS:
        n, x, y, z = m[N], m[X], m[Y], m[Z]
        for k in range(len(out)):
            out[k] = abs(x[k] * u[k] + y[k] * v[k] + z[k] * w[k]) / n[k] * QUANTUM
    else:
        near, far = m[NEAR], m[FAR]
        for k in range(len(out)):
            out[k] = (far[k] - near[k]) * QUANTUM if w[k] == w[k] else np.nan


@kernel
def _kinds(code, m, out):  # type: ignore[no-untyped-def]
    n, single, first, between = m[N], m[SINGLE], m[FIRST], m[INTERMEDIATE]
    one = 1.0 if code in (SINGLES, EGI, EBI) else 0.0
    two = 1.0 if code in (FIRSTS, EBI, EVI) else 0.0
    three = 1.0 if code in (BETWEENS, EVI) else 0.0
    last = 1.0 if code in (LASTS, EGI) else 0.0
    for k in range(len(out)):
        rest = n[k] - single[k] - first[k] - between[k]
        out[k] = (one * single[k] + two * first[k] + three * between[k] + last * rest) / n[k]


@kernel
def _values(code, m, out):  # type: ignore[no-untyped-def]
    """Mean (even) or standard deviation (odd) of an attribute, in its own unit."""
    row = AMPLITUDE if code < 2 else WIDTH if code < 4 else INTENSITY
    unit = 1.0 if row == INTENSITY else STEP
    count, total, squares = m[row], m[row + 1], m[row + 2]
    for k in range(len(out)):
        if code % 2 == 0:
            out[k] = total[k] / count[k] * unit
        else:
            out[k] = math.sqrt(_variance(count[k], total[k], squares[k])) * unit if count[k] > 0.0 else np.nan
