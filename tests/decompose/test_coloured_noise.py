"""Noise whose neighbours are correlated, and noise that grows with the signal: asked of the survey, and fitted with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import wavemaker as wm
from numpy.testing import assert_allclose
from scipy.linalg import solve_toeplitz

from fwclass.decompose.autoregression import WHITE, Autoregression, output_gain
from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.quiet import quiet_noise, with_correlated_noise
from fwclass.decompose.signal_noise import with_signal_noise
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.errors import InputError

HALF = 0.5 * wm.PULSE_WIDTH
KNOWN = (Channel(1.0, 255.0, 10.0, 0.1, 1.5, 18.0, 255.0),)
PHI = (0.5,)
KINDS = [PHI, (0.6, 0.1, -0.1), (-0.45,)]


@pytest.fixture(scope="module")
def params(base):
    return DecomposeParams(**{**base["decompose"], "tail_share": 0.0})


def asked(base, params, n=20_000, **noise):
    """The system as a survey of this noise shows it."""
    waves, _ = wm.survey_mix(n, seed=2, **noise)
    pulse = with_correlated_noise(estimate_pulse(waves, PulseParams(**base["pulse"])), waves, params)
    return with_signal_noise(pulse, waves, params)[0]


@pytest.fixture(scope="module")
def correlated(base, params):
    return asked(base, params, phi=PHI)


@pytest.mark.parametrize("phi", KINDS)
def test_an_autoregression_is_that_of_its_correlations(phi):
    noise = Autoregression(phi)
    expected = wm.covariance(phi, 20)
    assert_allclose(noise.correlation(20), expected / expected[0], atol=1e-12)
    assert_allclose(noise.innovation, 1.0 / expected[0], rtol=1e-12)
    for order in (1, 2, 5):
        best = solve_toeplitz(expected[:order], expected[1 : order + 1])
        assert_allclose(Autoregression.of(expected / expected[0], order).phi, best, atol=1e-12)
        if order < len(phi):
            assert_allclose(noise.shorter(order).phi, best, atol=1e-12)
    assert noise.shorter(0) == WHITE and noise.shorter(9) == noise
    assert_allclose(output_gain(noise.correlation(20), noise.filter), noise.innovation, rtol=1e-12)


@pytest.mark.parametrize("phi", [(1.0,), (1.2, -0.1), (np.nan,), (0.2, np.inf)])
def test_what_is_not_stationary_is_no_noise(phi):
    assert not Autoregression(phi).stationary
    channel = Channel(1.0, 255.0, 10.0, 0.1, 1.5, 20.0, 255.0)
    stored = SystemPulse("gaussian", 3.5, channels=(channel,)).to_json()
    stored["channels"][0]["phi"] = list(phi)
    with pytest.raises(InputError, match="stationary"):
        SystemPulse.from_json(stored)


@pytest.mark.statistics
def test_a_stored_pulse_keeps_its_noise(correlated):
    assert SystemPulse.from_json(correlated.to_json()).channels == correlated.channels


@pytest.mark.statistics
@pytest.mark.parametrize("maker", [wm.survey_mix, pytest.param(wm.hard_mix, marks=pytest.mark.slow), wm.noise_only])
def test_white_noise_is_left_alone(base, params, maker):
    """Neither hidden echoes nor noise that differs between waveforms is taken for correlation or for growth."""
    waves, _ = maker(20_000, seed=5)
    plain = estimate_pulse(waves, PulseParams(**base["pulse"]))
    seen, _ = with_signal_noise(with_correlated_noise(plain, waves, params), waves, params)
    assert seen is plain or seen == replace(plain, channels=seen.channels)
    assert all(c.phi == () and c.growth == 0.0 for c in seen.channels)
    assert quiet_noise(waves, plain, params).inflation < 1.05


@pytest.mark.statistics
@pytest.mark.parametrize("phi", [KINDS[0], *(pytest.param(k, marks=pytest.mark.slow) for k in KINDS[1:])])
def test_correlation_is_measured_beside_and_between_echoes(base, params, phi):
    """Rounding is white and takes its part of it."""
    pulse = asked(base, params, phi=phi)
    (channel,) = pulse.channels
    expected = wm.covariance(phi, 6) / wm.covariance(phi, 0)
    share = 1.0 - 1.0 / 12.0 / channel.noise**2
    assert_allclose(channel.autoregression.correlation(6)[1:], expected[1:] * share, atol=0.05)
    assert abs(channel.baseline - 10.0) < 0.05 and 1.35 < channel.noise < 1.55


@pytest.mark.statistics
@pytest.mark.parametrize("noise", [{"phi": PHI}, {"growth": 0.15}])
def test_the_order_of_the_waveforms_does_not_matter(params, noise):
    waves, _ = wm.survey_mix(9000, seed=2, **noise)  # more samples than are looked at
    pulse = SystemPulse("gaussian", wm.PULSE_WIDTH, channels=KNOWN)
    seen = []
    for rows in (np.arange(9000), np.random.default_rng(1).permutation(9000)):
        part = wm.rows_of(waves, rows)
        seen.append(with_signal_noise(with_correlated_noise(pulse, part, params), part, params)[0])
    assert seen[0].channels == seen[1].channels != KNOWN and seen[0].shape_error == seen[1].shape_error


def singles(n, **noise):
    waves, truth = wm.mix(n, (1.0,), amplitude=(20, 200), seed=13, **noise)
    return waves, truth, (truth.ratio >= 20.0) & ~truth.clipped


def at_most(share, n, limit):
    """Three sampling errors above `limit` are no evidence."""
    return share <= limit + 3.0 * np.sqrt(limit / n)


@pytest.mark.statistics
@pytest.mark.parametrize("n", [8000, pytest.param(60_000, marks=pytest.mark.slow)])
def test_errors_reach_the_bound_of_correlated_noise_and_are_stated(params, correlated, n):
    waves, truth, clear = singles(n, phi=PHI)
    fits = fit_waveforms(waves, params, correlated)
    assert at_most((fits.count[clear] > 1).mean(), clear.sum(), 0.003)
    i, error, sigma = wm.errors(truth, fits, HALF)
    use = ((fits.count == 1) & clear)[truth.row[i]]
    ratio, sd = wm.rms((error / wm.bounds(truth, phi=PHI)[i])[use])
    assert (ratio <= 1.03 + 3 * sd).all() and (ratio >= 0.9).all(), (ratio, sd)
    standard, sd = wm.rms((error / sigma)[use])
    assert (np.abs(standard - 1.0) <= 0.05 + 3 * sd).all(), (standard, sd)


@pytest.mark.statistics
@pytest.mark.parametrize("n", [50_000, pytest.param(400_000, marks=pytest.mark.slow)])
def test_correlated_noise_makes_no_echoes(params, correlated, n):
    waves, _ = wm.noise_only(n, seed=19, phi=PHI)
    assert at_most(fit_waveforms(waves, params, correlated).count.mean(), n, 2e-4)
    white = replace(correlated, channels=tuple(replace(c, phi=()) for c in correlated.channels))
    assert fit_waveforms(waves, params, white).count.mean() > 5e-3, "a noise that cannot deceive tests nothing"


def test_short_waveforms_are_foretold_from_fewer_samples(params):
    channel = replace(KNOWN[0], phi=Autoregression.of(Autoregression((0.6, 0.1, -0.1)).correlation(8), 8).phi)
    pulse = SystemPulse("gaussian", 3.5, channels=(channel,))
    for samples in (1, 4, 5, 9, 16, 24, 40):
        waves, _ = wm.fixed(300, [60.0], first=0.5 * samples, samples=samples, seed=1)
        fits = fit_waveforms(waves, params, pulse)
        assert (np.isfinite(fits.baseline) & np.isfinite(fits.noise)).all()
        if samples >= 16:
            assert (fits.count == 1).mean() > 0.97


@pytest.mark.statistics
@pytest.mark.parametrize("growth", [pytest.param(0.05, marks=pytest.mark.slow), 0.15])
def test_noise_that_grows_with_the_signal(base, params, growth):
    noise = {"noise": (1.3, 1.3), "growth": growth}
    pulse = asked(base, params, **noise)
    assert pulse.channels[0].growth > 0.5 * growth and pulse.channels[0].growth < 1.3 * growth
    waves, truth, clear = singles(8000, **noise)
    fits = fit_waveforms(waves, params, pulse)
    i, error, sigma = wm.errors(truth, fits, HALF)
    standard, sd = wm.rms((error / sigma)[((fits.count == 1) & clear)[truth.row[i]]])
    assert (np.abs(standard - 1.0) <= 0.07 + 3 * sd).all(), (standard, sd)
    for width in (1.0, 2.0):
        wide, _ = wm.fixed(8000, [75.0], width=width * wm.PULSE_WIDTH, first=30.0, seed=18, **(noise | {"noise": 1.3}))
        split = fit_waveforms(wide, params, pulse).count > 1
        assert at_most(split.mean(), len(split), 0.004)
