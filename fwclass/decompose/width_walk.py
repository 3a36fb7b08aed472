"""How wide echoes are at every height: a receiver whose samples grow with the light has one width at all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.params import PulseParams
from fwclass.decompose.pulse_align import narrowest
from fwclass.decompose.pulse_channels import rough_levels
from fwclass.decompose.pulse_estimate import bright_peaks, usable, with_clips
from fwclass.decompose.pulse_sample import rows_of
from fwclass.decompose.system_pulse import Channel
from fwclass.waveforms import Waveforms

CLASSES = 8
"""Classes of height, of equally many echoes, at most."""

SHARED, NEAR, FAR = 0.5, 0.1, 0.4
"""Of a class's echoes within `FAR` of the narrowest width, the share within `NEAR` of it for the width to be one that
they share, as flat targets do; where widths spread evenly it is a quarter."""

ROUGH, COARSE = 1.2, 0.01
"""A width between two crossings of half the height is off by these shares of itself: times noise over height (both
crossings of a Gaussian and its top), and by where the samples fall."""


def width_walk(waves: Waveforms, params: PulseParams, channels: Sequence[Channel] = ()) -> list[tuple[float, float]]:
    """(median height [DN], narrowest shared width at half maximum [ns]) of bright single echoes, by classes of height.

    All `channels` of the commonest sample spacing count alike, for digitisers may store bright echoes in wider numbers;
    but not those of receivers that are known to differ.
    Classes whose echoes share no width, of slopes or plants, are left out. Empty where there are too few.
    """
    waves = usable(waves)
    others = np.array([len(c.receivers) > 0 for c in channels] + [False])[channel_rows(channels, waves.pulses)]
    waves = rows_of(waves, np.flatnonzero(~others))
    if waves.pulses.rows == 0:
        return []
    waves, _, group, _ = with_clips(waves)
    level, noise = rough_levels(waves, group)
    peak, height, width = bright_peaks(waves, level, noise, params)
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    values, count = np.unique(spacing[peak >= 0], return_counts=True)
    if len(values) == 0:
        return []
    rows = np.flatnonzero((peak >= 0) & (spacing == values[count.argmax()]))
    rows = rows[np.argsort(height[rows], kind="stable")]
    classes = min(CLASSES, len(rows) // params.min_echoes)
    walk = []
    for some in np.array_split(rows, classes) if classes else []:
        error = width[some] * (ROUGH * noise[some] / height[some] + COARSE)
        least = narrowest(width[some], error)
        apart = np.abs(width[some] - least)
        if (apart < NEAR * least).sum() >= SHARED * (apart < FAR * least).sum():
            walk.append((float(np.median(height[some])), least))
    return walk
