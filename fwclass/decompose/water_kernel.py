"""Whether a waveform is one of water, and what its surface and bottom are: the model of `water_model` held against the
plain echoes."""

from __future__ import annotations

import math

import numpy as np

from fwclass.decompose.fitted_echoes import EDGE, OVERLAPPING, SATURATED
from fwclass.decompose.normal_equations import factorise, solve
from fwclass.decompose.sample_weights import load_samples, weigh_samples, whiten
from fwclass.decompose.water_model import best_decay, descend, equations, make_white, project
from fwclass.kernel import inlined, kernel
from fwclass.units import FWHM_PER_SIGMA

FEWEST = 16
"""Samples that count, without which seven numbers are not asked for."""
FOUND, T_S, A_S, DECAY, A_C, T_B, A_B, LEVEL = 0, 1, 2, 3, 4, 5, 6, 7
VAR_A_S, VAR_A_B, VAR_S, VAR_B, COVARIANCE, MISFIT, NOISE, DEV_S, DEV_B, FLAGS_S, FLAGS_B = range(8, 19)
ANSWERS = 19
"""Numbers of a waveform's answer: what was found (0 no water, 1 a surface, 2 a bottom too), times [ns], heights [DN],
decay [1/ns], height of the column [DN/ns], level [DN]; variances of heights and times, covariance of the times; reduced
chi-square, noise [DN], deviations (as of an echo) and flags."""


@kernel
def _highest_left(residual, weight, n, after, search):  # type: ignore[no-untyped-def]
    """Time [ns], at least `after`, where the `residual` looks most like an echo; below 0 where it does nowhere."""
    reach, best, at = int(3.0 * search.sigma / search.spacing) + 1, 0.0, -1.0
    for i in range(max(int(math.ceil(after / search.spacing)), 0), n):
        total, energy = 0.0, 0.0
        for j in range(max(i - reach, 0), min(i + reach + 1, n)):
            d = (j - i) * search.spacing / search.sigma
            g = math.exp(-0.5 * d * d)
            total += weight[j] * g * residual[j]
            energy += weight[j] * g * g
        value = total / math.sqrt(energy) if energy > 0.1 else 0.0
        if value > best:
            best, at = value, i * search.spacing
    return at


@inlined
def _plain(y, signal, weight, n, phi, prior, space):  # type: ignore[no-untyped-def]
    """Chi-square [DN^2] of the plain echoes' sum `signal`, with the level that fits best."""
    for i in range(n):
        space[0, i] = y[i] - signal[i]
    make_white(space[:1], n, phi)
    one, two = prior[1], prior[1] * prior[0]
    for i in range(n):
        one += weight[i]
        two += weight[i] * space[0, i]
    level = two / one
    chi = prior[1] * (level - prior[0]) ** 2
    for i in range(n):
        chi += weight[i] * (space[0, i] - level) ** 2
    return chi


@inlined
def _deviation(residual, weight, n, t, search):  # type: ignore[no-untyped-def]
    """Root mean square residual [DN] within an FWHM of `t` [ns]."""
    total, count, reach = 0.0, 0, FWHM_PER_SIGMA * search.sigma
    for i in range(n):
        if weight[i] > 0.0 and abs(i * search.spacing - t) <= reach:
            total += residual[i] ** 2
            count += 1
    return math.sqrt(total / (count * search.innovation)) if count > 0 else np.nan


@inlined
def _flags(y, n, t, other, top, search):  # type: ignore[no-untyped-def]
    """Flags of an echo at `t` beside one at `other` [ns]."""
    flags, fwhm = 0, FWHM_PER_SIGMA * search.sigma
    for i in range(n):
        if y[i] >= top and abs(i * search.spacing - t) <= 2.0 * search.sigma:
            flags |= SATURATED
    if abs(other - t) < 1.5 * fwhm:
        flags |= OVERLAPPING
    if t < fwhm or t > (n - 1) * search.spacing - fwhm:
        flags |= EDGE
    return flags


