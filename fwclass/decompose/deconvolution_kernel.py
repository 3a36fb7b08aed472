"""The kernel that takes the system's pulse out of waveforms."""

from __future__ import annotations

import numpy as np

from fwclass.kernel import kernel

TINY = 1e-12


@kernel
def deconvolve_rows(samples, offsets, rows, level, limit, pulse, before, gold, rounds, out):  # type: ignore[no-untyped-def]
    """Backscatter at every sample of waveforms, in heights of the pulse.

    Parameters
    ----------
    samples, offsets : [DN]; waveform i is ``samples[offsets[i]:offsets[i + 1]]``.
    rows : waveforms; level : (len(rows),) of each without signal [DN].
    limit : (len(rows),) what the sum over the pulse's own shape must reach for a sample to belong to a signal [DN].
    pulse, before : heights of the pulse at whole samples, the peak at ``pulse[before]``.
    gold : Gold's ratio instead of Richardson and Lucy's; rounds : how often it is taken.
    out : filled at the rows' samples; 0 where there is no signal.
    """
    m = len(pulse)
    mass, power = pulse.sum(), (pulse * pulse).sum()
    longest = 0
    for i in rows:
        longest = max(longest, offsets[i + 1] - offsets[i])
    y, x, fold = np.empty(longest), np.empty(longest + 2 * m), np.empty(longest + 2 * m)
    seen, weight = np.empty(longest + 2 * m), np.empty(longest + 2 * m)
    signal = np.empty(longest, np.bool_)
    for r in range(len(rows)):
        low, n = offsets[rows[r]], offsets[rows[r] + 1] - offsets[rows[r]]
        for j in range(n):
            y[j] = samples[low + j] - level[r]
            signal[j] = False
        for j in range(n):
            height = 0.0
            for k in range(max(0, before - j), min(m, n - j + before)):
                height += pulse[k] * y[j + k - before]
            if height > limit[r] * power:
                for k in range(max(0, j - before), min(n, j + m - before)):
                    signal[k] = True
        start = 0
        while start < n:
            if not signal[start]:
                start += 1
                continue
            stop = start
            while stop < n and signal[stop]:
                stop += 1
            size, total = stop - start, 0.0
            for j in range(size):
                y[start + j] = max(y[start + j], 0.0)
                total += y[start + j]
            for j in range(size):
                x[j] = total / (size * mass)
                weight[j] = 0.0
                for k in range(m):
                    if 0 <= j + k - before < size:
                        weight[j] += pulse[k]
                seen[j] = 0.0
                if gold:
                    for k in range(max(0, before - j), min(m, size - j + before)):
                        seen[j] += pulse[k] * y[start + j + k - before]
            for _ in range(rounds):
                for j in range(size):
                    value = 0.0
                    for k in range(max(0, j + before - size + 1), min(m, j + before + 1)):
                        value += pulse[k] * x[j + before - k]
                    fold[j] = value if gold else y[start + j] / max(value, TINY)
                for j in range(size):
                    value = 0.0
                    for k in range(max(0, before - j), min(m, size - j + before)):
                        value += pulse[k] * fold[j + k - before]
                    if gold:
                        x[j] *= max(seen[j], 0.0) / max(value, TINY)
                    else:
                        x[j] *= value / max(weight[j], TINY)
            for j in range(size):
                out[low + start + j] = x[j]
            start = stop
