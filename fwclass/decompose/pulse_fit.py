"""One waveform to its echoes: peaks, fit, a second look at the residuals, pruning."""

from __future__ import annotations

import math

import numpy as np

from fwclass.decompose.gaussians import evaluate, fit
from fwclass.decompose.peaks import first_echoes, is_peak, level_and_noise, make_template, match_filter, surer
from fwclass.kernel import inlined, kernel

SQRT_PI = math.sqrt(math.pi)
SATURATED, OVERLAPPING, POOR, EDGE = 1, 2, 4, 8
PRUNE = 0.8
"""Share of the detection threshold below which a fitted echo goes: a wide one is surer than its peak."""
FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))

# places in the settings vector of `fit_all`
PULSE_WIDTH, DETECTION, SPLIT_GAIN, NARROWEST, WIDEST, SEPARATION = 0, 1, 2, 3, 4, 5
NOISE_FLOOR, SHAPE_ERROR, POOR_MISFIT, ITERATIONS, TOLERANCE, TAIL_SHARE, TAIL_REACH = 6, 7, 8, 9, 10, 11, 12
SETTINGS = 13


@inlined
def _copy(source, size, target):  # type: ignore[no-untyped-def]
    for a in range(size):
        target[a] = source[a]


@inlined
def _weigh(y, n, top, level, variance, shape_error, weight):  # type: ignore[no-untyped-def]
    """Weights 1 / variance; saturated samples count nothing; the pulse's own shape is known to `shape_error` of its
    height. The number of samples that count."""
    used = 0
    for i in range(n):
        if y[i] >= top:
            weight[i] = 0.0
            continue
        height = 0.25 * y[max(i - 1, 0)] + 0.5 * y[i] + 0.25 * y[min(i + 1, n - 1)] - level
        shape = shape_error * max(height, 0.0)
        weight[i] = 1.0 / (variance + shape * shape)
        used += 1
    return used


@inlined
def _worst_shape(p, count, y, weight, n, model, basis, window, tried):  # type: ignore[no-untyped-def]
    """The echo whose residuals look most like two echoes: (score, echo, skewness).

    Score test against Gauss-Hermite terms of third and fourth order; chi-square with two degrees of freedom.
    """
    worst, at, lean = 0.0, -1, 0.0
    for k in range(count):
        if tried[k]:
            continue
        t, s = p[3 * k + 2], p[3 * k + 3]
        skew, peaked, information = 0.0, 0.0, 0.0
        for i in range(window[k, 0], window[k, 1]):
            d = (i - t) / s
            g = weight[i] * (y[i] - model[i]) * basis[k, 0, i]
            skew += g * d * (8.0 * d * d - 12.0)
            peaked += g * (16.0 * d**4 - 48.0 * d * d + 12.0)
            information += weight[i] * basis[k, 0, i] ** 2
        scale = information if information > 0.0 else 1.0
        score = (skew * skew / 48.0 + peaked * peaked / 384.0) / scale
        if score > worst:
            worst, at, lean = score, k, skew
    return worst, at, lean


@inlined
def _split_start(p, count, k, lean, later, sigma, trial):  # type: ignore[no-untyped-def]
    """``trial`` = `p` with echo k as two system pulses of the same mean and variance, `later` the second's share."""
    _copy(p, 3 * count + 1, trial)
    a, b = 3 * k + 1, 3 * count + 1
    narrow = 1.02 * sigma
    spread = max(p[a + 2] ** 2 - sigma * sigma, 0.3)
    apart = max(math.sqrt(spread / (later * (1.0 - later))), 1.2)
    whole = p[a] * p[a + 2] / narrow
    trial[a], trial[a + 1], trial[a + 2] = whole * (1.0 - later), p[a + 1] - later * apart, narrow
    trial[b], trial[b + 1], trial[b + 2] = whole * later, p[a + 1] + (1.0 - later) * apart, narrow


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


