"""The outgoing pulses as they were recorded, to hold the system pulse of the echoes against."""

from __future__ import annotations

from typing import Any

from fwclass.decompose.fitting import further_share
from fwclass.decompose.params import FEWEST, DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.waveforms import Waveforms


def recorded_pulse(outgoing: Waveforms, params: PulseParams) -> SystemPulse | None:
    """The pulse that recorded outgoing pulses share, of every channel; None where too few show one.

    They stand for the system's pulse as echoes do; compare Jutzi and Stilla 2006.
    """
    pulse = estimate_pulse(outgoing, params.model_copy(update={"width": None}))
    return pulse if pulse.echoes >= FEWEST else None


def channel_pulses(pulse: SystemPulse, recorded: SystemPulse | None, params: DecomposeParams) -> list[dict[str, Any]]:
    """Of every channel of the receiver, or of the strip where none is known: spacing [ns], saturation [DN], the
    `receivers` that it has of several that share these, its noise [DN], the width of its pulse [ns], how many echoes or
    outgoing pulses it stands on, how wide the outgoing pulse was recorded, what bright single echoes leave over the
    noise (`Channel.misfit`), the share of the threshold that is therefore asked of further echoes, whether its noise is
    correlated, the step of its samples [DN], its `recovery` [ns, DN], `copies` [ns, share], and
    `parity`."""
    outgoing = {} if recorded is None else {c.key: recorded.of(c) for c in recorded.channels}
    rows = []
    for channel in pulse.channels or (None,):
        own, as_sent = pulse.of(channel), outgoing.get(channel.key, recorded) if channel else recorded
        rows.append(
            {
                "sample_spacing": channel and channel.sample_spacing,
                "saturation": channel and channel.saturation,
                "receivers": list(channel.receivers) if channel else [],
                "noise": channel and channel.noise,
                "fwhm": own.fwhm,
                "echoes": own.echoes,
                "outgoing": own.outgoing,
                "recorded_fwhm": as_sent and as_sent.fwhm,
                "misfit": channel and channel.misfit,
                "further_detection": further_share(channel, params),
                "correlated": bool(channel and channel.phi),
                "step": channel.step if channel else 1.0,
                "recovery": channel.recovery if channel else 0.0,
                "recovery_depth": channel.recovery_depth if channel else 0.0,
                "parity": channel.parity if channel else 0.0,
                "copies": channel.copy_delays if channel else [],
                "parity_walk": channel.parity_walk if channel else 0.0,
            }
        )
    return rows
