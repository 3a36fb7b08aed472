"""Receivers that record every echo once more, later and lower: measured, told and taken off; scenes are left alone."""

from __future__ import annotations

from dataclasses import replace

import laspy
import numpy as np
import pytest
from defaults import BASE
from rawmaker import SIGMA, scene, write_parquet
from wavemaker import waves_of

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.copies import estimate_single_pulse, without_copies
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_sample import rows_of
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.errors import InputError
from fwclass.single_file.decompose import decompose_file

PULSES, SAMPLES, LEVEL = 1500, 120, 12.0
FIT = DecomposeParams(**BASE["decompose"])


def recorded(delay, share, highest=230.0, scatter=0.0, seed=3):
    """Waveforms of one to three echoes, each once more `delay` ns later; number of the pulse, time and height of
    every echo. With `scatter` the shares differ by it (of their logarithm), as two layers of a crop do."""
    rng = np.random.default_rng(seed)
    row, time = np.arange(PULSES), rng.uniform(25.0, 26.0, PULSES)
    height = np.exp(rng.uniform(np.log(20.0), np.log(highest), PULSES))
    more = rng.integers(0, PULSES, PULSES // 2)
    row, time = np.append(row, more), np.append(time, time[more] + 4.0 + rng.gamma(2.0, 8.0, len(more)))
    height = np.append(height, np.exp(rng.uniform(np.log(10.0), np.log(150.0), len(more))))
    shares = share * np.exp(scatter * rng.normal(size=len(row)))
    t, y = np.arange(SAMPLES), LEVEL + rng.normal(0.0, 0.7, (PULSES, SAMPLES))
    for i, at, a, s in zip(row, time, height, shares, strict=True):
        y[i] += a * (np.exp(-0.5 * ((t - at) / SIGMA) ** 2) + s * np.exp(-0.5 * ((t - at - delay) / SIGMA) ** 2))
    return np.rint(y).clip(0, 255).astype(np.uint16), row, time, height


def decomposed(tmp_path, samples, row, time, height, *settings):
    """Shares of false and of missing echoes (of 8 DN and more), what the channel tells of copies, and all words."""
    columns = scene(pulses=PULSES, n=SAMPLES).columns() | {"samples": list(samples)}
    told = {"crs": "EPSG:25832", "spacing_ns": "1", "saturation": "255"}
    path = write_parquet(tmp_path / "a.parquet", columns, told)
    words, judged = decompose_file(path, tmp_path / "a.laz", ("plausibility.accept=true", *settings), True)
    las = laspy.read(tmp_path / "a.laz")
    pulse = np.rint((np.asarray(las.gps_time) - 1000.0) / 1e-5).astype(int)
    at = np.asarray(las["echo time"])
    near = np.array([np.abs(at[pulse == i] - t).min(initial=np.inf) < 2.0 for i, t in zip(row, time, strict=True)])
    false = np.array([np.abs(time[row == i] - t).min() > 2.0 for i, t in zip(pulse, at, strict=True)])
    copies = judged["plausibility"]["channels"][0]["copies"]
    return false.sum() / PULSES, (~near & (height > 8.0)).mean(), copies, words


@pytest.mark.parametrize(
    ("delay", "share", "highest"),
    [(70.2, 0.08, 230.0), (20.3, 0.2, 230.0), pytest.param(45.6, 0.05, 2000.0, marks=pytest.mark.slow)],
)
def test_copies_are_told_and_make_no_echoes(tmp_path, delay, share, highest):
    hidden = decomposed(tmp_path, *recorded(delay, 0.0, highest))
    false, missing, copies, words = decomposed(tmp_path, *recorded(delay, share, highest))
    assert hidden[2] == [] and "once more" not in hidden[3]
    assert copies == [[pytest.approx(delay, abs=0.1), pytest.approx(share, rel=0.03)]]
    assert "recorded once more" in words
    assert false < hidden[0] + 0.004 and missing < hidden[1] + 0.004


def test_they_are_kept_where_samples_are_to_be_as_they_are(tmp_path):
    false, _, copies, words = decomposed(tmp_path, *recorded(70.2, 0.08), "decompose.recovery=keep")
    assert false > 0.5 and copies == [] and "ns behind the highest, 0.08" in words, "the case shows the fault"


@pytest.mark.parametrize("scatter", [pytest.param(0.2, marks=pytest.mark.slow), 0.4])
def test_layers_of_a_crop_are_the_scenes(tmp_path, scatter):
    assert decomposed(tmp_path, *recorded(40.0, 0.12, scatter=scatter))[2] == []


def test_every_waveform_is_corrected_alone():
    samples, *_ = recorded(45.6, 0.05, 2000.0)
    waves = waves_of(list(samples[:60].astype(np.uint8)))
    copies = tuple((lag, 0.01) for lag in range(43, 48))
    channel = Channel(1.0, 255.0, LEVEL, 0.1, 0.8, 10.0, 255.0, copies=copies)
    pulse = replace(SystemPulse.gaussian(4.0), channels=(channel,))
    assert channel_rows(pulse.channels, waves.pulses).max() == 0, "the channel is theirs"
    whole, doubt = without_copies(waves, pulse, FIT)
    assert (doubt > 0.0).any() and (whole.samples != waves.samples).any(), "some are saturated, and all are changed"
    for rows in (np.arange(17), np.arange(17, 60)):
        part, unsure = without_copies(rows_of(waves, rows), pulse, FIT)
        at = slice(waves.offsets[rows[0]], waves.offsets[rows[-1] + 1])
        np.testing.assert_array_equal(part.samples, whole.samples[at])
        np.testing.assert_array_equal(unsure if len(unsure) else np.zeros(len(part.samples)), doubt[at])


@pytest.mark.statistics
def test_the_order_of_the_waveforms_does_not_matter():
    samples, *_ = recorded(70.2, 0.08)
    waves, params = waves_of(list(samples.astype(np.uint8))), PulseParams(**BASE["pulse"])
    mixed = rows_of(waves, np.random.default_rng(1).permutation(PULSES))
    one, other = (estimate_single_pulse(w, params, FIT, None).channels[0].copies for w in (waves, mixed))
    assert one == other != ()
    surer = params.model_copy(update={"copies": params.copies.model_copy(update={"least": 0.3})})
    assert estimate_single_pulse(waves, surer, FIT, None).channels[0].copies == ()


def test_pulses_remember_them():
    channel = Channel(1.0, 255.0, 12.0, 0.1, 0.7, 10.0, 255.0, copies=((20, 0.04), (21, 0.04), (60, 0.1)))
    assert channel.copy_delays == [[20.5, pytest.approx(0.08)], [60.0, 0.1]]
    pulse = replace(SystemPulse.gaussian(4.0), channels=(channel,))
    assert SystemPulse.from_json(pulse.to_json()).channels == (channel,)
    for wrong in ("no", [[1]], [[0, 0.1]], [[5, 1.5]], [["a", 0.1]], [[5, "a"]]):
        plain = pulse.to_json()
        plain["channels"][0]["copies"] = wrong
        with pytest.raises(InputError, match="copies of another kind"):
            SystemPulse.from_json(plain)
