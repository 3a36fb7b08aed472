"""Kernels of stacking: pulses held against the place where a surface predicts their echo, then several together."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel


@kernel
def match_around(  # type: ignore[no-untyped-def]
    white, offsets, rows, at, half, template, phases, first, lags, product, energy, slope
):
    """Products of waveforms with the pulse's shape around a predicted sample, the level free.

    Parameters
    ----------
    white : samples less level and fitted echoes, made white [DN]; waveform i is ``white[offsets[i]:offsets[i + 1]]``.
    rows, at : (n,) waveforms, and the sample at which an echo is predicted.
    half : samples before and behind it that count; all of them must lie in the waveform.
    template, phases, first : the pulse made white, `phases` values a sample, from `first` samples after its peak on.
    lags : (k,) places that are tried [samples after the predicted one].
    product : (n, k), filled with the sum of shape times sample [DN]; energy : with the sum of the shape's squares;
        slope : with that of the squares of its derivative [1/sample2]. The shape's mean over the samples is taken off.
    """
    last = len(template) - 1
    for i in range(len(rows)):
        low = offsets[rows[i]]
        begin, end = int(math.ceil(at[i] - half)), int(math.floor(at[i] + half)) + 1
        for k in range(len(lags)):
            one, two, steep, both, values = 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(begin, end):
                y = white[low + j]
                values += y
                place = (j - at[i] - lags[k] - first) * phases
                cell = int(math.floor(place))
                if cell < 0 or cell >= last:
                    continue
                step = template[cell + 1] - template[cell]
                h = template[cell] + (place - cell) * step
                one += h
                two += h * h
                steep += (step * phases) ** 2
                both += h * y
            n = float(end - begin)
            product[i, k] = both - one * values / n
            energy[i, k] = two - one * one / n
            slope[i, k] = steep


@kernel
def stack_groups(members, product, energy, slope, weight, peaks):  # type: ignore[no-untyped-def]
    """Where the weighted sum of the pulses of a group stands out most.

    Parameters
    ----------
    members : (g, m) pulses of every group, -1 where it has fewer.
    product, energy, slope : (n, k), see `match_around`.
    weight : (n,) one over the variance of a pulse's noise [1/DN2].
    peaks : (g, 6), filled with significance (height of the sum over its standard deviation), amplitude and its standard
        error [DN], place of the peak [lags from the first; NaN at either end], its standard error [samples], pulses.
    """
    tried = product.shape[1]
    curve = np.empty(tried)
    for g in range(len(members)):
        top, count = 0, 0
        for i in members[g]:
            count += i >= 0
        for k in range(tried):
            total, known = 0.0, 0.0
            for i in members[g]:
                if i >= 0:
                    total += weight[i] * product[i, k]
                    known += weight[i] * energy[i, k]
            curve[k] = total / math.sqrt(known) if known > 0.0 else 0.0
            if curve[k] > curve[top]:
                top = k
        known, steep = 0.0, 0.0
        for i in members[g]:
            if i >= 0:
                known += weight[i] * energy[i, top]
                steep += weight[i] * slope[i, top]
        place = np.nan
        if 0 < top < tried - 1:
            bend = 2.0 * curve[top] - curve[top - 1] - curve[top + 1]
            place = top + (0.5 * (curve[top + 1] - curve[top - 1]) / bend if bend > 0.0 else 0.0)
        sigma = 1.0 / math.sqrt(known) if known > 0.0 else np.nan
        height = curve[top] * sigma
        peaks[g, 0], peaks[g, 1], peaks[g, 2] = curve[top], height, sigma
        peaks[g, 3], peaks[g, 4] = place, 1.0 / (height * math.sqrt(steep)) if height > 0.0 and steep > 0.0 else np.nan
        peaks[g, 5] = count
