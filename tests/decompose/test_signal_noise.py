"""Growth of the noise and the pulse's shape error are what a fit that weighs by them shows: neither the start nor how
often it is asked matters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import wavemaker as wm
from commandline import fwclass
from scipy.stats import chi2

from fwclass.decompose import signal_noise
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.pulse_sample import join_samples
from fwclass.decompose.quiet import with_correlated_noise
from fwclass.decompose.signal_noise import OUTLIER, SETTLED, _Bright, _shares, with_signal_noise
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span
from fwclass.waveforms import Waveforms

NEAR = 4.0 * SETTLED
"""What two starts may differ by: a fit shows up to 0.65 of a change again, so that three times a step may be left."""


@pytest.fixture(scope="module")
def params(base) -> DecomposeParams:
    return DecomposeParams(**base["decompose"])


def correlated(waves: Waveforms, base: dict, params: DecomposeParams) -> SystemPulse:
    return with_correlated_noise(estimate_pulse(waves, PulseParams(**base["pulse"])), waves, params)


def started(pulse: SystemPulse, error: float) -> SystemPulse:
    own = [replace(c, pulse=c.pulse and replace(c.pulse, shape_error=error)) for c in pulse.channels]
    return replace(pulse, channels=tuple(own), shape_error=error)


def growth_and_shape(pulse: SystemPulse) -> np.ndarray:
    return np.array([[c.growth, pulse.of(c).shape_error] for c in pulse.channels])


def assert_settled(pulse: SystemPulse, waves: Waveforms, params: DecomposeParams, most: float) -> None:
    first, unsettled = with_signal_noise(pulse, waves, params)
    assert unsettled == 0.0
    assert growth_and_shape(first)[:, 1].max() <= most
    for start in (first, started(pulse, 0.0), started(pulse, 0.08)):
        assert growth_and_shape(with_signal_noise(start, waves, params)[0]) == pytest.approx(
            growth_and_shape(first), rel=NEAR, abs=2e-4
        )


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("noise", "most"),
    [
        ({"phi": (0.5,)}, 0.002),
        pytest.param({"phi": (0.5,), "pulse": wm.skewed()}, 0.02, marks=pytest.mark.slow),
        pytest.param({"growth": 0.15}, 0.002, marks=pytest.mark.slow),
    ],
)
def test_what_a_simulated_strip_shows_is_what_its_own_fit_shows(base, params, noise, most) -> None:
    """Pairs too close to be told are no error of the shape."""
    waves, _ = wm.survey_mix(9000, seed=2, **noise)
    assert_settled(correlated(waves, base, params), waves, params, most)


@pytest.mark.slow
@pytest.mark.statistics
def test_pairs_that_nothing_tells_apart_settle(base, params) -> None:
    waves, _ = wm.mix(20_000, (0.3, 0.7), gap=(1.0, 4.0), amplitude=(20, 200), seed=5, phi=(0.5,))
    assert_settled(correlated(waves, base, params), waves, params, 0.05)


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("leica_2ns.laz", 0.06),
        ("riegl_q680i.las", 0.02),
        pytest.param("geolas_example2.pls", 0.12, marks=pytest.mark.slow),
    ],
)
def test_what_a_real_strip_shows_is_what_its_own_fit_shows(base, params, shared_data: Path, name, most) -> None:
    """Echoes of one height tell noise, its growth and the shape apart only by the samples beside them."""
    source, read = open_source(shared_data / "waveform" / name), ReadParams(**base["read"])
    waves = join_samples([read_span(source, span, read) for span in index_source(source, read)])
    assert_settled(correlated(waves, base, params), waves, params, most)


@pytest.mark.statistics
def test_what_has_not_settled_is_told_and_ends_with_4(tmp_path: Path, shared_data: Path, monkeypatch) -> None:
    """One fit of the Leica's, which weighs by noise and shape as they are known before."""
    line = ("decompose", shared_data / "waveform/leica_2ns.laz", tmp_path / "a.laz", "--overwrite")
    bound = "plausibility.max_unsettled"
    assert "did not settle" not in fwclass(*line).stderr
    monkeypatch.setattr(signal_noise, "ROUNDS", 1)
    for most, code in ((0.5, 0), (0.4, 4)):
        ended = fwclass(*line, "--set", f"{bound}={most}")
        assert ended.returncode == code and "did not settle" in ended.stderr, ended.stderr
        assert ("the noise under bright echoes does not settle" in ended.stderr) == (code == 4)


def test_shares_are_found_under_echoes_of_one_height_and_beside_them() -> None:
    """A tenth of the echoes hides another one."""
    rng, n = np.random.default_rng(3), 4000
    freedom = np.repeat([6.0, 40.0], n)
    by = np.stack([np.repeat([900.0, 0.0], n), np.ones(2 * n)], axis=1)
    left = (by @ [0.03**2, 1.2]) * rng.chisquare(freedom) / freedom
    left[: n // 10] *= 30.0
    (square, noise), error = _shares(_Bright(by, left, freedom, 1.0), 0)
    assert noise == pytest.approx(1.2, abs=0.02)
    assert 0.03 < square**0.5 < 0.035 and 0.0 < error < 0.1 * square


def test_what_is_cut_off_is_made_good() -> None:
    """Whatever the degrees of freedom: under echoes there are few of them, beside them many."""
    rng = np.random.default_rng(4)
    for freedom in (2.0, 5.0, 30.0):
        left = rng.chisquare(freedom, 50_000) / freedom
        assert (left > OUTLIER).mean() == pytest.approx(chi2.sf(OUTLIER * freedom, freedom), abs=0.003)
        one = np.ones((len(left), 1))
        both, error = _shares(_Bright(one, left, np.full(len(left), freedom), 1.0), 0)
        assert abs(both[0] - 1.0) < 4.0 * error + 0.002
