"""Level, noise and peaks of one waveform, before any fit. All per pulse, so that chunks cannot matter."""

from __future__ import annotations

import math

from fwclass.kernel import inlined, kernel

ROUNDS = 8
CLIP = 2.5
CLIP_LOSS = 1.0 / 0.9508
"""Samples above `CLIP` sigma are dropped; the spread of what is left of a normal distribution, undone."""


@inlined
def _sort(values, n):  # type: ignore[no-untyped-def]
    """Shell sort in place, without allocation."""
    gap = 1
    while gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            v = values[i]
            j = i
            while j >= gap and values[j - gap] > v:
                values[j] = values[j - gap]
                j -= gap
            values[j] = v
        gap //= 3


@kernel
def level_and_noise(y, n, floor, scratch):  # type: ignore[no-untyped-def]
    """(baseline, noise's standard deviation, samples) [DN] of ``y[:n]``: what stays when echoes are clipped from above.

    `floor` is the least standard deviation of a digitised signal.
    """
    if n == 0:
        return 0.0, floor, 0
    for i in range(n):
        scratch[i] = y[i]
    _sort(scratch, n)
    kept = n
    level, noise = 0.0, floor
    for _ in range(ROUNDS):
        level = 0.5 * (scratch[(kept - 1) // 2] + scratch[kept // 2])
        below, count = 0.0, 0
        for i in range(kept):
            if scratch[i] > level:
                break
            below += (scratch[i] - level) ** 2
            count += 1
        noise = max(math.sqrt(below / max(count, 1)), floor)
        before = kept
        while kept > 1 and scratch[kept - 1] > level + CLIP * noise:
            kept -= 1
        if kept == before:
            break
    mean = 0.0
    for i in range(kept):
        mean += scratch[i]
    mean /= kept
    square = 0.0
    for i in range(kept):
        square += (scratch[i] - mean) ** 2
    return mean, max(CLIP_LOSS * math.sqrt(square / max(kept - 1, 1)), floor), kept


@inlined
def surer(threshold, freedom):  # type: ignore[no-untyped-def]
    """The threshold in Student's t that is as rare as `threshold` in the normal distribution, to first order:
    noise estimated from few samples may be underestimated. Source: Cornish and Fisher 1937."""
    return threshold * (1.0 + (threshold * threshold + 1.0) / (4.0 * max(freedom, 4)))


@inlined
def make_template(sigma, template):  # type: ignore[no-untyped-def]
    """Fill ``template[:2 h + 1]`` with a Gaussian of `sigma` samples over its own energy; (h, energy)."""
    half = min(int(math.ceil(3.0 * sigma)), (len(template) - 1) // 2)
    energy = 0.0
    for j in range(-half, half + 1):
        g = math.exp(-0.5 * (j / sigma) ** 2)
        template[j + half] = g
        energy += g * g
    for j in range(2 * half + 1):
        template[j] /= energy
    return half, energy


@inlined
def match_filter(signal, n, template, half, out):  # type: ignore[no-untyped-def]
    """Amplitude of a system pulse at every sample, by correlation with the template."""
    for i in range(n):
        first, last = max(i - half, 0), min(i + half + 1, n)
        s = 0.0
        shift = half - i
        for j in range(first, last):
            s += signal[j] * template[j + shift]
        out[i] = s


@inlined
def is_peak(z, n, i):  # type: ignore[no-untyped-def]
    """Sample i is above its left and not below its right neighbour."""
    return (i == 0 or z[i] > z[i - 1]) and (i == n - 1 or z[i] >= z[i + 1])


@kernel
def first_echoes(z, n, threshold, sigma, most, p):  # type: ignore[no-untyped-def]
    """Starting values of the peaks of `z` above `threshold`, at most the `most` highest; how many.

    Time and width come from the parabola through the logarithms around the peak: a Gaussian of variance v
    filtered by one of variance sigma^2 has variance v + sigma^2.
    """
    count = 0
    if most <= 0:
        return 0
    for i in range(n):
        if z[i] <= threshold or not is_peak(z, n, i):
            continue
        left = max(z[max(i - 1, 0)], 0.05 * z[i])
        right = max(z[min(i + 1, n - 1)], 0.05 * z[i])
        la, lb, lc = math.log(left), math.log(z[i]), math.log(right)
        curve = 2.0 * lb - la - lc
        shift, variance = 0.0, sigma * sigma
        if curve > 1e-6:
            shift = min(max(0.5 * (lc - la) / curve, -0.7), 0.7)
            variance = 1.0 / curve - sigma * sigma
        s = min(math.sqrt(max(variance, 1.04 * sigma * sigma)), 2.0 * sigma)
        height = z[i] * math.sqrt((s * s + sigma * sigma) / (2.0 * s * s))
        k = count
        if count < most:
            count += 1
        else:
            k = 0
            for m in range(1, count):
                if p[3 * m + 1] < p[3 * k + 1]:
                    k = m
            if p[3 * k + 1] >= height:
                continue
        p[3 * k + 1], p[3 * k + 2], p[3 * k + 3] = height, i + shift, s
    return count
