"""A pulse for every channel of a receiver, held against its outgoing pulses as they were recorded."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import wavemaker as wm

from fwclass import conf
from fwclass.decompose.fitting import Fits, fit_waveforms, pulses_of, signal_of
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_channels import channel_groups, clip_levels
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.pulse_sample import join_samples, outgoing_of, rows_of
from fwclass.decompose.quiet import quiet_noise
from fwclass.decompose.recorded_pulse import channel_pulses, recorded_pulse
from fwclass.decompose.system_pulse import SystemPulse, disagree
from fwclass.errors import InputError
from fwclass.waveforms import Waveforms


@pytest.fixture(scope="module")
def params() -> PulseParams:
    return conf.section("pulse", ())


@pytest.fixture(scope="module")
def fit() -> DecomposeParams:
    return conf.section("decompose", ())


def of_width(fwhm, n=3000, seed=1, saturation=255.0, **options) -> Waveforms:
    """Waveforms of a sensor whose pulse is a Gaussian of `fwhm` [ns]."""
    waves, _ = wm.survey_mix(n, seed=seed, samples=120, pulse=wm.Pulse(fwhm), **options)
    return replace(waves, pulses=waves.pulses.with_columns({"saturation": np.full(n, saturation)}))


def both(first: Waveforms, second: Waveforms) -> Waveforms:
    """The waveforms of two channels by turns."""
    turn = [p.with_columns({"pulse": 2 * p["pulse"] + k}) for k, p in enumerate((first.pulses, second.pulses))]
    return join_samples([replace(first, pulses=turn[0]), replace(second, pulses=turn[1])])


def sent(width, spacing=1.0, n=60, samples=60, saturation=255.0) -> Waveforms:
    """Outgoing pulses, Gaussians of `width` [ns] at a place of their own, on a level of 7 DN."""
    t = spacing * np.arange(samples)
    at = 0.5 * samples * spacing + np.random.default_rng(1).uniform(-0.5, 0.5, n)
    shape = [np.rint(7.0 + 150.0 * np.exp(-0.5 * ((t - a) * wm.FWHM / width) ** 2)).astype(np.uint8) for a in at]
    waves = wm.waves_of([np.full(20, 7, np.uint8)] * n, spacing=spacing, saturation=saturation)
    waves = replace(waves, outgoing=np.concatenate(shape), outgoing_offsets=samples * np.arange(n + 1))
    return outgoing_of(waves, np.arange(n))


@pytest.mark.parametrize(("width", "spacing"), [(4.1, 1.0), (6.5, 2.0), (2.0, 0.5)])
def test_recorded_pulses_tell_their_width(params, width, spacing):
    waves = sent(width, spacing)
    for n in (60, 12):
        assert recorded_pulse(rows_of(waves, np.arange(n)), params).fwhm == pytest.approx(width, rel=0.03)
    assert recorded_pulse(rows_of(waves, np.arange(3)), params) is None
    full = replace(waves, pulses=waves.pulses.with_columns({"saturation": np.full(60, 100.0)}))
    assert recorded_pulse(full, params) is None, "at the digitiser's limit"
    assert recorded_pulse(replace(waves, samples=np.full(len(waves.samples), 9, np.uint8)), params) is None
    assert recorded_pulse(rows_of(waves, np.arange(0)), params) is None


def test_another_width_than_recorded_is_told():
    assert not disagree(4.4, 4.59) and not disagree(4.0, None)
    assert disagree(2.05, 4.09) and disagree(7.6, 6.5) and disagree(27.6, 6.53)


@pytest.mark.statistics
@pytest.mark.parametrize(("widths", "sizes"), [((3.5, 6.0), (3000, 2000)), ((8.0, 4.0), (1500, 3000))])
def test_every_channel_has_its_own_pulse(params, widths, sizes):
    waves = both(of_width(widths[0], sizes[0]), of_width(widths[1], sizes[1], 2, 4095.0))
    pulse = estimate_pulse(waves, params)
    seen = {c.saturation: pulse.of(c) for c in pulse.channels}
    assert seen[255.0].fwhm == pytest.approx(widths[0], rel=0.02)
    assert seen[4095.0].fwhm == pytest.approx(widths[1], rel=0.02)
    assert min(own.echoes for own in seen.values()) >= params.min_echoes
    order = np.random.default_rng(3).permutation(waves.pulses.rows)
    assert estimate_pulse(rows_of(waves, order), params).to_json() == pulse.to_json()
    stored = json.loads(json.dumps(pulse.to_json()))
    assert SystemPulse.from_json(stored).to_json() == pulse.to_json()


@pytest.mark.statistics
def test_channels_are_fitted_as_if_each_were_alone(params, fit):
    waves = both(of_width(3.5, 1500), of_width(6.0, 1500, 2, 4095.0))
    pulse = estimate_pulse(waves, params)
    together = fit_waveforms(waves, fit, pulse)
    left = signal_of(together, waves, pulse, fit)
    kinds, channels, kind = pulses_of(waves, pulse)
    assert channels == [*(c for c in pulse.channels if c.freedom > 0.0), None]
    for saturation in (255.0, 4095.0):
        rows = np.flatnonzero(waves.pulses["saturation"] == saturation)
        (own,) = (pulse.of(c) for c in pulse.channels if c.saturation == saturation)
        assert {kinds[k].fwhm for k in np.unique(kind[rows])} == {own.fwhm}
        alone = rows_of(waves, rows)
        lone = replace(own, channels=tuple(replace(c, pulse=None) for c in pulse.channels))
        fits = fit_waveforms(alone, fit, lone)
        mine = np.isin(together.row, rows)
        for name in ("amplitude", "time", "width", "energy", "amplitude_sigma", "width_sigma", "flags"):
            np.testing.assert_array_equal(getattr(together, name)[mine], getattr(fits, name), err_msg=name)
        single: Fits = fits
        flat = np.isin(single.row, np.flatnonzero(single.count == 1)) & (single.amplitude > 60.0)
        assert np.quantile(single.width[flat], 0.1) == pytest.approx(own.fwhm, rel=0.05)
        at = np.concatenate([np.arange(waves.offsets[r], waves.offsets[r + 1]) for r in rows])
        np.testing.assert_array_equal(left[at], signal_of(fits, alone, lone, fit))


@pytest.mark.statistics
def test_channels_of_one_receiver_share_its_pulse(params):
    waves = both(of_width(4.5, 1500), of_width(4.5, 1000, 2, 4095.0))
    pulse = estimate_pulse(waves, params)
    assert len(pulse.channels) == 2 and not any(c.pulse for c in pulse.channels)
    few = both(of_width(4.5, 1500), of_width(9.0, 40, 2, 4095.0))
    assert not any(c.pulse for c in estimate_pulse(few, params).channels), "too few of its own"


def wide_targets(n, seed=4, least=2.0, most=5.0):
    """Echoes of forest or of large footprints: none as narrow as the pulse of 4 ns."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(least, most, (n, 1)) * 4.0 / wm.FWHM
    height, time = rng.uniform(60.0, 200.0, (n, 1)), rng.uniform(70.0, 72.0, (n, 1))
    return wm.simulate(height, time, size, noise=np.ones(n), samples=160, pulse=wm.Pulse(4.0), seed=seed)[0]


