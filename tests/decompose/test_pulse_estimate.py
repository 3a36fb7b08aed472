"""The estimated system pulse against pulses that are known, whatever the sensor."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from defaults import BASE as DEFAULTS
from scipy.stats import f as fisher
from wavemaker import FWHM, Pulse, mix, noise_only, ringing, rows_of, simulate, skewed, survey_mix, waves_of

from fwclass.decompose.params import PulseParams
from fwclass.decompose.pulse_align import half_sample_mode, narrowest
from fwclass.decompose.pulse_channels import prior_variance
from fwclass.decompose.pulse_estimate import describe, estimate_pulse
from fwclass.decompose.pulse_sample import join_samples, sample_pulses, with_signal
from fwclass.decompose.pulse_template import gaussian_template, mean_shape
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.errors import InputError

BASE = DEFAULTS["pulse"]


def params_of(**changes) -> PulseParams:
    return PulseParams(**{**BASE, **changes})


PARAMS = params_of()


def departure(found: SystemPulse, true: Pulse) -> float:
    """Largest difference of the two shapes, their peaks at 0."""
    time = found.first + found.step * np.arange(len(found.values))
    return float(np.abs(found.values - true.height(time[None], np.array([true.core / FWHM]))[0]).max())


@pytest.mark.statistics
@pytest.mark.parametrize("pulse", [skewed(), ringing()], ids=["skewed", "ringing"])
def test_a_pulse_that_is_no_gaussian_is_measured(pulse):
    waves, _ = survey_mix(5000, seed=1, pulse=pulse, widest=1.0)
    found = estimate_pulse(waves, PARAMS)
    assert found.shape == "measured" and found.echoes >= 1000
    # the mean of 1000 echoes at 50 times the noise: 1e-3 of the height, where samples are 3.5 to a FWHM
    assert departure(found, pulse) < 4e-3
    assert found.fwhm == pytest.approx(pulse.fwhm, rel=3e-3)
    assert found.values.max() == found.values[round(-found.first / found.step)] == 1.0
    assert SystemPulse.from_json(json.loads(json.dumps(found.to_json()))).fwhm == found.fwhm


@pytest.mark.statistics
@pytest.mark.parametrize("widest", [1.0, 1.6])
def test_a_gaussian_stays_one(widest):
    """With widest = 1.6 no target is flat: only the edge of the widths tells the pulse's."""
    waves, _ = survey_mix(8000, seed=2, widest=widest)
    found = estimate_pulse(waves, PARAMS)
    assert found.shape == "gaussian" and len(found.values) == 0
    assert found.fwhm == pytest.approx(3.5, rel=0.01)
    assert found.shape_error < 0.005


def sensor(n, core, spacing, bits, baseline, noise, top, *, tail=0.0, share=0.0, seed=0):
    """Single and double echoes, half of them of flat targets, as some sensor records them."""
    rng = np.random.default_rng(seed)
    pulse = Pulse(core, tail, (share,) if share else (), (10.0,) if share else ())
    height = np.exp(rng.uniform(np.log(5 * noise), np.log(top), (n, 2)))
    wide = 0.4 * rng.beta(1, 3, (n, 2)) * (rng.random((n, 2)) < 0.5)
    time = np.full((n, 2), 3.0 * core) + rng.uniform(0, 3 * spacing, (n, 1))
    time[:, 1] = np.where(rng.random(n) < 0.25, time[:, 0] + rng.uniform(0.3, 4.0, n) * core, np.nan)
    length = int((9 * core + 40) / spacing)
    options = {"samples": length, "spacing": spacing, "bits": bits, "baseline": baseline, "pulse": pulse}
    waves, _ = simulate(
        height, time, pulse.fwhm / FWHM * (1 + wide), noise=noise * rng.uniform(0.8, 1.3, n), seed=seed, **options
    )
    return waves, pulse


SENSORS = [
    (2, 0.5, 8, 0, 0.5, 200),
    (2, 1, 8, 12, 1, 230),
    (2, 2, 8, 12, 1, 230),
    (4, 1, 16, 200, 3, 3000),
    (4.3, 1, 8, 2.5, 0.4, 180),
    (6, 2, 8, 30, 1, 200),
    (12, 1, 8, 15, 1, 400),
    (12, 2, 16, 500, 5, 4000),
]


