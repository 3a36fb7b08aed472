"""A lake and a wooded shore under a green laser, with their truth: light followed by its own rules, on a fine grid.

>>> truth = lake(tmp_path / "lake.las", pulses=500)
>>> score = scored(truth, laspy.read("echoes.laz"))

Nothing of the program is in here: the waveform is a row of impulses every 0.02 ns, convolved with the pulse by sums;
the beam breaks by angles in its own vertical plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lasmaker import Descriptor, correlated, write_las
from numpy.typing import NDArray

LIGHT = 0.299792458
AIR, AIR_GROUP = 1.000278, 1.000273
WATER, WATER_GROUP = 1.335, 1.357
STEP = 0.02
FWHM = 3.5
LEVEL, SURFACE_HEIGHT = 12.0, 300.0
EASTING, NORTHING = 500_000.0, 5_400_000.0


@dataclass
class Lake:
    """What was put in: per pulse whether it meets `water`, its `surface` and `bottom` (n, 3) and `depth` [m], `height`
    of the bottom's echo [DN] (0: none shows) and of the surface's, `decay` [1/m], `noise` [DN]."""

    path: Path
    water: NDArray
    surface: NDArray
    bottom: NDArray
    depth: NDArray
    height: NDArray
    bright: NDArray
    decay: NDArray
    noise: float


def record(impulses: NDArray, samples: int) -> NDArray:
    """Samples every ns of impulses every `STEP`, spread by the pulse: a sum over the grid, for every sample."""
    fine = np.arange(len(impulses)) * STEP
    sigma = FWHM / (2.0 * np.sqrt(2.0 * np.log(2.0)))
    out = np.zeros(samples)
    for i in range(samples):
        near = slice(max(int((i - 6 * sigma) / STEP), 0), int((i + 6 * sigma) / STEP) + 1)
        out[i] = (impulses[near] * np.exp(-((i - fine[near]) ** 2) / (2.0 * sigma**2))).sum()
    return out


def _put(impulses: NDArray, time: float, height: float) -> None:
    """An impulse at any time: shared between the two points of the grid beside it."""
    at = time / STEP
    k = int(np.floor(at))
    impulses[k] += height * (k + 1 - at)
    impulses[k + 1] += height * (at - k)


def lake(
    path: Path,
    pulses: int = 1000,
    *,
    seed: int = 0,
    noise: float = 1.2,
    lag1: float = 0.0,
    samples: int = 220,
    shore: float = 0.5,
    depths: tuple[float, float] = (0.5, 15.0),
    bottomless: float = 0.1,
    bits: int = 8,
    **options,
) -> Lake:
    """A file of `pulses`, the share `shore` of them on land: bare ground, hits in a crown over it, or foliage without
    gaps. Each pulse of water has one return, of the surface; each on land one a hit. Of the water pulses `bottomless`
    have no bottom."""
    r = np.random.default_rng([seed, 5])
    water = np.arange(pulses) >= shore * pulses
    tilt, turn = np.radians(r.uniform(0.0, 20.0, pulses)), r.uniform(0.0, 2.0 * np.pi, pulses)
    in_water = np.arcsin(np.sin(tilt) * AIR / WATER)
    row = np.arange(pulses)
    surface = np.stack([EASTING + 0.8 * (row % 40), NORTHING + 0.8 * (row // 40), np.full(pulses, SURFACE_HEIGHT)], 1)
    depth = np.where(water, r.uniform(*depths, pulses), 0.0)
    way = depth / np.cos(in_water)
    aside = depth * np.tan(in_water)
    bottom = surface + np.stack([aside * np.cos(turn), aside * np.sin(turn), -depth], axis=1)
    decay = r.uniform(0.1, 0.5, pulses)
    bright = r.uniform(60.0, 160.0, pulses)
    height = bright * r.uniform(0.5, 1.2, pulses) * np.exp(-decay * way)
    height[water & (r.random(pulses) < bottomless)] = 0.0
    share = r.uniform(0.1, 0.35, pulses)
    start = 40.0 + r.uniform(-0.5, 0.5, pulses)
    quiet = noise * correlated(pulses, samples, lag1, seed=seed)
    away = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)], axis=1)
    air = LIGHT / (2.0 * AIR_GROUP)
    grid = np.arange(int((samples + 20) / STEP)) * STEP
    waveforms, rows = [], []
    for p in range(pulses):
        impulses = np.zeros(len(grid))
        if water[p]:
            end = start[p] + way[p] * 2.0 * WATER_GROUP / LIGHT if height[p] > 0.0 else np.inf
            _put(impulses, start[p], bright[p])
            inside = (grid >= start[p]) & (grid <= end)
            plateau = share[p] * bright[p] / (FWHM * 1.0645)
            fade = np.exp(-decay[p] * (grid - start[p]) * LIGHT / (2.0 * WATER_GROUP))
            impulses[inside] += STEP * plateau * fade[inside]
            if height[p] > 0.0 and end < grid[-1] - 1.0:
                _put(impulses, end, height[p])
            hits = [start[p]]
        else:
            hits = _crown(r, impulses, start[p], grid)
        y = LEVEL + record(impulses, samples) + quiet[p]
        waveforms.append(np.clip(np.rint(y), 0, 2**bits - 1).astype(np.uint8 if bits <= 8 else np.uint16))
        rows += [(p, k + 1, len(hits), t, *(surface[p] + (t - start[p]) * air * away[p])) for k, t in enumerate(hits)]
    told = np.array(rows)
    pulse = told[:, 0].astype(int)
    written = write_las(
        path,
        told[:, 4:7],
        return_number=told[:, 1].astype(int),
        number_of_returns=told[:, 2].astype(int),
        waveforms=waveforms,
        pulse=pulse,
        location=told[:, 3],
        step=-away[pulse] * air,
        gps_time=1000.0 + 1e-5 * pulse,
        classification=np.where(water[pulse], 9, 2),
        descriptors={1: Descriptor(bits, samples, 1000)},
        **options,
    )
    return Lake(written, water, surface, bottom, depth, height, bright, decay, noise)


def _crown(r: np.random.Generator, impulses: NDArray, start: float, grid: NDArray) -> list[float]:
    """Impulses of land from `start` on, and the times of its hits: bare ground, leaves, or a crown without gaps."""
    kind = r.choice(3, p=[0.4, 0.4, 0.2])
    if kind == 0:
        _put(impulses, start, r.uniform(60.0, 180.0))
        return [start]
    ground = start + r.uniform(15.0, 120.0)
    if kind == 1:
        hits = np.sort(np.r_[start, start + (ground - start) * r.uniform(0.05, 0.8, r.integers(0, 4)), ground])
        for t in hits:
            spread = r.normal(0.0, r.uniform(0.0, 1.2), 8)
            for d in spread - spread.mean():
                _put(impulses, t + d, r.uniform(25.0, 120.0) / 8.0)
        return hits.tolist()
    end = start + (ground - start) * r.uniform(0.3, 0.8)
    inside = (grid >= start) & (grid <= end)
    rough = np.convolve(r.gamma(0.5, 1.0, inside.sum()), np.ones(100) / 100.0, "same")
    impulses[inside] += rough * r.uniform(300.0, 900.0) * STEP / (end - start)
    _put(impulses, ground, r.uniform(20.0, 100.0))
    return [start, ground]


@dataclass
class Score:
    """Figures of a decomposition of a lake: which bottoms were found, how high over the noise and how deep each is;
    which pulses of water have a surface, which a bottom that is none or 0.5 m off, and how many echoes too many; which
    on land count as water; errors per bottom that was found [m], and along the beam in water in standard errors."""

    found: NDArray
    visible: NDArray
    deep: NDArray
    surfaces: NDArray
    wrong: NDArray
    false_water: NDArray
    extra: NDArray
    depth_error: NDArray
    place_error: NDArray
    standard: NDArray


def scored(truth: Lake, points, tolerance: float = 0.5) -> Score:
    """Hold the points of a LAZ file of echoes against the truth. Where they have no `water`, as of a plain
    decomposition, the last echo of a pulse of several counts as its bottom."""
    pulse = np.asarray(points["pulse"])
    xyz = np.stack([np.asarray(points[c]) for c in "xyz"], axis=1)
    names = set(points.point_format.dimension_names)
    asked = "water" in names
    number, of = np.asarray(points.return_number), np.asarray(points.number_of_returns)
    kind = np.asarray(points["water"]) if asked else np.where((of > 1) & (number == of), 2, 0)
    there = truth.water & (truth.height > 0.0)
    deep = np.flatnonzero((kind == 2) & there[pulse])
    mine = pulse[deep]
    top = np.full(len(truth.water), np.nan)
    first = np.flatnonzero(number == 1)
    top[pulse[first]] = xyz[first, 2]
    depth_error = (top[mine] - xyz[deep, 2]) - truth.depth[mine]
    place_error = np.linalg.norm(xyz[deep] - truth.bottom[mine], axis=1)
    bent = np.stack([*(truth.bottom - truth.surface).T], axis=1)[mine]
    along = ((xyz[deep] - truth.bottom[mine]) * bent).sum(axis=1) / np.linalg.norm(bent, axis=1)
    hit = np.abs(depth_error) < tolerance + (0.0 if asked else 6.0)
    found = np.zeros(len(truth.water), bool)
    found[mine[hit]] = True
    wrong = np.zeros(len(truth.water), bool)
    wrong[pulse[kind == 2]] = True
    wrong &= ~found
    land = ~truth.water
    wet = np.zeros(len(truth.water), bool)
    wet[pulse[kind > 0]] = True
    surfaces = np.zeros(len(truth.water), bool)
    surfaces[pulse[kind == 1]] = True
    per_pulse = np.bincount(pulse, minlength=len(truth.water))
    return Score(
        found[there],
        (truth.height / truth.noise)[there],
        truth.depth[there],
        surfaces[truth.water],
        wrong[truth.water],
        wet[land],
        (per_pulse - 1 - there)[truth.water],
        depth_error[hit],
        place_error[hit],
        (along / np.asarray(points["range sigma"])[deep])[hit],
    )
