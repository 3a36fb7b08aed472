"""The model, a level plus widened system pulses, and its weighted least-squares fit (Levenberg-Marquardt).

Times and widths are in samples. Parameters are packed as ``[level, A0, t0, s0, A1, t1, s1, ...]``. Waveforms lie in
padded buffers: sample i at ``pad + i``, with weight 0 around, so that no profile is ever cut off. Weights are relative
to the variance of the noise; chi-square here is in DN^2.

Sources: Hofton 2000, Wagner 2006 (the model); Nocedal and Wright 2006, 10.3 (the method).
"""

from __future__ import annotations

import math

import numpy as np

from fwclass.decompose.normal_equations import factorise, normal_equations, solve
from fwclass.kernel import inlined, kernel, vectorised

FIRST_DAMPING = 1e-3
FROZEN = 1e30
"""Added to the information of a parameter that stands at its bound and wants beyond."""
LONGEST_STEP = 2.0
"""Samples that an echo moves in one step at most."""
OUTSIDE = 2.0
"""Samples that an echo's time may lie before the first sample or past the last: buffers are padded for no more."""


@inlined
def bound_time(t, n):  # type: ignore[no-untyped-def]
    """The time `t`, or the bound it lies beyond, of an echo of a waveform of `n` samples; the first bound for NaN."""
    return min(max(-OUTSIDE, t), n - 1.0 + OUTSIDE)


@inlined
def place(look, t, s):  # type: ignore[no-untyped-def]
    """Where the profile of an echo at time `t` and of width `s` [samples] lies in the table of `look`.

    Its row, its cell in width, the whole sample (index) it begins at, and what is left in time and in width."""
    k = int(min(max(0.0, (s - look.low) / look.step), len(look.first) - 1.0))
    cell = int(math.floor(t * look.phases + 0.5))
    whole = int(math.floor(cell / look.phases))
    dt = t - cell / look.phases
    ds = s - (look.low + (k + 0.5) * look.step)
    return k * look.phases + cell - whole * look.phases, k, whole, dt, ds


@vectorised
def _sums(parts, length, dt, ds, y, weight, level, height):  # type: ignore[no-untyped-def]
    """Sums over one echo's samples for its normal equations: products of (1, u, v, x, r) under the weights.

    u, v, x are the profile and its derivatives by time and width, r the residual.
    """
    w1u, w1v, w1x, uu, uv, ux, vv, vx, xx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ru, rv, rx, rr, r1, r0 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    half_t, cross, half_s = 0.5 * dt * dt, dt * ds, 0.5 * ds * ds
    for j in range(length):
        tt, ts, ss = parts[3, j], parts[4, j], parts[5, j]
        u = parts[0, j] + dt * parts[1, j] + ds * parts[2, j] + half_t * tt + cross * ts + half_s * ss
        v = parts[1, j] + dt * tt + ds * ts
        x = parts[2, j] + dt * ts + ds * ss
        w = weight[j]
        before = y[j] - level
        r = before - height * u
        wu, wv, wx, wr = w * u, w * v, w * x, w * r
        w1u += wu
        w1v += wv
        w1x += wx
        uu += wu * u
        uv += wu * v
        ux += wu * x
        vv += wv * v
        vx += wv * x
        xx += wx * x
        ru += wr * u
        rv += wr * v
        rx += wr * x
        rr += wr * r
        r1 += wr
        r0 += w * before * before
    return w1u, w1v, w1x, uu, uv, ux, vv, vx, xx, ru, rv, rx, rr - r0, r1


@vectorised
def moments(y, weight, pad, n):  # type: ignore[no-untyped-def]
    """Sums of w, w y, w y^2 over the waveform."""
    one, two, three = 0.0, 0.0, 0.0
    value, weigh = y[pad : pad + n], weight[pad : pad + n]
    for i in range(n):
        wy = weigh[i] * value[i]
        one += weigh[i]
        two += wy
        three += wy * value[i]
    return one, two, three