@pytest.mark.statistics
@pytest.mark.parametrize("kind", SENSORS, ids=lambda k: f"{k[0]}ns-every-{k[1]}ns-{k[2]}bit")
def test_the_width_is_found_for_any_sensor(kind):
    waves, pulse = sensor(1500, *kind)
    found = estimate_pulse(waves, PARAMS)
    assert found.shape == "gaussian"
    # one sample to a FWHM leaves one degree of freedom to an echo
    assert found.fwhm == pytest.approx(pulse.fwhm, rel=0.01 if kind[0] > kind[1] else 0.025)
    [channel] = found.channels
    rng = np.random.default_rng(1)
    silence = kind[3] + kind[4] * rng.uniform(0.8, 1.3, 20000) * rng.normal(size=20000)
    silence = np.maximum(np.rint(silence), 0.0)  # clipped at 0 DN the level is what is recorded, not what it was
    assert channel.baseline == pytest.approx(silence.mean(), abs=0.1 * kind[4])
    assert channel.noise == pytest.approx(silence.std(), rel=0.1)
    assert (channel.sample_spacing, channel.saturation) == (kind[1], 2 ** kind[2] - 1)


@pytest.mark.statistics
@pytest.mark.parametrize("kind", [SENSORS[3], SENSORS[4], SENSORS[7]], ids=["16bit", "8bit", "coarse"])
def test_the_shape_is_found_for_other_sensors(kind):
    waves, pulse = sensor(2500, *kind, tail=0.25 * kind[0])
    found = estimate_pulse(waves, PARAMS)
    assert found.shape == "measured"
    assert departure(found, pulse) < 5e-3


@pytest.mark.statistics
def test_neither_order_nor_cutting_matters():
    waves, _ = survey_mix(2000, seed=3, pulse=ringing())
    whole = estimate_pulse(waves, PARAMS)
    backwards = rows_of(waves, np.arange(2000)[::-1])
    parts = [rows_of(waves, np.arange(a, b)) for a, b in ((1200, 2000), (0, 1), (1, 1200))]
    joined = join_samples([sample_pulses(part, 2, 2000, PARAMS) for part in parts])
    assert joined.returns.rows == 0
    for other in (estimate_pulse(backwards, PARAMS), estimate_pulse(joined, PARAMS)):
        assert json.dumps(other.to_json()) == json.dumps(whole.to_json())


@pytest.mark.parametrize("hole", [0, 255])
def test_holes_are_no_quiet_samples(hole):
    """One waveform in 20 of nothing but zeros: noise of 2 DN was measured as 1.5 DN."""
    waves, _ = survey_mix(2000, seed=3)
    samples = waves.samples.reshape(2000, -1).copy()
    samples[::20] = hole
    holed = replace(waves, samples=samples.reshape(-1))
    kept = with_signal(holed)
    np.testing.assert_array_equal(kept.pulses["pulse"], np.delete(waves.pulses["pulse"], np.s_[::20]))
    np.testing.assert_array_equal(kept.samples, np.delete(waves.samples.reshape(2000, -1), np.s_[::20], 0).reshape(-1))
    assert with_signal(waves) is waves
    blank = replace(waves, samples=np.full_like(waves.samples, hole))
    assert with_signal(blank) is blank
    nothing = rows_of(waves, np.arange(0))
    assert with_signal(nothing) is nothing


def test_the_sample_is_a_share_of_the_strip_and_knows_no_chunks():
    waves, _ = noise_only(8000, seed=4, samples=12)
    params = params_of(sample=1000)
    chosen = sample_pulses(waves, 1, 8000, params).pulses["pulse"]
    assert abs(len(chosen) - 1000) < 4 * np.sqrt(1000 * 7 / 8)
    halves = [sample_pulses(rows_of(waves, np.arange(a, a + 4000)), 1, 8000, params) for a in (0, 4000)]
    np.testing.assert_array_equal(np.concatenate([h.pulses["pulse"] for h in halves]), chosen)
    assert len(np.intersect1d(chosen, sample_pulses(waves, 2, 8000, params).pulses["pulse"])) < 250
    assert sample_pulses(waves, 1, 1000, params).pulses.rows == 8000
    np.testing.assert_array_equal(
        halves[0].samples[12:24], waves.samples[12 * chosen[1] : 12 * chosen[1] + 12]
    )  # the samples go with their rows


