"""The model, a baseline plus Gaussians, and its weighted least-squares fit (Levenberg-Marquardt).

Times and widths are in samples here. Parameters are packed as ``[baseline, A0, t0, s0, A1, t1, s1, ...]``.
Source: Hofton 2000, Wagner 2006 (the model); Nocedal and Wright 2006, 10.3 (the method).
"""

from __future__ import annotations

import math

from fwclass.kernel import inlined, kernel

REACH = 4.5
"""A Gaussian is followed to this many standard deviations (4e-5 of its height)."""


@inlined
def evaluate(p, count, y, weight, n, model, basis, window):  # type: ignore[no-untyped-def]
    """Weighted sum of squared residuals of parameters `p` with `count` echoes.

    Fills ``model[:n]``, ``window[k]`` (first, past the last sample of echo k) and
    ``basis[k, :, i]`` = (g, g d, g d^2) with d = (i - t) / s and g = exp(-d^2 / 2), by recurrence from the peak.
    """
    for i in range(n):
        model[i] = p[0]
    for k in range(count):
        a, t, s = p[3 * k + 1], p[3 * k + 2], p[3 * k + 3]
        step = 1.0 / s
        low = max(int(math.floor(t - REACH * s)), 0)
        high = max(min(int(math.ceil(t + REACH * s)) + 1, n), low)
        window[k, 0], window[k, 1] = low, high
        if high <= low:
            continue
        centre = min(max(int(t + 0.5), low), high - 1)
        d0 = (centre - t) * step
        g0 = math.exp(-0.5 * d0 * d0)
        shrink = math.exp(-step * step)
        half = math.exp(-0.5 * step * step)
        slope = math.exp(-d0 * step)
        g, d, ratio = g0, d0, slope * half
        for i in range(centre, high):
            basis[k, 0, i], basis[k, 1, i], basis[k, 2, i] = g, g * d, g * d * d
            model[i] += a * g
            g *= ratio
            ratio *= shrink
            d += step
        ratio = half / slope
        g, d = g0 * ratio, d0 - step
        ratio *= shrink
        for i in range(centre - 1, low - 1, -1):
            basis[k, 0, i], basis[k, 1, i], basis[k, 2, i] = g, g * d, g * d * d
            model[i] += a * g
            g *= ratio
            ratio *= shrink
            d -= step
    chi = 0.0
    for i in range(n):
        r = y[i] - model[i]
        chi += weight[i] * r * r
    return chi


@inlined
def normal_equations(p, count, y, weight, n, model, basis, window, hessian, gradient):  # type: ignore[no-untyped-def]
    """Upper triangle of J^T W J and J^T W r, after `evaluate` at the same `p`."""
    size = 3 * count + 1
    for a in range(size):
        gradient[a] = 0.0
        for b in range(a, size):
            hessian[a, b] = 0.0
    total, pull = 0.0, 0.0
    for i in range(n):
        total += weight[i]
        pull += weight[i] * (y[i] - model[i])
    hessian[0, 0], gradient[0] = total, pull
    for k in range(count):
        _own(p, k, y, weight, model, basis, window, hessian, gradient)
        for m in range(k + 1, count):
            _cross(p, k, m, weight, basis, window, hessian)


@inlined
def _own(p, k, y, weight, model, basis, window, hessian, gradient):  # type: ignore[no-untyped-def]
    """One echo's share of the gradient, and its rows of J^T W J with the baseline and itself.

    Sums live in scalars, which stay in registers; g d^2 times g is (g d)^2, so five products do for six entries.
    """
    ru, rv, rx, bu, bv, bx, uu, uv, vv, vx, xx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(window[k, 0], window[k, 1]):
        w = weight[i]
        u, v, x = basis[k, 0, i], basis[k, 1, i], basis[k, 2, i]
        r = w * (y[i] - model[i])
        ru += r * u
        rv += r * v
        rx += r * x
        wu, wv = w * u, w * v
        bu += wu
        bv += wv
        bx += w * x
        uu += wu * u
        uv += wu * v
        vv += wv * v
        vx += wv * x
        xx += w * x * x
    a = 3 * k + 1
    f = p[a] / p[a + 2]
    gradient[a], gradient[a + 1], gradient[a + 2] = ru, f * rv, f * rx
    hessian[0, a], hessian[0, a + 1], hessian[0, a + 2] = bu, f * bv, f * bx
    hessian[a, a], hessian[a, a + 1], hessian[a, a + 2] = uu, f * uv, f * vv
    hessian[a + 1, a + 1], hessian[a + 1, a + 2] = f * f * vv, f * f * vx
    hessian[a + 2, a + 2] = f * f * xx


