"""The parts of the fit: the table of pulses, level and noise, the two ways to the same minimum, and odd waveforms."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import wavemaker as wm
from lasmaker import FWHM, digitise, gaussian
from scipy.optimize import curve_fit

from fwclass.decompose import fitting
from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import Fits, fit_waveforms, model_of
from fwclass.decompose.least_squares import evaluate, fit, fit_one, lay, moments, place
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.peaks import BINS, level_and_noise
from fwclass.decompose.shapes import Profiles, lookup, widths_of
from fwclass.decompose.system_pulse import Channel, SystemPulse

NOISE = 1.5
LENGTH = 72
PULSE = SystemPulse.gaussian(3.5)


def skewed() -> SystemPulse:
    """A Gaussian pulse with an exponential tail of 0.9 ns."""
    pulse = wm.skewed()
    t, h = pulse.values(0.05)
    return SystemPulse("measured", pulse.fwhm, first=float(t[0]), step=0.05, values=h)


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


def fitted(waveforms, params, pulse=PULSE, **options) -> Fits:
    return fit_waveforms(wm.waves_of(waveforms, **options), params, pulse)


def first_of(fits: Fits, name: str, count: int) -> np.ndarray:
    """A column of the waveforms that have `count` echoes, shape (waveforms, count)."""
    return getattr(fits, name)[np.isin(fits.row, np.flatnonzero(fits.count == count))].reshape(-1, count)


@pytest.mark.parametrize("spacing", [0.25, 1.0, 2.0])
def test_table_against_the_gaussian_itself(spacing):
    """Height within 3e-5 of the peak, derivatives within a percent of their greatest, anywhere in the table."""
    look = lookup(PULSE, spacing, 0.85, 3.0)
    s0 = 3.5 / FWHM / spacing
    rng = np.random.default_rng(0)
    for t, s in zip(rng.uniform(-3, 3, 300), s0 * rng.uniform(0.85, 3.0, 300), strict=True):
        row, cell, whole, dt, ds = place(look, t, s)
        h, by_t, by_s, tt, ts, ss = look.table[row, :, : look.length[cell]].astype(float)
        i = np.arange(look.length[cell]) + look.first[cell] + whole
        exact = np.exp(-0.5 * ((i - t) / s) ** 2)
        d = (i - t) / s
        near = h + dt * by_t + ds * by_s + 0.5 * dt**2 * tt + dt * ds * ts + 0.5 * ds**2 * ss
        np.testing.assert_allclose(near, exact, atol=3e-5)
        np.testing.assert_allclose((by_t + dt * tt + ds * ts) * s, exact * d, atol=6e-3)
        np.testing.assert_allclose((by_s + dt * ts + ds * ss) * s, exact * d * d, atol=8e-3)
        assert i[0] - t < -4.4 * s and i[-1] - t > 4.4 * s


def test_profiles_of_a_measured_pulse_keep_area_origin_and_width():
    """Widening is a convolution: variances add, and the echo's time stays where the pulse's own peak was."""
    pulse = skewed()
    profiles, step = Profiles(pulse), 0.05
    t = step * np.arange(-600, 601)
    h0 = profiles.at(profiles.s0, -600, 1201, step)
    mean0 = (t * h0).sum() / h0.sum()
    var0 = (t**2 * h0).sum() / h0.sum() - mean0**2
    for ratio in (1.2, 2.0, 3.0):
        h = profiles.at(ratio * profiles.s0, -600, 1201, step)
        mean = (t * h).sum() / h.sum()
        np.testing.assert_allclose(h.max(), 1.0, atol=1e-4)
        np.testing.assert_allclose(mean, mean0, atol=5e-3)
        grown = (t**2 * h).sum() / h.sum() - mean**2 - var0
        np.testing.assert_allclose(grown, (ratio**2 - 1) * profiles.s0**2, rtol=2e-3)
    widths = widths_of(pulse, 0.85, 3.0)
    np.testing.assert_allclose(np.interp(profiles.s0, widths.s, widths.fwhm), pulse.fwhm, rtol=2e-3)
    np.testing.assert_allclose(np.interp(profiles.s0, widths.s, widths.area), step * h0.sum(), rtol=1e-3)


def test_kept_widths_are_those_of_this_very_shape_and_range():
    """A pulse that differs in one value, or another range, gets widths of its own; the same one those that are kept."""
    pulse = skewed()
    other = replace(pulse, values=np.where(pulse.values > 0.999, 0.9, pulse.values))
    kept = widths_of(pulse, 0.85, 3.0)
    assert widths_of(replace(pulse, values=pulse.values.copy()), 0.85, 3.0) is kept
    assert not np.array_equal(widths_of(other, 0.85, 3.0).area, kept.area)
    assert widths_of(pulse, 0.85, 1.5).s[-1] < kept.s[-1]
    assert (
        widths_of(SystemPulse.gaussian(3.0), 0.85, 3.0).fwhm[0]
        != widths_of(SystemPulse.gaussian(4.0), 0.85, 3.0).fwhm[0]
    )


@pytest.mark.parametrize("deep", [1, 40])
def test_level_and_noise_of_waveforms_full_of_echoes(deep):
    """Unbiased on noise; half of a waveform under echoes moves the level by less than half the noise."""
    rng = np.random.default_rng(1)
    bins = np.empty((3, BINS + 1), np.int32)
    quiet = np.rint(deep * (30 + rng.normal(0, 1.5, (2000, 72)))).astype(np.uint16)
    full = quiet + np.rint(deep * gaussian(72, [(90, 20, 5), (60, 31, 5), (120, 44, 6)], 0.0)).astype(np.uint16)
    for samples, off, ratio in ((quiet, 0.03, 0.03), (full, 0.75, 0.35)):
        found = np.array([level_and_noise(y, 0, 72, 0.3, bins) for y in samples])
        assert abs(np.median(found[:, 0]) - deep * 30) < off * deep
        assert abs(np.median(found[:, 1]) / np.hypot(1.5 * deep, 0.289) - 1) < ratio


def test_fast_path_of_one_echo_is_the_general_fit():
    look = lookup(PULSE, 1.0, 0.85, 3.0)
    pad, most = look.before + 2, 3
    rng = np.random.default_rng(2)
    size, padded = 3 * most + 1, LENGTH + look.before + look.after + 4
    for _ in range(50):
        y, weight = np.zeros(padded), np.zeros(padded)
        truth = (rng.uniform(20, 200), rng.uniform(15, 50), rng.uniform(3.5, 7))
        y[pad : pad + LENGTH] = gaussian(LENGTH, [truth], 10.0) + rng.normal(0, 1.5, LENGTH)
        weight[pad : pad + LENGTH] = 1.0
        prior, limits, sums = (10.0, 0.1), (1.3, 4.4, 60, 1e-9, 500.0), moments(y, weight, pad, LENGTH)
        one, many = (np.array([9.0, truth[0] * 0.8, truth[1] + 0.4, truth[2] / FWHM * 1.1, 0, 0, 0]) for _ in range(2))
        many[4:] = (1e-9, 70.0, 1.4)
        work = (
            np.zeros(padded),
            np.empty((most, 3, look.table.shape[2])),
            np.zeros((most, 4), np.int64),
            np.empty((size, size)),
            np.empty(size),
            np.empty((size, size)),
            np.empty(size),
            np.empty(size),
            np.zeros(size),
        )
        chi, _ = fit_one(one, y, weight, pad, LENGTH, prior, limits, look, sums)
        square, _ = evaluate(one, 1, y, weight, pad, LENGTH, look, sums, *work[:3])
        np.testing.assert_allclose(square + 0.1 * (one[0] - 10.0) ** 2, chi, rtol=1e-9)
        lay(one, 1, y, pad, LENGTH, look, *work[:3])
        left = work[0][pad : pad + LENGTH]
        np.testing.assert_allclose(square, left @ left, rtol=1e-9)  # quiet samples by their moments alone
        # a second echo of no height does not change the first
        general = fit(many, 2, y, weight, pad, LENGTH, prior, limits, look, sums, work)
        assert general > 0.6 * chi
        assert general <= chi + 0.2


def test_same_answer_as_a_general_optimiser(base):
    waveforms = noisy(20, [(90.0, 20.3, 3.7), (50.0, 27.1, 4.2)], seed=5)
    fits = fitted(waveforms, params_of(base))
    t = np.arange(LENGTH)

    def model(t, b, *p):
        return b + sum(p[k] * np.exp(-0.5 * ((t - p[k + 1]) * FWHM / p[k + 2]) ** 2) for k in range(0, len(p), 3))

    for i, y in enumerate(waveforms):
        found, covariance = curve_fit(model, t, y.astype(float), p0=(10, 80, 20, 3.5, 60, 27, 3.5))
        assert fits.count[i] == 2
        at = fits.row == i
        ours = np.stack([fits.amplitude[at], fits.time[at], fits.width[at]], axis=1).ravel()
        sigma = np.stack([fits.amplitude_sigma[at], fits.time_sigma[at], fits.width_sigma[at]], axis=1).ravel()
        # the level's weak prior pulls by a few hundredths of a standard error
        assert (np.abs(ours - found[1:]) < 0.1 * sigma).all()
        np.testing.assert_allclose(sigma, np.sqrt(np.diag(covariance))[1:], rtol=0.03)
        np.testing.assert_allclose(fits.baseline[i], found[0], atol=0.05)
        total, curves = model_of(fits, i, LENGTH, 1.0, PULSE)
        np.testing.assert_allclose(total, model(t, fits.baseline[i], *ours), atol=0.02)
        np.testing.assert_allclose(total, fits.baseline[i] + curves.sum(axis=0))


def test_energy_is_the_area_of_the_curve(base):
    for pulse in (PULSE, skewed()):
        fits = fitted(noisy(50, [(150.0, 30.3, 4.5)]), params_of(base), pulse)
        for i in np.flatnonzero(fits.count == 1):
            curve = model_of(fits, i, LENGTH, 1.0, pulse)[1][0]
            np.testing.assert_allclose(fits.energy[fits.row == i][0], curve.sum(), rtol=2e-3)


@pytest.mark.parametrize("spacing", [0.25, 0.5, 1.0, 2.0])
def test_sample_spacing(base, spacing):
    n = int(64 / spacing)
    y = digitise(gaussian(n, [(150.0, 25.3, 3.9)], spacing=spacing) + np.random.default_rng(9).normal(0, 0.5, n))
    fits = fitted([y], params_of(base), spacing=spacing)
    assert fits.count[0] == 1
    found = (fits.amplitude[0], fits.time[0], fits.width[0])
    np.testing.assert_allclose(found, [150.0, 25.3, 3.9], rtol=0.02, atol=0.05)


def test_what_the_receiver_is_known_for_steadies_level_and_noise(base):
    """Many degrees of freedom: the channel's noise; a waveform of another channel keeps its own."""
    known = SystemPulse("gaussian", 3.5, channels=(Channel(1.0, 255.0, 10.0, 0.01, NOISE, 1e6, 255.0),))
    waveforms = noisy(200, [(60.0, 30.0, 3.5)])
    mine, free = fitted(waveforms, params_of(base), known), fitted(waveforms, params_of(base))
    np.testing.assert_allclose(mine.noise, NOISE, rtol=1e-3)
    assert free.noise.std() > 0.05 and mine.baseline.std() < 0.1 * free.baseline.std()
    other = fitted(waveforms, params_of(base), known, saturation=250.0)
    np.testing.assert_array_equal(other.noise, free.noise)


