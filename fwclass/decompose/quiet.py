"""What the samples that no echo reaches tell of a receiver's noise: how neighbouring ones hang together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.autoregression import Autoregression, output_gain
from fwclass.decompose.fitting import fit_waveforms, signal_of
from fwclass.decompose.floor import at_floor, floor_doubt
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_channels import FEWEST, channel_from
from fwclass.decompose.pulse_sample import of_channel
from fwclass.decompose.pulse_scan import MARK
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.waveforms import Waveforms

Floats = NDArray[np.floating]

REACH = 1.5
"""The pulse is taken this many widths to both sides of its peak."""

MOST_SAMPLES = 500_000
"""Samples of a channel that are looked at, about: they tell a correlation to 0.002."""

LEFT = 3.0
"""Standard deviations of the noise; of an echo that is lower there its fit leaves no more than a tenth of them."""
SURELY = 2.0
"""How much higher than usual an echo must be while the noise is not known: what real receivers' correlation makes the
matched filter's output wider by."""
FEWEST_PAIRS = 1000
"""Pairs of neighbouring quiet samples below which nothing is said; 1000 tell the correlation to 0.03."""

FAINTEST = 4.0
"""Standard deviations of the matched filter's output, as the samples have it, from which it may be a faint echo."""

FEWEST_CLEAR = 10_000
"""Quiet samples of waveforms with an echo that are enough without those of the others."""

LAGS = 32
"""Samples apart that pairs are looked at; in the farther half the noise has forgotten itself."""
MOST_ORDER = 12
"""Samples from which the next one is foretold at most."""
FEWEST_LAGS = 4
"""Samples apart, at least, that tell where the noise has forgotten itself."""

NOISELESS = 0.98
"""Share of one value among a channel's quiet samples from which they show no noise: noise of 0.21 steps, or less."""

GAIN_TOLERANCE, WORTH, SURE = 0.1, 0.02, 3.0
"""An order is enough when the variance behind the matched filter is what it is taken for to 10 % (5 % of the
threshold), or to three sampling errors, and no order foretells the samples better by 2 %."""


@dataclass(frozen=True)
class QuietNoise:
    """What the samples that no echo reaches show; of several channels the one that the fit knows least well.

    Attributes
    ----------
    lag1 : correlation of neighbouring samples; 0 is white noise. None: too few quiet samples.
    inflation : standard deviation of the matched filter's output over what the fit takes it for; at least 1.
    samples : quiet samples looked at.
    order : samples that the fit foretells the next one from; 0: it takes the noise for white.
    growth : what a DN of signal adds to the variance [DN].
    periodic : share of the variance that comes back every `period` samples, as a disturbance does that is picked up;
        of the channel where it is most.
    still : least share over all channels of the quiet samples that have their channel's commonest value. Channels with
        `NOISELESS` or more have no noise to measure, rounding alone counts, and the other numbers are not of them.
    """

    lag1: float | None
    inflation: float
    samples: int
    order: int = 0
    growth: float = 0.0
    periodic: float = 0.0
    period: int = 0
    still: float = 0.0

    @property
    def facts(self) -> dict[str, float | int | None]:
        """What a receipt says of the noise, by name: correlation, growth [DN], number of samples; None where
        unknown."""
        return {
            "lag1": self.lag1,
            "inflation": self.inflation,
            "quiet_samples": self.samples,
            "noise_order": self.order,
            "noise_growth": self.growth,
            "noise_periodic": self.periodic,
            "noise_period": self.period,
            "noise_still": self.still,
        }


@dataclass(frozen=True)
class _Quiet:
    """A channel's samples less their echoes, over its level [DN]; which of them no echo reaches; their waveforms; the
    share of the commonest value among the quiet ones as they were recorded."""

    value: Floats
    quiet: NDArray[np.bool_]
    row: NDArray[np.int64]
    still: float


def quiet_noise(waves: Waveforms, pulse: SystemPulse, params: DecomposeParams) -> QuietNoise:
    """How far the noise in a sample of a strip's waveforms is what the fit takes it for.

    Looked at are samples less the fitted echoes, where these are lower than `LEFT` standard deviations of the noise and
    nothing else stands out. Depends on the set of waveforms only: of a channel with more than `MOST_SAMPLES` every n-th
    in their order is taken.
    """
    worst, tone, still = QuietNoise(None, 1.0, 0), (0.0, 0), list[float]()
    for _, channel, part in _channels(waves, pulse, params):
        still.append(part.still)
        if part.still >= NOISELESS:
            continue
        differences = _differences(part.value, part.quiet, part.row)
        correlation, samples = _correlation(differences), int(part.quiet.sum())
        if len(correlation) < 2:
            continue
        tone = max(tone, periodicity(differences))
        noise = channel.autoregression
        gain = filter_gain(correlation, noise, _template(pulse.of(channel), channel.sample_spacing))
        inflation = math.sqrt(max(gain, 1.0))
        measured = QuietNoise(float(correlation[1]), inflation, samples, len(noise.phi), channel.growth)
        if worst.lag1 is None or measured.inflation > worst.inflation:
            worst = measured
    return replace(worst, periodic=tone[0], period=tone[1], still=min(still, default=0.0))


