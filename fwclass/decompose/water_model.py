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
from fwclass.kernel import inlined, kernel

ENDLESS = 1e5
"""Length [ns] of a column without a bottom."""
FROZEN = 1e30
STARTS = 3
"""Decays that are tried first."""
SQRT_HALF_PI, SQRT_HALF = math.sqrt(0.5 * math.pi), math.sqrt(0.5)


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
def make_white(rows, n, phi):  # type: ignore[no-untyped-def]
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
    make_white(shapes if bottom else shapes[:4], n, phi)


@kernel
def project(theta, bottom, white, weight, n, search, phi, prior, work, p):  # type: ignore[no-untyped-def]
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
def equations(p, bottom, decay, weight, n, prior, work):  # type: ignore[no-untyped-def]
    """Normal equations, (size, size) and (size,) of `work`, of all parameters after `project`: level and heights [DN],
    then times [ns] and decay [1/ns]; their number."""
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
def descend(theta, low, high, bottom, white, weight, n, search, phi, prior, tolerance, work, p):  # type: ignore[no-untyped-def]
    """Improve `theta` (3,), surface [ns], decay [1/ns] and bottom [ns], between `low` and `high` (3,); its chi-square
    [DN^2], infinite where nothing fits; level and heights [DN] in `p`."""
    hessian, gradient, upper, frozen, move = work[3], work[4], work[5], work[6], work[7]
    count, first = (3, 4) if bottom else (2, 3)
    before, damping = np.empty(3), 1e-3
    chi = project(theta, bottom, white, weight, n, search, phi, prior, work, p)
    for _ in range(search.iterations):
        if not chi < np.inf:
            break
        size = equations(p, bottom, theta[1], weight, n, prior, work)
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
        trial = project(theta, bottom, white, weight, n, search, phi, prior, work, p)
        if trial < chi:
            done, chi, damping = chi - trial < tolerance, trial, 0.1 * damping
            if done:
                break
            continue
        for a in range(count):
            theta[a] = before[a]
        project(theta, bottom, white, weight, n, search, phi, prior, work, p)
        damping *= 10.0
        if damping > 1e4:
            break
    return chi


@kernel
def best_decay(theta, bottom, white, weight, n, search, phi, prior, work, p):  # type: ignore[no-untyped-def]
    """Chi-square [DN^2] of the best of `STARTS` decays [1/ns], put into `theta` (3,)."""
    best, decay = np.inf, search.least_decay
    for k in range(STARTS):
        theta[1] = search.least_decay * (search.most_decay / search.least_decay) ** ((k + 0.5) / STARTS)
        chi = project(theta, bottom, white, weight, n, search, phi, prior, work, p)
        if chi < best:
            best, decay = chi, theta[1]
    theta[1] = decay
    return best