def test_saturated_echo_is_weighted_out_and_flagged(base):
    rng = np.random.default_rng(10)
    y = [digitise(gaussian(60, [(400.0, 20.3, 3.6)]) + rng.normal(0, 1, 60)) for _ in range(50)]
    fits = fitted(y, params_of(base))
    assert (fits.count == 1).mean() > 0.9
    assert (fits.flags[fits.amplitude > 100] & 1).all()
    found = [np.median(first_of(fits, name, 1)) for name in ("amplitude", "time", "width")]
    np.testing.assert_allclose(found, [400.0, 20.3, 3.6], rtol=0.03)


def test_flags_of_edge_and_overlap(base):
    y = [
        digitise(gaussian(60, [(150.0, 2.0, 3.6)])),
        digitise(gaussian(60, [(150.0, 30.0, 3.6), (150.0, 33.5, 3.6)])),
        digitise(gaussian(60, [(150.0, 30.0, 3.6)])),
    ]
    fits = fitted(y, params_of(base))
    flags = fits.flags[np.searchsorted(fits.row, np.arange(3))]
    assert flags[0] & 8 and flags[1] & 2 and flags[2] == 0


def test_no_echo_higher_than_its_samples_or_outside_the_segment(base):
    """The foot of an echo beyond the segment's end is no echo, and nothing runs away."""
    rng = np.random.default_rng(11)
    at = rng.uniform(-8, 0, 500) + np.where(rng.random(500) < 0.5, 0.0, LENGTH + 7)
    fits = fitted(noisy(500, [(120.0, at, 4.0)], seed=12), params_of(base))
    assert (fits.amplitude < 1.6 * 120).all()
    assert (fits.time >= -0.5).all() and (fits.time <= LENGTH - 0.5).all()


