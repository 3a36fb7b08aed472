"""What the estimate of the system's pulse needs of every sampled waveform: level, bright peak, echo-free samples."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel
from fwclass.sorting import sort_few

ROUNDS = 8
CLIP = 2.5
MARK = 4.0
"""Standard deviations above the level from which a sample belongs to an echo."""


@kernel
def levels(samples, offsets, level, spread):  # type: ignore[no-untyped-def]
    """Per waveform the level and the standard deviation of its noise [DN]: what stays when echoes are clipped from
    above, by medians. Fills float64 `level` and `spread` (rows,); NaN for empty waveforms."""
    for w in range(len(level)):
        values = samples[offsets[w] : offsets[w + 1]].astype(np.float64)
        sort_few(values)
        kept = len(values)
        level[w], spread[w] = np.nan, np.nan
        for _ in range(ROUNDS):
            if kept == 0:
                break
            middle = 0.5 * (values[(kept - 1) // 2] + values[kept // 2])
            square, count = 0.0, 0
            for i in range(kept):
                if values[i] > middle:
                    break
                square += (values[i] - middle) ** 2
                count += 1
            level[w], spread[w] = middle, math.sqrt(square / max(count, 1))
            last = middle + CLIP * max(spread[w], 0.5)
            before = kept
            while kept > 1 and values[kept - 1] > last:
                kept -= 1
            if kept == before:
                break


@kernel
def brightest(samples, offsets, spacing, top, level, least, isolation, noise, peak, height, width):  # type: ignore[no-untyped-def]
    """The highest peak of every waveform, if it is isolated, unsaturated and falls to half on both sides.

    Parameters
    ----------
    samples, offsets : ragged samples [DN].
    spacing, top, level, least, noise : per waveform: sample spacing [ns], saturation, level, least height and noise's
        standard deviation [DN].
    isolation : away from the peak the samples may rise again by this share of its height.
    peak : int64 (rows,), filled with the peak's sample, -1 without one.
    height, width : float64 (rows,), filled with the height [DN] and the width at half of it [ns].
    """
    for w in range(len(peak)):
        y = samples[offsets[w] : offsets[w + 1]]
        n = len(y)
        peak[w], height[w], width[w] = -1, np.nan, np.nan
        if n < 5:
            continue
        at = 0
        for i in range(n):
            if y[i] > y[at]:
                at = i
        high = y[at] - level[w]
        if not high >= least[w] or y[at] >= top[w]:
            continue
        half = level[w] + 0.5 * high
        sides = np.zeros(2)
        crossings, clear = 0, True
        rise = isolation * high + 4.0 * noise[w]
        for side in range(2):
            step = 2 * side - 1
            low, crossed = float(y[at]), False
            i = at + step
            while 0 <= i < n:
                if not crossed and y[i] < half:
                    before = float(y[i - step])
                    sides[side] = abs(i - at) - (half - y[i]) / (before - y[i])
                    crossed = True
                low = min(low, float(y[i]))
                if y[i] > low + rise:
                    clear = False
                    break
                i += step
            crossings += crossed
        if crossings == 2 and clear:
            peak[w], height[w], width[w] = at, high, (sides[0] + sides[1]) * spacing[w]


@kernel
def echo_free(samples, offsets, spacing, level, noise, before, after, mean, variance, count):  # type: ignore[no-untyped-def]
    """Mean and variance of the samples that no echo reaches.

    A sample that stands `MARK` deviations above the level takes those up to `before` ahead of it and up to `after`
    behind it [ns] along. Fills float64 `mean` [DN], `variance` [DN²] and int64 `count` (rows,).
    """
    for w in range(len(count)):
        y = samples[offsets[w] : offsets[w + 1]]
        n = len(y)
        ahead, behind = int(math.ceil(before / spacing[w])), int(math.ceil(after / spacing[w]))
        limit = level[w] + MARK * noise[w]
        blocked, coming = -1, 0
        total, square, kept = 0.0, 0.0, 0
        for i in range(n):
            while coming < min(i + ahead + 1, n):
                if y[coming] > limit:
                    blocked = coming + behind
                coming += 1
            if i <= blocked:
                continue
            d = y[i] - level[w]
            total += d
            square += d * d
            kept += 1
        count[w] = kept
        mean[w] = level[w] + total / kept if kept > 0 else np.nan
        variance[w] = max(square - total * total / kept, 0.0) / (kept - 1) if kept > 1 else np.nan
