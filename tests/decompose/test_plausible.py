"""The pieces of plausibility: envelope of the returns, noise of quiet samples, order of the echoes of a pulse."""

from __future__ import annotations

import numpy as np
import pytest
from lasmaker import correlated, digitise
from wavemaker import survey_mix, waves_of

from fwclass.decompose.envelope import Envelope
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.plausible import renumber
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.quiet import quiet_noise, with_correlated_noise
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.schema import Table
from fwclass.waveforms import IMPLAUSIBLE


@pytest.fixture(scope="module")
def params(base):
    return DecomposeParams(**base["decompose"])


@pytest.mark.parametrize("cut", [1, 7])
@pytest.mark.parametrize("offset", [0.0, -5e6])
def test_the_envelope_is_the_lowest_return_of_nine_cells_however_the_strip_is_cut(cut, offset):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(offset, offset + 200.0, 500), rng.uniform(-100.0, 100.0, 500)
    z = rng.uniform(10.0, 50.0, 500)
    parts = [Table({"x": x[k::cut], "y": y[k::cut], "z": z[k::cut]}) for k in range(cut)]
    envelope = Envelope.of(parts, 25.0)
    at_x, at_y = rng.uniform(offset, offset + 200.0, 50), rng.uniform(-100.0, 100.0, 50)
    near = [
        (np.abs(np.floor(x / 25.0) - np.floor(a / 25.0)) <= 1) & (np.abs(np.floor(y / 25.0) - np.floor(b / 25.0)) <= 1)
        for a, b in zip(at_x, at_y, strict=True)
    ]
    np.testing.assert_array_equal(envelope.below(at_x, at_y), [z[n].min() for n in near])
    assert (envelope.bottom, envelope.top) == (z.min(), z.max())
    assert envelope.below(np.array([offset + 9e5]), np.array([0.0]))[0] == z.min(), "far from all returns: the lowest"


def test_a_strip_without_returns_has_no_envelope():
    envelope = Envelope.of([Table.empty("xyz")], 25.0)
    assert np.isnan(envelope.below(np.zeros(3), np.zeros(3))).all()


@pytest.mark.parametrize(("lag1", "least", "most"), [(0.0, 1.0, 1.1), (0.6, 1.5, 2.3)])
def test_the_noise_is_measured_where_no_echo_reaches(params, lag1, least, most):
    samples = [digitise(20.0 + 3.0 * row) for row in correlated(400, 200, lag1)]
    for k in range(0, 400, 2):  # every second waveform has an echo of 100 DN with a tail
        samples[k][80:120] += (100.0 * np.exp(-np.arange(40) / 6.0)).astype(np.uint8)
    waves, channel = waves_of(samples), Channel(1.0, 255.0, 20.0, 0.1, 3.0, 1000.0, 255.0)
    pulse = SystemPulse("gaussian", 4.0, channels=(channel,))
    found = quiet_noise(waves, pulse, params)
    assert abs(found.lag1 - lag1) < 0.05 and least <= found.inflation <= most and found.order == 0
    assert found.samples < 200 * 200 + 200 * 160
    known = with_correlated_noise(pulse, waves, params)
    left = quiet_noise(waves, known, params)
    assert abs(left.lag1 - lag1) < 0.05 and left.inflation < 1.1 and left.order == len(known.channels[0].phi)


def test_white_noise_in_short_records_is_not_taken_for_correlated(base, params):
    waves, _ = survey_mix(3000, seed=5)
    found = quiet_noise(waves, estimate_pulse(waves, PulseParams(**base["pulse"])), params)
    assert abs(found.lag1) < 0.1


def test_waveforms_without_noise_have_none_however_their_pulses_end(params):
    """What the flanks leave, rounded, correlates: it was taken for a receiver's noise."""
    rng, t = np.random.default_rng(1), np.arange(80)
    shape = np.exp(-0.5 * ((t - 20.0) / 1.75) ** 2)
    samples = [np.full(160, 16, np.uint8) for _ in range(300)]
    for one in samples:
        one[60:140] += np.rint(rng.uniform(20.0, 200.0) * shape).astype(np.uint8)
    waves, channel = waves_of(samples), Channel(1.0, 255.0, 16.0, 0.0, 0.2887, 1000.0, 255.0)
    pulse = SystemPulse("gaussian", 4.12, channels=(channel,))
    known = with_correlated_noise(pulse, waves, params)
    noise = quiet_noise(waves, known, params)
    assert known == pulse
    assert noise.lag1 is None and noise.inflation == 1.0 and noise.still >= 0.98
    noisy = waves_of([s + np.rint(rng.normal(0.0, 0.5, 160) + 0.3).astype(np.int8).astype(np.uint8) for s in samples])
    assert quiet_noise(noisy, pulse, params).still < 0.9


def test_nothing_is_said_of_too_few_samples(params):
    pulse = SystemPulse("gaussian", 4.0, channels=(Channel(1.0, 255.0, 10.0, 0.1, 0.5, 20.0, 255.0),))
    assert quiet_noise(waves_of([np.full(30, 10, np.uint8)] * 3), pulse, params).lag1 is None
    assert quiet_noise(waves_of([]), pulse, params).inflation == 1.0


def test_plausible_echoes_are_numbered_first():
    pulse = np.array([4, 4, 4, 7, 9, 9])
    echoes = {
        "pulse": pulse,
        "echo_number": np.array([1, 2, 3, 1, 1, 2]),
        "number_of_echoes": np.array([3, 3, 3, 1, 2, 2]),
        "fit_flags": np.full(6, 2, np.uint8),
        "source_class": np.full(6, 5),
        "z": np.arange(6.0),
    }
    made = renumber(echoes, np.array([True, False, False, False, True, True]))
    np.testing.assert_array_equal(made["z"], [1.0, 2.0, 0.0, 3.0, 4.0, 5.0])
    np.testing.assert_array_equal(made["echo_number"], [1, 2, 3, 1, 1, 2])
    np.testing.assert_array_equal(made["number_of_echoes"], [2, 2, 3, 1, 2, 2])
    np.testing.assert_array_equal(made["fit_flags"] & IMPLAUSIBLE > 0, [False, False, True, False, True, True])
    np.testing.assert_array_equal(made["source_class"], [5, 5, 0, 5, 0, 0])