@kernel
def _likely_bottom(times, later, start, end, white, weight, n, search, phi, prior, work, theta, p):  # type: ignore[no-untyped-def]
    """Time of a bottom [ns] and decay [1/ns] that leave least, of the plain echoes' `times` behind the first and of
    `later`; whether there is any. The surface is kept at `start`."""
    likely, bottom, decay = np.inf, end, search.least_decay
    for c in range(1, len(times) + 1):
        t = times[c] if c < len(times) else later
        if start + search.least_delay <= t <= end:
            theta[0], theta[2] = start, t
            trial = best_decay(theta, True, white, weight, n, search, phi, prior, work, p)
            if trial < likely:
                likely, bottom, decay = trial, t, theta[1]
    return bottom, decay, likely < np.inf


@kernel
def _search_water(best, times, white, weight, n, end, variance, search, phi, prior, work, p):  # type: ignore[no-untyped-def]
    """Put the surface [ns], decay [1/ns] and bottom [ns] of the best model into `best` (3,); whether one fits, and
    whether it has a bottom. `times`: of the plain echoes [ns]."""
    theta, low, high, start = np.empty(3), np.empty(3), np.empty(3), times[0]
    reach, tolerance = FWHM_PER_SIGMA * search.sigma, 1e-3 * variance
    low[0], high[0] = max(start - reach, 0.0), min(start + reach, end)
    low[1], high[1] = search.least_decay, search.most_decay
    theta[0], theta[1], theta[2] = start, search.least_decay, 0.0
    best_decay(theta, False, white, weight, n, search, phi, prior, work, p)
    alone = descend(theta, low, high, False, white, weight, n, search, phi, prior, tolerance, work, p)
    if not alone < np.inf:
        return False, False
    chi = alone if p[1] > 0.0 and p[2] > 0.0 else np.inf
    best[:] = theta
    later = _highest_left(work[2], weight, n, theta[0] + search.least_delay, search)
    later, decay, any_bottom = _likely_bottom(
        times, later, start, end, white, weight, n, search, phi, prior, work, theta, p
    )
    if any_bottom:
        theta[0], theta[1], theta[2] = start, decay, later
        low[2], high[2] = theta[2] - 2.0 * reach, min(theta[2] + 2.0 * reach, end)
        trial = descend(theta, low, high, True, white, weight, n, search, phi, prior, tolerance, work, p)
        sound = p[1] > 0.0 and p[2] > 0.0 and p[3] > 0.0 and theta[2] < end
        needed = search.bottom + 2.0 * math.log(max(n / 72.0, 1.0))
        if trial < chi and alone - trial > needed * variance and sound:
            best[:] = theta
            return True, True
    return chi < np.inf, False


@inlined
def _write_errors(out, bottom, size, variance, upper, move):  # type: ignore[no-untyped-def]
    """Variances of heights and times, from the factors `upper` of the normal equations."""
    unit, heights = np.zeros(7), 4 if bottom else 3
    out[VAR_A_B], out[VAR_B], out[COVARIANCE] = np.nan, np.nan, np.nan
    for a in range(size):
        unit[:] = 0.0
        unit[a] = 1.0
        solve(upper, unit, size, move)
        if a == 1:
            out[VAR_A_S] = variance * move[a]
        elif a == heights:
            out[VAR_S] = variance * move[a]
        elif bottom and a == 3:
            out[VAR_A_B] = variance * move[a]
        elif bottom and a == heights + 2:
            out[VAR_B], out[COVARIANCE] = variance * move[a], variance * move[heights]


