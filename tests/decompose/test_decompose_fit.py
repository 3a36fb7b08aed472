"""The fit against physical laws, known answers and the Cramér-Rao bound."""

from __future__ import annotations

import numpy as np
import pytest
from lasmaker import FWHM, digitise, gaussian
from scipy.optimize import curve_fit

from fwclass.decompose.stage import DecomposeParams, fit_waveforms
from fwclass.schema import Table
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

NOISE = 1.5
LENGTH = 72


def waves_of(waveforms, spacing=1.0, saturation=255.0) -> Waveforms:
    """Pulses that hold the given waveforms and nothing else of interest."""
    n = len(waveforms)
    pulses = {name: np.ones(n) for name in PULSE_COLUMNS}
    pulses |= {
        "pulse": np.arange(n),
        "sample_spacing": np.broadcast_to(spacing, n),
        "saturation": np.full(n, saturation),
    }
    returns = {name: np.ones(n) for name in RETURN_COLUMNS} | {"pulse": np.arange(n)}
    offsets = np.concatenate([[0], np.cumsum([len(w) for w in waveforms])]).astype(np.int64)
    samples = np.concatenate(waveforms) if n else np.empty(0, np.uint8)
    return Waveforms(Table(pulses), Table(returns), samples, offsets)


def params_of(base, **changes) -> DecomposeParams:
    return DecomposeParams(**{**base["decompose"], "tail_share": 0.0, **changes})


def noisy(n, echoes, seed=0, noise=NOISE, length=LENGTH, baseline=10.0):
    """`n` waveforms; every echo is (amplitude, time, width), scalars or arrays (n,)."""
    rng = np.random.default_rng(seed)
    y = np.full((n, length), baseline)
    t = np.arange(length)
    for a, at, w in echoes:
        a, at, w = (np.broadcast_to(v, n)[:, None] for v in (a, at, w))
        y += a * np.exp(-0.5 * ((t - at) * FWHM / w) ** 2)
    return list(digitise(y + rng.normal(0, noise, y.shape)))


def bound(echoes, noise=NOISE, length=LENGTH):
    """Cramér-Rao bound (echoes, 3) of amplitude, time, width, by numerical derivatives of the model."""
    flat = np.array([10.0, *np.ravel(echoes)])

    def model(p):
        return gaussian(length, p[1:].reshape(-1, 3), p[0])

    step = 1e-5
    jacobian = np.array([(model(flat + step * e) - model(flat - step * e)) / (2 * step) for e in np.eye(len(flat))])
    information = jacobian @ jacobian.T / (noise**2 + 1 / 12)
    return np.sqrt(np.diag(np.linalg.inv(information)))[1:].reshape(-1, 3)


@pytest.mark.parametrize("amplitude", [25.0, 60.0, 120.0, 200.0])
def test_single_echo_reaches_the_cramer_rao_bound(base, amplitude):
    n = 3000
    times = 20 + np.random.default_rng(1).uniform(-0.5, 0.5, n)
    fit = fit_waveforms(waves_of(noisy(n, [(amplitude, times, 3.8)])), params_of(base, shape_error=0.0))
    one = fit["count"] == 1
    assert one.mean() > 0.99
    error = fit["values"][one, 0] - np.c_[np.full(n, amplitude), times, np.full(n, 3.8)][one]
    limit = bound([(amplitude, 20.0, 3.8)])[0]
    ratio = np.sqrt((error**2).mean(axis=0)) / limit
    assert (ratio < 1.06).all(), ratio  # 3000 trials: standard error 1.3 %
    assert (ratio > 0.94).all(), ratio  # better than the bound would be a wrong bound
    assert (np.abs(error.mean(axis=0)) < 0.1 * limit).all()


@pytest.mark.parametrize("apart", [4.0, 6.0, 10.0])
def test_two_echoes_reach_the_bound(base, apart):
    n = 1500
    times = 20 + np.random.default_rng(2).uniform(-0.5, 0.5, n)
    echoes = [(90.0, times, 3.5), (60.0, times + apart, 3.5)]
    fit = fit_waveforms(waves_of(noisy(n, echoes)), params_of(base, shape_error=0.0))
    two = fit["count"] == 2
    assert two.mean() > 0.985
    error = fit["values"][two, :2, 1] - np.c_[times, times + apart][two]
    limit = bound([(90.0, 20.0, 3.5), (60.0, 20.0 + apart, 3.5)])[:, 1]
    assert (np.sqrt((error**2).mean(axis=0)) / limit < 1.08).all()


