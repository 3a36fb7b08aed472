"""How wide echoes are at every height and along the strip: a receiver whose samples grow with the light has one width
at all heights, and a laser and receiver that do not drift have one from begin to end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.params import PulseParams
from fwclass.decompose.pulse_align import narrowest
from fwclass.decompose.pulse_channels import rough_levels
from fwclass.decompose.pulse_estimate import bright_peaks, usable, with_clips
from fwclass.decompose.pulse_sample import rows_of
from fwclass.decompose.system_pulse import Channel
from fwclass.waveforms import Waveforms

Floats = NDArray[np.floating]

CLASSES = 8
"""Classes of height, or along the strip, of equally many echoes, at most."""

SHARED, NEAR, FAR = 0.5, 0.1, 0.4
"""Of a class's echoes within `FAR` of the narrowest width, the share within `NEAR` of it for the width to be one that
they share, as flat targets do; where widths spread evenly it is a quarter."""

ROUGH, COARSE = 1.2, 0.01
"""A width between two crossings of half the height is off by these shares of itself: times noise over height (both
crossings of a Gaussian and its top), and by where the samples fall."""


class BrightWidths(NamedTuple):
    """Bright single echoes of the commonest sample spacing: height [DN], width and its error [ns], number of the
    pulse."""

    height: Floats
    width: Floats
    error: Floats
    pulse: Floats


def bright_widths(waves: Waveforms, params: PulseParams, channels: Sequence[Channel] = ()) -> BrightWidths:
    """Of the bright single echoes how wide they are.

    All `channels` of the commonest sample spacing count alike, for digitisers may store bright echoes in wider numbers;
    but not those of receivers that are known to differ.
    """
    waves = usable(waves)
    others = np.array([len(c.receivers) > 0 for c in channels] + [False])[channel_rows(channels, waves.pulses)]
    waves = rows_of(waves, np.flatnonzero(~others))
    if waves.pulses.rows == 0:
        return BrightWidths(*np.empty((4, 0)))
    waves, _, group, _ = with_clips(waves)
    level, noise = rough_levels(waves, group)
    peak, height, width = bright_peaks(waves, level, noise, params)
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    values, count = np.unique(spacing[peak >= 0], return_counts=True)
    rows = np.flatnonzero((peak >= 0) & (spacing == values[count.argmax()] if len(values) else False))
    error = width[rows] * (ROUGH * noise[rows] / height[rows] + COARSE)
    return BrightWidths(height[rows], width[rows], error, waves.pulses["pulse"][rows].astype(np.float64))


def width_walk(echoes: BrightWidths, params: PulseParams) -> list[tuple[float, float]]:
    """(median height [DN], narrowest shared width at half maximum [ns]) of bright single echoes, by classes of height.

    Classes whose echoes share no width, of slopes or plants, are left out. Empty where there are too few.
    """
    return [(float(np.median(echoes.height[some])), least) for some, least in _shared(echoes, echoes.height, params)]


def width_drift(echoes: BrightWidths, params: PulseParams) -> list[tuple[float, float]]:
    """(median number of the pulse, narrowest shared width [ns]) of bright single echoes along the strip, as
    `width_walk`."""
    return [(float(np.median(echoes.pulse[some])), least) for some, least in _shared(echoes, echoes.pulse, params)]


def _shared(echoes: BrightWidths, by: Floats, params: PulseParams) -> Iterator[tuple[NDArray[np.int64], float]]:
    """Classes of `echoes` by ascending `by`, (n,), and the narrowest width that each shares [ns], where it does."""
    order = np.argsort(by, kind="stable")
    classes = min(CLASSES, len(order) // params.min_echoes)
    for some in np.array_split(order, classes) if classes else []:
        least = narrowest(echoes.width[some], echoes.error[some])
        apart = np.abs(echoes.width[some] - least)
        if (apart < NEAR * least).sum() >= SHARED * (apart < FAR * least).sum():
            yield some, least
