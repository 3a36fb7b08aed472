"""A receiver whose samples do not grow with the light, told by the widths of echoes of different heights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import wavemaker as wm

from fwclass import conf
from fwclass.decompose.params import PulseParams
from fwclass.decompose.pulse_channels import noise_drift
from fwclass.decompose.pulse_sample import join_samples, rows_of
from fwclass.decompose.system_pulse import disagree
from fwclass.decompose.width_walk import bright_widths, width_drift, width_walk
from fwclass.read.pls_read import index_pls, read_pls
from fwclass.read.pulsewaves import open_pls
from fwclass.report.pulse_remarks import pulse_remarks
from fwclass.waveforms import Waveforms


@pytest.fixture(scope="module")
def params() -> PulseParams:
    return conf.section("pulse", ())


def survey(seed: int = 1, n: int = 4000) -> Waveforms:
    return wm.survey_mix(n, seed=seed, samples=120, pulse=wm.Pulse(4.0))[0]


def expanded(waves: Waveforms) -> Waveforms:
    """Samples behind 80 DN three times as far apart; those that then pass 255 are of another channel."""
    y = waves.samples.astype(np.int64)
    y = np.where(y > 80, 80 + 3 * (y - 80), y).astype(np.uint16)
    bright = np.maximum.reduceat(y, waves.offsets[:-1]) > 255
    return replace(waves, samples=y, pulses=waves.pulses.with_columns({"saturation": np.where(bright, 65535.0, 255.0)}))


def told(waves: Waveforms, params: PulseParams) -> list[str]:
    return pulse_remarks([{"name": "s", "channels": [], "widths": width_walk(bright_widths(waves, params), params)}])


def test_a_linear_receiver_has_one_width(params: PulseParams) -> None:
    walk = width_walk(bright_widths(survey(), params), params)
    assert len(walk) >= 4 and [w for _, w in walk] == pytest.approx([4.0] * len(walk), rel=0.08)
    assert not told(survey(), params)


def test_expanded_samples_are_told_whatever_channel_they_are_of(params: PulseParams) -> None:
    waves = expanded(survey())
    walk = width_walk(bright_widths(waves, params), params)
    assert walk[0][1] == pytest.approx(4.0, rel=0.08) and disagree(walk[-1][1], walk[0][1])
    (line,) = told(waves, params)
    assert "do not grow in proportion to the light" in line
    order = np.random.default_rng(2).permutation(waves.pulses.rows)
    assert width_walk(bright_widths(rows_of(waves, order), params), params) == walk


@pytest.mark.parametrize(("bits", "wooded", "said"), [(8, False, False), (12, False, True), (8, True, False)])
def test_samples_of_more_bits_in_a_part_of_the_strip_are_told(bits: int, wooded: bool, said: bool) -> None:
    """Of 8 and 12 bits heights are 16 times apart, and fits are as good; plants make noise of no other number."""
    rng = np.random.default_rng(4)
    quiet = rng.normal(12.0, 1.0, (800, 80))
    if wooded:
        quiet[400:760, 10:60] += rng.uniform(10.0, 60.0, (360, 50))
    quiet[400:] *= 2.0 ** (bits - 8)
    drift = noise_drift(wm.waves_of(list(np.rint(quiet).astype(np.uint16)), saturation=65535.0))
    lines = pulse_remarks([{"name": "s", "channels": [], "noise_drift": drift}])
    assert [("gains or numbers of bits change along the strip" in line) for line in lines] == [True] * said


@pytest.mark.parametrize("last", [4.2, 6.0])
def test_a_pulse_that_widens_along_the_strip_is_told(params: PulseParams, last: float) -> None:
    parts = [
        wm.survey_mix(500, seed=k, samples=120, pulse=wm.Pulse(w))[0] for k, w in enumerate(np.linspace(4, last, 8))
    ]
    numbered = [
        replace(p, pulses=p.pulses.with_columns({"pulse": np.arange(500) + 500 * k})) for k, p in enumerate(parts)
    ]
    waves = join_samples(numbered)
    drift = width_drift(bright_widths(waves, params), params)
    assert len(drift) >= 4
    for number, width in drift:
        assert width == pytest.approx(4.0 + (last - 4.0) * number / 4000, rel=0.08)
    lines = pulse_remarks([{"name": "s", "channels": [], "widths": [], "drift": drift}])
    assert len(lines) == (last > 5.0) and all("change along the strip" in line for line in lines), lines
    walk = [(30.0, 5.0), (200.0, 4.0)]  # as where the wider pulse is the weaker one
    both = pulse_remarks([{"name": "s", "channels": [], "widths": walk, "drift": drift}])
    assert len(both) == 1 and ("in proportion" in both[0]) == (last <= 5.0), both
    order = np.random.default_rng(2).permutation(waves.pulses.rows)
    assert width_drift(bright_widths(rows_of(waves, order), params), params) == drift


def test_nothing_is_told_of_slopes_plants_and_few(params: PulseParams) -> None:
    rng = np.random.default_rng(4)
    height = rng.uniform(40.0, 200.0, (3000, 1))
    width = 4.0 * (1.0 + rng.uniform(0.0, 1.5, (3000, 1)) * np.sqrt(40.0 / height))  # brighter ones are flatter
    plants, _ = wm.simulate(height, np.full((3000, 1), 40.0), width / wm.FWHM, samples=120, pulse=wm.Pulse(4.0))
    assert not told(plants, params)
    assert width_walk(bright_widths(rows_of(survey(), np.arange(20)), params), params) == []
    assert width_walk(bright_widths(rows_of(survey(), np.arange(0)), params), params) == []
    assert width_drift(bright_widths(rows_of(survey(), np.arange(20)), params), params) == []
    steady = {"name": "s", "channels": [], "widths": [], "drift": width_drift(bright_widths(survey(), params), params)}
    assert steady["drift"] and not pulse_remarks([steady])


def test_the_geolas_sample_stores_bright_echoes_in_wider_numbers_and_expands_them(
    params: PulseParams, shared_data: Path
) -> None:
    source = open_pls(shared_data / "waveform" / "geolas_example2.pls")
    (waves,) = [read_pls(source, span) for span in index_pls(source, source.n_records)]
    walk = dict(width_walk(bright_widths(waves, params), params))
    assert max(walk.values()) == pytest.approx(4.11, abs=0.05) and min(walk.values()) == pytest.approx(2.97, abs=0.05)
    wide = np.maximum.reduceat(waves.samples, waves.offsets[:-1]) > 255
    assert np.array_equal(wide, waves.pulses["saturation"] > 255.0), "16 bits are those of pulses that pass 255 DN"
