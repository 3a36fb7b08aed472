"""Receivers that swing below their level behind saturated samples, and recover exponentially: measured, and taken off.

Behind every stretch of saturated samples the level is lower by d exp(-t / tau), t from its end on. tau is the
channel's, from its own saturated waveforms; d is each stretch's, by linear least squares from what the echoes leave.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.copies import without_copies
from fwclass.decompose.fitting import fit_waveforms, sample_limits, signal_of
from fwclass.decompose.floor import at_floor, floor_doubt
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_sample import of_channel, rows_of
from fwclass.decompose.sample_parity import even_gains
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

FEWEST, MOST = 20, 500
"""Saturated waveforms of a channel that tell its recovery, at least and at most."""

TIMES = np.geomspace(2.0, 120.0, 36)
"""Time constants that are tried [ns]."""

WORTH = 10.0
"""Mean gain of chi-square, of a saturated waveform, that a recovery must bring: without one 0.6 to 1.6 (simulated)."""

NEAR = 1.5
"""FWHM behind the end of saturation within which when the recovery begins, and how, is not known."""

ROUNDS, SWEEPS = 3, 3
"""Fits of the recovery, and passes over the stretches of saturation in each."""

UNKNOWN = 1e8
"""Variance of samples that are not to count [DN^2]."""

CAPPED, STRAY = 25.0, 6.0
"""Square of a standardised residual that counts at most, and one that does not count at all."""

MODEL = 0.02
"""Share of the echoes' height by which they are doubted themselves."""

AT_LIMIT, NOTICED = 3.0, 0.2
"""A corrected sample so few DN below the limit was at the receiver's, where the level was lower by that many DN."""


@dataclass(frozen=True)
class _Saturated:
    """Saturated waveforms, sample by sample.

    Attributes
    ----------
    waves : the waveforms.
    row, saturated : of every sample, its waveform and whether it stands at the limit.
    top, noise, step : of every sample, limit, noise and step of its channel [DN].
    ends : int64 (stretches, rows), the last sample of each waveform's first, second, ... stretch; -1 without.
    rate, doubt : of every sample, 1 over the time constant [1/samples], and `Channel.recovery_doubt`.
    near : samples in which the recovery begins.
    """

    waves: Waveforms
    row: NDArray[np.int64]
    saturated: NDArray[np.bool_]
    top: Floats
    noise: Floats
    step: Floats
    ends: NDArray[np.int64]
    rate: Floats
    doubt: Floats
    near: NDArray[np.bool_]

    def fade(self, k: int) -> Floats:
        """How far the k-th stretch of every waveform still is in effect, from 1 right behind it."""
        behind = np.arange(len(self.row)) - self.ends[k][self.row]
        there = (self.ends[k][self.row] >= 0) & (behind > 0)
        return np.where(there, np.exp(-(np.maximum(behind, 1) - 1.0) * self.rate), 0.0)


def with_recovery(pulse: SystemPulse, waves: Waveforms, params: DecomposeParams) -> SystemPulse:
    """`pulse` whose channels tell how they recover from saturation, where their saturated waveforms show it, and
    `params.recovery` does not keep the samples as they are.

    Depends on the set of waveforms only.
    """
    if params.recovery == "keep":
        return pulse
    waves, _ = without_copies(even_gains(waves, pulse), pulse, params)
    return replace(pulse, channels=tuple(_measure(c, pulse, waves, params) for c in pulse.channels))


