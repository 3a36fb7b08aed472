"""A receiver that swings below its level behind saturated samples: measured, taken off and told."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from defaults import BASE
from wavemaker import FWHM, rows_of, waves_of

from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.quiet import with_correlated_noise
from fwclass.decompose.recorded_pulse import channel_pulses
from fwclass.decompose.recovery import recovered, with_recovery
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.report.pulse_remarks import pulse_remarks

PULSE, FIT = PulseParams(**BASE["pulse"]), DecomposeParams(**BASE["decompose"])
LEVEL, LIMIT, WIDTH, SAMPLES = 25.0, 230, 4.0, 120


def recorded(depth, time, n=2500, seed=0, delay=0.0, step=1):
    """Waveforms of one or two echoes, and row, time and height of these. Behind every stretch above the limit, by
    `delay` [ns], the level is lower, by `depth` [DN] for every factor of e that the echo is too high."""
    rng, sigma = np.random.default_rng(seed), WIDTH / FWHM
    two = rng.random(n) < 0.4
    first = rng.uniform(25.0, 35.0, n)
    row = np.concatenate([np.arange(n), np.flatnonzero(two)])
    at = np.concatenate([first, (first + rng.uniform(14.0, 45.0, n))[two]])
    height = np.exp(rng.uniform(np.log(20.0), np.log(1500.0), len(row)))
    t, y = np.arange(SAMPLES), LEVEL + rng.normal(0.0, 1.0, (n, SAMPLES))
    for i, t0, a in zip(row, at, height, strict=True):
        y[i] += a * np.exp(-0.5 * ((t - t0) / sigma) ** 2)
        if a > LIMIT - LEVEL:
            over = np.log(a / (LIMIT - LEVEL))
            end = t0 + sigma * np.sqrt(2.0 * over) + delay
            y[i] -= depth * over * np.where(t > end, np.exp(-(t - end) / time), 0.0)
    counts = step * np.clip(np.rint(y / step), 0, LIMIT // step)
    return waves_of(list(counts.astype(np.uint8))), row, at, height


def measured(waves):
    pulse = with_recovery(estimate_pulse(waves, PULSE), waves, FIT)
    return with_correlated_noise(pulse, recovered(waves, FIT, pulse)[0], FIT)


@cache
def swung(step=1):
    """Waveforms of a receiver that swings, its pulse without and with what was measured of that."""
    waves, *_ = recorded(12.0, 20.0, n=600, step=step)
    plain = estimate_pulse(waves, PULSE)
    return waves, plain, with_recovery(plain, waves, FIT)


def shares(waves, pulse, row, at, height):
    """(strong echoes missing, false ones), as shares."""
    level, doubt = recovered(waves, FIT, pulse)
    fits = fit_waveforms(level, FIT, pulse, doubt)
    near = np.array(
        [np.abs(fits.time[fits.row == i] - t).min(initial=np.inf) < 2.5 for i, t in zip(row, at, strict=True)]
    )
    return (~near & (height > 8.0)).mean(), (len(fits.row) - near.sum()) / len(fits.row)


@pytest.mark.statistics
@pytest.mark.parametrize("delay", [pytest.param(0.0, marks=pytest.mark.slow), 1.5])
def test_the_recovery_makes_no_echoes_and_hides_none(delay):
    waves, *truth = recorded(20.0, 15.0, delay=delay)
    pulse = measured(waves)
    (channel,) = pulse.channels
    assert channel.recovery == pytest.approx(15.0, rel=0.2) and channel.recovery_depth > 10.0
    missing, wrong = shares(waves, pulse, *truth)
    assert missing < 0.004 and wrong < 0.006
    plain = estimate_pulse(waves, PULSE)
    assert shares(waves, with_correlated_noise(plain, waves, FIT), *truth)[1] > 0.03, "the case shows the fault"


def test_where_nothing_swings_nothing_is_changed():
    waves, *_ = recorded(0.0, 15.0, n=1200)
    pulse = with_recovery(estimate_pulse(waves, PULSE), waves, FIT)
    assert pulse.channels[0].recovery == 0.0
    assert recovered(waves, FIT, pulse)[0] is waves
    assert pulse_remarks([{"name": "s", "channels": channel_pulses(pulse, None, FIT), "widths": []}]) == []


def test_a_few_saturated_waveforms_tell_nothing():
    waves, *_ = recorded(20.0, 15.0, n=1200)
    full = (
        np.array([waves.samples[a:b].max() for a, b in zip(waves.offsets[:-1], waves.offsets[1:], strict=True)])
        >= LIMIT
    )
    some = rows_of(waves, np.flatnonzero(~full | (np.cumsum(full) <= 15)))
    assert with_recovery(estimate_pulse(some, PULSE), some, FIT).channels[0].recovery == 0.0


@pytest.mark.statistics
def test_samples_are_kept_where_they_are_to_be() -> None:
    waves, plain, pulse = swung()
    assert plain.channels[0].recovery == 0.0 < pulse.channels[0].recovery
    assert with_recovery(plain, waves, FIT.model_copy(update={"recovery": "keep"})) == plain


@pytest.mark.statistics
def test_no_receiver_swings_further_than_its_range() -> None:
    """A dip of another shape, right behind: a fast recovery from thousands of DN below the level would explain it."""
    waves, *_ = recorded(2000.0, 2.0, n=600)
    assert with_recovery(estimate_pulse(waves, PULSE), waves, FIT).channels[0].recovery == 0.0


@pytest.mark.statistics
@pytest.mark.parametrize("step", [1, 2])
def test_every_waveform_is_corrected_alone(step):
    waves, _, pulse = swung(step)
    assert pulse.channels[0].recovery > 0.0 and pulse.channels[0].step == step
    whole, doubt = recovered(waves, FIT, pulse)
    chosen = np.arange(599, -1, -3)
    part, own = recovered(rows_of(waves, chosen), FIT, pulse)
    for k, i in enumerate(chosen):
        here, there = slice(*part.offsets[k : k + 2]), slice(*whole.offsets[i : i + 2])
        np.testing.assert_array_equal(part.samples[here], whole.samples[there])
        np.testing.assert_array_equal(own[here], doubt[there])
    assert not (whole.samples % step).any()


def test_it_is_stored_and_told():
    _, _, pulse = swung()
    again = SystemPulse.from_json(json.loads(json.dumps(pulse.to_json())))
    assert again.channels == pulse.channels
    (line,) = pulse_remarks([{"name": "s", "channels": channel_pulses(pulse, None, FIT), "widths": []}])
    channel = pulse.channels[0]
    assert f"{channel.recovery_depth:.3g} DN below" in line and f"{channel.recovery:.0f} ns" in line
    bare = replace(pulse, channels=(replace(channel, recovery=0.0),))
    assert pulse_remarks([{"name": "s", "channels": channel_pulses(bare, None, FIT), "widths": []}]) == []
