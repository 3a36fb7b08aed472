"""How far the noise of a strip's waveforms hangs together: the fit's thresholds stand on noise that does not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.pulse_channels import channel_groups, estimate_channels, rough_levels
from fwclass.decompose.pulse_sample import rows_of
from fwclass.decompose.pulse_scan import MARK
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.waveforms import Waveforms

REACH = 1.5
"""The pulse is taken this many widths to both sides of its peak."""

MOST_WAVEFORMS = 4000
FEWEST_PAIRS = 1000
"""Pairs of neighbouring quiet samples below which nothing is said; 1000 tell the correlation to 0.03."""


@dataclass(frozen=True)
class QuietNoise:
    """What the samples that no echo reaches show.

    Attributes
    ----------
    lag1 : correlation of neighbouring samples; 0 is white noise. None: too few quiet samples.
    inflation : standard deviation of the matched filter's output over what white noise would give; at least 1.
    samples : quiet samples looked at.
    """

    lag1: float | None
    inflation: float
    samples: int

    @property
    def told(self) -> dict[str, float | int | None]:
        return {"lag1": self.lag1, "inflation": self.inflation, "quiet_samples": self.samples}


def quiet_noise(waves: Waveforms, pulse: SystemPulse, tail: float) -> QuietNoise:
    """Correlation of the noise in a sample of a strip's waveforms, all channels together.

    A sample is quiet that is further than one pulse width before, and `tail` [ns] after, every sample that stands
    `MARK` standard deviations above the level. Depends on the set of waveforms only: of more than `MOST_WAVEFORMS`
    every n-th in their order by pulse is taken.
    """
    nothing = QuietNoise(None, 1.0, 0)
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    sound = np.flatnonzero(np.isfinite(spacing) & (spacing > 0.0) & (np.diff(waves.offsets) > 1))
    if len(sound) == 0:
        return nothing
    steps, count = np.unique(spacing[sound], return_counts=True)
    step = float(steps[int(count.argmax())])
    rows = sound[spacing[sound] == step]
    waves = rows_of(waves, rows[:: -(-len(rows) // MOST_WAVEFORMS)])
    kinds, group = channel_groups(waves)
    level, noise = rough_levels(waves, group)
    _, level = estimate_channels(waves, kinds, group, level, noise, pulse.fwhm, tail)
    row = np.repeat(np.arange(waves.pulses.rows), np.diff(waves.offsets))
    value = (waves.samples - level[row]) / noise[row]
    ahead = math.ceil(pulse.fwhm / step)
    quiet = ~_near(value > MARK, row, ahead, math.ceil(tail / step))
    if not quiet.any():
        return nothing
    value = np.where(quiet, value - value[quiet].mean(), 0.0)
    half = math.ceil(REACH * ahead)
    template = pulse.at(step * np.arange(-half, half + 1, dtype=np.float64))
    lags = _correlations(value, quiet, row, min(len(template), int(np.diff(waves.offsets).max())))
    if len(lags) < 2:
        return nothing
    overlap = np.correlate(template, template, "full")[len(template) - 1 :][: len(lags)]
    gain = (overlap[0] + 2.0 * float(lags[1:] @ overlap[1:])) / overlap[0]
    return QuietNoise(float(lags[1]), math.sqrt(max(gain, 1.0)), int(quiet.sum()))


def _near(hot: NDArray[np.bool_], row: NDArray[np.int64], ahead: int, behind: int) -> NDArray[np.bool_]:
    """Samples at most `ahead` before or `behind` after a `hot` one of their own waveform."""
    at, never = np.arange(len(hot)), 2 * len(hot)
    last = np.maximum.accumulate(np.where(hot, at, -never))
    following = np.minimum.accumulate(np.where(hot, at, never)[::-1])[::-1]
    after = (at - last <= behind) & (row[last % len(hot)] == row)
    return np.asarray(after | ((following - at <= ahead) & (row[following % len(hot)] == row)))


def _correlations(
    value: NDArray[np.float64], quiet: NDArray[np.bool_], row: NDArray[np.int64], most: int
) -> NDArray[np.float64]:
    """Correlation at lags 0, 1, …; shorter where fewer than `FEWEST_PAIRS` pairs are left."""
    variance = float((value[quiet] ** 2).mean())
    found = [1.0]
    for lag in range(1, most):
        pairs = quiet[:-lag] & quiet[lag:] & (row[:-lag] == row[lag:])
        n = int(pairs.sum())
        if n < FEWEST_PAIRS or variance <= 0.0:
            break
        found.append(float((value[:-lag] * value[lag:])[pairs].mean()) / variance)
    return np.array(found)
