"""Receivers that record every echo once more, later and lower: measured, and taken off.

After-pulses of a detector, or a reflection inside of the instrument, add to the samples x what x was before: y(t) =
x(t) + sum over k of h(k) x(t - k), with a few k about one delay. A scene does not: behind the highest echo half of all
waveforms would have the same share of its height at one delay.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.fitting import fit_waveforms, signal_of
from fwclass.decompose.params import CopyParams, DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.pulse_sample import of_channel, rows_of
from fwclass.decompose.sample_parity import estimate_even_pulse, even_gains
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.units import ERROR_OF_MEDIAN, SIGMA_PER_MAD
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

MOST_VALUES = 1_000_000
"""Samples of the waveforms that tell of a copy, about, at most."""

ROUNDS = 4
"""Of taking copies of copies off, and of leaving out what departs."""

STRAY, SMOOTH = 2.0, 0.02
"""Times the usual by which a waveform departs that has an echo where the copy is, and the least singular value that
counts of the samples before, as a share of the largest."""

UNKNOWN, MODEL = 1e8, 0.1
"""Variance of samples that are not to count [DN^2], and share by which the height of a saturated echo is doubted."""


def estimate_single_pulse(
    waves: Waveforms, params: PulseParams, fit: DecomposeParams, recorded: SystemPulse | None
) -> SystemPulse:
    """`estimate_even_pulse` of `waves`, whose channels tell what they record of every echo once more, where their
    bright echoes show it, and `fit.recovery` does not keep the samples as they are; measured without that.

    Depends on the set of waveforms only.
    """
    pulse = estimate_even_pulse(waves, params, recorded)
    if fit.recovery == "keep":
        return pulse
    even = even_gains(waves, pulse)
    copies = {c.key: c.copies for c in (_measure(c, pulse, even, fit, params.copies) for c in pulse.channels)}
    if not any(copies.values()):
        return pulse
    with_copies = replace(pulse, channels=tuple(replace(c, copies=copies[c.key]) for c in pulse.channels))
    once = estimate_pulse(without_copies(even, with_copies, fit)[0], params, recorded)
    old = {c.key: c for c in with_copies.channels}
    return replace(
        once,
        channels=tuple(
            replace(c, copies=o.copies, parity=o.parity, parity_walk=o.parity_walk) if (o := old.get(c.key)) else c
            for c in once.channels
        ),
    )


def without_copies(waves: Waveforms, pulse: SystemPulse, params: DecomposeParams) -> tuple[Waveforms, Floats]:
    """`waves` without what their channels record once more, rounded to whole steps, and the variance that every sample
    has for it [DN^2], (samples,), as saturated echoes do not tell well how high their copies are; `waves` itself and an
    empty array where no channel does so. Samples at the limit and at 0 stay. Every waveform is corrected alone."""
    copying = [k for k, c in enumerate(pulse.channels) if c.copies]
    if not copying:
        return waves, np.empty(0)
    channel = np.repeat(channel_rows(pulse.channels, waves.pulses), np.diff(waves.offsets))
    samples, doubt = waves.samples.copy(), np.zeros(len(waves.samples))
    for k in copying:
        at = np.flatnonzero(channel == k)
        part = rows_of(waves, np.flatnonzero(channel_rows(pulse.channels, waves.pulses) == k))
        samples[at], doubt[at] = _once(part, pulse.channels[k], pulse, params)
    return replace(waves, samples=samples), doubt


def of_sure_copies(waves: Waveforms, pulse: SystemPulse) -> Waveforms:
    """`waves` less those of channels with copies that are saturated: what is left of theirs is no noise."""
    top = np.array([c.clip if c.copies else np.inf for c in pulse.channels] + [np.inf])
    if not np.isfinite(top).any():
        return waves
    limit = np.repeat(top[channel_rows(pulse.channels, waves.pulses)], np.diff(waves.offsets))
    row = np.repeat(np.arange(waves.pulses.rows), np.diff(waves.offsets))
    return rows_of(waves, np.setdiff1d(np.arange(waves.pulses.rows), row[waves.samples >= limit]))


def _once(waves: Waveforms, channel: Channel, pulse: SystemPulse, params: DecomposeParams) -> tuple[Any, Floats]:
    """Samples of a channel without copies, and their variance for it."""
    beyond, doubt = np.zeros(len(waves.samples)), np.zeros(len(waves.samples))
    samples = _less(waves, beyond, channel)
    full = waves.samples >= channel.clip
    if full.any():
        length = np.diff(waves.offsets)
        row = np.repeat(np.arange(len(length)), length)
        some = np.unique(row[full])
        at = np.flatnonzero(np.isin(row, some))
        doubt = np.where(_later(full.astype(np.float64), channel.copies, waves) != 0.0, UNKNOWN, 0.0)
        part = rows_of(replace(waves, samples=samples), some)
        fits = fit_waveforms(part, params, pulse, doubt[at])
        height = signal_of(fits, part, pulse, params) + channel.baseline - channel.clip
        beyond[at] = np.where(full[at], np.maximum(height, 0.0), 0.0)
        samples, doubt = _less(waves, beyond, channel), (MODEL * _later(beyond, channel.copies, waves)) ** 2
    return samples, doubt


def _less(waves: Waveforms, beyond: Floats, channel: Channel) -> Any:
    """Samples without copies of themselves, and of what they have `beyond` the limit [DN], (samples,)."""
    value = waves.samples.astype(np.float64)
    signal = value - channel.baseline + beyond
    copy = np.zeros(len(value))
    for _ in range(ROUNDS):
        copy = _later(signal - copy, channel.copies, waves)
    kept = (value == 0.0) | (value >= channel.clip)
    lower = np.clip(value - channel.step * np.rint(copy / channel.step), 0.0, channel.clip - channel.step)
    return np.where(kept, value, lower).astype(waves.samples.dtype)


def _later(values: Floats, copies: tuple[tuple[int, float], ...], waves: Waveforms) -> Floats:
    """Sum of `values`, (samples,), as many samples before in the same waveform as each of `copies` says, times its
    share."""
    length = np.diff(waves.offsets)
    number = np.arange(len(values)) - np.repeat(waves.offsets[:-1] - waves.offsets[0], length)
    total = np.zeros(len(values))
    for lag, share in copies:
        total[lag:] += np.where(number[lag:] >= lag, share * values[: max(len(values) - lag, 0)], 0.0)
    return total


def _measure(
    channel: Channel, pulse: SystemPulse, waves: Waveforms, params: DecomposeParams, bounds: CopyParams
) -> Channel:
    mine = of_channel(waves, channel, pulse.channels, len(waves.samples) + 1)
    mine = rows_of(mine, np.flatnonzero(np.diff(mine.offsets) > 1))
    if mine.pulses.rows < bounds.waveforms:
        return channel
    highest = np.maximum.reduceat(mine.samples, mine.offsets[:-1])
    bright = np.flatnonzero((highest < channel.clip) & (highest > channel.baseline + bounds.bright * channel.noise))
    if len(bright) < bounds.waveforms:
        return channel
    most = min(bounds.most_waveforms, max(MOST_VALUES // int(np.diff(mine.offsets)[bright].max()), bounds.waveforms))
    mine = rows_of(mine, bright[:: -(-len(bright) // most)])
    own = pulse.of(channel)
    for _ in range(bounds.most):
        once, _ = without_copies(mine, replace(pulse, channels=(channel,)), params)
        fits = fit_waveforms(once, params, pulse)
        order = np.lexsort((fits.time, -fits.amplitude, fits.row))
        row, at = np.unique(fits.row[order], return_index=True)
        time, height = fits.time[order][at] / channel.sample_spacing, fits.amplitude[order][at]
        level = np.nan_to_num(fits.baseline)[row]
        delay = _delay(once, row, time, height, level, channel, own.fwhm / channel.sample_spacing, bounds)
        if not delay:
            break
        copies = _shares(mine, once, row, time, channel, delay, own.fwhm / channel.sample_spacing, bounds)
        if not copies:
            break
        channel = replace(channel, copies=tuple(sorted(channel.copies + copies)))
    return channel


def _delay(
    waves: Waveforms,
    row: NDArray[np.int64],
    time: Floats,
    height: Floats,
    level: Floats,
    channel: Channel,
    width: float,
    bounds: CopyParams,
) -> float:
    """Delay [samples] of what follows the highest echoes, at `time` [samples] of rows `row`, always as high beside
    them; 0 where nothing does."""
    length = np.diff(waves.offsets)[row]
    delays = np.arange(bounds.behind * width, length.max() - 1.0, 0.5)
    if len(delays) == 0:
        return 0.0
    place = time[:, None] + delays
    before = np.floor(place).astype(np.int64)
    inside = (before >= 0) & (before + 1 < length[:, None])
    first = np.where(inside, waves.offsets[row][:, None] + before, 0)
    part = place - before
    samples = waves.samples.astype(np.float64)
    value = samples[first] * (1.0 - part) + samples[np.minimum(first + 1, len(samples) - 1)] * part
    share = np.where(inside, (value - level[:, None]) / height[:, None], np.nan)
    enough = inside.sum(axis=0) >= bounds.waveforms
    if not enough.any():
        return 0.0
    delays, share = delays[enough], share[:, enough]
    middle = np.nanmedian(share, axis=0)
    spread = SIGMA_PER_MAD * np.nanmedian(np.abs(share - middle), axis=0)
    aside = round(bounds.beside * width / 0.5)
    padded = np.concatenate([np.full(aside, middle[0]), middle, np.full(aside, middle[-1])])
    beside = np.maximum(padded[: len(middle)], padded[2 * aside :])
    above = middle - beside
    best = int(np.argmax(above))
    error = ERROR_OF_MEDIAN * spread[best] / np.sqrt(inside[:, enough][:, best].sum())
    own = np.sqrt(max(spread[best] ** 2 - float(np.median((channel.noise / height) ** 2)), 0.0))
    sure = above[best] > max(bounds.least, bounds.sure * error) and own < bounds.scatter * middle[best]
    return float(delays[best]) if sure else 0.0


def _shares(
    waves: Waveforms,
    once: Waveforms,
    row: NDArray[np.int64],
    time: Floats,
    channel: Channel,
    delay: float,
    width: float,
    bounds: CopyParams,
) -> tuple[tuple[int, float], ...]:
    """Delays [samples] about `delay` and shares that make the copy of `once` in it, by least squares over the samples
    where it lies; waveforms that have something else there do not count."""
    lags = np.arange(int(np.floor(delay - width)), int(np.ceil(delay + width)) + 1)
    window = np.arange(-int(np.ceil(bounds.beside * width)), int(np.ceil(bounds.beside * width)) + 1)
    at = np.rint(time + delay).astype(np.int64)[:, None] + window
    length = np.diff(waves.offsets)[row]
    whole = (at[:, -1] < length) & (at[:, 0] - lags[-1] >= 0)
    if whole.sum() < bounds.waveforms:
        return ()
    at = at[whole] + waves.offsets[row][whole][:, None]
    signal = once.samples.astype(np.float64) - channel.baseline
    before = np.stack([signal[at - lag] for lag in lags], axis=2)
    there = signal[at]
    kept = np.ones(len(at), np.bool_)
    shares = np.zeros(len(lags))
    for _ in range(ROUNDS):
        if kept.sum() < bounds.waveforms // 2:
            return ()
        left, values, right = np.linalg.svd(before[kept].reshape(-1, len(lags)), full_matrices=False)
        some = values > SMOOTH * values[0]
        shares = (right.T[:, some] / values[some]) @ (left.T[some] @ there[kept].reshape(-1))
        rough = np.sqrt(((there - before @ shares) ** 2).mean(axis=1))
        usual = float(np.median(rough))
        kept = rough < STRAY * usual
    if abs(shares.sum()) > bounds.highest:
        return ()
    return tuple((int(lag), round(float(share), 6)) for lag, share in zip(lags, shares, strict=True))
