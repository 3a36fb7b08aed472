"""Whether every other pulse, or those of one waveform descriptor, have higher echoes than their neighbours: lasers,
facets or receivers that are not alike."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import Fits
from fwclass.units import ERROR_OF_MEDIAN, SIGMA_PER_MAD
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

FEWEST = 200
"""Pairs of consecutive pulses of one echo each that tell it."""

LEAST, SURE = 0.02, 5.0
"""Ratio of both heights less 1 from which it is told, and in standard errors."""

PIECES = 4
"""Parts along a strip that are asked on their own: in a file joined of two, odd pulses of one are even ones here."""

CHOSEN = 0.25
"""Share of the ratio's logarithm by which pulses before those of a descriptor are higher than those before others,
from which on the height has chosen the descriptor, and not the other way round."""


def alternate_heights(sample: Waveforms, fits: Fits) -> float:
    """How many times as high (amplitudes [DN]) the echoes of odd pulses are as those of even ones, of `sample_runs`, or
    of that quarter of it where they differ most; 1 where that is not sure. What lies under consecutive pulses is much
    the same, and a median over pairs knows nothing of the rest."""
    pulse, height, _ = _singles(sample, fits)
    pairs = np.flatnonzero(np.diff(pulse) == 1)
    higher = (height[pairs + 1] - height[pairs]) * (2.0 * (pulse[pairs] % 2 == 0) - 1.0)
    parts = [_sure(part) for part in (higher, *np.array_split(higher, PIECES))]
    return math.exp(parts[0] or max(parts[1:], key=abs))


def descriptor_heights(sample: Waveforms, fits: Fits) -> tuple[tuple[int, float], ...]:
    """Waveform descriptors, and how many times as high [DN] their echoes are as those of the commonest one in the
    pulses before and behind, of `sample_runs`; none where that is not sure, or where the height tells which it is, as
    in receivers that change over to a detector of low gain."""
    pulse, height, descriptor = _singles(sample, fits)
    kinds, count = np.unique(descriptor, return_counts=True)
    if len(kinds) < 2:
        return ()
    usual = kinds[np.argmax(count)]
    follows = np.flatnonzero(np.diff(pulse) == 1)
    before, behind = descriptor[follows], descriptor[follows + 1]
    first, second = height[follows], height[follows + 1]
    unlike = []
    for kind in kinds[kinds != usual]:
        onto, back = (before == usual) & (behind == kind), (before == kind) & (behind == usual)
        ratio = _sure(np.concatenate([(second - first)[onto], (first - second)[back]]))
        same = (before == usual) & (behind == usual)
        chosen = float(np.median(first[onto]) - np.median(first[same])) if onto.any() and same.any() else 0.0
        if abs(chosen) < CHOSEN * abs(ratio):
            unlike.append((int(kind), math.exp(ratio)))
    return tuple(unlike)


def _singles(sample: Waveforms, fits: Fits) -> tuple[NDArray[np.int64], Floats, NDArray[np.integer]]:
    """Numbers of the pulses that have one echo, the logarithm of its height, and their waveform descriptor."""
    number = sample.pulses["pulse"].astype(np.int64)
    alone = np.bincount(fits.row, minlength=len(number)) == 1
    alone[1:] &= number[1:] != number[:-1]
    alone[:-1] &= number[1:] != number[:-1]
    use = alone[fits.row] & (fits.flags & SATURATED == 0)
    row = fits.row[use]
    return number[row], np.log(fits.amplitude[use]), sample.pulses["receiver"][row]


def _sure(higher: Floats) -> float:
    """Median of `higher`, (n,); 0 where it is not surely one, or is little."""
    if len(higher) < FEWEST:
        return 0.0
    middle = float(np.median(higher))
    spread = SIGMA_PER_MAD * float(np.median(np.abs(higher - middle)))
    sure = abs(middle) > SURE * ERROR_OF_MEDIAN * spread / math.sqrt(len(higher))
    return middle if sure and abs(middle) > LEAST else 0.0
