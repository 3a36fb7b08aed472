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


def over_surface(place, heights, amplitude, *, seed, noise=1.5, phi=()):
    """Pulses that meet a surface at `place` (n, 3), 10 degrees off the vertical, with echoes so high above it
    `heights` (n, k) [m], negative behind it, NaN where there is none, of `amplitude` (n, k) [DN]."""
    rng = np.random.default_rng(seed)
    n, beam = len(place), np.array([np.sin(0.17), 0.0, -np.cos(0.17)])
    there = 120.0 + rng.uniform(0.0, 1.0, n)
    time = there[:, None] - heights / np.cos(0.17) / SPEED
    sigma = np.full(time.shape, wm.PULSE_WIDTH / wm.FWHM)
    made, _ = wm.simulate(amplitude, time, sigma, noise=noise, samples=220, phi=phi, seed=seed)
    columns = {name: np.zeros(n) for name in PULSE_COLUMNS}
    columns |= {name: made.pulses[name] for name in ("pulse", "sample_spacing", "saturation", "gain")}
    columns |= {f"anchor_{a}": place[:, c] for c, a in enumerate("xyz")}
    columns |= {f"step_{a}": np.full(n, -SPEED * beam[c]) for c, a in enumerate("xyz")}
    columns["anchor_time"] = there
    return Waveforms(Table(columns), Table.empty(RETURN_COLUMNS), made.samples, made.offsets)


OPEN = 9.0
"""The roof of `under_tree` lies open west of it [m]."""


def under_tree(ratio, *, seed, noise=1.5, slope=0.35, leaves=0, eaves=19.0, side=SIDE):
    """A roof that rises to the east, half of it under a tree: west of `OPEN` every pulse shows it with 30 DN; further
    on it has `ratio` times the noise, under a crown of 60 DN. East of `eaves` there is none, and an echo 8 m lower.

    `leaves`: a branch beside the house, as high as its roof, of that many echoes of 0.5 to 2 times the noise a pulse.
    Returns waveforms, the true place of the roof, rough by 3 cm (n, 3), and those of it that lie open."""
    rng = np.random.default_rng([seed, 1])
    x, y = (v.ravel() + 0.3 for v in np.meshgrid(STEP * np.arange(side), STEP * np.arange(side)))
    n = len(x)
    place = np.c_[x, y, 100.0 + slope * x + 0.03 * rng.standard_normal(n)]
    bare, beyond = x < OPEN, x >= eaves
    crown = np.where(bare, np.nan, rng.uniform(6.0, 9.0, n))
    surface = np.where(beyond | (~bare & (ratio == 0.0)), np.nan, 0.0)
    lower = np.where(beyond & (rng.random(n) < 0.5), -8.0, np.nan)
    more = np.where(beyond[:, None], rng.uniform(-0.5, 0.5, (n, leaves)), np.nan)
    heights = np.c_[crown, surface, lower, more]
    weak = noise * rng.uniform(0.5, 2.0, more.shape)
    amplitude = np.c_[np.full(n, 60.0), np.where(bare, 30.0, ratio * noise), np.full(n, 30.0), weak]
    waves = over_surface(place, heights, amplitude, seed=seed, noise=noise)
    return waves, place, place[bare]


def pond(ratio, *, seed, noise=1.5, waves=0.02, side=SIDE):
    """Water at 100 m that mirrors the light away: every pulse has one echo, of `ratio` times the noise; its places."""
    rng = np.random.default_rng([seed, 2])
    x, y = (v.ravel() + 0.3 for v in np.meshgrid(STEP * np.arange(side), STEP * np.arange(side)))
    place = np.c_[x, y, 100.0 + waves * rng.standard_normal(len(x))]
    heights = np.full((len(x), 1), 0.0 if ratio > 0.0 else np.nan)
    return over_surface(place, heights, np.full((len(x), 1), ratio * noise), seed=seed, noise=noise), place
