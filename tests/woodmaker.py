"""A wood flown over in straight lines: an echo of the crown and one of the ground for every pulse, with numpy alone."""

from __future__ import annotations

import numpy as np
import wavemaker as wm

from fwclass.schema import Table
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

SPEED = wm.METRES_PER_NS
STEP, SIDE = 0.6, 40


def flown(height, ratio, *, seed, noise=1.5, canopy=12.0, rough=0.0, phi=(), slope=0.0, side=SIDE):
    """Pulses over a wood, `STEP` apart: an echo of the crown at 60 DN, one of the ground `ratio` times the noise.

    Returns waveforms and the true place of the ground (n, 3). The beams are 10 degrees off the vertical."""
    rng = np.random.default_rng(seed)
    x0, y0 = (v.ravel() + 0.3 for v in np.meshgrid(STEP * np.arange(side), STEP * np.arange(side)))
    n, beam = len(x0), np.array([np.sin(0.17), 0.0, -np.cos(0.17)])
    z0 = height + slope * x0 + rough * rng.standard_normal(n)
    ground = np.c_[x0, y0, z0]
    below = (canopy + rng.uniform(-2.0, 2.0, n)) / np.cos(0.17) / SPEED  # ns from crown to ground
    crown = 20.0 + rng.uniform(0.0, 1.0, n)
    time = np.c_[crown, crown + below]
    amplitude = np.c_[np.full(n, 60.0), np.full(n, ratio * noise)]
    time[:, 1] = np.where(ratio > 0.0, time[:, 1], np.nan)
    sigma = np.full((n, 2), wm.PULSE_WIDTH / wm.FWHM)
    made, _ = wm.simulate(amplitude, time, sigma, noise=noise, samples=170, phi=phi, seed=seed)
    anchor = ground - (below * SPEED)[:, None] * beam
    columns = {name: np.zeros(n) for name in PULSE_COLUMNS}
    columns |= {name: made.pulses[name] for name in ("pulse", "sample_spacing", "saturation", "gain")}
    columns |= {f"anchor_{a}": anchor[:, c] for c, a in enumerate("xyz")}
    columns |= {f"step_{a}": np.full(n, -SPEED * beam[c]) for c, a in enumerate("xyz")}
    columns["anchor_time"] = crown
    waves = Waveforms(Table(columns), Table.empty(RETURN_COLUMNS), made.samples, made.offsets)
    return waves, ground
