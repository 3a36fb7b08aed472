"""What bright echoes leave beyond the receiver's noise: noise that grows with the signal, and the pulse's shape error.

A photodiode's noise has a variance of a + b DN (shot noise); an error of the shape grows with the height itself. Echoes
of different heights tell the two apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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
_Key = tuple[float, float, tuple[int, ...]]

FEWEST = 200
"""Bright single echoes below which nothing is said."""
MOST_SAMPLES = 2_000_000
"""Of the waveforms that are fitted for it, about, at most."""
BRIGHT = 2.0
"""Standard deviations of the noise from which a sample belongs to an echo here."""
PARAMETERS = 3
"""Of an echo: height, time and width."""
ROUNDS, CUTS = 24, 100
"""Fits and regressions at most."""
SETTLED, LEAST = 0.005, 5e-5
"""A fit may show a growth and a shape error that differ from those it weighed by by this share, or by `LEAST`."""
STEEPEST = 0.8
"""How much of a change of the shape error a fit may show again; the more, the farther is where the two agree."""
OUTLIER = 2.0
"""Echoes that leave more than so many times what those of their height do count as so many: they hide another one."""
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


def with_signal_noise(pulse: SystemPulse, waves: Waveforms, params: DecomposeParams) -> tuple[SystemPulse, float]:
    """`pulse` whose channels tell how their noise grows with the signal, where bright single echoes show it; its shape
    error is then what is left. Depends on the set of waveforms only.

    Both are right when a fit that weighs its samples by them leaves as much of faint as of bright echoes, and as much
    under as beside them. A growth that a later fit no more shows is none. The number beside is 0 where `ROUNDS` of
    fits came to that; else the share by which the last one shows another variance of a bright echo's samples than it
    weighed them by.
    """
    tried, doubted, apart = pulse, set[_Key](), 0.0
    before: dict[_Key | None, tuple[float, float]] = {}
    for _ in range(ROUNDS):
        channels, settled = [], True
        weighed = {_owner(c): tried.of(c).shape_error for c in tried.channels}
        shown: dict[_Key | None, float] = {}
        bright: dict[_Key, tuple[float, float]] = {}
        for channel in tried.channels:
            look = lookup(tried.of(channel), channel.sample_spacing, 1.0, 1.1, channel.autoregression)
            echoes, growth = _bright(waves, channel, tried, params, look.pulse_gain), channel.growth
            if echoes is not None:
                bright[channel.key] = echoes.height, look.pulse_gain
                growth, square = _separate_noise(echoes, channel.noise**2, channel.key not in doubted)
                shown[_owner(channel)] = max(shown.get(_owner(channel), 0.0), math.sqrt(square))
            if channel.growth > 0.0 and growth == 0.0:
                doubted.add(channel.key)
            settled &= abs(growth - channel.growth) <= SETTLED * growth
            channels.append(replace(channel, growth=growth))
        if not any(c.growth > 0.0 or c.phi for c in channels) or max(shown.values(), default=0.0) > ABSURD:
            return pulse, 0.0
        both = [(old, new) for old, new in zip(tried.channels, channels, strict=True) if old.key in bright]
        apart = max((_apart(old, new, weighed, shown, *bright[old.key]) for old, new in both), default=0.0)
        settled &= all(abs(e - weighed[o]) <= max(SETTLED * e, LEAST) for o, e in shown.items())
        agreed = weighed | {o: _agreed(weighed[o], e, *before.get(o, (weighed[o], e))) for o, e in shown.items()}
        before = {o: (weighed[o], e) for o, e in shown.items()}
        channels = [replace(c, pulse=c.pulse and replace(c.pulse, shape_error=agreed[c.key])) for c in channels]
        tried = replace(tried, channels=tuple(channels), shape_error=agreed.get(None, tried.shape_error))
        if settled:
            return tried, 0.0
    return tried, apart


def _apart(
    old: Channel,
    new: Channel,
    weighed: Mapping[_Key | None, float],
    shown: Mapping[_Key | None, float],
    height: float,
    pulse_gain: float,
) -> float:
    """By what share of the greater one two variances of samples of a `height` [DN] differ: that of a channel before and
    after a fit, with the shape errors that it `weighed` by and has `shown`."""
    one, other = (
        c.autoregression.innovation * (c.noise**2 + c.growth * height) + (pulse_gain * errors[_owner(c)] * height) ** 2
        for c, errors in ((old, weighed), (new, shown))
    )
    return abs(one - other) / max(one, other)


def _owner(channel: Channel) -> _Key | None:
    """The channel whose pulse it has; None: the strip's."""
    return channel.key if channel.pulse else None