def recovered(waves: Waveforms, params: DecomposeParams, pulse: SystemPulse) -> tuple[Waveforms, Floats]:
    """`waves` whose samples have one gain (`even_gains`), those behind saturated ones brought back to the level,
    rounded to whole steps, and what variance every sample has beside the noise's for it, and at the digitiser's floor
    [DN^2], (samples,); `waves` itself where no channel needs either, and an empty array where no sample is
    doubted. Every waveform is corrected alone."""
    waves, later = without_copies(even_gains(waves, pulse), pulse, params)
    cut = _summed(floor_doubt(waves, pulse), later)
    if not any(c.recovery > 0.0 for c in pulse.channels):
        return waves, cut
    saturated = _saturated(waves, pulse)
    if saturated is None:
        return waves, cut
    part, rows = saturated
    lower = np.zeros(len(part.row))
    doubt = np.where(part.near, UNKNOWN, 0.0)
    for _ in range(ROUNDS - 1):
        residual, variance = _left(part, pulse, params, lower, doubt)
        lower, _ = _lowered(part, residual, variance)
        doubt = np.where(part.near, (part.doubt * lower) ** 2, 0.0)
    samples, doubts = waves.samples.copy(), np.zeros(len(waves.samples))
    length = np.diff(waves.offsets)[rows]
    at = np.arange(len(part.row)) + np.repeat(waves.offsets[rows] - part.waves.offsets[:-1], length)
    samples[at], doubts[at] = _raised(part, lower), doubt
    return replace(waves, samples=samples), _summed(doubts, cut)


def _summed(one: Floats, other: Floats) -> Floats:
    """Variances of samples, (samples,) or empty, together."""
    return one + other if len(one) and len(other) else one if len(one) else other