@kernel
def second_look(p, count, chi, y, weight, n, prior, limits, bounds, template, half, work, spare):  # type: ignore[no-untyped-def]
    """Add or split echoes while the fit gains significantly; (echoes, chi).

    The gain counts in units of the new fit's own misfit where that is above 1, so that neither an underestimated
    noise nor a pulse of another shape makes echoes (an F test).
    `bounds` is (sigma, detection threshold, gain, separation, most echoes, variance of the noise, samples used).
    """
    sigma, threshold, gain, apart, most = bounds[0], bounds[1], bounds[2], bounds[3], int(bounds[4])
    model, basis, window = work[0], work[1], work[2]
    residual, filtered, trial, best, tried = spare
    variance, used = bounds[5], bounds[6]
    tried[:] = False
    for _ in range(2 * most):
        if count >= most or 3 * count + 5 > n:
            break
        for i in range(n):
            residual[i] = (y[i] - model[i]) * weight[i] * variance
        match_filter(residual, n, template, half, filtered)
        peak = -1
        for i in range(n):
            if filtered[i] > threshold and is_peak(filtered, n, i) and (peak < 0 or filtered[i] > filtered[peak]):
                peak = i
        score, k, lean = _worst_shape(p, count, y, weight, n, model, basis, window, tried)
        split = score > gain
        if peak < 0 and not split:
            break
        price = gain / max(used - 3.0 * count - 4.0, 1.0)
        best_chi = chi
        found = False
        if peak >= 0:
            _copy(p, 3 * count + 1, trial)
            a = 3 * count + 1
            trial[a], trial[a + 1], trial[a + 2] = filtered[peak], float(peak), 1.02 * sigma
            new = fit(trial, count + 1, y, weight, n, prior, limits, work)
            if new < best_chi and chi - new > max(gain, price * new) and _sound(trial, count, 0.5 * threshold, apart):
                found, best_chi = True, new
                _copy(trial, 3 * count + 4, best)
        if split:
            tried[k] = True
            for attempt in range(2):
                later = 0.5 if attempt == 1 else (0.28 if lean > 0.0 else 0.72)
                _split_start(p, count, k, lean, later, sigma, trial)
                new = fit(trial, count + 1, y, weight, n, prior, limits, work)
                if (
                    new < best_chi
                    and chi - new > max(gain, price * new)
                    and _sound(trial, count, 0.5 * threshold, apart)
                ):
                    found, best_chi = True, new
                    _copy(trial, 3 * count + 4, best)
        if found:
            _copy(best, 3 * count + 4, p)
            count += 1
            chi = best_chi
            tried[:] = False
        evaluate(p, count, y, weight, n, model, basis, window)
        if not found and not split:
            break
    return count, chi


@inlined
def _weakest(p, count, noise):  # type: ignore[no-untyped-def]
    """(significance, echo) of the least significant echo: its height over the noise of a filter of its width."""
    least, at = 1e300, -1
    for k in range(count):
        q = p[3 * k + 1] * math.sqrt(SQRT_PI * p[3 * k + 3]) / noise
        if q < least:
            least, at = q, k
    return least, at


@inlined
def _by_time(p, count):  # type: ignore[no-untyped-def]
    """Sort the echoes of `p` by time."""
    for a in range(1, count):
        b = a
        while b > 0 and p[3 * b + 2] < p[3 * b - 1]:
            for c in range(1, 4):
                p[3 * b + c], p[3 * (b - 1) + c] = p[3 * (b - 1) + c], p[3 * b + c]
            b -= 1


@inlined
def _without_tails(p, count, share, reach):  # type: ignore[no-untyped-def]
    """Drop echoes lower than `share` of one up to `reach` samples before: the receiver's ringing. The others, by
    time as before, keep the values that they have beside it."""
    kept = 0
    for k in range(count):
        ringing = False
        for m in range(k):
            near = p[3 * k + 2] - p[3 * m + 2] <= reach
            if near and p[3 * k + 1] < share * p[3 * m + 1]:
                ringing = True
        p[3 * k + 3] = -1.0 if ringing else p[3 * k + 3]
    for k in range(count):
        if p[3 * k + 3] > 0.0:
            for c in range(1, 4):
                p[3 * kept + c] = p[3 * k + c]
            kept += 1
    return kept


@inlined
def _flags(p, count, k, y, n, top, misfit, poor):  # type: ignore[no-untyped-def]
    t, s = p[3 * k + 2], p[3 * k + 3]
    flags = 0
    for i in range(max(int(t - 2.0 * s), 0), min(int(t + 2.0 * s) + 2, n)):
        if y[i] >= top:
            flags |= SATURATED
    for m in range(count):
        if m != k and abs(p[3 * m + 2] - t) < 0.75 * FWHM * (s + p[3 * m + 3]):
            flags |= OVERLAPPING
    if misfit > poor:
        flags |= POOR
    if t - FWHM * s < 0.0 or t + FWHM * s > n - 1.0:
        flags |= EDGE
    return flags


