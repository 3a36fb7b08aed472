"""Pulses that take one sample and less: their echoes are there, also those whose peak lies between two samples."""

from __future__ import annotations

import numpy as np
import pytest
from defaults import BASE
from wavemaker import FWHM, Pulse, match, simulate

from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse

PULSE, FIT = PulseParams(**BASE["pulse"]), DecomposeParams(**BASE["decompose"])


@pytest.mark.parametrize(("fwhm", "spacing"), [(0.8, 1.0), (1.5, 2.0), (1.0, 1.0)])
def test_pulses_of_several_echoes_keep_them_all(fwhm, spacing):
    rng, n = np.random.default_rng(5), 1500
    time = spacing * (20.0 + rng.uniform(0.0, 1.0, (n, 3)) + np.array([0.0, 9.0, 18.0]))
    time[: n // 2, 1:] = np.nan
    height = np.exp(rng.uniform(np.log(15.0), np.log(200.0), (n, 3)))
    wide = np.full((n, 3), fwhm / FWHM)
    waves, truth = simulate(height, time, wide, noise=1.0, spacing=spacing, pulse=Pulse(fwhm), seed=6)
    fits = fit_waveforms(waves, FIT, estimate_pulse(waves, PULSE))
    mine, theirs = match(truth, fits, 0.5 * spacing)
    # midway between two samples 0.3 of a pulse of 0.75 samples is recorded: the faintest are near the threshold
    assert len(truth.row) - len(mine) <= 0.004 * len(truth.row)
    assert len(fits.row) - len(theirs) <= 0.004 * len(fits.row)
    assert abs(np.median(fits.time[theirs] - truth.time[mine])) < 0.02 * spacing