@pytest.mark.statistics
def test_scaling_and_raising_change_the_channel_not_the_pulse():
    waves, _ = survey_mix(1500, seed=5, pulse=skewed(), bits=16, amplitude=(50.0, 2000.0), noise=(10.0, 20.0))
    one = estimate_pulse(waves, PARAMS)
    other = waves_of((waves.samples.reshape(1500, -1) * 7 + 500).astype(np.uint16), saturation=65535.0)
    two = estimate_pulse(other, PARAMS)
    assert two.fwhm == pytest.approx(one.fwhm, rel=1e-4)
    assert two.channels[0].baseline == pytest.approx(7 * one.channels[0].baseline + 500, rel=1e-6)
    assert two.channels[0].noise == pytest.approx(7 * one.channels[0].noise, rel=1e-3)


@pytest.mark.statistics
def test_two_channels_are_told_apart():
    one, _ = survey_mix(3000, seed=6, baseline=10.0)
    other, _ = survey_mix(3000, seed=7, baseline=30.0, saturation=200.0, amplitude=(5.0, 150.0))
    pulses = other.pulses.with_columns({"pulse": other.pulses["pulse"] + 3000})
    both = join_samples([one, type(other)(pulses, other.returns, other.samples, other.offsets)])
    found = estimate_pulse(both, PARAMS)
    assert [(c.saturation, round(c.baseline)) for c in found.channels] == [(200.0, 30), (255.0, 10)]
    assert found.fwhm == pytest.approx(3.5, rel=0.015)


def test_saturated_echoes_do_not_count():
    waves, _ = survey_mix(2000, seed=8, amplitude=(50.0, 1500.0), widest=1.0)
    assert estimate_pulse(waves, PARAMS).fwhm == pytest.approx(3.5, rel=0.01)


@pytest.mark.statistics
def test_a_digitiser_of_fewer_bits_than_its_samples_is_told():
    """12 bits stored in 16: clipped at 4095, and no flat top enters the pulse's shape."""
    waves, _ = mix(2000, (1.0,), amplitude=(200.0, 9000.0), noise=(3.0, 3.0), bits=16, saturation=65535.0, seed=8)
    clipped = replace(waves, samples=np.minimum(waves.samples, 4095))
    pulse = estimate_pulse(clipped, PARAMS)
    assert [c.clip for c in pulse.channels] == [4095.0] and pulse.channels[0].saturation == 65535.0
    assert pulse.shape == "gaussian" and abs(pulse.fwhm / 3.5 - 1.0) < 0.02
    whole = estimate_pulse(waves, PARAMS)
    assert [c.clip for c in whole.channels] == [65535.0]


def test_too_few_echoes_give_a_width_at_most():
    few, _ = mix(40, (1.0,), seed=9, amplitude=(100.0, 200.0), pulse=skewed(), widest=1.0)
    found = estimate_pulse(few, PARAMS)
    assert found.shape == "gaussian" and found.fwhm == pytest.approx(skewed().fwhm, rel=0.05)
    nothing, _ = noise_only(500, seed=10)
    found = estimate_pulse(nothing, PARAMS)
    assert (found.shape, found.fwhm, found.echoes) == ("gaussian", PARAMS.fallback_width, 0)
    # noise differs from 1 to 2 DN between waveforms
    assert 3 < found.channels[0].freedom < 60
    empty = estimate_pulse(rows_of(nothing, np.arange(0)), PARAMS)
    assert empty.to_json() == SystemPulse.gaussian(PARAMS.fallback_width).to_json()
    assert estimate_pulse(nothing, params_of(width=5.0)).fwhm == 5.0


def test_shape_and_width_can_be_given():
    waves, _ = survey_mix(2000, seed=11, pulse=ringing())
    forced = estimate_pulse(waves, params_of(shape="gaussian", width=3.6))
    assert (forced.shape, forced.fwhm) == ("gaussian", 3.6)
    given = estimate_pulse(waves, params_of(width=3.6))
    assert (given.shape, given.fwhm) == ("gaussian", 3.6), "a width is a width, whatever the echoes look like"
    with pytest.raises(ValueError, match="width of its own"):
        params_of(shape="measured", width=3.6)
    plain, _ = survey_mix(2000, seed=12)
    measured = estimate_pulse(plain, params_of(shape="measured"))
    assert measured.shape == "measured" and departure(measured, Pulse()) < 0.02


