"""The samples of one waveform in their padded buffer, made white, and what each of them weighs in the fit."""

from __future__ import annotations

from fwclass.kernel import inlined, vectorised


@vectorised
def load_samples(samples, first, n, base, pad, after, top, y, weight):  # type: ignore[no-untyped-def]
    """Samples less `base` into the padded buffer `y`, weights 1, or 0 where saturated; samples that count."""
    used = 0
    part = samples[first : first + n]
    into, weigh = y[pad : pad + n + after], weight[pad : pad + n + after]
    for i in range(n):
        value = float(part[i])
        into[i] = value - base
        good = value < top
        weigh[i] = 1.0 if good else 0.0
        used += good
    for i in range(n, n + after):
        into[i], weigh[i] = 0.0, 0.0
    return used


@vectorised
def highest_sample(y, pad, n):  # type: ignore[no-untyped-def]
    """The highest of the `n` samples [DN] of the padded buffer `y` float64 (samples,)."""
    high = y[pad]
    for i in range(pad + 1, pad + n):
        high = y[i] if y[i] > high else high
    return high


@vectorised
def _foretell(y, n, phi, white):  # type: ignore[no-untyped-def]
    """``white[:n]`` = samples `y` less what those before each foretell of it."""
    for i in range(n):
        white[i] = y[i]
    for k in range(min(len(phi), n - 1)):
        share, later = phi[k], white[k + 1 :]
        for i in range(n - 1 - k):
            later[i] -= share * y[i]


@inlined
def whiten(y, weight, pad, n, after, used, phi, white):  # type: ignore[no-untyped-def]
    """``white`` float64 (samples,) = what is left of the samples `y` [DN] when each is foretold from those before it;
    weight 1 where all of them count, else 0. Samples that count, of `used` before."""
    _foretell(y[pad:], n, phi, white[pad:])
    white[pad + n : pad + n + after] = 0.0
    if used == n:
        weight[pad : pad + min(len(phi), n)] = 0.0
        return max(n - len(phi), 0)
    used, good = 0, 0
    for i in range(pad, pad + n):
        good = good + 1 if weight[i] > 0.0 else 0
        weight[i] = 1.0 if good > len(phi) else 0.0
        used += good > len(phi)
    return used


@vectorised
def weigh_samples(y, n, level, variance, shape_error, growth, weight):  # type: ignore[no-untyped-def]
    """Less weight where echoes are high: the pulse's own shape is known to `shape_error` of its height, and noise
    grows with the signal, by `growth` a DN. Neighbours of the first and the last of the `n` samples are these."""
    square = shape_error * shape_error
    for i in (0, n - 1):
        high = max(0.5 * y[i] + 0.25 * (y[i] + y[1 if i == 0 else n - 2]) - level, 0.0)
        weight[i] *= variance / (variance + growth * high + square * high * high)
    before, at, after, weigh = y[: n - 2], y[1 : n - 1], y[2:n], weight[1 : n - 1]
    for i in range(n - 2):
        high = max(0.25 * before[i] + 0.5 * at[i] + 0.25 * after[i] - level, 0.0)
        weigh[i] *= variance / (variance + growth * high + square * high * high)


@vectorised
def weigh_doubt(doubt, n, variance, innovation, weight):  # type: ignore[no-untyped-def]
    """Less weight of the first `n` samples where something beside the noise's `variance` [DN^2] makes them vary."""
    for i in range(n):
        # a ratio of two equal numbers is 1 but for its last bit here: what is not doubted stays as it is
        weight[i] *= variance / (variance + innovation * doubt[i]) if doubt[i] > 0.0 else 1.0
