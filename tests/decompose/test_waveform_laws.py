"""Laws of the public function `fit_waveforms`: what must hold whatever the algorithm."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import wavemaker as wm

from fwclass.decompose.fitting import Fits, fit_waveforms, model_of
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.waveforms import Waveforms

PULSE = SystemPulse.gaussian(wm.PULSE_WIDTH)
FLAT = tuple(f.name for f in fields(Fits) if f.name not in ("count", "baseline", "noise", "misfit"))
PER_ROW = ("count", "baseline", "noise", "misfit")


@pytest.fixture(scope="module")
def params(base):
    return DecomposeParams(**{**base["decompose"], "tail_share": 0.0})


def records(n=600, seed=51, **options):
    """16 bit waveforms of 1 to 4 clear echoes, well inside the record, as (n, samples)."""
    waves, truth = wm.mix(
        n,
        (1, 1, 1, 1),
        amplitude=(60, 400),
        gap=(8, 14),
        noise=(1.5, 1.5),
        bits=16,
        samples=90,
        baseline=40.0,
        seed=seed,
        **options,
    )
    return waves.samples.reshape(n, -1), truth


def fitted(samples, params, pulse=PULSE, **options) -> Fits:
    return fit_waveforms(wm.waves_of(samples, **{"saturation": 65535.0, **options}), params, pulse)


def same_echoes(a: Fits, b: Fits, least=0.995):
    """Rows with as many echoes in both (nearly all), and masks of their echoes."""
    rows = a.count == b.count
    assert rows.mean() >= least, rows.mean()
    return rows[a.row], rows[b.row]


def close(value, expected, sigma, share=0.1):
    """Within a `share` of the standard error, for all but 1 in 200 (which may end in another minimum).

    The fit ends when a step gains less than 1e-3 of chi-square: within a few hundredths of a standard error.
    """
    off = np.abs(value - expected) > share * sigma
    assert off.mean() <= 0.005, (off.mean(), np.abs(value - expected).max())


@pytest.mark.parametrize("shift", [1, 7, -4])
def test_shift_by_samples(params, shift):
    samples, _ = records()
    a, b = fitted(samples, params), fitted(np.roll(samples, shift, axis=1), params)
    u, v = same_echoes(a, b)
    close(b.time[v], a.time[u] + shift, a.time_sigma[u])
    for name in ("amplitude", "width"):
        close(getattr(b, name)[v], getattr(a, name)[u], getattr(a, f"{name}_sigma")[u])
    close(b.baseline, a.baseline, 0.2)


@pytest.mark.parametrize("factor", [2, 16])
def test_scale(params, factor):
    """Heights, areas, levels, noise and their errors scale; times, widths and goodness of fit do not."""
    samples, _ = records()
    a, b = fitted(samples, params), fitted(samples * np.uint16(factor), params)
    u, v = same_echoes(a, b)
    close(b.amplitude[v], factor * a.amplitude[u], factor * a.amplitude_sigma[u])
    close(b.time[v], a.time[u], a.time_sigma[u])
    close(b.width[v], a.width[u], a.width_sigma[u])
    np.testing.assert_allclose(np.median(b.energy[v] / a.energy[u]), factor, rtol=1e-4)
    np.testing.assert_allclose(np.median(b.amplitude_sigma[v] / a.amplitude_sigma[u]), factor, rtol=0.01)
    np.testing.assert_allclose(np.median(b.time_sigma[v] / a.time_sigma[u]), 1.0, rtol=0.01)
    np.testing.assert_allclose(np.median(b.noise / a.noise), factor, rtol=0.01)
    np.testing.assert_allclose(np.median(b.misfit / a.misfit), 1.0, rtol=0.02)


@pytest.mark.parametrize("raised", [1, 500, 20_000])
def test_baseline(params, raised):
    samples, _ = records()
    a, b = fitted(samples, params), fitted(samples + np.uint16(raised), params)
    u, v = same_echoes(a, b)
    close(b.baseline, a.baseline + raised, 0.2)
    for name in ("amplitude", "time", "width"):
        close(getattr(b, name)[v], getattr(a, name)[u], getattr(a, f"{name}_sigma")[u])
    np.testing.assert_allclose(b.noise, a.noise, rtol=0.02)


def test_reversed_order_of_samples(params):
    """Time runs backwards: the Gaussian pulse is symmetric, so are its fits. Echoes come in reversed order."""
    samples, _ = records()
    a, b = fitted(samples, params), fitted(np.ascontiguousarray(samples[:, ::-1]), params)
    u, v = same_echoes(a, b)
    order = np.lexsort((-b.time[v], b.row[v]))
    for name in ("amplitude", "width"):
        close(getattr(b, name)[v][order], getattr(a, name)[u], getattr(a, f"{name}_sigma")[u])
    close(samples.shape[1] - 1 - b.time[v][order], a.time[u], a.time_sigma[u])


def test_energy_adds_up(params):
    """The areas of a waveform's echoes are the area of its samples above the level; and of the sum of two waveforms
    whose echoes lie apart, the sum of both."""
    samples, truth = records()
    fits = fitted(samples, params)
    total = np.bincount(fits.row, fits.energy, minlength=len(samples))
    above = (samples - fits.baseline[:, None]).sum(axis=1)
    # a level free to fit makes the residuals sum to zero, to the weight of what is known of it
    np.testing.assert_allclose(total, above, atol=4.0 * 1.5 * np.sqrt(samples.shape[1]))
    assert abs((total - above).mean()) < 0.5 * 1.5
    right = fits.count == truth.count
    true = np.bincount(truth.row, truth.energy, minlength=len(samples))
    np.testing.assert_allclose(total[right].sum(), true[right].sum(), rtol=1e-3)
    one, _ = wm.fixed(400, [150.0], noise=1.0, bits=16, samples=90, first=20.0, baseline=40.0, seed=52)
    two, _ = wm.fixed(400, [90.0], noise=1.0, bits=16, samples=90, first=60.0, baseline=40.0, width=5.0, seed=53)
    y, z = one.samples.reshape(400, -1), two.samples.reshape(400, -1)
    a, b, c = (fitted(s, params) for s in (y, z, y + z))
    every = [np.bincount(f.row, f.energy, minlength=400) for f in (a, b, c)]
    good = (a.count == 1) & (b.count == 1) & (c.count == 2)
    assert good.mean() > 0.99
    spread = (every[0] + every[1] - every[2])[good]
    assert np.abs(spread.mean()) < 4 * spread.std() / np.sqrt(400) + 0.05 and spread.std() < 10.0


def assert_same(a: Fits, b: Fits, rows) -> None:
    """`b` holds `rows` of `a`, bit for bit."""
    for name in PER_ROW:
        np.testing.assert_array_equal(getattr(a, name)[rows], getattr(b, name))
    first = np.searchsorted(a.row, rows)
    at = np.concatenate([[], *(np.arange(f, f + n) for f, n in zip(first, a.count[rows], strict=True))]).astype(int)
    np.testing.assert_array_equal(b.row, np.repeat(np.arange(len(rows)), b.count))
    for name in FLAT:
        if name != "row":
            np.testing.assert_array_equal(getattr(a, name)[at], getattr(b, name))


def mixed() -> Waveforms:
    """Waveforms of several lengths, spacings and depths, some strange."""
    rng = np.random.default_rng(54)
    parts: list[tuple[np.ndarray, float, float]] = []
    for samples, spacing, top in ((72, 1.0, 255.0), (40, 2.0, 255.0), (160, 0.5, 255.0), (72, 1.0, 200.0)):
        waves, _ = wm.hard_mix(60, samples=samples, spacing=spacing, saturation=top, seed=samples)
        parts += [(w, spacing, top) for w in waves.samples.reshape(60, -1)]
    for strange in ([], [9], [7] * 30, [255] * 30, [0] * 40, [0, 255] * 20):
        parts.append((np.array(strange, np.uint8), 1.0, 255.0))
    order = rng.permutation(len(parts))
    samples, spacing, top = zip(*(parts[i] for i in order), strict=True)
    return wm.waves_of(samples, spacing=np.array(spacing), saturation=np.array(top))


CHANNELS = (Channel(1.0, 255.0, 10.0, 0.1, 1.5, 15.0, 255.0), Channel(2.0, 255.0, 10.0, 0.1, 1.5, 15.0, 255.0))
T, H = wm.skewed().values(0.05)
PULSES = pytest.mark.parametrize(
    "pulse",
    [
        PULSE,
        SystemPulse("gaussian", wm.PULSE_WIDTH, shape_error=0.01, channels=CHANNELS),
        SystemPulse("measured", wm.skewed().fwhm, first=float(T[0]), step=0.05, values=H, channels=CHANNELS),
    ],
    ids=["gaussian", "channels", "measured"],
)


@PULSES
def test_batches_change_nothing(params, pulse):
    """Cut anywhere, in any order, alone or repeated: bit for bit the same."""
    waves = mixed()
    n = waves.pulses.rows
    whole = fit_waveforms(waves, params, pulse)
    assert whole.row.size > n
    for size, every in ((1, 6), (7, 28), (100, 100)):
        for a in range(0, n, every):
            rows = np.arange(a, min(a + size, n))
            assert_same(whole, fit_waveforms(wm.rows_of(waves, rows), params, pulse), rows)
    for rows in (np.arange(n)[::-1], np.random.default_rng(1).permutation(n), np.zeros(3, int), np.arange(0)):
        assert_same(whole, fit_waveforms(wm.rows_of(waves, rows), params, pulse), rows)


@PULSES
def test_sound_numbers(params, pulse):
    """Echoes by row and time, positive, finite, with finite standard errors; rows without echoes say so."""
    waves = mixed()
    fits = fit_waveforms(waves, params, pulse)
    np.testing.assert_array_equal(np.bincount(fits.row, minlength=waves.pulses.rows), fits.count)
    assert (np.lexsort((fits.time, fits.row)) == np.arange(len(fits.row))).all()
    for name in ("amplitude", "width", "energy", "amplitude_sigma", "time_sigma", "width_sigma"):
        value = getattr(fits, name)
        assert np.isfinite(value).all() and (value > 0).all(), name
    assert np.isfinite(fits.time).all() and np.isfinite(fits.deviation).all()
    assert np.isnan(fits.misfit[fits.count == 0]).all() and np.isfinite(fits.misfit[fits.count > 0]).all()
    alike = np.array([np.ptp(waves.samples[a:b]) == 0 if b > a else True for a, b in _spans(waves)])
    assert (fits.count[alike] == 0).all()


def _spans(waves):
    return zip(waves.offsets[:-1], waves.offsets[1:], strict=True)


@pytest.mark.parametrize("step", [0.05, 0.25])
def test_a_gaussian_given_as_values_is_a_gaussian(params, step):
    """A measured pulse whose values are a Gaussian gives the Gaussian result; linear interpolation of its values is
    off by at most step^2 |h''| / 8, and that over the height bounds the relative error of heights and widths."""
    samples, _ = records()
    t, h = wm.Pulse().values(step)
    values = SystemPulse("measured", wm.PULSE_WIDTH, first=float(t[0]), step=step, values=h)
    a, b = fitted(samples, params), fitted(samples, params, values)
    u, v = same_echoes(a, b, 0.98)
    off = step**2 / 8 / (wm.PULSE_WIDTH / wm.FWHM) ** 2 + 1e-3
    for name in ("amplitude", "width", "energy"):
        wrong = np.abs(getattr(b, name)[v] - getattr(a, name)[u])
        allowed = 2 * off * getattr(a, name)[u]
        if name != "energy":
            allowed = allowed + 0.1 * getattr(a, f"{name}_sigma")[u]
        else:
            allowed = allowed + 0.1 * a.energy[u] * (a.amplitude_sigma / a.amplitude + a.width_sigma / a.width)[u]
        assert (wrong > allowed).mean() <= 0.005, (name, wrong.max())
    close(b.time[v], a.time[u], a.time_sigma[u])


@pytest.mark.statistics
@PULSES
def test_the_model_explains_the_samples(params, pulse):
    """`model_of` is what was fitted: its residuals have the noise's size and the misfit's chi-square."""
    shape = wm.skewed() if pulse.shape == "measured" else wm.Pulse()
    waves, truth = wm.mix(100, (0.5, 0.5), amplitude=(40, 100), gap=(9, 20), noise=(1.5, 1.5), pulse=shape, seed=55)
    fits = fit_waveforms(waves, params, pulse)
    y = waves.samples.reshape(100, -1).astype(float)
    residual = np.empty_like(y)
    for row in range(100):
        total, echoes = model_of(fits, row, truth.samples, truth.spacing, pulse)
        assert echoes.shape == (fits.count[row], truth.samples)
        np.testing.assert_allclose(total, fits.baseline[row] + echoes.sum(axis=0), atol=1e-9)
        residual[row] = y[row] - total
        mine = fits.row == row
        np.testing.assert_allclose(echoes.sum(axis=1), fits.energy[mine], rtol=0.01)
    # parameters take up to 7 of 72 degrees of freedom
    np.testing.assert_allclose(residual.std(), np.sqrt(1.5**2 + 1 / 12), rtol=0.06)
    assert abs(fits.misfit.mean() - 1.0) < 0.1


def test_segments_of_other_depth_are_the_same_waveform(params):
    """8 and 16 bit storage of the same numbers, where nothing saturates."""
    waves, _ = wm.survey_mix(300, amplitude=(5, 90), seed=56)
    y = waves.samples.reshape(300, -1)
    assert y.max() < 250
    a, b = fitted(y, params, saturation=255.0), fitted(y.astype(np.uint16), params, saturation=65535.0)
    assert_same(a, b, np.arange(300))


ECHOES_OF_TWO_RECEIVERS = """
import hashlib
import sys
import numpy as np
import wavemaker as wm
import yaml
from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.compiling import count