@pytest.mark.parametrize(
    "samples",
    [[], [7], [7] * 60, [255] * 60, [0] * 60, [0, 255] * 30, [0] * 30 + [255] * 30, list(range(60)), [0] * 29 + [250]],
)
def test_strange_waveforms_do_no_harm(samples):
    waves = waves_of([np.array(samples, np.uint8)] * 100)
    assert estimate_pulse(waves, PARAMS).fwhm > 0.0
    for spacing in (0.0, -1.0, np.nan, 1e-6, 1e6):
        assert estimate_pulse(waves_of([np.array(samples, np.uint8)] * 60, spacing=spacing), PARAMS).fwhm > 0.0


def test_random_samples_do_no_harm():
    rng = np.random.default_rng(13)
    waves = waves_of([rng.integers(0, 256, rng.integers(0, 200)).astype(np.uint8) for _ in range(800)])
    assert np.isfinite(estimate_pulse(waves, params_of(shape="measured")).fwhm)


def test_the_narrowest_width_is_the_edge_of_the_widths():
    rng = np.random.default_rng(14)
    error = 3.5 / np.exp(rng.uniform(np.log(30), np.log(130), 3000))
    for flat in (1.0, 0.5, 0.2):
        wide = 0.6 * rng.beta(1, 3, 3000) * (rng.random(3000) > flat)
        width = 3.5 * (1 + wide) + error * rng.normal(size=3000)
        assert narrowest(width, error) == pytest.approx(3.5, rel=5e-3), flat
    assert half_sample_mode(np.r_[np.linspace(0, 10, 11), 4.01, 4.02, 4.03]) == pytest.approx(4.015, abs=0.02)


def test_prior_of_the_variance_is_that_of_smyth():
    """Sample variances of 9 degrees of freedom, their true ones scaled inverse chi-square: F times the scale."""
    variance = 2.0 * fisher.rvs(9, 12, size=20000, random_state=15)
    scale, freedom = prior_variance(variance, np.full(20000, 9.0))
    assert scale == pytest.approx(2.0, rel=0.03)
    assert freedom == pytest.approx(12.0, rel=0.2)
    same = 2.0 * np.random.default_rng(16).chisquare(9, 20000) / 9
    assert prior_variance(same, np.full(20000, 9.0))[1] > 100


def test_weak_second_echoes_do_not_reach_the_mean_shape():
    """Every tenth waveform has something of 5 % of the height somewhere in the tail."""
    rng = np.random.default_rng(17)
    u = rng.uniform(-8, 30, (600, 40))
    shape = np.exp(-0.5 * (u / 3.5 * FWHM) ** 2)
    bump = 0.05 * np.exp(-0.5 * ((u - rng.uniform(6, 25, (600, 1))) / 1.5) ** 2) * (np.arange(600) % 10 == 0)[:, None]
    v = shape + bump + rng.normal(0, 0.01, u.shape)
    found = mean_shape(u.ravel(), v.ravel(), np.full(u.size, 0.01), 3.5, 28.0)
    value, _, _ = found.at(np.arange(6.0, 26.0), np.ones(1))
    assert np.abs(value).max() < 0.002
    assert found.fwhm == pytest.approx(3.5, rel=5e-3)


@pytest.mark.parametrize("phases", [1, 3, 40])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_steep_rise_and_a_cut_tail_are_no_outliers(phases, noise):
    # as a simulator's detector records them: (t / tau)^2 exp(-t / tau) that ends after 8 ns, at few phases
    tau, spacing, size = 8.0 / 7.0, 0.4, 200
    shift = spacing * (np.arange(size) % phases) / phases
    u = spacing * np.arange(-20, 60) + shift[:, None]
    t = u + 2.0 * tau
    pulse = np.where((t > 0.0) & (t < 8.0), (t / tau) ** 2 * np.exp(-t / tau), 0.0) / (4.0 * np.exp(-2.0))
    v = pulse + noise * np.random.default_rng(3).standard_normal(u.shape)
    shape = mean_shape(u.ravel(), v.ravel(), np.full(u.size, 1e-3), 3.8, 20.0)
    inside = (t > 0.5) & (t < 7.5)
    assert np.abs(np.interp(u, shape.time, shape.value, 0.0, 0.0) - pulse)[inside].max() < 0.04
    assert np.abs(np.interp(u, shape.time, shape.value, 0.0, 0.0) - pulse)[t < -0.5].max() < 0.02