@kernel
def fit_one(p, y, weight, pad, n, prior, limits, look, sums):  # type: ignore[no-untyped-def]
    """`fit` for a single echo, `p` of shape (4,): the same steps, all in registers; (chi-square, number of steps).

    `sums` : `moments` of the weights."""
    narrow, wide, iterations, tolerance, highest = limits
    b, a, t, s = p[0], p[1], bound_time(p[2], n), p[3]
    damping = FIRST_DAMPING
    tb, ta, tt, ts = b, a, t, s
    chi = np.inf
    expected = np.inf
    steps = 0
    hbb, hba, hbt, hbs, haa, hat, has, htt, hts, hss = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    gb, ga, gt, gs = 0.0, 0.0, 0.0, 0.0
    while True:
        row, k, whole, dt, ds = place(look, tt, ts)
        start = pad + whole + look.first[k]
        length = look.length[k]
        w1u, w1v, w1x, uu, uv, ux, vv, vx, xx, ru, rv, rx, rr, _ = _sums(
            look.table[row], length, dt, ds, y[start : start + length], weight[start : start + length], tb, ta
        )
        away = tb - prior[0]
        new = sums[2] - 2.0 * tb * sums[1] + tb * tb * sums[0] + rr + prior[1] * away * away
        if new <= chi:
            gain = chi - new
            b, a, t, s, chi = tb, ta, tt, ts, new
            if expected < tolerance or gain < tolerance:
                break
            damping = max(0.1 * damping, 1e-10) if steps > 0 else damping
            hbb, hba, hbt, hbs = sums[0] + prior[1], w1u, a * w1v, a * w1x
            haa, hat, has = uu, a * uv, a * ux
            htt, hts, hss = a * a * vv, a * a * vx, a * a * xx
            gb, ga, gt, gs = sums[1] - b * sums[0] - a * w1u - prior[1] * away, ru, a * rv, a * rx
        else:
            damping = max(10.0 * damping, FIRST_DAMPING)
            if expected < tolerance or damping > 1e7:
                break
        if steps >= iterations:
            break
        steps += 1
        grown = 1.0 + damping
        frozen = FROZEN if (s <= narrow and gs < 0.0) or (s >= wide and gs > 0.0) else 0.0
        # Cholesky's factor L, row by row
        l00 = 1.0 / math.sqrt(hbb * grown + 1e-12)
        l10, l20, l30 = hba * l00, hbt * l00, hbs * l00
        q = haa * grown + 1e-12 - l10 * l10
        l11 = 1.0 / math.sqrt(q) if q > 0.0 else 0.0
        l21, l31 = (hat - l20 * l10) * l11, (has - l30 * l10) * l11
        q = htt * grown + 1e-12 - l20 * l20 - l21 * l21
        l22 = 1.0 / math.sqrt(q) if q > 0.0 else 0.0
        l32 = (hts - l30 * l20 - l31 * l21) * l22
        q = hss * grown + frozen + 1e-12 - l30 * l30 - l31 * l31 - l32 * l32
        l33 = 1.0 / math.sqrt(q) if q > 0.0 else 0.0
        if l11 == 0.0 or l22 == 0.0 or l33 == 0.0:
            damping = 10.0 * damping + FIRST_DAMPING
            if damping > 1e8:
                break
            tb, ta, tt, ts, expected = b, a, t, s, np.inf
            chi = np.inf
            continue
        x0 = gb * l00
        x1 = (ga - l10 * x0) * l11
        x2 = (gt - l20 * x0 - l21 * x1) * l22
        x3 = (gs - l30 * x0 - l31 * x1 - l32 * x2) * l33
        expected = x0 * x0 + x1 * x1 + x2 * x2 + x3 * x3
        x3 = x3 * l33
        x2 = (x2 - l32 * x3) * l22
        x1 = (x1 - l21 * x2 - l31 * x3) * l11
        x0 = (x0 - l10 * x1 - l20 * x2 - l30 * x3) * l00
        tb = b + x0
        ta = min(max(a + x1, 0.1 * a), 4.0 * a, highest)
        tt = bound_time(t + min(max(x2, -LONGEST_STEP), LONGEST_STEP), n)
        ts = min(max(s + x3, 0.5 * s, narrow), wide)
    p[0], p[1], p[2], p[3] = b, a, t, s
    return chi, steps


