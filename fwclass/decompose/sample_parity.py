"""Two digitisers in turn whose gains differ: samples of even and of odd number in their record, made alike.

A pulse wider than some samples has nothing at the highest frequency that they can hold, so that the sum of its samples
of even number less those of odd number is 0; with unlike gains it is a share of the pulse's whole sum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.params import ParityParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.pulse_sample import of_channel, rows_of
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.units import SIGMA_PER_MAD
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

TRIMMED, ROUNDS = 4.0, 3
"""Robust deviations beyond which a sample does not count, round by round."""

NONE = (0.0, np.inf)
"""A parity and its standard error, of which nothing is known."""


def estimate_even_pulse(waves: Waveforms, params: PulseParams, recorded: SystemPulse | None) -> SystemPulse:
    """`estimate_pulse` of `waves`, from samples of one gain, which its channels tell (`parity`).

    Depends on the set of waveforms only.
    """
    pulse = estimate_pulse(waves, params, recorded)
    gains = {
        c.key: _gains(of_channel(waves, c, pulse.channels, len(waves.samples) + 1), c, params.parity)
        for c in pulse.channels
    }
    pulse = _with_gains(pulse, gains)
    if not any(c.parity for c in pulse.channels):
        return pulse
    return _with_gains(estimate_pulse(even_gains(waves, pulse), params, recorded), gains)


def _with_gains(pulse: SystemPulse, gains: Mapping[tuple[Any, ...], tuple[float, float]]) -> SystemPulse:
    each = [(c, *gains.get(c.key, (0.0, 0.0))) for c in pulse.channels]
    return replace(pulse, channels=tuple(replace(c, parity=parity, parity_walk=walk) for c, parity, walk in each))


def even_gains(waves: Waveforms, pulse: SystemPulse) -> Waveforms:
    """`waves` whose samples have one gain, rounded to whole steps; `waves` itself where no channel has two. Samples at
    the limit and at 0 stay. Every waveform is corrected alone."""
    channel = channel_rows(pulse.channels, waves.pulses)
    values = [(c.parity, c.baseline, c.step, c.clip) for c in pulse.channels]
    by_row = np.array([*values, (0.0, 0.0, 1.0, 0.0)])[channel]
    if not by_row[:, 0].any():
        return waves
    length = np.diff(waves.offsets)
    parity, level, step, top = np.repeat(by_row, length, axis=0).T
    value = waves.samples.astype(np.float64)
    raised = step * np.rint((level + (value - level) / (1.0 + parity * _signs(waves))) / step)
    whole = (value == 0.0) | (value >= top) | (parity == 0.0)
    samples: Any = np.where(whole, value, np.clip(raised, 0.0, top - step)).astype(waves.samples.dtype)
    return replace(waves, samples=samples)


def _signs(waves: Waveforms) -> Floats:
    """1 of every sample of even number in its waveform, -1 of every other."""
    length = np.diff(waves.offsets)
    number = np.arange(len(waves.samples)) - np.repeat(waves.offsets[:-1] - waves.offsets[0], length)
    return 1.0 - 2.0 * (number & 1)


def _gains(waves: Waveforms, channel: Channel, params: ParityParams) -> tuple[float, float]:
    """Gain of a channel's samples of even number over the mean of both, less 1, and by how much it differs between
    quarters of the strip; each 0 where that is not sure."""
    quarters = np.array_split(np.argsort(waves.pulses["pulse"], kind="stable"), params.pieces)
    known = [
        one for q in quarters if (one := _parity(rows_of(waves, q), channel, params.waveforms // params.pieces, params))
    ]
    whole = _sure(*(_parity(waves, channel, params.waveforms, params) or NONE), params)
    (low, doubt), (high, doubt_too) = (min(known), max(known)) if known else (NONE, NONE)
    return whole if abs(whole) <= params.most else 0.0, _sure(high - low, float(np.hypot(doubt, doubt_too)), params)


def _sure(value: float, error: float, params: ParityParams) -> float:
    """`value`, or 0 where it is little, or no more than chance."""
    return value if abs(value) > params.sure * error and abs(value) >= params.least else 0.0


def _parity(waves: Waveforms, channel: Channel, least: int, params: ParityParams) -> tuple[float, float] | None:
    """Gain of samples of even number over the mean of both, less 1, and its standard error; None where fewer than
    `least` bright waveforms of either kind tell it, or both kinds tell something else. A pulse that the record cuts
    has another sum of even than of odd ones: waveforms that do not begin and end at the level are left out."""
    waves = rows_of(waves, np.flatnonzero(np.diff(waves.offsets) > 1))
    length, first = np.diff(waves.offsets), waves.offsets[:-1]
    if len(length) < 2 * least:
        return None
    sign, samples = _signs(waves), waves.samples.astype(np.float64)
    last = np.zeros(len(samples), np.bool_)
    last[waves.offsets[1:] - 1] = (length & 1) == 1  # as many of even number as of odd
    sums = np.add.reduceat(np.where(last, 0.0, samples - channel.baseline), first)
    turns = np.add.reduceat(np.where(last, 0.0, samples * sign), first)
    highest, used = np.maximum.reduceat(samples, first), (length // 2 * 2).astype(np.float64)
    at_highest = samples == np.repeat(highest, length)
    number = np.add.reduceat(np.where(at_highest, 1, 0), first)
    peak = np.maximum.reduceat(np.where(at_highest, sign, -1.0), first)
    ends = np.abs(
        samples[np.concatenate([[first, first + 1, first + length - 2, first + length - 1]])] - channel.baseline
    )
    quiet = ends.max(axis=0) <= params.ends * channel.noise
    some = quiet & (number == 1) & (highest < channel.clip) & (sums > params.bright * channel.noise * np.sqrt(used))
    sums, turns, used, even = sums[some], turns[some], used[some], peak[some] > 0.0
    if min(even.sum(), (~even).sum()) < least:
        return None
    known = np.stack([used, np.where(even, sums, 0.0), np.where(even, 0.0, sums)], axis=1)
    kept = np.ones(len(sums), np.bool_)
    for _ in range(ROUNDS):
        answer = np.linalg.lstsq(known[kept], turns[kept], rcond=None)[0]
        residual = turns - known @ answer
        sigma = SIGMA_PER_MAD * float(np.median(np.abs(residual)))
        kept = np.abs(residual) <= TRIMMED * sigma
    _, one, other = answer
    spread = np.linalg.pinv(known[kept].T @ known[kept])[1:, 1:] * sigma**2
    error = 0.5 * np.sqrt(max(float(spread.sum()), 0.0))
    alone = np.sqrt(np.maximum(spread.diagonal(), 0.0))
    if abs(one - other) > max(params.alike * abs(one + other), params.chance * float(alone.max())):
        return None
    return float(0.5 * (one + other)), float(error)