def test_completeness_and_false_echoes(base):
    """By signal-to-noise ratio; false echoes on pulses with one echo, and on noise alone."""
    params = params_of(base)
    for ratio, least in ((4.0, 0.60), (5.0, 0.88), (8.0, 0.999)):
        fit = fit_waveforms(waves_of(noisy(2000, [(ratio * NOISE, 20.3, 3.5)])), params)
        assert (fit["count"] >= 1).mean() > least, ratio
    strong = fit_waveforms(waves_of(noisy(4000, [(80.0, 20.3, 3.5)], seed=3)), params)
    assert (strong["count"] > 1).mean() < 0.01
    assert (strong["count"] == 0).sum() == 0
    nothing = fit_waveforms(waves_of(noisy(4000, [], seed=4)), params)
    assert (nothing["count"] > 0).mean() < 0.01


def test_close_echoes_are_split(base):
    """Two equal echoes 2.5 ns apart, closer than the pulse is wide, at 50 times the noise."""
    fit = fit_waveforms(waves_of(noisy(1000, [(75.0, 20.2, 3.5), (75.0, 22.7, 3.5)])), params_of(base))
    assert (fit["count"] == 2).mean() > 0.90


def test_same_answer_as_a_general_optimiser(base):
    waveforms = noisy(20, [(90.0, 20.3, 3.7), (50.0, 27.1, 4.2)], seed=5)
    fit = fit_waveforms(waves_of(waveforms), params_of(base, shape_error=0.0))
    t = np.arange(LENGTH)

    def model(t, b, *p):
        return b + sum(p[k] * np.exp(-0.5 * ((t - p[k + 1]) * FWHM / p[k + 2]) ** 2) for k in range(0, len(p), 3))

    for i, y in enumerate(waveforms):
        found, _ = curve_fit(model, t, y.astype(float), p0=(10, 80, 20, 3.5, 60, 27, 3.5))
        assert fit["count"][i] == 2
        # the level's weak prior pulls by less than 0.15 DN
        np.testing.assert_allclose(fit["values"][i, :2].ravel(), found[1:], rtol=3e-3, atol=0.02)
        np.testing.assert_allclose(fit["baseline"][i], found[0], atol=0.1)


def test_shift_by_samples_shifts_times(base):
    waveforms = noisy(200, [(90.0, 25.3, 3.7), (30.0, 36.0, 4.0)], seed=6)
    shifted = [np.roll(w, 4) for w in waveforms]
    a, b = (fit_waveforms(waves_of(w), params_of(base)) for w in (waveforms, shifted))
    np.testing.assert_array_equal(a["count"], b["count"])
    same = a["count"] == 2
    np.testing.assert_allclose(b["values"][same, :2, 1] - a["values"][same, :2, 1], 4.0, atol=1e-3)
    np.testing.assert_allclose(b["values"][same, :2, 0], a["values"][same, :2, 0], rtol=1e-3)


def test_scale_scales_amplitudes_and_level_moves_the_baseline(base):
    waveforms = [w.astype(np.uint16) for w in noisy(200, [(90.0, 25.3, 3.7), (30.0, 36.0, 4.0)], seed=7)]
    params = params_of(base)
    a = fit_waveforms(waves_of(waveforms, saturation=65535), params)
    scaled = fit_waveforms(waves_of([w * 7 for w in waveforms], saturation=65535), params)
    raised = fit_waveforms(waves_of([w + 500 for w in waveforms], saturation=65535), params)
    for other in (scaled, raised):
        np.testing.assert_array_equal(a["count"], other["count"])
        np.testing.assert_allclose(a["values"][..., 1:], other["values"][..., 1:], atol=2e-3)
        np.testing.assert_allclose(a["misfit"], other["misfit"], rtol=1e-4)
    np.testing.assert_allclose(scaled["values"][..., 0], 7 * a["values"][..., 0], rtol=1e-4)
    np.testing.assert_allclose(raised["values"][..., 0], a["values"][..., 0], rtol=1e-4)
    np.testing.assert_allclose(raised["baseline"], a["baseline"] + 500, atol=1e-3)


