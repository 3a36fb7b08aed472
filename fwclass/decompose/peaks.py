"""Level, noise and peaks of one waveform, before any fit. All per waveform, so that chunks cannot matter."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import inlined, kernel, vectorised

BINS = 256
ROUNDS = 12
CLIP = 2.5
CLIP_LOSS = 0.9556
"""Variance that is left of a normal distribution cut off `CLIP` standard deviations above its mean."""
CLIP_SHIFT = 0.0176
"""How far below the whole distribution's mean that of the rest is, in standard deviations."""
AT_ONCE = 32
"""Samples that are looked at together for one that stands out."""
LEAST_CUT = 2.0
"""Bins above the level that are never cut off: ties of whole numbers hide a spread of less than a bin."""


@vectorised
def _least(part, n):  # type: ignore[no-untyped-def]
    least = part[0]
    for i in range(n):
        least = min(least, part[i])
    return least


@vectorised
def _total(two, one):  # type: ignore[no-untyped-def]
    for v in range(len(one)):
        one[v] = two[0, v] + two[1, v]


@inlined
def _count(samples, first, n, shift, bins):  # type: ignore[no-untyped-def]
    """Fill ``bins[2]`` with counts of the samples, `shift` bits coarser, from the least sample on; the least sample.

    The last bin takes all that is higher. Neighbours count in two histograms: quiet samples hit the same bin again
    and again, and each would wait for the one before.
    """
    part = samples[first : first + n]
    least = np.int64(_least(part, n))
    bins[:2] = 0
    even, odd = bins[0], bins[1]
    for i in range(n // 2):
        even[min((np.int64(part[2 * i]) - least) >> shift, BINS)] += 1
        odd[min((np.int64(part[2 * i + 1]) - least) >> shift, BINS)] += 1
    if n % 2 == 1:
        even[min((np.int64(part[n - 1]) - least) >> shift, BINS)] += 1
    _total(bins, bins[2])
    return least


@kernel
def level_and_noise(samples, first, n, floor, histograms):  # type: ignore[no-untyped-def]
    """(baseline, standard deviation of the noise, samples) [DN] of ``samples[first:first + n]``.

    The level is where the samples that no echo lifts lie: the lowest half to begin with, then all that are not above
    the level by more than `CLIP` of their own spread downwards. `floor` is the least standard deviation of a
    digitised signal; `histograms` is integer room, (3, `BINS` + 1).
    """
    bins = histograms[2]
    if n == 0:
        return 0.0, floor, 0
    shift = 0
    while True:
        least = _count(samples, first, n, shift, histograms)
        size = float(1 << shift)
        kept, top = (n + 1) // 2, -1
        level, noise, inside = 0.0, floor, True
        for _ in range(ROUNDS):
            middle = 0.5 * kept
            total, at, upper = 0, 0, -1
            while total < middle:
                total += bins[at]
                at += 1
            level = at - 1.0
            if total == middle:
                upper = at
                while upper < BINS and bins[upper] == 0:
                    upper += 1
                level = 0.5 * (level + upper)
            below, count = 0.0, 0.0
            for v in range(at):
                d = v - level
                below += bins[v] * d * d
                count += bins[v] if d < 0.0 else 0.5 * bins[v]
            noise = max(math.sqrt(below / count) if count > 0.0 else 0.0, floor / size)
            last = int(level + max(CLIP * noise, LEAST_CUT))
            if last >= BINS:
                inside = False
                break
            if last == top:
                break
            top = last
            kept = 0
            for v in range(top + 1):
                kept += bins[v]
        if inside or shift >= 8:
            break
        shift += 2
    top = min(top, BINS) if top >= 0 else BINS
    mean = level
    for _ in range(ROUNDS):
        kept, one, two = 0, 0, 0
        for v in range(top + 1):
            c = int(bins[v])
            kept += c
            one += c * v
            two += c * v * v
        mean = one / max(kept, 1)
        noise = max(math.sqrt(max(two - one * mean, 0.0) / (max(kept - 1, 1) * CLIP_LOSS)), floor / size)
        before = top
        top = min(int(mean + max(CLIP * noise, LEAST_CUT)), BINS)
        if top == before:
            break
    noise *= size
    return least + size * mean + 0.5 * (size - 1.0) + CLIP_SHIFT * noise, noise, kept


@inlined
def surer(threshold, freedom):  # type: ignore[no-untyped-def]
    """The threshold in Student's t, of `freedom` degrees, as rare as `threshold` [standard deviations] in the normal
    distribution, to second order: noise estimated from few samples may be too low. Source: Cornish and Fisher 1937."""
    f, z = max(freedom, 4.0), threshold * threshold
    return threshold * (1.0 + (z + 1.0) / (4.0 * f) + (5.0 * z * z + 16.0 * z + 3.0) / (96.0 * f * f))


@vectorised
def match_filter(signal, pad, n, template, template_first, out):  # type: ignore[no-untyped-def]
    """``out[:n]``: height of a system pulse at every sample of ``signal[pad:pad + n]``, which is 0 around."""
    for i in range(n):
        out[i] = 0.0
    taps, start = len(template), pad + template_first
    for j in range(0, taps - taps % 3, 3):  # three at a time: fewer ways to and from memory
        a, b, c = template[j], template[j + 1], template[j + 2]
        one, two, three = signal[start + j :], signal[start + j + 1 :], signal[start + j + 2 :]
        for i in range(n):
            out[i] += a * one[i] + b * two[i] + c * three[i]
    for j in range(taps - taps % 3, taps):
        a, one = template[j], signal[start + j :]
        for i in range(n):
            out[i] += a * one[i]


@vectorised
def _above(part, length, bound):  # type: ignore[no-untyped-def]
    count = 0
    for i in range(length):
        count += part[i] > bound
    return count


@inlined
def next_above(z, i, n, bound):  # type: ignore[no-untyped-def]
    """Index of the first of the samples i, i + 1, … of `z` (n,) above `bound`; `n` if none is. Low ones are passed
    `AT_ONCE` at a time."""
    while i < n:
        length = min(AT_ONCE, n - i)
        if _above(z[i : i + length], length, bound) > 0:
            while not z[i] > bound:
                i += 1
            return i
        i += length
    return n


@inlined
def is_peak(z, n, i):  # type: ignore[no-untyped-def]
    """Whether sample i of `z` (n,) is above its left and not below its right neighbour."""
    return (i == 0 or z[i] > z[i - 1]) and (i == n - 1 or z[i] >= z[i + 1])


@kernel
def first_echoes(z, n, first, threshold, sigma, response, response_first, starts, most, p):  # type: ignore[no-untyped-def]
    """Starting values of the peaks of `z` above `threshold`, at most the `most` highest, where the highest of all is
    above `first`; how many.

    Of what the highest peak itself leaves around it (`response`), a receiver's ringing, no echo is made.

    Time and width come from the parabola through the logarithms around the peak: a Gaussian of variance v
    filtered by one of variance sigma^2 has variance v + sigma^2. Behind a filter for correlated noise `starts`
    (curvature, width, height over the peak's; the sharpest first) tell them.
    """
    count = 0
    if most <= 0:
        return 0
    main = next_above(z, 0, n, threshold)
    if main == n:
        return 0
    begin, i = main, main + 1
    while i < n:
        main = i if z[i] > z[main] else main
        i = i + 1 if z[i] > threshold else next_above(z, i + 1, n, z[main])
    if z[main] <= first:
        return 0
    i = begin - 1
    while i < n - 1:
        i += 1
        if z[i] <= threshold:
            i = next_above(z, i + 1, n, threshold)
        if i == n or not is_peak(z, n, i):
            continue
        lag = i - main - response_first
        if i != main and 0 <= lag < len(response) and z[i] - z[main] * max(response[lag], 0.0) <= threshold:
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
        if len(starts) > 0:
            at = 0
            while at < len(starts) - 1 and starts[at, 0] > curve:
                at += 1
            s, height = min(max(starts[at, 1], 1.02 * sigma), 2.0 * sigma), z[i] * starts[at, 2]
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
