"""Whether more echoes follow those that saturate than those that nearly do: a receiver that is overloaded.

What lies behind a surface knows nothing of the digitiser's limit, so that waveforms on both sides of it are followed
alike. A receiver that swings to and fro behind saturated samples makes echoes there, at any time and of any height.
"""

from __future__ import annotations

import math

import numpy as np

from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import Fits

FEWEST = 20
"""Waveforms on either side of the limit that tell it."""

NEARLY = 0.5
"""Share of the limit, taken from the brightest echoes below it, from which on an echo nearly saturates."""

LEAST, SURE = 0.2, 5.0
"""Difference of both shares from which it is told, and in standard errors: 0.07 of sound receivers (simulated)."""


def followed_echoes(fits: Fits) -> tuple[float, float]:
    """Share of the waveforms whose highest echo saturates, and of those where it nearly does, in which another echo
    follows it; (0, 0) where the first is not surely the larger one by `LEAST`.

    Parameters
    ----------
    fits : of a strip's sample; every row is a waveform.
    """
    order = np.lexsort((fits.time, -fits.amplitude, fits.row))
    row, time = fits.row[order], fits.time[order]
    highest = np.flatnonzero(np.append(True, row[1:] != row[:-1])[: len(row)])
    number = np.cumsum(np.bincount(highest, minlength=len(row))) - 1
    follows = np.zeros(len(highest), np.bool_)
    follows[number[time > time[highest][number]]] = True
    full, height = fits.flags[order][highest] & SATURATED > 0, fits.amplitude[order][highest]
    if full.sum() < FEWEST or (~full).sum() < FEWEST:
        return 0.0, 0.0
    nearly = ~full & (height >= NEARLY * np.quantile(height[~full], 0.99))
    if nearly.sum() < FEWEST:
        return 0.0, 0.0
    behind, usual = float(follows[full].mean()), float(follows[nearly].mean())
    variance = behind * (1.0 - behind) / full.sum() + usual * (1.0 - usual) / nearly.sum()
    more = behind - usual
    return (behind, usual) if more >= LEAST and more >= SURE * math.sqrt(variance) else (0.0, 0.0)
