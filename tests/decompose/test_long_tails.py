"""A receiver that rises fast and falls slowly: its tail is followed, its rise is sharp, and neither makes echoes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from commandline import fwclass
from defaults import BASE
from lasmaker import Descriptor, write_las
from scipy.special import erfc
from wavemaker import FWHM, METRES_PER_NS, waves_of

from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse

PULSE, FIT = PulseParams(**BASE["pulse"]), DecomposeParams(**BASE["decompose"])
RISE, SAMPLES = 1.5, 180


def exgaussian(t, tail, sigma=RISE / FWHM):
    """A Gaussian convolved with an exponential of `tail` [ns], in closed form, not scaled."""
    z = (sigma / tail - t / sigma) / np.sqrt(2.0)
    return np.exp(0.5 * (sigma / tail) ** 2 - t / tail) * erfc(z)


@cache
def crest(tail):
    t = np.arange(0.0, 6.0, 1e-4)
    h = exgaussian(t, tail)
    return t[h.argmax()], h.max()


def recorded(tail, n=3000, seed=0):
    """Waveforms of 1 ns and 1 DN of noise with one echo, or two that are 1 to 3 tails apart; row and time of each."""
    rng = np.random.default_rng(seed)
    two = rng.random(n) < 0.3
    first = rng.uniform(30.0, 40.0, n)
    second = first + rng.uniform(1.0, 3.0, n) * tail
    row = np.concatenate([np.arange(n), np.flatnonzero(two)])
    time = np.concatenate([first, second[two]])
    height = np.exp(rng.uniform(np.log(20.0), np.log(180.0), len(row)))
    y = 12.0 + rng.normal(0.0, 1.0, (n, SAMPLES))
    at, top = crest(tail)
    for i, t0, a in zip(row, time, height, strict=True):
        y[i] += a * exgaussian(np.arange(SAMPLES) - t0 + at, tail) / top
    waves = waves_of(list(np.clip(np.rint(y), 0, 255).astype(np.uint8)))
    return waves, row, time


@pytest.mark.statistics
@pytest.mark.parametrize("tail", [4.0, 12.0])
def test_a_tail_far_longer_than_the_rise_makes_no_echoes(tail):
    waves, row, time = recorded(tail)
    pulse = estimate_pulse(waves, PULSE)
    fits = fit_waveforms(waves, FIT, pulse)
    known = pulse.first + pulse.step * np.arange(len(pulse.values))
    at, top = crest(tail)
    assert pulse.shape == "measured"
    apart = np.abs(pulse.values - exgaussian(known + at, tail) / top)
    assert apart[known > 0.0].max() < 0.01  # followed to where 1 % is left
    nearest = np.array(
        [np.abs(fits.time[fits.row == i] - t).min(initial=np.inf) for i, t in zip(row, time, strict=True)]
    )
    assert (nearest > 2.0).sum() <= 0.003 * len(row)
    assert len(fits.row) - (nearest <= 2.0).sum() < 0.006 * len(fits.row)
    single = np.flatnonzero((np.bincount(row) == 1)[fits.row] & (fits.count[fits.row] == 1))
    first = time[: waves.pulses.rows]
    assert abs(np.median(fits.time[single] - first[fits.row[single]])) * METRES_PER_NS < 0.01


def test_two_detectors_of_one_spacing_are_named_among_the_causes(tmp_path):
    rng, n = np.random.default_rng(2), 800
    at, top = crest(4.0)
    t, first = np.arange(90), rng.uniform(25.0, 26.0, n)
    height = rng.uniform(40.0, 180.0, n)
    y = 12.0 + rng.normal(0.0, 1.0, (n, len(t)))
    for i in range(n):
        gaussian = np.exp(-0.5 * ((t - first[i]) / 4.0 * FWHM) ** 2)
        y[i] += height[i] * (gaussian if i % 2 else exgaussian(t - first[i] + at, 4.0) / top)
    write_las(
        tmp_path / "two.las",
        np.c_[500000.0 + 0.5 * (np.arange(n) % 20), 5400000.0 + 0.5 * (np.arange(n) // 20), np.full(n, 200.0)],
        waveforms=list(np.clip(np.rint(y), 0, 255).astype(np.uint8)),
        descriptor_of=1 + np.arange(n) % 2,
        descriptors={k: Descriptor(8, len(t), 1000) for k in (1, 2)},
        pulse=np.arange(n),
        location=first,
        gps_time=1000.0 + 1e-5 * np.arange(n),
    )
    ended = fwclass("decompose", tmp_path / "two.las", tmp_path / "two.laz")
    assert ended.returncode == 4 and "detectors with pulses of their own" in ended.stderr, ended.stderr
