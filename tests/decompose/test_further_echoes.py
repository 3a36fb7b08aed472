"""How high a further echo of a waveform must be: the strip's own single echoes tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import wavemaker as wm

from fwclass import conf
from fwclass.decompose.fitting import fit_waveforms, further_share
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.quiet import with_correlated_noise
from fwclass.decompose.recorded_pulse import channel_pulses
from fwclass.decompose.signal_noise import with_misfit
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.errors import InputError
from fwclass.single_file.waveforms.text import further_words

HALF = 0.5 * wm.PULSE_WIDTH


@pytest.fixture(scope="module")
def fit() -> DecomposeParams:
    return conf.section("decompose", ())


def asked(waves, fit, shape=None) -> SystemPulse:
    pulse = estimate_pulse(waves, conf.section("pulse", () if shape is None else (f"pulse.shape={shape}",)))
    return with_misfit(pulse, waves, fit)


@pytest.mark.statistics
def test_where_single_echoes_leave_noise_alone_further_ones_are_found_lower(fit):
    """More true echoes, and no more false ones."""
    pulse = asked(wm.survey_mix(10_000, seed=31)[0], fit)
    (channel,) = pulse.channels
    assert 0.95 < channel.misfit < 1.1 and fit.further_detection <= further_share(channel, fit) < 0.95
    waves, truth = wm.survey_mix(40_000, seed=32)
    found, false = [], []
    for share in (1.0, fit.further_detection):
        got = fit_waveforms(waves, fit.model_copy(update={"further_detection": share}), pulse)
        hits = len(wm.match(truth, got, HALF)[0])
        found.append(hits / len(truth.row))
        false.append((len(got.row) - hits) / len(truth.count))
    assert found[1] > 0.969 and found[1] - found[0] > 0.002, found
    assert false[1] < false[0] + 5e-4, false


def test_where_noise_is_correlated_the_whole_threshold_holds(fit):
    """A strip's sample knows its likeness to echoes least: five of 900 echoes of flat ground had another below."""
    waves, _ = wm.survey_mix(4000, seed=37, phi=(0.5,))
    pulse = with_correlated_noise(estimate_pulse(waves, conf.section("pulse", ())), waves, fit)
    (channel,) = with_misfit(pulse, waves, fit).channels
    assert channel.phi and channel.misfit < 1.2 and further_share(channel, fit) == 1.0
    (line,) = further_words(channel_pulses(replace(pulse, channels=(channel,)), None, fit))
    assert "need 100% of the threshold" in line and line.endswith("and the noise is correlated")


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("kind", "shape"), [({"pulse": wm.skewed()}, "gaussian"), ({"growth": 0.15, "noise": (1.3, 1.3)}, None)]
)
def test_where_they_leave_more_the_whole_threshold_holds(fit, kind, shape):
    """A pulse of another shape, and noise that grows with the signal, leave what looks like echoes."""
    waves, _ = wm.survey_mix(4000, seed=33, **kind)
    pulse = asked(waves, fit, shape)
    (channel,) = pulse.channels
    assert channel.misfit > 1.3 and further_share(channel, fit) == 1.0
    plain = replace(pulse, channels=(replace(channel, misfit=None),))
    one, other = (fit_waveforms(waves, fit, p) for p in (pulse, plain))
    np.testing.assert_array_equal(one.time, other.time)


def test_too_few_bright_echoes_tell_nothing(fit):
    for waves, _ in (wm.survey_mix(150, seed=34), wm.noise_only(3000, seed=34)):
        assert all(c.misfit is None and further_share(c, fit) == 1.0 for c in asked(waves, fit).channels)


def test_the_order_of_the_waveforms_does_not_matter(fit):
    waves, _ = wm.survey_mix(3000, seed=35)
    mixed = wm.rows_of(waves, np.random.default_rng(1).permutation(3000))
    pulse = estimate_pulse(waves, PulseParams(**conf.section("pulse", ()).model_dump()))
    assert repr(with_misfit(pulse, waves, fit)) == repr(with_misfit(pulse, mixed, fit))  # arrays have no one answer


def test_it_is_stored_and_told(fit):
    pulse = asked(wm.survey_mix(3000, seed=36)[0], fit)
    assert SystemPulse.from_json(pulse.to_json()).channels == pulse.channels
    stored = pulse.to_json()
    stored["channels"][0]["misfit"] = -1.0
    with pytest.raises(InputError, match="misfit out of range"):
        SystemPulse.from_json(stored)
    told = channel_pulses(pulse, None, fit)
    assert told[0]["misfit"] == pulse.channels[0].misfit
    (line,) = further_words(told)
    assert line.startswith("further echoes of a waveform need 9") and "times the noise's variance" in line
    (line,) = further_words([{**told[0], "misfit": None, "further_detection": 1.0}])
    assert line == "further echoes of a waveform need 100% of the threshold; too few single ones are bright"


@pytest.mark.slow
@pytest.mark.statistics
def test_long_waveforms_have_no_more_false_further_echoes(fit):
    """More samples are more chances to look like an echo: a waveform ten times as long has no more false ones."""
    rates = []
    for samples in (160, 1600):
        waves, truth = wm.fixed(8000, [100.0], samples=samples, seed=38, noise=1.0)
        pulse = asked(waves, fit)
        assert further_share(pulse.channels[0], fit) < 0.95
        got = fit_waveforms(waves, fit, pulse)
        rates.append((len(got.row) - len(truth.row)) / len(truth.count))
    assert rates[1] < 2.5 * max(rates[0], 1e-3), rates