@inlined
def _cross(p, k, m, weight, basis, window, hessian):  # type: ignore[no-untyped-def]
    """The block of J^T W J of two echoes, over the samples that both reach."""
    h00, h01, h02, h10, h11, h12, h20, h21, h22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(max(window[k, 0], window[m, 0]), min(window[k, 1], window[m, 1])):
        w = weight[i]
        u0, u1, u2 = w * basis[k, 0, i], w * basis[k, 1, i], w * basis[k, 2, i]
        v0, v1, v2 = basis[m, 0, i], basis[m, 1, i], basis[m, 2, i]
        h00 += u0 * v0
        h01 += u0 * v1
        h02 += u0 * v2
        h10 += u1 * v0
        h11 += u1 * v1
        h12 += u1 * v2
        h20 += u2 * v0
        h21 += u2 * v1
        h22 += u2 * v2
    a, b = 3 * k + 1, 3 * m + 1
    f, g = p[a] / p[a + 2], p[b] / p[b + 2]
    hessian[a, b], hessian[a, b + 1], hessian[a, b + 2] = h00, g * h01, g * h02
    hessian[a + 1, b], hessian[a + 1, b + 1], hessian[a + 1, b + 2] = f * h10, f * g * h11, f * g * h12
    hessian[a + 2, b], hessian[a + 2, b + 1], hessian[a + 2, b + 2] = f * h20, f * g * h21, f * g * h22


@inlined
def factorise(hessian, damping, size, lower):  # type: ignore[no-untyped-def]
    """Cholesky factor of the upper triangle of `hessian` with its diagonal grown by `damping`; False if singular."""
    for i in range(size):
        for j in range(i + 1):
            s = hessian[j, i]
            if i == j:
                s = s * (1.0 + damping) + 1e-12
            for k in range(j):
                s -= lower[i, k] * lower[j, k]
            if i != j:
                lower[i, j] = s / lower[j, j]
            elif s > 0.0:
                lower[i, i] = math.sqrt(s)
            else:
                return False
    return True


@inlined
def back_solve(lower, right, size, x):  # type: ignore[no-untyped-def]
    """Solve L L^T x = right."""
    for i in range(size):
        s = right[i]
        for k in range(i):
            s -= lower[i, k] * x[k]
        x[i] = s / lower[i, i]
    for i in range(size - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, size):
            s -= lower[k, i] * x[k]
        x[i] = s / lower[i, i]


@inlined
def _bounded_step(p, move, count, n, narrow, wide, trial):  # type: ignore[no-untyped-def]
    """``trial = p + move``, each parameter held to a sane change and range."""
    trial[0] = p[0] + move[0]
    for k in range(count):
        a = 3 * k + 1
        trial[a] = min(max(p[a] + move[a], 0.1 * p[a]), 4.0 * p[a])
        trial[a + 1] = min(max(p[a + 1] + min(max(move[a + 1], -2.0), 2.0), -2.0), n + 1.0)
        trial[a + 2] = min(max(p[a + 2] + move[a + 2], 0.5 * p[a + 2], narrow), wide)


@kernel
def fit(p, count, y, weight, n, prior, limits, work):  # type: ignore[no-untyped-def]
    """Fit `p` in place; the weighted sum of squares at the end. The work arrays then belong to the final `p`.

    `prior` is (baseline, 1 / its variance); `limits` is (narrowest, widest [samples], iterations, tolerance).
    """
    model, basis, window, hessian, gradient, lower, move, trial = work
    size = 3 * count + 1
    narrow, wide, iterations, tolerance = limits[0], limits[1], int(limits[2]), limits[3]
    chi = evaluate(p, count, y, weight, n, model, basis, window) + prior[1] * (p[0] - prior[0]) ** 2
    damping = 1e-3
    fresh = True
    for _ in range(iterations):
        if fresh:
            normal_equations(p, count, y, weight, n, model, basis, window, hessian, gradient)
            hessian[0, 0] += prior[1]
            gradient[0] -= prior[1] * (p[0] - prior[0])
            fresh = False
        if not factorise(hessian, damping, size, lower):
            damping = 10.0 * damping + 1e-3
            if damping > 1e8:
                break
            continue
        back_solve(lower, gradient, size, move)
        expected = 0.0
        for a in range(size):
            expected += move[a] * gradient[a]
        _bounded_step(p, move, count, n, narrow, wide, trial)
        new = evaluate(trial, count, y, weight, n, model, basis, window)
        new += prior[1] * (trial[0] - prior[0]) ** 2
        if new <= chi:
            gain = chi - new
            for a in range(size):
                p[a] = trial[a]
            chi = new
            damping = max(0.1 * damping, 1e-10)
            fresh = True
            if gain < tolerance:
                break
        else:
            damping = max(10.0 * damping, 1e-3)
            if expected < tolerance or damping > 1e7:
                break
    evaluate(p, count, y, weight, n, model, basis, window)
    return chi