def test_a_waveform_does_not_know_its_neighbours(base):
    rng = np.random.default_rng(8)
    waveforms = [
        digitise(gaussian(n, [(120, 0.4 * n, 3.6)], spacing=s) + rng.normal(0, 1, n))
        for n, s in [(60, 1.0), (120, 1.0), (40, 0.5), (300, 0.5), (33, 1.0)]
    ]
    spacing = np.array([1.0, 1.0, 0.5, 0.5, 1.0])
    together = fit_waveforms(waves_of(waveforms, spacing), params_of(base))
    for i in range(len(waveforms)):
        alone = fit_waveforms(waves_of([waveforms[i]], spacing[i]), params_of(base))
        for name in together:
            np.testing.assert_array_equal(together[name][i], alone[name][0])


@pytest.mark.parametrize("spacing", [0.25, 0.5, 1.0, 2.0])
def test_sample_spacing(base, spacing):
    n = int(64 / spacing)
    y = digitise(gaussian(n, [(150.0, 25.3, 3.9)], spacing=spacing) + np.random.default_rng(9).normal(0, 0.5, n))
    fit = fit_waveforms(waves_of([y], spacing), params_of(base))
    assert fit["count"][0] == 1
    np.testing.assert_allclose(fit["values"][0, 0], [150.0, 25.3, 3.9], rtol=0.02, atol=0.05)


def test_saturated_echo_is_weighted_out_and_flagged(base):
    rng = np.random.default_rng(10)
    y = [digitise(gaussian(60, [(400.0, 20.3, 3.6)]) + rng.normal(0, 1, 60)) for _ in range(50)]
    fit = fit_waveforms(waves_of(y), params_of(base, shape_error=0.0))
    assert (fit["count"] == 1).mean() > 0.9
    assert (fit["flags"][:, 0] & 1).all()
    one = fit["count"] == 1
    np.testing.assert_allclose(np.median(fit["values"][one, 0], axis=0), [400.0, 20.3, 3.6], rtol=0.03)


def test_flags_of_edge_and_overlap(base):
    y = [
        digitise(gaussian(60, [(150.0, 2.0, 3.6)])),
        digitise(gaussian(60, [(150.0, 30.0, 3.6), (150.0, 33.5, 3.6)])),
        digitise(gaussian(60, [(150.0, 30.0, 3.6)])),
    ]
    flags = fit_waveforms(waves_of(y), params_of(base))["flags"][:, 0]
    assert flags[0] & 8 and flags[1] & 2 and flags[2] == 0


def test_ringing_after_an_echo_is_left_out(base):
    y = [digitise(gaussian(60, [(200.0, 20.0, 3.6), (7.0, 30.0, 6.0)]))]
    assert fit_waveforms(waves_of(y), params_of(base))["count"][0] == 2
    ringing = fit_waveforms(waves_of(y), params_of(base, tail_share=0.05))
    assert ringing["count"][0] == 1
    np.testing.assert_allclose(ringing["values"][0, 0], [200.0, 20.0, 3.6], rtol=0.01)
    before = [digitise(gaussian(60, [(7.0, 20.0, 3.6), (200.0, 30.0, 3.6)]))]
    assert fit_waveforms(waves_of(before), params_of(base, tail_share=0.05))["count"][0] == 2


@pytest.mark.parametrize(
    "samples",
    [[], [7], [7] * 4, [7] * 60, [255] * 60, [0] * 60, [0, 255] * 30, [0] * 30 + [255] * 30, list(range(60))],
)
def test_strange_waveforms_give_numbers(base, samples):
    fit = fit_waveforms(waves_of([np.array(samples, np.uint8)] * 2), params_of(base))
    for i in range(2):
        found = fit["values"][i, : fit["count"][i]]
        assert np.isfinite(found).all() and (found[:, [0, 2]] > 0).all()
    if len(set(samples)) <= 1:
        assert (fit["count"] == 0).all()


def test_more_echoes_than_allowed(base):
    echoes = [(100.0 + 5 * k, 10.0 + 12 * k, 3.5) for k in range(8)]
    fit = fit_waveforms(waves_of([digitise(gaussian(120, echoes))]), params_of(base, max_echoes=4))
    assert fit["count"][0] == 4
    np.testing.assert_allclose(fit["values"][0, :, 1], [58, 70, 82, 94], atol=0.3)


def test_no_waveforms(base):
    fit = fit_waveforms(waves_of([]), params_of(base))
    assert fit["count"].shape == (0,)