@kernel
def fit_pulse(y, n, top, spacing, settings, most, p, work, spare, weight, template):  # type: ignore[no-untyped-def]
    """Echoes of ``y[:n]`` into `p`, sorted by time; (count, misfit)."""
    residual, filtered = spare[0], spare[1]
    sigma = settings[PULSE_WIDTH] / (FWHM * spacing)
    level, noise, kept = level_and_noise(y, n, settings[NOISE_FLOOR], residual)
    p[0] = level
    if n < 5:
        return 0, np.nan
    variance = noise * noise
    used = _weigh(y, n, top, level, variance, settings[SHAPE_ERROR], weight)
    half, energy = make_template(sigma, template)
    detection = surer(settings[DETECTION], kept - 1)
    threshold = detection * noise / math.sqrt(energy)
    for i in range(n):
        residual[i] = y[i] - level
    match_filter(residual, n, template, half, filtered)
    count = first_echoes(filtered, n, threshold, sigma, min(most, max((used - 2) // 3, 0)), p)
    if count == 0:
        return 0, np.nan
    prior = (level, 0.25 / variance)
    limits = (
        settings[NARROWEST] * sigma,
        settings[WIDEST] * sigma,
        settings[ITERATIONS],
        settings[TOLERANCE],
    )
    chi = fit(p, count, y, weight, n, prior, limits, work)
    bounds = (
        sigma,
        threshold,
        settings[SPLIT_GAIN],
        settings[SEPARATION] / spacing,
        float(most),
        variance,
        float(used),
    )
    count, chi = second_look(p, count, chi, y, weight, n, prior, limits, bounds, template, half, work, spare)
    while count > 0:
        least, k = _weakest(p, count, noise)
        if least >= PRUNE * detection:
            break
        for a in range(3 * k + 1, 3 * count - 2):
            p[a] = p[a + 3]
        count -= 1
        if count > 0:
            chi = fit(p, count, y, weight, n, prior, limits, work)
    _by_time(p, count)
    misfit = chi / max(used - 3 * count - 1, 1)
    return _without_tails(p, count, settings[TAIL_SHARE], settings[TAIL_REACH] / spacing), misfit


@kernel
def fit_all(samples, offsets, spacing, top, settings, most, length, count, values, baseline, misfit, flags):  # type: ignore[no-untyped-def]
    """Every waveform of a batch.

    Parameters
    ----------
    samples, offsets : ragged samples [DN].
    spacing, top : per waveform, sample spacing [ns] and saturation [DN].
    settings : `SETTINGS` numbers, in the order of this module's constants.
    most, length : echoes at most; samples of the longest waveform.
    count : int64 (n,), filled with the number of echoes.
    values : float64 (n, most, 3), filled with amplitude [DN], time [ns], FWHM [ns].
    baseline, misfit : float64 (n,) [DN], reduced chi-square.
    flags : uint8 (n, most).
    """
    size = 3 * most + 1
    work = (
        np.empty(length), np.empty((most, 3, length)), np.zeros((most, 2), np.int64), np.empty((size, size)),
        np.empty(size), np.empty((size, size)), np.empty(size), np.empty(size),
    )  # fmt: skip
    spare = (np.empty(length), np.empty(length), np.empty(size), np.empty(size), np.zeros(most, np.bool_))
    y, weight, p, template = np.empty(length), np.empty(length), np.empty(size), np.empty(257)
    for w in range(len(count)):
        n = offsets[w + 1] - offsets[w]
        for i in range(n):
            y[i] = samples[offsets[w] + i]
        found, chi = fit_pulse(y, n, top[w], spacing[w], settings, most, p, work, spare, weight, template)
        count[w], misfit[w], baseline[w] = found, chi, p[0]
        for k in range(found):
            values[w, k, 0] = p[3 * k + 1]
            values[w, k, 1] = p[3 * k + 2] * spacing[w]
            values[w, k, 2] = p[3 * k + 3] * FWHM * spacing[w]
            flags[w, k] = _flags(p, found, k, y, n, top[w], chi, settings[POOR_MISFIT])
