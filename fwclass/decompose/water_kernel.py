"""Green light into water: an echo of the surface, an exponential column, and an echo of the bottom, fitted together.

y(t) = b + A_s g(t - t_s) + A_c C(t - t_s) + A_b g(t - t_b), where g is a Gaussian of the system pulse's width and unit
height, and C(u) its convolution with exp(-k tau) from 0 to t_b - t_s, or without an end where no bottom shows. Times
are in ns. Level and heights follow from the other three by linear least squares (variable projection); t_s, k and t_b
by damped Gauss-Newton steps within bounds.

Sources: Abdallah and others 2012, Abady and others 2014 (the model); Grushka 1972 (the integral); Kaufman 1975 (the
steps).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fwclass.decompose.normal_equations import factorise, solve
from fwclass.decompose.pulse_fit import EDGE, OVERLAPPING, SATURATED
from fwclass.decompose.sample_weights import load_samples, weigh_samples, whiten
from fwclass.kernel import inlined, kernel
from fwclass.units import FWHM_PER_SIGMA

ENDLESS = 1e5
"""Length [ns] of a column without a bottom."""
FROZEN = 1e30
FEWEST = 16
"""Samples that count, without which seven numbers are not asked for."""
STARTS = 3
"""Decays that are tried first."""
SQRT_HALF_PI, SQRT_HALF = math.sqrt(0.5 * math.pi), math.sqrt(0.5)
FOUND, T_S, A_S, DECAY, A_C, T_B, A_B, LEVEL = 0, 1, 2, 3, 4, 5, 6, 7
VAR_A_S, VAR_A_B, VAR_S, VAR_B, COVARIANCE, MISFIT, NOISE, DEV_S, DEV_B, FLAGS_S, FLAGS_B = range(8, 19)
ANSWERS = 19
"""Numbers of a waveform's answer: what was found (0 no water, 1 a surface, 2 a bottom too), times [ns], heights [DN],
decay [1/ns], height of the column [DN/ns], level [DN]; variances of heights and times, covariance of the times; reduced
chi-square, noise [DN], deviations (as of an echo) and flags."""


class Search(NamedTuple):
    """What is looked for, the same for all waveforms of a kind.

    Attributes
    ----------
    spacing, sigma : of the samples, and of the pulse [ns].
    least_decay, most_decay : [1/ns].
    least_delay : of the bottom after the surface [ns].
    gain : least drop of chi-square against the plain fit, when each has paid `price` for every parameter.
    price : chi-square that a parameter is worth.
    bottom : least drop of chi-square by a bottom, in a waveform of 72 samples.
    shape_error, growth : as of `weigh_samples`; innovation : variance of white samples over the noise's.
    level : what a level of 1 is in the samples made white.
    floor : least variance of the noise [DN^2].
    worst : reduced chi-square above which nothing is taken.
    iterations : steps at most.
    """

    spacing: float
    sigma: float
    least_decay: float
    most_decay: float
    least_delay: float
    gain: float
    price: float
    bottom: float
    shape_error: float
    growth: float
    innovation: float
    level: float
    floor: float
    worst: float
    iterations: int


@inlined
def _scaled_erfc(x):  # type: ignore[no-untyped-def]
    """exp(x^2) erfc(x) for x >= 0."""
    if x < 25.0:
        return math.exp(x * x) * math.erfc(x)
    square = 1.0 / (x * x)
    return (1.0 - 0.5 * square * (1.0 - 1.5 * square)) / (x * math.sqrt(math.pi))


@kernel
def column_shape(u, sigma, decay, length):  # type: ignore[no-untyped-def]
    """C at `u` [ns] after the surface: the integral of exp(-decay tau) g(u - tau) over tau from 0 to `length` [ns]."""
    m, root = u - decay * sigma * sigma, SQRT_HALF / sigma
    start, end = -m * root, (length - m) * root
    if start < 0.0 <= end:
        scale = math.exp(0.5 * decay * decay * sigma * sigma - decay * u)
        return sigma * SQRT_HALF_PI * scale * (math.erf(end) - math.erf(start))
    # beside the column both ends are small next to what they are made of: each is taken as a Gaussian's height
    a, b = u / sigma, (u - length) / sigma
    one = math.exp(-0.5 * a * a) * _scaled_erfc(abs(start))
    other = math.exp(-0.5 * b * b - decay * length) * _scaled_erfc(abs(end))
    return sigma * SQRT_HALF_PI * (one - other if start >= 0.0 else other - one)


@inlined
def _make_white(rows, n, phi):  # type: ignore[no-untyped-def]
    """Each of `rows` (r, n) less what its values before foretell."""
    for row in rows:
        for i in range(n - 1, 0, -1):
            for m in range(min(len(phi), i)):
                row[i] -= phi[m] * row[i - 1 - m]


@kernel
def _lay(theta, bottom, n, search, phi, shapes):  # type: ignore[no-untyped-def]
    """Rows of `shapes` (7, n), made white: g and its derivative by -t at the surface, C and its moment, both at the
    bottom, and exp(-k L) g there."""
    spacing, sigma, decay = search.spacing, search.sigma, theta[1]
    square = sigma * sigma
    length = theta[2] - theta[0] if bottom else ENDLESS
    left = math.exp(-decay * length)
    for i in range(n):
        u, v = i * spacing - theta[0], i * spacing - theta[0] - length
        g, h = math.exp(-0.5 * u * u / square), math.exp(-0.5 * v * v / square)
        c = column_shape(u, sigma, decay, length)
        shapes[0, i], shapes[1, i], shapes[2, i] = g, u / square * g, c
        shapes[3, i] = u * c - square * (left * h - g + decay * c)
        shapes[4, i], shapes[5, i], shapes[6, i] = h, v / square * h, left * h
    _make_white(shapes if bottom else shapes[:4], n, phi)


@kernel
def _project(theta, bottom, white, weight, n, search, phi, prior, work, p):  # type: ignore[no-untyped-def]
    """Chi-square [DN^2] of the best level and heights, put into `p`, at the times and the decay `theta`; infinite where
    they cannot be told apart."""
    shapes, columns, residual, hessian, gradient, upper, frozen, _ = work
    _lay(theta, bottom, n, search, phi, shapes)
    size = 4 if bottom else 3
    for i in range(n):
        columns[0, i], columns[1, i], columns[2, i] = 1.0, shapes[0, i], shapes[2, i]
        columns[3, i] = shapes[4, i]
    for a in range(size):
        frozen[a], gradient[a] = 0.0, 0.0
        for i in range(n):
            gradient[a] += weight[i] * columns[a, i] * white[i]
        for b in range(a, size):
            hessian[a, b] = 0.0
            for i in range(n):
                hessian[a, b] += weight[i] * columns[a, i] * columns[b, i]
    gradient[0] += prior[1] * prior[0]
    hessian[0, 0] += prior[1]
    if not factorise(hessian, frozen, 0.0, size, upper):
        return np.inf
    solve(upper, gradient, size, p)
    chi = prior[1] * (p[0] - prior[0]) ** 2
    for i in range(n):
        value = white[i]
        for a in range(size):
            value -= p[a] * columns[a, i]
        residual[i] = value
        chi += weight[i] * value * value
    return chi


@kernel
def _equations(p, bottom, decay, weight, n, prior, work):  # type: ignore[no-untyped-def]
    """Normal equations of all parameters after `_project`: level, heights, then times and decay; their number."""
    shapes, columns, residual, hessian, gradient, _, _, _ = work
    first = 4 if bottom else 3
    size = first + (3 if bottom else 2)
    for i in range(n):
        columns[first, i] = p[1] * shapes[1, i] + p[2] * (decay * shapes[2, i] - shapes[0, i])
        columns[first + 1, i] = -p[2] * shapes[3, i]
        if bottom:
            columns[first + 2, i] = p[2] * shapes[6, i] + p[3] * shapes[5, i]
    for a in range(size):
        gradient[a] = 0.0
        for i in range(n):
            gradient[a] += weight[i] * columns[a, i] * residual[i]
        for b in range(a, size):
            hessian[a, b] = 0.0
            for i in range(n):
                hessian[a, b] += weight[i] * columns[a, i] * columns[b, i]
    hessian[0, 0] += prior[1]
    return size


@kernel
def _descend(theta, low, high, bottom, white, weight, n, search, phi, prior, tolerance, work, p):  # type: ignore[no-untyped-def]
    """Improve `theta` between `low` and `high`; its chi-square, level and heights in `p`."""
    hessian, gradient, upper, frozen, move = work[3], work[4], work[5], work[6], work[7]
    count, first, before, damping = (3, 4, np.empty(3), 1e-3) if bottom else (2, 3, np.empty(3), 1e-3)
    chi = _project(theta, bottom, white, weight, n, search, phi, prior, work, p)
    for _ in range(search.iterations):
        if not chi < np.inf:
            break
        size = _equations(p, bottom, theta[1], weight, n, prior, work)
        for a in range(size):
            frozen[a] = 0.0
        for a in range(count):
            pull = gradient[first + a]
            if (theta[a] <= low[a] and pull < 0.0) or (theta[a] >= high[a] and pull > 0.0):
                frozen[first + a] = FROZEN
        if not factorise(hessian, frozen, damping, size, upper):
            break
        solve(upper, gradient, size, move)
        for a in range(count):
            before[a] = theta[a]
            theta[a] = min(max(low[a], theta[a] + move[first + a]), high[a])
        if bottom:
            theta[2] = max(theta[2], theta[0] + search.least_delay)
        trial = _project(theta, bottom, white, weight, n, search, phi, prior, work, p)
        if trial < chi:
            done, chi, damping = chi - trial < tolerance, trial, 0.1 * damping
            if done:
                break
            continue
        for a in range(count):
            theta[a] = before[a]
        _project(theta, bottom, white, weight, n, search, phi, prior, work, p)
        damping *= 10.0
        if damping > 1e4:
            break
    return chi


@kernel
def _best_decay(theta, bottom, white, weight, n, search, phi, prior, work, p):  # type: ignore[no-untyped-def]
    """Chi-square of the best of `STARTS` decays, put into `theta`."""
    best, decay = np.inf, search.least_decay
    for k in range(STARTS):
        theta[1] = search.least_decay * (search.most_decay / search.least_decay) ** ((k + 0.5) / STARTS)
        chi = _project(theta, bottom, white, weight, n, search, phi, prior, work, p)
        if chi < best:
            best, decay = chi, theta[1]
    theta[1] = decay
    return best


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
    _make_white(space[:1], n, phi)
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
    p, unit, low, high, theta, best = np.empty(7), np.zeros(7), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for w in rows:
        out, first, n = answers[w], offsets[w], offsets[w + 1] - offsets[w]
        out[FOUND] = 0.0
        count = starts_of[w + 1] - starts_of[w]
        if count == 0 or n < FEWEST:
            continue
        end = (n - 1) * search.spacing
        variance, freedom = receiver[w, 2], receiver[w, 3]
        base = math.floor(receiver[w, 0])
        used = load_samples(samples, first, n, base, 0, 0, top[w], y, weight)
        for i in range(n):
            white[i] = y[i]
        if len(phi) > 0:
            used = whiten(y, weight, 0, n, 0, used, phi, white)
        start = starts[starts_of[w]]
        if used < FEWEST or start < 2.0 * search.sigma or not variance > 0.0:
            continue
        level = receiver[w, 0] - base
        if search.shape_error > 0.0 or search.growth > 0.0:
            weigh_samples(y, n, level, variance, search.shape_error, search.growth * search.innovation, weight)
        prior = (level * search.level, receiver[w, 1])
        plain = _plain(y, signal[first : first + n], weight, n, phi, prior, work[0])
        reach = FWHM_PER_SIGMA * search.sigma
        low[0], high[0] = max(start - reach, 0.0), min(start + reach, end)
        low[1], high[1] = search.least_decay, search.most_decay
        tolerance = 1e-3 * variance
        theta[0], theta[1], theta[2] = start, search.least_decay, 0.0
        _best_decay(theta, False, white, weight, n, search, phi, prior, work, p)
        chi = _descend(theta, low, high, False, white, weight, n, search, phi, prior, tolerance, work, p)
        if not chi < np.inf:
            continue
        bottom, needed = False, search.bottom + 2.0 * math.log(max(n / 72.0, 1.0))
        best[:] = theta
        alone, later = chi, _highest_left(work[2], weight, n, theta[0] + search.least_delay, search)
        if not (p[1] > 0.0 and p[2] > 0.0):
            chi = np.inf
        likely, later_start, decay = np.inf, end, search.least_decay
        for c in range(1, count + 1):
            t = starts[starts_of[w] + c] if c < count else later
            if start + search.least_delay <= t <= end:
                theta[0], theta[2] = start, t
                trial = _best_decay(theta, True, white, weight, n, search, phi, prior, work, p)
                if trial < likely:
                    likely, later_start, decay = trial, t, theta[1]
        if likely < np.inf:
            theta[0], theta[1], theta[2] = start, decay, later_start
            low[2], high[2] = theta[2] - 2.0 * reach, min(theta[2] + 2.0 * reach, end)
            trial = _descend(theta, low, high, True, white, weight, n, search, phi, prior, tolerance, work, p)
            sound = p[1] > 0.0 and p[2] > 0.0 and p[3] > 0.0 and theta[2] < end
            if trial < chi and alone - trial > needed * variance and sound:
                chi, bottom = trial, True
                best[:] = theta
        if not chi < np.inf:
            continue
        chi = _project(best, bottom, white, weight, n, search, phi, prior, work, p)
        size = _equations(p, bottom, best[1], weight, n, prior, work)
        free = max(used - size, 1.0)
        expected = variance
        if freedom > 0.0:
            variance = (variance * freedom + chi) / (freedom + free)
        else:
            variance = max(chi / free, search.floor)
        saved = (plain - chi) / variance + search.price * (3.0 * count + 1.0 - size)
        if not saved > search.gain or not chi <= search.worst * free * expected:
            continue
        hessian, upper, frozen, move = work[3], work[5], work[6], work[7]
        frozen[:] = 0.0
        if not factorise(hessian, frozen, 0.0, size, upper):
            continue
        heights = 4 if bottom else 3
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
        out[FOUND] = 2.0 if bottom else 1.0
        out[T_S], out[A_S], out[DECAY], out[A_C] = best[0], p[1], best[1], p[2]
        out[T_B], out[A_B] = (best[2], p[3]) if bottom else (np.nan, np.nan)
        out[LEVEL], out[MISFIT] = p[0] / search.level + base, chi / (free * expected)
        out[NOISE] = math.sqrt(variance / search.innovation)
        out[DEV_S] = 1000.0 * _deviation(work[2], weight, n, best[0], search) / p[1]
        other = best[2] if bottom else np.inf
        out[FLAGS_S] = _flags(y, n, best[0], other, top[w] - base, search)
        out[DEV_B], out[FLAGS_B] = np.nan, 0.0
        if bottom:
            out[DEV_B] = 1000.0 * _deviation(work[2], weight, n, best[2], search) / p[3]
            out[FLAGS_B] = _flags(y, n, best[2], best[0], top[w] - base, search)