@pytest.mark.statistics
@pytest.mark.parametrize("n", [40, 61, 3000])
def test_where_echoes_share_no_width_the_recorded_pulse_is_taken(params, fit, n):
    waves, recorded = wide_targets(n), recorded_pulse(sent(4.1), params)
    assert disagree(estimate_pulse(waves, params).fwhm, recorded.fwhm)
    pulse = estimate_pulse(waves, params, recorded)
    assert pulse.fwhm == recorded.fwhm and pulse.outgoing == recorded.echoes and pulse.echoes == 0
    assert pulse.channels == estimate_pulse(waves, params).channels
    (told,) = channel_pulses(pulse, recorded, fit)
    assert told["outgoing"] == recorded.echoes and told["fwhm"] == told["recorded_fwhm"]
    given = params.model_copy(update={"width": 5.0})
    assert estimate_pulse(waves, given, recorded).outgoing == 0, "the user's width holds"


@pytest.mark.statistics
@pytest.mark.parametrize(("width", "widest"), [(4.1, 1.6), (5.2, 1.6), (3.0, 1.6), (8.2, 1.0)])
def test_echoes_that_share_a_width_are_believed(params, fit, width, widest):
    """A receiver other than the one that recorded the outgoing pulse: told, not overruled."""
    waves, recorded = of_width(width, 1500, widest=widest), recorded_pulse(sent(4.1), params)
    pulse = estimate_pulse(waves, params, recorded)
    assert pulse.to_json() == estimate_pulse(waves, params).to_json()
    (told,) = channel_pulses(pulse, recorded, fit)
    assert disagree(told["fwhm"], told["recorded_fwhm"]) == (width != 4.1)


def test_a_stored_pulse_of_a_channel_is_checked(params):
    stored = estimate_pulse(both(of_width(3.5, 1000), of_width(6.0, 1000, 2, 4095.0)), params).to_json()
    own = next(c for c in stored["channels"] if c["pulse"])
    for wrong in ({"channels": [own]}, {"fwhm": -1.0}, {"values": [2.0] * 9}):
        broken = {**stored, "channels": [{**own, "pulse": {**own["pulse"], **wrong}}]}
        with pytest.raises(InputError):
            SystemPulse.from_json(broken)
    for wrong in ("yes", [], {"fwhm": 3.0}):
        with pytest.raises(InputError):
            SystemPulse.from_json({**stored, "channels": [{**own, "pulse": wrong}]})


