"""A second look at a fitted waveform: echoes are added or split while the fit gains significantly."""

from __future__ import annotations

import math
from typing import NamedTuple

from fwclass.decompose.least_squares import bound_time, fit, lay
from fwclass.decompose.peaks import is_peak, match_filter, next_above, surer
from fwclass.kernel import inlined, vectorised

TRIGGER = 0.6
"""Share of the gain that a split must bring, at which the score test lets a split be tried."""


LONG = 160.0
"""Samples of a waveform up to which a further echo's threshold holds: more are more chances, and it becomes
sqrt(z^2 + 2 ln(n / LONG)), which keeps the false echoes of a waveform as rare."""


class Settings(NamedTuple):
    """Numbers of `DecomposeParams` that the kernels need; times and widths in samples, heights in DN."""

    detection: float
    split_gain: float
    narrowest: float
    widest: float
    separation: float
    noise_floor: float
    shape_error: float
    poor_misfit: float
    iterations: float
    tolerance: float
    tail_share: float
    tail_reach: float
    sigma: float
    between: float
    further: float


@inlined
def _copy(source, size, target):  # type: ignore[no-untyped-def]
    for a in range(size):
        target[a] = source[a]


@vectorised
def _times(one, two, n, out):  # type: ignore[no-untyped-def]
    for i in range(n):
        out[i] = one[i] * two[i]


@inlined
def _highest_peak(z, n, threshold):  # type: ignore[no-untyped-def]
    """The highest peak above `threshold`, -1 without one."""
    peak = -1
    i = next_above(z, 0, n, threshold)
    while i < n:
        if is_peak(z, n, i) and (peak < 0 or z[i] > z[peak]):
            peak = i
        i = next_above(z, i + 1, n, threshold)
    return peak


@vectorised
def _scores(parts, weight, residual, length):  # type: ignore[no-untyped-def]
    """(sum of w r h_ts, of w r h_ss, of w h^2, of h^2) over an echo's samples."""
    lean, flat, weighted, plain = 0.0, 0.0, 0.0, 0.0
    for j in range(length):
        wr = weight[j] * residual[j]
        h = parts[0, j]
        lean += wr * parts[4, j]
        flat += wr * parts[5, j]
        weighted += weight[j] * h * h
        plain += h * h
    return lean, flat, weighted, plain


@inlined
def _worst_shape(count, weight, residual, window, look, tried):  # type: ignore[no-untyped-def]
    """The echo whose residuals look most like two echoes: (score [DN^2], echo, skewness).

    Two echoes close together differ from a wide one in the directions of the second derivatives by (t, s) and (s, s)
    of the model: score test with two degrees of freedom.
    """
    worst, at, skew = 0.0, -1, 0.0
    for k in range(count):
        if tried[k]:
            continue
        cell = window[k, 2]
        start, length = window[k, 0], look.length[cell]
        lean, flat, weighted, plain = _scores(
            look.table[window[k, 3]], weight[start : start + length], residual[start : start + length], length
        )
        share = max(weighted / plain, 1e-3)
        inverse = look.score[cell]
        score = (lean * lean * inverse[0] + 2.0 * lean * flat * inverse[1] + flat * flat * inverse[2]) / share
        if score > worst:
            worst, at, skew = score, k, lean
    return worst, at, skew


@inlined
def _split_start(p, count, k, later, sigma, n, trial):  # type: ignore[no-untyped-def]
    """``trial`` = `p` with echo k as two system pulses of the same mean and variance, `later` the second's share,
    both held to where an echo of `n` samples may lie."""
    _copy(p, 3 * count + 1, trial)
    a, b = 3 * k + 1, 3 * count + 1
    narrow = 1.02 * sigma
    spread = max(p[a + 2] ** 2 - sigma * sigma, 0.14 * sigma * sigma)
    apart = max(math.sqrt(spread / (later * (1.0 - later))), 0.8 * sigma)
    whole = p[a] * p[a + 2] / narrow
    first, second = bound_time(p[a + 1] - later * apart, n), bound_time(p[a + 1] + (1.0 - later) * apart, n)
    trial[a], trial[a + 1], trial[a + 2] = whole * (1.0 - later), first, narrow
    trial[b], trial[b + 1], trial[b + 2] = whole * later, second, narrow