def test_ringing_after_an_echo_is_left_out(base):
    y = [digitise(gaussian(60, [(200.0, 20.0, 3.6), (7.0, 30.0, 6.0)]))]
    assert fitted(y, params_of(base)).count[0] == 2
    ringing = fitted(y, params_of(base, tail_share=0.05))
    assert ringing.count[0] == 1
    found = (ringing.amplitude[0], ringing.time[0], ringing.width[0])
    np.testing.assert_allclose(found, [200.0, 20.0, 3.6], rtol=0.01)
    before = [digitise(gaussian(60, [(7.0, 20.0, 3.6), (200.0, 30.0, 3.6)]))]
    assert fitted(before, params_of(base, tail_share=0.05)).count[0] == 2


def test_more_echoes_than_allowed(base):
    echoes = [(100.0 + 5 * k, 10.0 + 12 * k, 3.5) for k in range(8)]
    fits = fitted([digitise(gaussian(120, echoes))], params_of(base, max_echoes=4))
    np.testing.assert_allclose(fits.time, [58, 70, 82, 94], atol=0.3)


def test_no_waveforms(base):
    fits = fitted([], params_of(base))
    assert fits.count.shape == (0,) and fits.time.shape == (0,)


def test_samples_at_the_channel_s_clip_level_carry_no_weight(base):
    """A channel that clips below its saturation: heights are extrapolated, flagged, and not split."""
    waves, truth = wm.fixed(300, (3000.0,), bits=16, saturation=65535.0, noise=2.0, seed=4)
    clipped = replace(waves, samples=np.minimum(waves.samples, 2000))
    channel = Channel(1.0, 65535.0, 10.0, 0.5, 2.0, 50.0, 2000.0)
    params = params_of(base)
    fits = fit_waveforms(clipped, params, SystemPulse("gaussian", 3.5, channels=(channel,)))
    assert (fits.count == 1).all() and (fits.flags & SATURATED > 0).all()
    np.testing.assert_allclose(fits.amplitude, truth.amplitude, rtol=0.02)
    blind = fit_waveforms(clipped, params, SystemPulse("gaussian", 3.5))
    assert (np.abs(blind.amplitude / 3000.0 - 1.0) > 0.1).mean() > 0.9


