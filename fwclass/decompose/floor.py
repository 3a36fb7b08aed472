"""Samples at the digitiser's floor: what a receiver that swings below its level behind bright echoes would have had
below 0 is cut off, so that they carry no weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.waveforms import Waveforms

DEEP = 8.0
"""Standard deviations of the noise by which a level must stand above 0 for a sample of 0 to be none of its noise."""

CUT = 1e8
"""Variance of samples that are not to count [DN^2]."""


def at_floor(waves: Waveforms, pulse: SystemPulse) -> NDArray[np.bool_]:
    """Which samples are 0, though their channel's level [DN] is far above it, bool (samples,)."""
    zero = waves.samples == 0
    if not zero.any():
        return zero
    high = np.array([c.baseline > DEEP * c.noise for c in pulse.channels] + [False])
    return zero & np.repeat(high[channel_rows(pulse.channels, waves.pulses)], np.diff(waves.offsets))


def floor_doubt(waves: Waveforms, pulse: SystemPulse) -> NDArray[np.float64]:
    """Variance of every sample beside the noise's [DN^2], (samples,); empty where none is at the floor."""
    cut = at_floor(waves, pulse)
    return np.where(cut, CUT, 0.0) if cut.any() else np.empty(0)