def _agreed(weighed: float, shown: float, weighed_before: float, shown_before: float) -> float:
    """Where a fit shows the shape error that it weighs by, by a straight line through the last two (Wegstein 1958)."""
    change = weighed - weighed_before
    slope = min(max((shown - shown_before) / change, -1.0), STEEPEST) if change else 0.0
    return min(max((shown - slope * weighed) / (1.0 - slope), 0.0), ABSURD)


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
    residual = np.convolve(np.nan_to_num(part.samples - signal - fits.baseline[row]), noise.filter)[use]
    height = np.full(rows, np.nan)
    height[fits.row] = fits.amplitude
    return _Single(residual, signal[use], row[use], np.where(one, height, np.nan))


class _Bright(NamedTuple):
    """Of the samples that a bright single echo reaches, and of those beside it, a row each: what (growth, square of the
    shape error, noise) add to their mean square over what the fit takes it for, (rows, 3); that mean square, and its
    degrees of freedom, (rows,). The median height of samples under echoes [DN]."""

    by: Floats
    left: Floats
    freedom: Floats
    height: float


def _bright(
    waves: Waveforms, channel: Channel, pulse: SystemPulse, params: DecomposeParams, pulse_gain: float
) -> _Bright | None:
    """The waveforms of the channel with one bright echo; None where fewer than `FEWEST` have samples beside it, too."""
    single, noise = _single(waves, channel, pulse, params), channel.autoregression
    rows, reached = len(single.height), single.signal > BRIGHT * channel.noise
    growing, shape = noise.innovation * np.maximum(single.signal, 0.0), (pulse_gain * single.signal) ** 2
    plain = np.full(len(single.row), channel.noise**2 * noise.innovation)
    variance = plain + channel.growth * growing + pulse.of(channel).shape_error ** 2 * shape
    under, beside = (np.bincount(single.row[m], minlength=rows) for m in (reached, ~reached))
    bright = under > 2 * PARAMETERS
    parts: list[tuple[NDArray, ...]] = []
    for samples, count, spent in ((reached, under, PARAMETERS), (~reached, beside, 1)):
        use, row = bright & (count > 2 * PARAMETERS), single.row[samples]
        if use.sum() < FEWEST:
            return None
        sums = (np.bincount(row, (v / variance)[samples], rows)[use] for v in (growing, shape, plain, single.left**2))
        *by, chi = sums
        parts.append((np.stack(by, axis=1) / count[use, None], chi / (count[use] - spent), count[use] - spent))
    height = float(np.median(single.signal[reached & bright[single.row]]))
    whole = [np.concatenate(p) for p in zip(*parts, strict=True)]
    return _Bright(whole[0], whole[1], whole[2], height)


def _separate_noise(echoes: _Bright, variance: float, grows: bool) -> tuple[float, float]:
    """(growth of the variance [DN], square of the shape error) of a channel whose noise has a `variance` [DN^2]; 0 for
    a growth that is not sure, does not matter, or is not asked for (`grows`)."""
    if grows:
        (growth, square, _), error = _shares(echoes, 0)
        if growth > SURE * error and growth * echoes.height > NOTICED * variance:
            return float(growth), float(square)
    return 0.0, float(_shares(echoes, 1)[0][0])


def _shares(echoes: _Bright, first: int) -> tuple[Floats, float]:
    """The factors of the columns from `first` on that foretell what is left, and the standard error of the first of
    them. What noise leaves beside echoes is its share under them."""
    by, half = echoes.by[:, first:], 0.5 * echoes.freedom
    usual = scipy.special.gammainc(half + 1.0, OUTLIER * half)
    usual += OUTLIER * scipy.special.gammaincc(half, OUTLIER * half)  # the mean of a chi-square that is cut so
    foretold, both = np.full(len(by), np.median(echoes.left)), np.zeros(by.shape[1])
    for _ in range(CUTS):
        left = np.minimum(echoes.left / foretold, OUTLIER) / usual
        before, both = both, scipy.optimize.nnls(by / foretold[:, None], left)[0]
        foretold = np.maximum(by @ both, np.finfo(np.float64).tiny)
        if np.allclose(both, before, rtol=1e-5, atol=1e-12):
            break
    rows = by / foretold[:, None]
    inverse = np.linalg.pinv(rows.T @ rows)[0]
    left = np.minimum(echoes.left / foretold, OUTLIER) / usual
    return both, float(np.linalg.norm((rows @ inverse) * (left - 1.0)))