def test_long_waveforms_make_no_more_false_echoes(base):
    """2000 samples are 28 times the chances of 72."""
    waves, _ = wm.noise_only(2000, samples=2000, seed=6)
    params = params_of(base)
    known = SystemPulse("gaussian", 3.5, channels=(Channel(1.0, 255.0, 10.0, 0.05, 1.5, 18.0, 255.0),))
    assert fit_waveforms(waves, params, known).count.sum() <= 3


def test_calls_of_the_kernel_change_nothing_and_are_short(base, monkeypatch):
    """An interrupt is heeded between two of them."""
    waveforms = noisy(50, [(80.0, 20.0, 3.5), (40.0, 45.0, 4.0)], seed=5) + noisy(7, [(60.0, 11.0, 3.5)], length=30)
    once = fitted(waveforms, params_of(base))
    sizes, real = [], fitting.fit_all
    monkeypatch.setattr(fitting, "AT_A_TIME", 8)
    monkeypatch.setattr(fitting, "fit_all", lambda *words: sizes.append(len(words[2])) or real(*words))
    again = fitted(waveforms, params_of(base))
    assert sum(sizes) == 57 and max(sizes) == 8
    for field in fields(Fits):
        np.testing.assert_array_equal(getattr(once, field.name), getattr(again, field.name))