def with_correlated_noise(pulse: SystemPulse, waves: Waveforms, params: DecomposeParams) -> SystemPulse:
    """`pulse` whose channels tell how their noise is correlated, where the quiet samples show it.

    Level, noise and their spread of such a channel are those of its samples made white: in correlated samples they
    look surer, and differ more from waveform to waveform, than they are. As long as the noise is taken for white, what
    it makes looks like echoes: the fit is asked for clear ones only.
    """
    certain = params.model_copy(
        update={"detection": SURELY * params.detection, "split_gain": SURELY**2 * params.split_gain}
    )
    channels = {c.key: c for c in pulse.channels}
    for rows, channel, part in _channels(waves, pulse, certain):
        if part.still >= NOISELESS:  # what is left is the flanks of pulses, which correlate as they will
            continue
        correlation, samples = correlations(part.value, part.quiet, part.row)
        noise = choose_order(correlation, samples, _template(pulse.of(channel), channel.sample_spacing))
        if noise.phi:
            channels[channel.key] = _of_white(channel, noise, rows, part)
    return replace(pulse, channels=tuple(channels.values()))


def correlations(value: Floats, quiet: NDArray[np.bool_], row: NDArray[np.int64]) -> tuple[Floats, int]:
    """Correlation float64 (lags,) at lags 0, 1, … up to half of those that enough pairs of quiet samples reach; quiet
    samples.

    `value` float64 (samples,) [DN], `quiet` bool (samples,) and `row` int64 (samples,), the waveform of each.

    From the differences of pairs of a waveform, over those of the farther half of the lags: no level is needed, and
    what drifts more slowly than that counts as level.
    """
    return _correlation(_differences(value, quiet, row)), int(quiet.sum())


def _correlation(differences: list[float]) -> Floats:
    half = len(differences) // 2
    far = float(np.mean(differences[half:])) if differences else 0.0
    if len(differences) < FEWEST_LAGS or not far > 0.0:
        return np.ones(1)
    return np.concatenate([[1.0], 1.0 - np.array(differences[:half]) / far])


def _differences(value: Floats, quiet: NDArray[np.bool_], row: NDArray[np.int64]) -> list[float]:
    """Mean squared differences of pairs of a waveform's quiet samples 1, 2, … apart, of enough pairs."""
    differences = []
    for lag in range(1, LAGS + 1):
        pairs = quiet[:-lag] & quiet[lag:] & (row[:-lag] == row[lag:])
        if int(pairs.sum()) < FEWEST_PAIRS:
            break
        differences.append(float(((value[lag:] - value[:-lag])[pairs] ** 2).mean()))
    return differences