base = yaml.safe_load(open(sys.argv[1]))
state = hashlib.sha256()
for options in ({}, {"bits": 16, "amplitude": (300, 3000)}):
    waves, _ = wm.survey_mix(8000, seed=5, **options)
    pulse = estimate_pulse(waves, PulseParams(**base["pulse"]))
    fits = fit_waveforms(waves, DecomposeParams(**base["decompose"]), pulse)
    for column in (fits.baseline, fits.amplitude, fits.time, fits.deviation):
        state.update(np.ascontiguousarray(column).tobytes())
print(count() > 0, state.hexdigest())
"""


@pytest.mark.slow
def test_a_process_that_compiles_gives_the_bytes_of_one_that_loads(tmp_path):
    """Sums may be reordered where that is said to be so: but in one way only on a machine."""
    root = Path(__file__).resolve().parents[2]
    words = [sys.executable, "-c", ECHOES_OF_TWO_RECEIVERS, str(root / "conf" / "base.yaml")]
    inside = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": f"{root}{os.pathsep}{root / 'tests'}"}
    cold, warm = (subprocess.run(words, env=inside, capture_output=True, text=True, check=True).stdout for _ in "ab")
    assert cold.split()[0] == "True" and warm.split()[0] == "False"
    assert cold.split()[1] == warm.split()[1]
