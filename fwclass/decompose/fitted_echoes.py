"""Echoes that are fitted to one waveform: their order, flags, standard errors, and which of them are not to be kept.

`p` holds the parameters of a waveform: its level [DN], then height [DN], time and sigma [samples] of `count` echoes.
"""

from __future__ import annotations

import math

import numpy as np

from fwclass.decompose.normal_equations import factorise, normal_equations, variances
from fwclass.kernel import inlined, vectorised
from fwclass.units import FWHM_PER_SIGMA

SATURATED, OVERLAPPING, POOR, EDGE = 1, 2, 4, 8
"""Values of `fit_flags`."""

IDENTIFIED = 0.5
"""Height over its standard error that each of several echoes must have: two echoes on one place explain samples
better than one, and yet neither has a height."""


@vectorised
def _energy(profile, weight, length):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(length):
        total += weight[j] * profile[j] * profile[j]
    return total


@inlined
def weakest(p, count, weight, basis, window, noise):  # type: ignore[no-untyped-def]
    """(significance, echo) of the least significant echo: its height over the `noise` [DN] of a filter of its shape."""
    least, at = 1e300, -1
    for k in range(count):
        start = window[k, 0]
        energy = _energy(basis[k, 0], weight[start:], window[k, 1] - start)
        q = p[3 * k + 1] * math.sqrt(energy) / noise
        if q < least:
            least, at = q, k
    return least, at


@inlined
def leave_out(p, count, k):  # type: ignore[no-untyped-def]
    """Close the gap that echo k of `p`, float64 (3 count + 1,), leaves; how many remain."""
    for a in range(3 * k + 1, 3 * count - 2):
        p[a] = p[a + 3]
    return count - 1


@inlined
def by_time(p, count):  # type: ignore[no-untyped-def]
    """Sort the echoes of `p`, float64 (3 count + 1,), by time; whether any moved."""
    moved = False
    for a in range(1, count):
        b = a
        while b > 0 and p[3 * b + 2] < p[3 * b - 1]:
            for c in range(1, 4):
                p[3 * b + c], p[3 * (b - 1) + c] = p[3 * (b - 1) + c], p[3 * b + c]
            b -= 1
            moved = True
    return moved


@inlined
def mark_dropped(p, count, n, share, reach, drop):  # type: ignore[no-untyped-def]
    """Mark in `drop`, bool (count,), echoes that are fitted but not reported: those that peak outside the segment, and
    those lower than `share` of one up to `reach` samples before, the receiver's ringing."""
    for k in range(count):
        t = p[3 * k + 2]
        drop[k] = t < -0.5 or t > n - 0.5
        for m in range(k):
            if t - p[3 * m + 2] <= reach and p[3 * k + 1] < share * p[3 * m + 1]:
                drop[k] = True


@inlined
def _are_near(p, k, m):  # type: ignore[no-untyped-def]
    """Whether echoes k and m are nearer to each other than their two widths allow to separate well."""
    return abs(p[3 * m + 2] - p[3 * k + 2]) < 0.75 * FWHM_PER_SIGMA * (p[3 * k + 3] + p[3 * m + 3])


@inlined
def _overlaps(p, count, k):  # type: ignore[no-untyped-def]
    """Whether another echo is near to echo k."""
    for m in range(count):
        if m != k and _are_near(p, k, m):
            return True
    return False


@inlined
def at_edge(p, k, n):  # type: ignore[no-untyped-def]
    """Whether echo k of `p`, float64 (3 count + 1,), reaches beyond the first or the last of `n` samples."""
    t, reach = p[3 * k + 2], FWHM_PER_SIGMA * p[3 * k + 3]
    return t - reach < 0.0 or t + reach > n - 1.0


@inlined
def flags_of(p, count, k, y, pad, n, top, misfit, poor, drop):  # type: ignore[no-untyped-def]
    """The flags of echo k of `p`, float64 (3 count + 1,), by `n` samples `y` [DN] from `pad` on, which are saturated
    from `top` [DN] on, and the echoes that are not marked in `drop`, bool (count,)."""
    t, s = p[3 * k + 2], p[3 * k + 3]
    flags = 0
    for i in range(max(int(t - 2.0 * s), 0), min(int(t + 2.0 * s) + 2, n)):
        if y[pad + i] >= top:
            flags |= SATURATED
    for m in range(count):
        if m != k and not drop[m] and _are_near(p, k, m):
            flags |= OVERLAPPING
    if misfit > poor:
        flags |= POOR
    if at_edge(p, k, n):
        flags |= EDGE
    return flags


@inlined
def rms_near(residual, weight, pad, n, t, reach):  # type: ignore[no-untyped-def]
    """Root mean square residual [DN] of the samples that count within `reach` of t."""
    total, count = 0.0, 0
    for i in range(max(int(math.ceil(t - reach)), 0), min(int(math.floor(t + reach)) + 1, n)):
        if weight[pad + i] > 0.0:
            total += residual[pad + i] ** 2
            count += 1
    return math.sqrt(total / count) if count > 0 else np.nan


@inlined
def least_known(p, count, n, errors):  # type: ignore[no-untyped-def]
    """The echo whose height, by `errors`, float64 (3 count + 1,), is least sure, if it is less sure than `IDENTIFIED`
    and another one or the record's edge is near; -1 otherwise. One that stands alone between two samples is there,
    whatever its height."""
    least, at = IDENTIFIED, -1
    for k in range(count):
        sure = p[3 * k + 1] / errors[3 * k + 1]
        if not sure >= least and (_overlaps(p, count, k) or at_edge(p, k, n)):
            least, at = sure if sure == sure else -1.0, k
    return at


@inlined
def standard_errors(p, count, weight, noise, prior_information, sums, work, out):  # type: ignore[no-untyped-def]
    """Fill ``out[:3 count + 1]`` with the parameters' standard errors, after `lay` at `p`; NaN if singular."""
    residual, basis, window, hessian, gradient, upper, move, _, frozen = work
    size = 3 * count + 1
    normal_equations(p, count, weight, residual, basis, window, sums[0], 0.0, hessian, gradient)
    hessian[0, 0] += prior_information
    for a in range(size):
        frozen[a] = 0.0
    if factorise(hessian, frozen, 0.0, size, upper):
        variances(upper, size, move, out)
        for a in range(size):
            out[a] = noise * math.sqrt(out[a])
    else:
        out[:size] = np.nan