@inlined
def _write_echoes(out, best, bottom, p, y, weight, n, top, residual, search):  # type: ignore[no-untyped-def]
    """Times, heights, deviations and flags of surface and bottom. `top`: limit of the samples `y` [DN]."""
    out[FOUND] = 2.0 if bottom else 1.0
    out[T_S], out[A_S], out[DECAY], out[A_C] = best[0], p[1], best[1], p[2]
    out[T_B], out[A_B] = (best[2], p[3]) if bottom else (np.nan, np.nan)
    out[DEV_S] = 1000.0 * _deviation(residual, weight, n, best[0], search) / p[1]
    out[FLAGS_S] = _flags(y, n, best[0], best[2] if bottom else np.inf, top, search)
    out[DEV_B], out[FLAGS_B] = np.nan, 0.0
    if bottom:
        out[DEV_B] = 1000.0 * _deviation(residual, weight, n, best[2], search) / p[3]
        out[FLAGS_B] = _flags(y, n, best[2], best[0], top, search)


@kernel
def fit_water(samples, offsets, rows, signal, top, receiver, starts, starts_of, search, phi, answers):  # type: ignore[no-untyped-def]
    """Look for water in the waveforms `rows` of a batch, all of one sample spacing and kind of noise.

    Parameters
    ----------
    samples, offsets : ragged samples [DN].
    signal : sum of the plain echoes at every sample, without the level [DN].
    top : limit of the samples per waveform [DN].
    receiver : (n, 4) level and its information [samples], variance of the noise made white [DN^2], and freedom.
    starts, starts_of : times [ns] of the plain echoes, ragged.
    search, phi : `Search`, and the noise's autoregression.
    answers : float64 (n, `ANSWERS`), filled at `rows`.
    """
    longest = 0
    for w in rows:
        longest = max(longest, offsets[w + 1] - offsets[w])
    y, white, weight = np.empty(longest), np.empty(longest), np.empty(longest)
    work = (
        np.empty((7, longest)),
        np.empty((7, longest)),
        np.empty(longest),
        np.empty((7, 7)),
        np.empty(7),
        np.empty((7, 7)),
        np.empty(7),
        np.empty(7),
    )
    p, best = np.empty(7), np.empty(3)
    for w in rows:
        out, first, n = answers[w], offsets[w], offsets[w + 1] - offsets[w]
        out[FOUND] = 0.0
        times = starts[starts_of[w] : starts_of[w + 1]]
        if len(times) == 0 or n < FEWEST:
            continue
        end, variance, freedom = (n - 1) * search.spacing, receiver[w, 2], receiver[w, 3]
        base = math.floor(receiver[w, 0])
        used = load_samples(samples, first, n, base, 0, 0, top[w], y, weight)
        for i in range(n):
            white[i] = y[i]
        if len(phi) > 0:
            used = whiten(y, weight, 0, n, 0, used, phi, white)
        if used < FEWEST or times[0] < 2.0 * search.sigma or not variance > 0.0:
            continue
        level = receiver[w, 0] - base
        if search.shape_error > 0.0 or search.growth > 0.0:
            weigh_samples(y, n, level, variance, search.shape_error, search.growth * search.innovation, weight)
        prior = (level * search.level, receiver[w, 1])
        plain = _plain(y, signal[first : first + n], weight, n, phi, prior, work[0])
        fits, bottom = _search_water(best, times, white, weight, n, end, variance, search, phi, prior, work, p)
        if not fits:
            continue
        chi = project(best, bottom, white, weight, n, search, phi, prior, work, p)
        size = equations(p, bottom, best[1], weight, n, prior, work)
        free = max(used - size, 1.0)
        expected = variance
        if freedom > 0.0:
            variance = (variance * freedom + chi) / (freedom + free)
        else:
            variance = max(chi / free, search.floor)
        saved = (plain - chi) / variance + search.price * (3.0 * len(times) + 1.0 - size)
        if not saved > search.gain or not chi <= search.worst * free * expected:
            continue
        hessian, upper, frozen, move = work[3], work[5], work[6], work[7]
        frozen[:] = 0.0
        if not factorise(hessian, frozen, 0.0, size, upper):
            continue
        _write_errors(out, bottom, size, variance, upper, move)
        _write_echoes(out, best, bottom, p, y, weight, n, top[w] - base, work[2], search)
        out[LEVEL], out[MISFIT] = p[0] / search.level + base, chi / (free * expected)
        out[NOISE] = math.sqrt(variance / search.innovation)