@vectorised
def _profile(parts, length, dt, ds, height, residual, basis):  # type: ignore[no-untyped-def]
    """Fill ``basis`` (3, length) with (u, v, x) of one echo and take the echo off the residual."""
    half_t, cross, half_s = 0.5 * dt * dt, dt * ds, 0.5 * ds * ds
    for j in range(length):
        tt, ts, ss = parts[3, j], parts[4, j], parts[5, j]
        u = parts[0, j] + dt * parts[1, j] + ds * parts[2, j] + half_t * tt + cross * ts + half_s * ss
        basis[0, j] = u
        basis[1, j] = parts[1, j] + dt * tt + ds * ts
        basis[2, j] = parts[2, j] + dt * ts + ds * ss
        residual[j] -= height * u


@kernel
def add_echoes(amplitude, time, width, first, last, look, signal):  # type: ignore[no-untyped-def]
    """Add echoes, times and widths in samples, to ``signal[first:last]``, each to its own waveform's."""
    for e in range(len(amplitude)):
        row, cell, whole, dt, ds = place(look, time[e], width[e])
        parts = look.table[row]
        half_t, cross, half_s = 0.5 * dt * dt, dt * ds, 0.5 * ds * ds
        start = first[e] + whole + look.first[cell]
        for j in range(max(first[e] - start, 0), min(last[e] - start, look.length[cell])):
            u = parts[0, j] + dt * parts[1, j] + ds * parts[2, j]
            u += half_t * parts[3, j] + cross * parts[4, j] + half_s * parts[5, j]
            signal[start + j] += amplitude[e] * u


@vectorised
def less(y, level, n, residual):  # type: ignore[no-untyped-def]
    """``residual[:n]`` = y - level."""
    for i in range(n):
        residual[i] = y[i] - level


@vectorised
def _explained_sums(y, level, residual, weight, n):  # type: ignore[no-untyped-def]
    """Sums of w (r^2 - q^2) and w (r - q), where q is what the sample has over the level."""
    two, one = 0.0, 0.0
    for i in range(n):
        above = y[i] - level
        wr, wq = weight[i] * residual[i], weight[i] * above
        two += wr * residual[i] - wq * above
        one += wr - wq
    return two, one


@inlined
def _lay(p, count, y, pad, first, last, n, look, residual, basis, window):  # type: ignore[no-untyped-def]
    """`lay` between the samples `first` and `last` of the padded buffer, which hold all windows."""
    less(y[first:], p[0], last - first, residual[first:])
    for k in range(count):
        row, cell, whole, dt, ds = place(look, bound_time(p[3 * k + 2], n), p[3 * k + 3])
        start = pad + whole + look.first[cell]
        length = look.length[cell]
        window[k, 0], window[k, 1], window[k, 2], window[k, 3] = start, start + length, cell, row
        _profile(look.table[row], length, dt, ds, p[3 * k + 1], residual[start : start + length], basis[k])


@inlined
def _span(p, count, pad, n, look):  # type: ignore[no-untyped-def]
    """(first, past the last) sample that an echo of `p` reaches, in the padded buffer."""
    first, last = pad + n, pad
    for k in range(count):
        _, cell, whole, _, _ = place(look, bound_time(p[3 * k + 2], n), p[3 * k + 3])
        start = pad + whole + look.first[cell]
        first, last = min(first, start), max(last, start + look.length[cell])
    return first, last


