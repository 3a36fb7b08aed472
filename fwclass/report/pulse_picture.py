"""The system's pulse as a picture, for the report and for `fwclass info --waveforms`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fwclass.decompose.system_pulse import SystemPulse
from fwclass.publish.waveform_pictures import ReceiverPicture, draw_pulse, draw_receiver
from fwclass.report.pulse_remarks import descriptor_words

LEAST_REACH = 25.0
"""Time after the peak that is shown at least [ns]: ringing comes late."""


FREQUENCIES = 257
"""Of the noise's spectrum, up to half of the sampling rate."""


def pulse_picture(pulse: SystemPulse, source: str) -> bytes:
    """PNG of the system's pulse of `source`, beside a Gaussian of its width."""
    time = _times(pulse)
    return draw_pulse(time, pulse.at(time), SystemPulse.gaussian(pulse.fwhm).at(time), _title(pulse, source))


def receiver_picture(
    pulse: SystemPulse, recorded: SystemPulse | None, places: Mapping[str, Any] | None, source: str
) -> bytes:
    """PNG of all that is known of the receiver of `source`: its pulse beside the recorded outgoing one, the spectrum of
    its noise, and its vendor's offset over the height (`places`, see `describe_placement`)."""
    time = _times(pulse)
    spectra = []
    for channel in pulse.channels:
        noise, rate = channel.autoregression, 1.0 / channel.sample_spacing
        frequency = np.linspace(0.0, 0.5 * rate, FREQUENCIES)
        turn = np.exp(-2j * np.pi * np.outer(frequency / rate, np.arange(len(noise.filter))))
        power = noise.innovation / np.abs(turn @ noise.filter) ** 2
        spectra.append((_channel(*channel.key), frequency, power))
    offsets = [
        (_channel(c["sample_spacing"], c["saturation"], c["receivers"]), np.array(c["heights"]), np.array(c["offsets"]))
        for c in (places or {}).get("vendor_offset", ())
    ]
    gaussian = SystemPulse.gaussian(pulse.fwhm).at(time)
    outgoing = None if recorded is None else recorded.at(time)
    return draw_receiver(
        ReceiverPicture(_title(pulse, source), time, pulse.at(time), gaussian, outgoing, spectra, offsets)
    )


def _channel(spacing: float, saturation: float, receivers: Sequence[int]) -> str:
    own = f", {descriptor_words(receivers)}" if receivers else ""
    return f"{spacing:g} ns, up to {saturation:g} DN{own}"


def _times(pulse: SystemPulse) -> np.ndarray:
    return np.linspace(-2.0 * pulse.fwhm, max(4.0 * pulse.fwhm, LEAST_REACH), 1201)


def _title(pulse: SystemPulse, source: str) -> str:
    origin = f"from {pulse.echoes:,} echoes" if pulse.echoes else "not measured"
    origin = f"of {pulse.outgoing:,} recorded outgoing pulses" if pulse.outgoing else origin
    return f"System's pulse of {source}: {pulse.shape}, {pulse.fwhm:.2f} ns wide, {origin}"
