"""The system's pulse as a picture, for the report and for `fwclass info --waveforms`."""

from __future__ import annotations

import numpy as np

from fwclass.decompose.system_pulse import SystemPulse
from fwclass.publish.waveplot import draw_pulse

LEAST_REACH = 25.0
"""Time after the peak that is shown at least [ns]: ringing comes late."""


def pulse_picture(pulse: SystemPulse, of: str) -> bytes:
    """PNG of the system's pulse of `of`, beside a Gaussian of its width."""
    time = np.linspace(-2.0 * pulse.fwhm, max(4.0 * pulse.fwhm, LEAST_REACH), 1201)
    origin = f"from {pulse.echoes:,} echoes" if pulse.echoes else "not measured"
    origin = f"of {pulse.outgoing:,} recorded outgoing pulses" if pulse.outgoing else origin
    title = f"System's pulse of {of}: {pulse.shape}, {pulse.fwhm:.2f} ns wide, {origin}"
    return draw_pulse(time, pulse.at(time), SystemPulse.gaussian(pulse.fwhm).at(time), title)