@inlined
def _sound(p, count, least, apart):  # type: ignore[no-untyped-def]
    """The newest echo is high enough and far enough from every other."""
    new = 3 * count + 1
    if p[new] < least:
        return False
    for k in range(count):
        if p[3 * k + 1] < least or abs(p[new + 1] - p[3 * k + 2]) < apart:
            return False
    return True


@inlined
def posterior(chi, freedom, known):  # type: ignore[no-untyped-def]
    """(variance of the noise, its degrees of freedom) after a fit; `known` is the receiver's (variance, freedom,
    least variance)."""
    freedom = max(freedom, 1.0)
    return max((known[0] * known[1] + chi) / (known[1] + freedom), known[2]), known[1] + freedom


@inlined
def _pays(chi, new, freedom, gain, known):  # type: ignore[no-untyped-def]
    """Whether a fit's drop of chi-square from `chi` to `new` pays for one more echo: an F test on this waveform alone,
    so that neither an underestimated noise nor a pulse of another shape makes echoes."""
    freedom = max(freedom, 1.0)
    return chi - new > gain * (1.0 + 0.5 * gain / freedom) * max(new / freedom, known[2])


@inlined
def second_look(  # type: ignore[no-untyped-def]
    p, count, chi, y, weight, pad, n, prior, limits, used, quiet, known, settings, most, look, sums, work, spare
):
    """Add or split echoes while the fit gains significantly; (echoes, chi).

    `quiet` is (variance, degrees of freedom) of the noise as first estimated. On return `residual`, `basis` and
    `window` of `work` belong to `p`.
    """
    residual, basis, window = work[0], work[1], work[2]
    weighted, filtered, trial, best, tried = spare
    tried[:] = False
    gain = settings.split_gain
    lay(p, count, y, pad, n, look, residual, basis, window)
    for _ in range(2 * most):
        if count >= most or 3 * count + 5 > used:
            break
        variance, freedom = posterior(chi, used - 3.0 * count - 1.0, known)
        variance = min(variance, quiet[0])
        further = settings.further * surer(settings.detection, freedom)
        if n > LONG:
            further = math.sqrt(further * further + 2.0 * math.log(n / LONG))
        threshold = further * math.sqrt(variance / look.energy)
        _times(residual[pad:], weight[pad:], n, weighted[pad:])
        match_filter(weighted, pad, n, look.template, look.template_first, filtered)
        peak = _highest_peak(filtered, n, threshold)
        score, k, skew = _worst_shape(count, weight, residual, window, look, tried)
        split = score > TRIGGER * gain * variance
        if peak < 0 and not split:
            break
        improved, best_chi = False, chi
        left = used - 3.0 * count - 4.0
        least = 0.5 * threshold
        if peak >= 0:
            _copy(p, 3 * count + 1, trial)
            a = 3 * count + 1
            trial[a], trial[a + 1], trial[a + 2] = filtered[peak], float(peak), 1.02 * settings.sigma
            new = fit(trial, count + 1, y, weight, pad, n, prior, limits, look, sums, work)
            if (
                new < best_chi
                and _pays(chi, new, left, gain, known)
                and _sound(trial, count, least, settings.separation)
            ):
                improved, best_chi = True, new
                _copy(trial, 3 * count + 4, best)
        if split and not improved:
            tried[k] = True
            for attempt in range(2):
                later = 0.5 if attempt == 1 else (0.28 if skew > 0.0 else 0.72)
                _split_start(p, count, k, later, settings.sigma, n, trial)
                new = fit(trial, count + 1, y, weight, pad, n, prior, limits, look, sums, work)
                if _pays(chi, new, left, gain, known) and _sound(trial, count, least, settings.separation):
                    improved, best_chi = True, new
                    _copy(trial, 3 * count + 4, best)
                    break
        if improved:
            _copy(best, 3 * count + 4, p)
            count += 1
            chi = best_chi
            tried[:] = False
        lay(p, count, y, pad, n, look, residual, basis, window)
        if not improved and not split:
            break
    return count, chi
