"""What bright echoes leave beyond the receiver's noise: noise that grows with the signal, and the pulse's shape error.

A photodiode's noise has a variance of a + b DN (shot noise); an error of the shape grows with the height itself. Echoes
of different heights tell the two apart.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.decompose.fitting import fit_waveforms, signal_of
from fwclass.decompose.floor import at_floor, floor_doubt
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_sample import of_channel
from fwclass.decompose.shapes import lookup
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.waveforms import Waveforms

Floats = NDArray[np.floating]

FEWEST = 200
"""Bright single echoes below which nothing is said."""
MOST_SAMPLES = 2_000_000
BRIGHT = 2.0
"""Standard deviations of the noise from which a sample belongs to an echo here."""
PARAMETERS = 3
FITS, CUTS = 5, 5
OUTLIER = 3.0
"""Echoes that leave this many times what those of their height do hide another one."""
SURE = 3.0
"""Standard errors that the growth must reach to be believed; it is a sum over samples that also hold other faults."""
ABSURD = 0.2
"""A shape that is off by so much is none, and what is left beside it tells nothing, as in samples without noise."""
NEAR, BESIDE = 2.0, 0.1
"""Samples are an echo's where it is higher than so many standard deviations of the noise, and beside it where lower."""
HIGH = 20.0
"""Standard deviations of the noise from which an echo tells whether its pulse is known."""
NOTICED = 0.1
"""Share of the noise's variance that the growth must reach at the median echo's height to matter."""


def with_signal_noise(pulse: SystemPulse, waves: Waveforms, params: DecomposeParams) -> SystemPulse:
    """`pulse` whose channels tell how their noise grows with the signal, where bright single echoes show it; its shape
    error is then what is left. Depends on the set of waveforms only.

    Both are right when a fit that weighs its samples by them leaves as much of faint as of bright echoes.
    """
    tried = pulse
    for _ in range(FITS):
        channels, shared = [], []
        for channel in tried.channels:
            own = tried.of(channel)
            look = lookup(own, channel.sample_spacing, 1.0, 1.1, channel.autoregression)
            echoes = _bright(waves, channel, tried, params, look.pulse_gain)
            if echoes is None:
                channels.append(channel)
                continue
            by, left, height = echoes
            growth, error = _separate_noise(by, left, np.array([channel.growth, own.shape_error**2, 1.0]))
            matters = growth * height > NOTICED * channel.noise**2
            error = math.sqrt(error)
            if error > ABSURD:
                return pulse
            own_pulse = channel.pulse and replace(channel.pulse, shape_error=error)
            shared += [] if channel.pulse else [error]
            channels.append(replace(channel, growth=growth if matters else 0.0, pulse=own_pulse))
        tried = replace(tried, channels=tuple(channels), shape_error=max(shared, default=tried.shape_error))
        if not any(c.growth > 0.0 or c.phi for c in channels):
            return pulse
    return tried


def with_misfit(pulse: SystemPulse, waves: Waveforms, params: DecomposeParams) -> SystemPulse:
    """`pulse` whose channels tell how much bright single echoes leave under them, over the noise beside them in the
    same waveforms (`Channel.misfit`), where there are `FEWEST` such echoes. Depends on the set of waveforms only.

    No allowance is made for an error of the shape or for noise that grows: what both leave looks like echoes.
    """
    channels = []
    for channel in pulse.channels:
        single = _single(waves, channel, pulse, params)
        near, beside = single.signal > NEAR * channel.noise, single.signal < BESIDE * channel.noise
        count, quiet = (np.bincount(single.row[m], minlength=len(single.height)) for m in (near, beside))
        use = (single.height > HIGH * channel.noise) & (np.minimum(count, quiet) > 2 * PARAMETERS)
        under, noise = (float((single.left[m & use[single.row]] ** 2).sum()) for m in (near, beside))
        if use.sum() >= FEWEST and noise > 0.0:
            misfit = (under / (count[use] - PARAMETERS).sum()) / (noise / quiet[use].sum())
            channel = replace(channel, misfit=misfit)
        channels.append(channel)
    return replace(pulse, channels=tuple(channels))


