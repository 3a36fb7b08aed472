"""A receiver that rises fast and falls slowly: its tail is followed, its rise is sharp, and neither makes echoes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import laspy
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
from fwclass.report.pulse_remarks import pulse_remarks

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
@pytest.mark.parametrize("tail", [4.0, pytest.param(12.0, marks=pytest.mark.slow)])
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


@pytest.mark.statistics
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_descriptors_of_one_detector_share_its_pulse_however_few_their_echoes(seed):
    waves, _, _ = recorded(4.0, 700, seed)
    receiver = (np.arange(700) % 3).astype(waves.pulses["receiver"].dtype)
    pulse = estimate_pulse(replace(waves, pulses=waves.pulses.with_columns({"receiver": receiver})), PULSE)
    assert pulse.shape == "measured" and len(pulse.channels) == 1


def two_detectors(path, descriptors, n=2000):
    """Every second pulse is a detector's of other shape, of a sixth of the gain, with a sixth of the noise; the number
    of echoes, a return each."""
    rng = np.random.default_rng(2)
    at, top = crest(4.0)
    t, first = np.arange(90), rng.uniform(25.0, 26.0, n)
    two = rng.random(n) < 0.2
    height = np.exp(rng.uniform(np.log(40.0), np.log(220.0), (n, 2))) / np.where(np.arange(n) % 2, 6.0, 1.0)[:, None]
    y = 12.0 + rng.normal(0.0, 1.0, (n, len(t))) * np.where(np.arange(n) % 2, 0.5, 3.0)[:, None]
    time = first[:, None] + np.c_[np.zeros(n), np.where(two, rng.uniform(10.0, 30.0, n), np.nan)]
    for i, k in np.argwhere(np.isfinite(time)):
        gaussian = np.exp(-0.5 * ((t - time[i, k]) / 4.0 * FWHM) ** 2)
        y[i] += height[i, k] * (gaussian if i % 2 else exgaussian(t - time[i, k] + at, 4.0) / top)
    pulse, echo = np.nonzero(np.isfinite(time))
    ground = np.c_[500000.0 + 0.5 * (pulse % 50), 5400000.0 + 0.5 * (pulse // 50), 200.0 + 0.0 * pulse]
    write_las(
        path,
        ground - np.outer(time[pulse, echo] - first[pulse], (0.0, 0.0, METRES_PER_NS)),
        waveforms=list(np.clip(np.rint(y), 0, 255).astype(np.uint8)),
        return_number=echo + 1,
        number_of_returns=1 + two[pulse],
        intensity=np.rint(10.0 * height[pulse, echo]),
        descriptor_of=descriptors(np.arange(n)),
        descriptors={k: Descriptor(8, len(t), 1000) for k in (1, 2, 3)},
        pulse=pulse,
        location=time[pulse, echo],
        gps_time=1000.0 + 1e-5 * pulse,
    )
    return len(pulse)


@pytest.mark.parametrize(
    "descriptors",
    [pytest.param(lambda i: 1 + i % 2, marks=pytest.mark.slow), lambda i: np.where(i % 2, 3, 1 + i // 2 % 2)],
)
def test_detectors_that_descriptors_tell_apart_have_pulses_of_their_own(tmp_path, descriptors):
    echoes = two_detectors(tmp_path / "two.las", descriptors)
    ended = fwclass("decompose", tmp_path / "two.las", tmp_path / "two.laz")
    assert ended.returncode == 0 and "tell receivers of different pulses or noise apart" in ended.stderr, ended.stderr
    las = laspy.read(tmp_path / "two.laz")
    assert abs(len(las) - echoes) < 0.01 * echoes
    assert np.median(np.abs(np.asarray(las.z)[np.asarray(las.return_number) == 1] - 200.0)) < 0.02
    odd = np.asarray(las["noise"]) < 1.2  # each detector has its own noise
    assert abs(odd.mean() - 0.5) < 0.03, odd.mean()


def test_a_detector_whose_fellow_was_never_quiet_is_told_alone():
    """The other one has no channel: none of its samples are free of echoes."""
    own = {"sample_spacing": 1.0, "saturation": 255.0, "receivers": [2], "fwhm": 4.0, "noise": 1.2}
    channel = own | {"outgoing": False, "recorded_fwhm": None}
    (line,) = pulse_remarks([{"name": "s", "channels": [channel]}])
    assert "descriptor 2 (4.00 ns wide, noise 1.20 DN); each is fitted" in line


def test_detectors_in_turn_that_no_descriptor_tells_apart_are_told(tmp_path):
    """Of digitisers of unlike gains, which bright echoes seemed to show, nothing is said: a third of the echoes was one
    too many for that."""
    count = two_detectors(tmp_path / "two.las", lambda i: np.ones(len(i), int), 800)
    ended = fwclass("decompose", tmp_path / "two.las", tmp_path / "two.laz")
    assert ended.returncode == 0 and "two lasers, facets or receivers in turn" in ended.stderr
    assert f"{count} echoes from {count} returns" in ended.stderr and "samples of even number" not in ended.stderr


@pytest.mark.slow
@pytest.mark.statistics
def test_descriptors_of_one_detector_stay_one_channel():
    waves, *_ = recorded(4.0)
    turn = np.arange(waves.pulses.rows) % 3
    several = replace(waves, pulses=waves.pulses.with_columns({"receiver": turn.astype(np.uint8)}))
    assert estimate_pulse(several, PULSE).to_json() == estimate_pulse(waves, PULSE).to_json()