def periodicity(differences: list[float]) -> tuple[float, int]:
    """(share of the variance, samples) of what comes back: the wave that is left in the differences over the farther
    half of all lags, where noise has forgotten itself, beside a trend; (0, 0) of too few lags."""
    if len(differences) < LAGS:
        return 0.0, 0
    far = np.array(differences[LAGS // 2 :])
    lag = np.arange(len(far))
    best = (np.inf, 0.0, 0)
    for period in range(2, LAGS // 2 + 1):
        angle = 2.0 * np.pi * lag / period
        terms = np.stack([np.ones(len(lag)), lag, np.cos(angle), np.sin(angle)], axis=1)
        fit = np.linalg.lstsq(terms, far, rcond=None)[0]
        swing = float(np.hypot(fit[2], fit[3]) / far.mean()) if far.mean() > 0.0 else 0.0
        best = min(best, (float(((terms @ fit - far) ** 2).sum()), min(swing, 1.0), period))
    return best[1], best[2]


def filter_gain(correlation: Floats, noise: Autoregression, template: Floats) -> float:
    """Variance of the matched filter's output on samples of this `correlation` (lags,), over what it is if `noise`
    holds."""
    white = np.convolve(template, noise.filter)
    whole = np.convolve(noise.filter, white[::-1])
    return output_gain(correlation, whole) / (noise.innovation * float(white @ white))


def choose_order(correlation: Floats, samples: int, template: Floats) -> Autoregression:
    """The shortest autoregression that describes what `samples` quiet samples show; white where that does."""
    tried = []
    for order in range(min(MOST_ORDER, len(correlation) - 1) + 1):
        try:
            tried.append(Autoregression.of(correlation, order))
        except ValueError:
            break
    overlap = np.correlate(template, template, "full")[len(template) :]
    spread = float(((overlap / (template @ template)) ** 2).sum() * (2.0 * correlation @ correlation - 1.0))
    tolerance = max(GAIN_TOLERANCE, SURE * 2.0 * math.sqrt(spread / max(samples, 1)))
    gains = [abs(filter_gain(correlation, noise, template) - 1.0) for noise in tried]
    least = tried[-1].innovation
    worth = max(WORTH, SURE * len(tried) / max(samples, 1))
    for noise, gain in zip(tried, gains, strict=True):
        if gain <= tolerance and noise.innovation * (1.0 - worth) <= least:
            return noise
    return tried[int(np.argmin(gains))]


def _channels(
    waves: Waveforms, pulse: SystemPulse, params: DecomposeParams
) -> Iterator[tuple[Waveforms, Channel, _Quiet]]:
    """Of every known channel waveforms and their samples less the echoes fitted to them."""
    for channel in pulse.channels:
        part = of_channel(waves, channel, pulse.channels, MOST_SAMPLES)
        if len(part.samples):
            yield part, channel, _quiet(part, channel, pulse, params)


def _quiet(waves: Waveforms, channel: Channel, pulse: SystemPulse, params: DecomposeParams) -> _Quiet:
    fits = fit_waveforms(waves, params, pulse, floor_doubt(waves, pulse))
    signal = signal_of(fits, waves, pulse, params)
    row = np.repeat(np.arange(waves.pulses.rows), np.diff(waves.offsets))
    above = np.nan_to_num((waves.samples - signal - fits.baseline[row]) / fits.noise[row])
    reach = math.ceil(pulse.of(channel).fwhm / channel.sample_spacing)
    bad = (fits.misfit > params.poor_misfit) | ~np.isfinite(fits.baseline)
    excluded = (np.abs(signal) > LEFT * channel.noise) | (waves.samples >= channel.clip) | bad[row]
    excluded |= at_floor(waves, pulse)
    hot = ~excluded & (above > MARK)
    filtered = _filter(np.where(excluded, 0.0, above), _template(pulse.of(channel), channel.sample_spacing))
    faint = filtered > FAINTEST * _spread(filtered[~excluded])
    quiet = ~_near(hot | faint, row, reach, reach) & ~excluded
    # a recorder that waits for an echo has one in every waveform: where none stands out, one is hidden
    clear = (fits.count > 0)[row]
    if (quiet & clear).sum() >= FEWEST_CLEAR:
        quiet &= clear
    _, count = np.unique(waves.samples[quiet], return_counts=True)
    still = float(count.max(initial=0) / max(int(quiet.sum()), 1))
    return _Quiet(waves.samples - signal - channel.baseline, quiet, row, still)


def _filter(value: Floats, template: Floats) -> Floats:
    """`value` behind the matched filter, as many numbers."""
    half = len(template) // 2
    return np.convolve(value, template[::-1])[half : half + len(value)]


def _spread(value: Floats) -> float:
    """Standard deviation of what varies around 0, outliers above it aside."""
    below = value[value <= 0.0]
    return float(np.sqrt((below**2).mean())) if len(below) else np.inf


def _near(hot: NDArray[np.bool_], row: NDArray[np.int64], ahead: int, behind: int) -> NDArray[np.bool_]:
    """Samples at most `ahead` before or `behind` after a `hot` one of their own waveform."""
    at, never = np.arange(len(hot)), 2 * len(hot)
    last = np.maximum.accumulate(np.where(hot, at, -never))
    following = np.minimum.accumulate(np.where(hot, at, never)[::-1])[::-1]
    after = (at - last <= behind) & (row[last % len(hot)] == row)
    return np.asarray(after | ((following - at <= ahead) & (row[following % len(hot)] == row)))


def _template(pulse: SystemPulse, spacing: float) -> Floats:
    half = math.ceil(REACH * math.ceil(pulse.fwhm / spacing))
    return pulse.at(spacing * np.arange(-half, half + 1, dtype=np.float64))


def _of_white(channel: Channel, noise: Autoregression, waves: Waveforms, part: _Quiet) -> Channel:
    """`channel` with the level, noise and freedom that its samples show when they are made white by `noise`."""
    taps = noise.filter
    white = np.convolve(part.value, taps)[: len(part.value)]
    clear = np.convolve(part.quiet, np.ones(len(taps)))[: len(white)] > len(taps) - 0.5
    clear[len(taps) - 1 :] &= part.row[len(taps) - 1 :] == part.row[: len(white) - len(taps) + 1]
    count = np.bincount(part.row[clear], minlength=waves.pulses.rows)
    use = count >= FEWEST
    if use.sum() < 2:
        return replace(channel, phi=noise.phi)
    total = np.bincount(part.row[clear], white[clear], minlength=len(count))
    square = np.bincount(part.row[clear], white[clear] ** 2, minlength=len(count))
    mean, n = total[use] / count[use], count[use]
    variance = np.maximum(square[use] - n * mean**2, 0.0) / (n - 1)
    kind = np.array([channel.sample_spacing, channel.saturation])
    step, gain = channel.step, float(taps.sum())
    recorded = channel_from(kind, mean / step, variance / step**2, n).times(step)
    return replace(
        channel,
        baseline=channel.baseline + recorded.baseline / gain,
        baseline_sd=recorded.baseline_sd / gain,
        noise=recorded.noise / math.sqrt(noise.innovation),
        freedom=recorded.freedom,
        phi=noise.phi,
    )
