"""Whether every other pulse has higher echoes: two lasers, facets or receivers in turn that are not alike."""

from __future__ import annotations

import math

import numpy as np

from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import Fits
from fwclass.units import SIGMA_PER_MAD
from fwclass.waveforms import Waveforms

FEWEST = 200
"""Pairs of consecutive pulses of one echo each that tell it."""

LEAST, SURE = 0.02, 5.0
"""Ratio of both heights less 1 from which it is told, and in standard errors."""

ERROR_OF_MEDIAN = 1.2533
"""Standard error of a median over that of a mean."""


def alternate_heights(sample: Waveforms, fits: Fits) -> float:
    """How many times as high (amplitudes [DN]) the echoes of odd pulses are as those of even ones, of `sample_runs`; 1
    where that is not sure. What lies under consecutive pulses is much the same, and a median over pairs knows nothing
    of the rest."""
    number = sample.pulses["pulse"].astype(np.int64)
    alone = np.bincount(fits.row, minlength=len(number)) == 1
    alone[1:] &= number[1:] != number[:-1]
    alone[:-1] &= number[1:] != number[:-1]
    use = alone[fits.row] & (fits.flags & SATURATED == 0)
    pulse, height = number[fits.row[use]], np.log(fits.amplitude[use])
    pairs = np.flatnonzero(np.diff(pulse) == 1)
    if len(pairs) < FEWEST:
        return 1.0
    higher = (height[pairs + 1] - height[pairs]) * (2.0 * (pulse[pairs] % 2 == 0) - 1.0)
    middle = float(np.median(higher))
    spread = SIGMA_PER_MAD * float(np.median(np.abs(higher - middle)))
    sure = abs(middle) > SURE * ERROR_OF_MEDIAN * spread / math.sqrt(len(pairs))
    return math.exp(middle) if sure and abs(middle) > LEAST else 1.0