@kernel
def lay(p, count, y, pad, n, look, residual, basis, window):  # type: ignore[no-untyped-def]
    """Take the level and the `count` echoes of `p` off the waveform.

    Fills ``residual``, ``window[k]`` (first, past the last sample of echo k, in the padded buffer; its cell in width
    and its row of the table) and ``basis[k, :, j]`` = (u, v, x) on the window. Times count as `bound_time`.
    """
    _lay(p, count, y, pad, pad, pad + n, n, look, residual, basis, window)


@kernel
def evaluate(p, count, y, weight, pad, n, look, sums, residual, basis, window):  # type: ignore[no-untyped-def]
    """(sum of w r^2, sum of w r) of parameters `p` with `count` echoes.

    As `lay`, but ``residual`` is only filled where an echo reaches: elsewhere it is what `sums`, `moments` of the
    waveform, tell of the level, so that quiet samples cost nothing.
    """
    first, last = _span(p, count, pad, n, look)
    _lay(p, count, y, pad, first, last, n, look, residual, basis, window)
    two, one = _explained_sums(y[first:], p[0], residual[first:], weight[first:], last - first)
    b = p[0]
    return sums[2] - 2.0 * b * sums[1] + b * b * sums[0] + two, sums[1] - b * sums[0] + one


@inlined
def _bounded_step(p, move, count, n, narrow, wide, highest, trial):  # type: ignore[no-untyped-def]
    """``trial = p + move``, each parameter held to a sane change and range."""
    trial[0] = p[0] + move[0]
    for k in range(count):
        a = 3 * k + 1
        trial[a] = min(max(p[a] + move[a], 0.1 * p[a]), 4.0 * p[a], highest)
        shift = min(max(move[a + 1], -LONGEST_STEP), LONGEST_STEP)
        trial[a + 1] = bound_time(p[a + 1] + shift, n)
        trial[a + 2] = min(max(p[a + 2] + move[a + 2], 0.5 * p[a + 2], narrow), wide)


@kernel
def fit(p, count, y, weight, pad, n, prior, limits, look, sums, work):  # type: ignore[no-untyped-def]
    """Fit `p` in place; the weighted sum of squares at the end, in DN^2.

    `prior` is (level, 1 / its variance in units of the noise's); `limits` is (narrowest, widest [samples], iterations,
    tolerance [DN^2], greatest height [DN]). A parameter at its bound that wants beyond stands still for the step.
    """
    if count == 1:
        return fit_one(p, y, weight, pad, n, prior, limits, look, sums)[0]
    residual, basis, window, hessian, gradient, upper, move, trial, frozen = work
    size = 3 * count + 1
    narrow, wide, iterations, tolerance, highest = limits
    damping = FIRST_DAMPING
    chi, expected = np.inf, np.inf
    steps = 0
    for a in range(size):
        trial[a] = p[a]
    while True:
        new, pull = evaluate(trial, count, y, weight, pad, n, look, sums, residual, basis, window)
        away = trial[0] - prior[0]
        new += prior[1] * away * away
        if new <= chi:
            gain = chi - new
            chi = new
            for a in range(size):
                p[a] = trial[a]
            if expected < tolerance or gain < tolerance:
                break
            damping = max(0.1 * damping, 1e-10) if steps > 0 else damping
            normal_equations(p, count, weight, residual, basis, window, sums[0], pull, hessian, gradient)
            hessian[0, 0] += prior[1]
            gradient[0] -= prior[1] * away
        else:
            damping = max(10.0 * damping, FIRST_DAMPING)
            if expected < tolerance or damping > 1e7:
                break
        if steps >= iterations:
            break
        steps += 1
        for k in range(count):
            a = 3 * k + 3
            held = (p[a] <= narrow and gradient[a] < 0.0) or (p[a] >= wide and gradient[a] > 0.0)
            frozen[a] = FROZEN if held else 0.0
        while not factorise(hessian, frozen, damping, size, upper):
            damping = 10.0 * damping + FIRST_DAMPING
            if damping > 1e8:
                return chi
        expected = solve(upper, gradient, size, move)
        _bounded_step(p, move, count, n, narrow, wide, highest, trial)
    return chi