class _Single(NamedTuple):
    """Samples of the waveforms of a channel that have one echo and reach no limit: what the fit leaves, made white,
    the echo [DN], and the waveform of each; the echo's height in every waveform of the channel [DN], NaN in others."""

    left: Floats
    signal: Floats
    row: NDArray[np.int64]
    height: Floats


def _single(waves: Waveforms, channel: Channel, pulse: SystemPulse, params: DecomposeParams) -> _Single:
    part = of_channel(waves, channel, pulse.channels, MOST_SAMPLES)
    fits = fit_waveforms(part, params, pulse, floor_doubt(part, pulse))
    lengths, rows = np.diff(part.offsets), part.pulses.rows
    row = np.repeat(np.arange(rows), lengths)
    cut = (part.samples >= channel.clip) | at_floor(part, pulse)
    one = (fits.count == 1) & (np.bincount(row, cut, rows) == 0)
    signal, noise = signal_of(fits, part, pulse, params), channel.autoregression
    whole = np.arange(len(row)) - np.repeat(part.offsets[:-1], lengths) >= len(noise.phi)
    use = np.flatnonzero(whole & one[row])
    left = np.convolve(np.nan_to_num(part.samples - signal - fits.baseline[row]), noise.filter)[use]
    height = np.full(rows, np.nan)
    height[fits.row] = fits.amplitude
    return _Single(left, signal[use], row[use], np.where(one, height, np.nan))


def _bright(
    waves: Waveforms, channel: Channel, pulse: SystemPulse, params: DecomposeParams, pulse_gain: float
) -> tuple[Floats, Floats, float] | None:
    """Of every waveform of the channel with one bright echo, over the samples that it reaches: what (growth, square of
    the shape error, noise) add to the sum of the squared residuals over their variance, shape (n, 3), and what that sum
    has beyond its degrees of freedom; both over these. Also the median height [DN]."""
    single = _single(waves, channel, pulse, params)
    noise, rows = channel.autoregression, len(single.height)
    reached = single.signal > BRIGHT * channel.noise
    left, row, signal = single.left[reached], single.row[reached], single.signal[reached]
    growing, shape = noise.innovation * signal, (pulse_gain * signal) ** 2
    plain = np.full(len(row), channel.noise**2 * noise.innovation)
    variance = plain + channel.growth * growing + pulse.of(channel).shape_error ** 2 * shape
    count = np.bincount(row, minlength=rows)
    use = count > 2 * PARAMETERS
    if use.sum() < FEWEST:
        return None
    chi, *by = (np.bincount(row, v / variance, rows)[use] for v in (left**2, growing, shape, plain))
    freedom = count[use] - PARAMETERS
    return np.stack(by, axis=1) / count[use, None], chi / freedom - 1.0, float(np.median(signal))


def _separate_noise(by: Floats, left: Floats, known: Floats) -> tuple[float, float]:
    """(growth of the variance [DN], square of the shape error) from `_bright` echoes that were weighed by `known`.

    What all echoes leave alike is noise that differs between waveforms.
    """
    total = left + by @ known
    inliers, both = np.ones(len(by), np.bool_), known
    for _ in range(CUTS):
        rows, aim = by[inliers], total[inliers]
        both = scipy.optimize.nnls(rows, aim)[0]
        inliers = total < OUTLIER * (by @ both)
    spread = float(((aim - rows @ both) ** 2).mean())
    if both[0] > SURE * math.sqrt(spread * np.linalg.pinv(rows.T @ rows)[0, 0]):
        return float(both[0]), float(both[1])
    return 0.0, float(scipy.optimize.nnls(rows[:, 1:], aim)[0][0])