def test_the_family_of_a_gaussian_is_gaussians():
    template = gaussian_template(3.5)
    u = np.linspace(-6, 6, 101)
    for size in (0.7, 1.0, 1.234, 1.7):
        value, slope, growth = template.at(u, np.full(1, size))
        exact = np.exp(-0.5 * (u / size / 3.5 * FWHM) ** 2)
        np.testing.assert_allclose(value, exact, atol=5e-4)  # straight lines, 45 steps to a FWHM at 0.7
        np.testing.assert_allclose(slope, -u * (FWHM / 3.5 / size) ** 2 * exact, atol=0.04)
        np.testing.assert_allclose(growth, (u * FWHM / 3.5 / size) ** 2 / size * exact, atol=0.04)


def test_describe():
    told = describe(SystemPulse.gaussian(3.5, shape_error=0.002))
    # from 10 to 90 % of a Gaussian: sqrt(2 ln 10) - sqrt(2 ln (10 / 9)) sigma
    rise = (np.sqrt(2 * np.log(10)) - np.sqrt(2 * np.log(10 / 9))) * 3.5 / FWHM
    assert told["rise_time"] == pytest.approx(rise, rel=1e-3)
    assert abs(told["skew"]) < 1e-9 and told["tail_share"] < 1e-3 and told["shape_error"] == 0.002
    time, value = skewed().values(0.02)
    told = describe(SystemPulse("measured", skewed().fwhm, float(time[0]), 0.02, value, echoes=7))
    # third moment of an exponential, 2 tail^3, over the sum of variances
    assert told["skew"] == pytest.approx(2 * 0.9**3 / ((3.5 / FWHM) ** 2 + 0.9**2) ** 1.5, rel=0.01)
    assert told["echoes"] == 7


def stored() -> dict:
    time, value = skewed().values(0.05)
    pulse = SystemPulse(
        "measured", 3.9, float(time[0]), 0.05, value, 0.01, 7, (Channel(1.0, 255.0, 10.0, 0.5, 1.2, 30.0, 255.0),)
    )
    return json.loads(json.dumps(pulse.to_json()))


def test_a_stored_pulse_comes_back():
    for one in (stored(), SystemPulse.gaussian(4.0).to_json()):
        assert SystemPulse.from_json(one).to_json() == one


@pytest.mark.parametrize(
    "change",
    [
        {"shape": "square"},
        {"fwhm": 0.0},
        {"fwhm": float("nan")},
        {"fwhm": "4"},
        {"fwhm": None},
        {"fwhm": True},
        {"step": 0.0},
        {"step": -1.0},
        {"first": float("inf")},
        {"first": 5.0},
        {"first": -1.0},
        {"values": []},
        {"values": "1"},
        {"values": [0.0] * 200_000},
        {"values": [0.0, 1.0, float("nan")] * 9},
        {"values": [0.5] * 500},
        {"values": [None] * 9},
        {"values": [10**400] * 9},
        {"values": [[0.0, 1.0]] * 9},
        {"echoes": -1},
        {"channels": [{}]},
        {"channels": [1]},
        {"channels": {}},
        {"channels": [None] * 1000},
        {"shape_error": 2.0},
        {"colour": "red"},
        {"shape": []},
    ],
    ids=lambda c: str(c)[:30],
)
def test_a_strangers_pulse_is_refused(change):
    with pytest.raises(InputError):
        SystemPulse.from_json({**stored(), **change}, "pulse.json")


def test_a_strangers_pulse_without_its_keys_is_refused():
    for one in ({}, [], None, {k: v for k, v in stored().items() if k != "step"}):
        with pytest.raises(InputError):
            SystemPulse.from_json(one)