def _measure(channel: Channel, pulse: SystemPulse, waves: Waveforms, params: DecomposeParams) -> Channel:
    mine = of_channel(waves, channel, pulse.channels, len(waves.samples) + 1)
    if len(mine.samples) == 0:
        return channel
    full = np.flatnonzero(np.maximum.reduceat(mine.samples, mine.offsets[:-1]) >= channel.clip)
    mine = rows_of(mine, full[:: max(-(-len(full) // MOST), 1)])
    trial = replace(channel, recovery=1.0, recovery_doubt=0.5, receivers=())
    saturated = _saturated(mine, replace(pulse, channels=(trial,))) if len(full) >= FEWEST else None
    if saturated is None or saturated[0].waves.pulses.rows < FEWEST:
        return channel
    part, spacing = saturated[0], channel.sample_spacing
    lower, doubt = np.zeros(len(part.row)), np.where(part.near, UNKNOWN, 0.0)
    gain, share, depth, time = 0.0, 0.5, 0.0, 0.0
    for _ in range(ROUNDS):
        residual, variance = _left(part, pulse, params, lower, doubt)
        usual = _chi(residual, variance)
        tried = []
        for candidate in TIMES:
            part = replace(part, rate=np.full(len(part.row), spacing / candidate))
            by, _ = _lowered(part, residual, variance)
            tried.append(_chi(residual + by, variance))
        time = float(TIMES[int(np.argmin(tried))])
        part = replace(part, rate=np.full(len(part.row), spacing / time))
        lower, depths = _lowered(part, residual, variance)
        gain = (usual - min(tried)) / part.waves.pulses.rows
        depth = float(np.median(depths))
        first = part.near & ~part.saturated & (lower > 0.0)
        over = ((residual + lower)[first] ** 2 - part.noise[first] ** 2).sum()
        share = math.sqrt(min(max(float(over / max((lower[first] ** 2).sum(), 1e-9)), 0.0), 1.0))
        doubt = np.where(part.near, (share * lower) ** 2, 0.0)
    if gain < WORTH or not 0.0 < depth < channel.clip:  # nothing swings further than its range
        return channel
    return replace(channel, recovery=time, recovery_depth=depth, recovery_doubt=share)


def _saturated(waves: Waveforms, pulse: SystemPulse) -> tuple[_Saturated, NDArray[np.int64]] | None:
    """The waveforms of channels that recover with saturated samples that others follow, and their rows; None without
    any."""
    limit = sample_limits(waves, pulse)
    channels = channel_rows(pulse.channels, waves.pulses)
    channels[~np.array([c.recovery > 0.0 for c in pulse.channels] + [False])[channels]] = -1
    length = np.diff(waves.offsets)
    row = np.repeat(np.arange(len(length)), length)
    saturated = (waves.samples >= limit[row]) & (channels[row] >= 0)
    end = np.zeros(len(row), np.bool_)
    end[:-1] = saturated[:-1] & ~saturated[1:] & (row[1:] == row[:-1])
    rows = np.unique(row[end])
    if len(rows) == 0:
        return None
    chosen = np.isin(row, rows)
    saturated, last = saturated[chosen], np.flatnonzero(end[chosen])
    row = np.repeat(np.arange(len(rows)), length[rows])
    number = np.arange(len(last)) - np.searchsorted(row[last], row[last])
    ends = np.full((int(number.max()) + 1, len(rows)), -1)
    ends[number, row[last]] = last
    own = [pulse.channels[k] for k in channels[rows]]
    values = np.array([(c.noise, c.step, c.sample_spacing / c.recovery, c.recovery_doubt) for c in own])
    reach = np.array([math.ceil(NEAR * pulse.of(c).fwhm / c.sample_spacing) for c in own])
    at = np.arange(len(row))
    newest = np.maximum.accumulate(np.where(saturated, at, -1))
    begins = np.searchsorted(row, np.arange(len(rows)))
    near = ~saturated & (newest >= begins[row]) & (at - newest <= reach[row])
    noise, step, rate, doubt = (values[row, c] for c in range(4))
    part = rows_of(waves, rows)
    return _Saturated(part, row, saturated, limit[rows][row], noise, step, ends, rate, doubt, near), rows


def _raised(part: _Saturated, lower: Floats) -> Any:
    """The samples brought back to the level: those that come to the limit stand at it."""
    steps = part.step * np.rint(lower / part.step)
    value = part.waves.samples + steps
    full = part.saturated | ((lower > NOTICED) & (value >= part.top - AT_LIMIT * part.step))
    return np.where(full, part.top, np.minimum(value, part.top - part.step)).astype(part.waves.samples.dtype)


def _left(
    part: _Saturated, pulse: SystemPulse, params: DecomposeParams, lower: Floats, doubt: Floats
) -> tuple[Floats, Floats]:
    """What the echoes and the level that are fitted to the samples, with `lower` made good, leave of them as they are
    [DN], and its variance [DN^2]; saturated samples, and those at the floor, have none that counts."""
    raised = replace(part.waves, samples=_raised(part, lower))
    doubt = np.where(at_floor(part.waves, pulse), UNKNOWN, doubt)
    fits = fit_waveforms(raised, params, pulse, doubt)
    signal = signal_of(fits, raised, pulse, params)
    residual = part.waves.samples - signal - np.nan_to_num(fits.baseline)[part.row]
    variance = part.noise**2 + doubt + (MODEL * signal) ** 2
    return residual, np.where(part.saturated | np.isnan(fits.baseline)[part.row], np.inf, variance)


def _lowered(part: _Saturated, residual: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """How much lower than the level every sample is [DN], and the depths right behind all stretches (stretches,)."""
    weight, rows = 1.0 / variance, part.waves.pulses.rows
    fades = [part.fade(k) for k in range(len(part.ends))]
    depths, lower = np.zeros((len(fades), rows)), np.zeros(len(residual))
    for sweep in range(SWEEPS):
        for k, fade in enumerate(fades):
            others = lower - fade * depths[k][part.row]
            pull = np.bincount(part.row, -weight * fade * (residual + others), rows)
            hold = np.bincount(part.row, weight * fade**2, rows)
            depths[k] = np.maximum(pull / np.maximum(hold, 1e-6), 0.0)
            lower = others + fade * depths[k][part.row]
        if sweep == 0:
            weight = np.where(np.abs(residual + lower) * np.sqrt(weight) > STRAY, 0.0, weight)
    return np.where(part.saturated, 0.0, lower), depths[part.ends >= 0]


def _chi(residual: Floats, variance: Floats) -> float:
    return float(np.minimum(residual**2 / variance, CAPPED).sum())
