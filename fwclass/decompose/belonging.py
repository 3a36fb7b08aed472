"""Whether waveforms are those of the returns that point to them, and counted in the same time: what a file shows whose
packets were mixed up, or whose times and beam vectors have other units than the format's."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.placing import beams
from fwclass.waveforms import Waveforms

APART = 3.0
"""Least time between two returns of a pulse [ns] whose distance tells something: 0.45 m, of places in centimetres."""

NEARER, FARTHER, ROUNDED = 0.7, 1.1, 0.1
"""Shares of the way that light goes between two returns' locations within which their distance lies, and metres beside:
0.75 where a vendor has taken the light's slower way through water off the places."""

ASIDE = 0.1
"""Share of that way by which the later return lies beside the beam at most: light that comes down 25 degrees off bends
by as much in water; beams that are mirrored, or all straight down, are off by as much from 3 and 6 degrees on."""

COUNTS = ("compared", "unlike", "paired", "misplaced")
"""What `belonging` counts."""


def belonging(waves: Waveforms, of_return: Mapping[str, NDArray], usable: NDArray[np.bool_]) -> dict[str, int]:
    """How well waveforms belong to their returns, by `COUNTS`.

    Of consecutive returns those ``compared`` that differ in strength, and ``unlike`` where the echo of the stronger one
    is the lower; ``paired`` consecutive returns of one pulse, and ``misplaced`` those that do not lie as far apart,
    along their beam, as light goes between their locations.

    Parameters
    ----------
    waves : pulses and returns of a chunk.
    of_return : columns of the echo of every return; ``amplitude`` [DN] is read.
    usable : bool (returns,), whether that echo is fitted, and its height known.
    """
    if waves.returns.rows == 0 or waves.pulses.rows == 0:
        return dict.fromkeys(COUNTS, 0)
    compared, unlike = _strengths(waves, of_return["amplitude"], usable)
    paired, misplaced = _distances(waves)
    return dict(zip(COUNTS, (compared, unlike, paired, misplaced), strict=True))


def _strengths(waves: Waveforms, amplitude: NDArray, usable: NDArray[np.bool_]) -> tuple[int, int]:
    """Differences tell, not values: intensities may be scaled by range, which neighbours share, and samples by gain,
    so that only neighbours of one gain are compared."""
    returns, pulses = waves.returns, waves.pulses
    stored = returns["vendor_amplitude"]
    strength = np.where(np.isnan(stored), returns["intensity"], stored).astype(np.float64)[usable]
    row = np.searchsorted(pulses["pulse"], returns["pulse"][usable])
    gain = pulses["gain"][np.minimum(row, pulses.rows - 1)]
    product = np.sign(np.diff(strength)) * np.sign(np.diff(amplitude[usable].astype(np.float64)))
    product = product[np.diff(gain) == 0.0]
    return int((np.abs(product) > 0.0).sum()), int((product < 0.0).sum())


def _distances(waves: Waveforms) -> tuple[int, int]:
    returns = waves.returns.take(np.flatnonzero(waves.returns["has_packet"]))
    returns = returns.take(np.lexsort((returns["return_number"], returns["pulse"])))
    later = np.diff(returns["location"].astype(np.float64))
    pair = (np.diff(returns["pulse"].astype(np.int64)) == 0) & (np.abs(later) >= APART)
    row = np.searchsorted(waves.pulses["pulse"], returns["pulse"][1:][pair])
    beam, speed = (values[row] for values in beams(waves))
    way = np.abs(later[pair]) * speed
    place = np.stack([returns[a] for a in "xyz"], axis=1)
    apart = np.diff(place, axis=0)[pair] * np.sign(later[pair])[:, None]
    distance, along = np.linalg.norm(apart, axis=1), (apart * beam).sum(axis=1)
    aside = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
    misplaced = (distance > FARTHER * way + ROUNDED) | (distance < NEARER * way - ROUNDED)
    misplaced |= (aside > ASIDE * way + ROUNDED) | (along < -ROUNDED)
    return int(pair.sum()), int(misplaced.sum())
