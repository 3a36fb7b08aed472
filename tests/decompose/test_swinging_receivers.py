"""A receiver that passes a band alone swings below its level behind every echo, and below what its digitiser can
record: neither makes echoes."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass
from defaults import BASE
from rawmaker import scene, write_parquet
from wavemaker import FWHM, rows_of, waves_of

from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.floor import at_floor, floor_doubt
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.recovery import recovered

PULSE, FIT = PulseParams(**BASE["pulse"]), DecomposeParams(**BASE["decompose"])
FINE, SAMPLES = 0.05, 110
TIME = np.arange(-40.0, 140.0, FINE)


def high_passed(tau: float) -> np.ndarray:
    """A Gaussian of 4 ns behind a high pass of one pole, of unit peak at time 0, every `FINE` ns of `TIME`."""
    answer, low = np.exp(-0.5 * (TIME / 4.0 * FWHM) ** 2), 0.0
    for i, v in enumerate(answer):
        low += (v - low) * FINE / tau
        answer[i] = v - low
    return np.roll(answer / answer.max(), -int(answer.argmax() - np.argmin(np.abs(TIME))))


def recorded(tau: float, level: float, n: int = 1200, seed: int = 1):
    """Waveforms of one to three echoes, and row and time of every echo."""
    rng, shape = np.random.default_rng(seed), high_passed(tau)
    row = np.sort(np.r_[np.arange(n), rng.choice(n, n // 4)])
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    time = rng.uniform(24.0, 26.0, n)[row] + rank * rng.uniform(8.0, 20.0, len(row))
    y = level + rng.normal(0.0, 1.0, (n, SAMPLES))
    for i, t in zip(row, time, strict=True):
        y[i] += np.exp(rng.uniform(np.log(10.0), np.log(170.0))) * np.interp(np.arange(SAMPLES) - t, TIME, shape)
    return waves_of(list(np.clip(np.rint(y), 0, 255).astype(np.uint8))), row, time


@pytest.mark.statistics
@pytest.mark.parametrize(("tau", "level"), [(6.0, 80.0), pytest.param(6.0, 30.0, marks=pytest.mark.slow), (15.0, 20.0)])
def test_swinging_below_the_level_makes_no_echoes_and_hides_none(tau: float, level: float) -> None:
    waves, row, time = recorded(tau, level)
    pulse = estimate_pulse(waves, PULSE)
    assert pulse.shape == "measured" and abs(pulse.channels[0].noise - 1.04) < 0.03
    assert np.abs(pulse.at(TIME) - high_passed(tau))[(TIME > -8.0) & (TIME < 30.0)].max() < 0.02
    assert (at_floor(waves, pulse).mean() > 1e-3) == (level < 80.0)
    same, doubt = recovered(waves, FIT, pulse)
    fits = fit_waveforms(same, FIT, pulse, doubt)
    nearest = np.array(
        [np.abs(fits.time[fits.row == i] - t).min(initial=np.inf) for i, t in zip(row, time, strict=True)]
    )
    seen = (nearest < 2.0).sum()
    assert seen >= 0.995 * len(row) and len(fits.row) - seen <= 0.004 * len(row), (seen, len(fits.row), len(row))


def test_every_waveform_is_fitted_alone() -> None:
    waves, *_ = recorded(6.0, 30.0, 300)
    pulse = estimate_pulse(waves, PULSE)
    together = fit_waveforms(waves, FIT, pulse, floor_doubt(waves, pulse))
    floored = np.array(
        [(waves.samples[a:b] == 0).any() for a, b in zip(waves.offsets, waves.offsets[1:], strict=False)]
    )
    assert 0.1 < floored.mean() < 0.9
    for rows in (np.flatnonzero(~floored), np.flatnonzero(floored)):
        some = rows_of(waves, rows)
        alone = fit_waveforms(some, FIT, pulse, floor_doubt(some, pulse))
        mine = np.isin(together.row, rows)
        for name in ("amplitude", "time", "width", "time_sigma", "flags"):
            np.testing.assert_array_equal(getattr(together, name)[mine], getattr(alone, name), err_msg=name)


def test_a_level_that_lies_at_0_has_no_floor() -> None:
    rng = np.random.default_rng(3)
    waves = waves_of(list(np.clip(np.rint(3.0 + rng.normal(0.0, 1.0, (200, 60))), 0, 255).astype(np.uint8)))
    pulse = estimate_pulse(waves, PULSE)
    assert (waves.samples == 0).any() and not at_floor(waves, pulse).any() and len(floor_doubt(waves, pulse)) == 0


def test_a_file_of_it_has_its_echoes(tmp_path: Path) -> None:
    waves, row, _ = recorded(6.0, 30.0)
    columns = scene(pulses=1200, n=SAMPLES).columns() | {"samples": list(waves.samples.reshape(-1, SAMPLES))}
    write_parquet(tmp_path / "a.parquet", columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    ended = fwclass("decompose", tmp_path / "a.parquet", tmp_path / "a.laz")
    assert ended.returncode == 0 and "another one" not in ended.stderr, ended.stderr
    assert abs(laspy.open(tmp_path / "a.laz").header.point_count - len(row)) < 0.01 * len(row)