@pytest.mark.statistics
@pytest.mark.parametrize("swapped", [False, True])
def test_a_tone_is_told_of_the_channel_that_has_it(params: PulseParams, fit: DecomposeParams, swapped: bool) -> None:
    """The other one is correlated, and known less."""
    plain = of_width(3.5, noise=(1.0, 1.0))
    phase = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, 3000)
    tone = 3.0 * np.sin(2.0 * np.pi * np.arange(120) / 11.0 + phase[:, None])
    hum = replace(plain, samples=np.clip(np.rint(plain.samples + tone.ravel()), 0, 255).astype(np.uint8))
    other = of_width(3.5, saturation=250.0, seed=2, phi=(0.8,))
    waves = both(other, hum) if swapped else both(hum, other)
    noise = quiet_noise(waves, estimate_pulse(waves, params), fit)
    assert noise.period == 11 and noise.periodic > 0.5


@pytest.mark.parametrize("highest", [220.0, 1500.0])
def test_a_limit_far_below_the_range_is_known(highest):
    """Tables that name no limit have 16 bits of range: 8 bit samples that stop at 200 are clipped all the same."""
    rng = np.random.default_rng(5)
    height = np.exp(rng.uniform(np.log(20.0), np.log(highest), (3000, 1)))
    record = {"baseline": 12.0, "noise": np.ones(3000), "saturation": 65535.0, "bits": 16}
    waves, _ = wm.simulate(height, rng.uniform(25, 35, (3000, 1)), np.full((3000, 1), 1.7), seed=5, **record)
    clipped = replace(waves, samples=np.minimum(waves.samples, 200))
    kinds, group = channel_groups(waves)
    assert clip_levels(clipped, kinds, group).tolist() == [200.0]
    assert clip_levels(waves, kinds, group).tolist() == [65535.0]


def test_tops_of_broad_pulses_of_one_height_are_no_limit():
    """Without noise all of them have several samples of one value."""
    waves, _ = wm.fixed(500, (200.0,), width=40.0, first=100.0, samples=200, noise=0.0, saturation=65535.0, bits=16)
    kinds, group = channel_groups(waves)
    assert clip_levels(waves, kinds, group).tolist() == [65535.0]


@pytest.mark.statistics
@pytest.mark.parametrize(("step", "bits"), [(3, 8), pytest.param(4, 8, marks=pytest.mark.slow), (16, 12)])
def test_samples_in_coarse_steps_have_the_noise_of_their_rounding(step, bits):
    """Sound samples, stored coarsely, make few false echoes, and stated errors hold about; heights stay in DN."""
    top = 2.0**bits - 1.0
    size = step / 3 if bits == 8 else step
    height = np.exp(
        np.random.default_rng(6).uniform(np.log(20 * size), np.log(180 * size if bits == 12 else 230), 4000)
    )
    noise = 0.35 * step * np.ones(4000)
    time = np.random.default_rng(7).uniform(25, 35, (4000, 1))
    record = {"baseline": 12.0 * size, "noise": noise, "saturation": 65535.0, "bits": 16, "seed": 6}
    fine, truth = wm.simulate(height[:, None], time, np.full((4000, 1), 1.7), **record)
    waves = replace(fine, samples=(np.rint(np.minimum(fine.samples, top) / step) * step).astype(np.uint16))
    fit = conf.section("decompose", ())
    pulse = estimate_pulse(waves, conf.section("pulse", ()))
    (channel,) = pulse.channels
    assert channel.step == step and 0.25 * step < channel.noise < 0.6 * step
    assert SystemPulse.from_json(json.loads(json.dumps(pulse.to_json())), "x").channels == pulse.channels
    got = fit_waveforms(waves, fit, pulse)
    assert (len(got.row) - 4000) / 4000 < 0.008
    a, b = wm.match(truth, got, 2.0)
    assert len(a) == 4000
    assert abs(np.median(got.amplitude[b] / truth.amplitude[a]) - 1.0) < 0.003
    z = (got.amplitude[b] - truth.amplitude[a]) / got.amplitude_sigma[b]
    assert 0.9 < np.sqrt(np.median(z**2)) / 0.6745 < 1.25
    assert estimate_pulse(fine, conf.section("pulse", ())).channels[0].step == 1.0


def test_odd_waveforms_among_coarse_ones_are_fitted_as_they_are():
    waves, _ = wm.fixed(400, (100.0,), seed=9, noise=1.2)
    coarse = replace(waves, samples=waves.samples // 4 * 4)
    pulse = estimate_pulse(coarse, conf.section("pulse", ()))
    fit = conf.section("decompose", ())
    assert pulse.channels[0].step == 4.0
    mixed = replace(waves, samples=np.concatenate([coarse.samples[: 72 * 200], waves.samples[72 * 200 :]]))
    one, other = fit_waveforms(mixed, fit, pulse), fit_waveforms(coarse, fit, pulse)
    first = one.row < 200
    np.testing.assert_array_equal(one.amplitude[first], other.amplitude[other.row < 200])
    assert (one.count == 1).mean() > 0.97
    np.testing.assert_allclose(one.amplitude[~first], 100.0, atol=8.0)
