"""Zeros behind the last sample of a waveform: records of one length whose digitiser stopped earlier."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fwclass.waveforms import Waveforms

FEWEST, LEVEL = 4, 4
"""Zeros on end that are padding, where no other sample of the waveform is below so many DN: noise reaches 0 in a record
whose level lies there, and a receiver that swings down to 0 behind an echo loses nothing that counts."""

PADDED = "waveform padded with zeros at its end (left out)"


def without_padding(waves: Waveforms) -> Waveforms:
    """`waves` that end with their last sample, those that were padded counted in `faults`."""
    length = np.diff(waves.offsets)
    rows = np.flatnonzero(length > FEWEST)
    tails = waves.samples[waves.offsets[1:][rows, None] - 1 - np.arange(FEWEST)]
    kept = length.copy()
    for row in rows[~tails.any(axis=1)]:
        kept[row] = _recorded(waves.samples[waves.offsets[row] : waves.offsets[row + 1]])
    padded = int((kept < length).sum())
    if padded == 0:
        return waves
    offsets = np.concatenate([[0], np.cumsum(kept)]).astype(np.int64)
    at = np.arange(offsets[-1]) + np.repeat(waves.offsets[:-1] - offsets[:-1], kept)
    return replace(waves, samples=waves.samples[at], offsets=offsets, faults={**waves.faults, PADDED: padded})


def _recorded(samples: NDArray) -> int:
    """How many of `samples`, whose last ones are 0, are no padding."""
    some = np.flatnonzero(samples)
    n = int(some[-1]) + 1 if len(some) else 0
    return n if n and samples[:n].min() >= LEVEL else len(samples)
