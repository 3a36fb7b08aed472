"""Single echoes cut out, fitted with a template, and the width that the narrowest of them share."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.decompose.floor import DEEP
from fwclass.decompose.pulse_template import BEFORE, NARROWEST, WIDEST, Template
from fwclass.waveforms import Waveforms

Floats = NDArray[np.floating]

CORE = 1.3
"""Half width of the part of an echo that its time, height and width are fitted to, in FWHM."""

STEPS = 8
"""Gauss-Newton steps of every echo."""

MOST_WIDTHS = 1500
"""Widths, the surest, that tell the one that they share."""

FARTHEST = 12.0
"""Bound of the parameters of the widths' model: logarithms, log odds, typical errors."""

STRAY = 0.02
"""Share of widths that follow no model."""


@dataclass(frozen=True)
class Echoes:
    """Waveforms around their bright echo, one row each, NaN outside the waveform.

    Attributes
    ----------
    y : samples above the level [DN], shape (n, w).
    u : their time after the highest sample [ns], shape (n, w).
    noise : standard deviation [DN], shape (n,).
    amplitude, time, size : fitted height [DN], time after the highest sample [ns] and width in widths of the
        template; `size_sd` its standard error. Shape (n,).
    misfit : mean square residual of the fitted part over the noise's variance, shape (n,).
    """

    y: Floats
    u: Floats
    noise: Floats
    amplitude: Floats
    time: Floats
    size: Floats
    size_sd: Floats
    misfit: Floats

    def take(self, index: NDArray) -> Echoes:
        """The echoes at `index` (numbers or a mask (n,))."""
        return Echoes(
            self.y[index],
            self.u[index],
            self.noise[index],
            self.amplitude[index],
            self.time[index],
            self.size[index],
            self.size_sd[index],
            self.misfit[index],
        )

    def __len__(self) -> int:
        return len(self.noise)


def cut_samples(
    waves: Waveforms, rows: NDArray, peak: NDArray, level: Floats, noise: Floats, fwhm: float, after: float
) -> Echoes:
    """Samples of waveforms `rows` from `BEFORE` FWHM before to `after` [ns] behind the sample `peak`."""
    spacing = waves.pulses["sample_spacing"].astype(np.float64)[rows]
    finest = float(spacing.min(initial=np.inf)) if len(rows) else 1.0
    ahead, behind = math.ceil((BEFORE * fwhm) / finest) + 1, math.ceil(after / finest) + 1
    place = np.arange(-ahead, behind + 1)
    at = waves.offsets[rows][:, None] + peak[:, None] + place
    u = place * spacing[:, None]
    outside = (at < waves.offsets[rows][:, None]) | (at >= waves.offsets[rows + 1][:, None])
    outside |= (u < -BEFORE * fwhm - spacing[:, None]) | (u > after + spacing[:, None])
    y = waves.samples[np.clip(at, 0, max(len(waves.samples) - 1, 0))].astype(np.float64) - level[:, None]
    y[outside | ((y <= -level[:, None]) & (level > DEEP * noise)[:, None])] = np.nan
    zero, nothing = np.zeros(len(rows)), np.full(len(rows), np.nan)
    return Echoes(y, u, noise, np.nanmax(y, axis=1, initial=0.0), zero, zero + 1.0, nothing, nothing)


def fit_template(echoes: Echoes, template: Template) -> Echoes:
    """Height, time and size of every echo by Gauss-Newton on its core."""
    core = np.flatnonzero((np.abs(echoes.u) <= CORE * template.fwhm + 1e-9).any(axis=0))
    columns = slice(int(core[0]), int(core[-1]) + 1)
    y, u = echoes.y[:, columns], echoes.u[:, columns]
    used = np.isfinite(y) & (np.abs(u) <= CORE * template.fwhm)
    y = np.where(used, y, 0.0)
    amplitude, time, size = echoes.amplitude, echoes.time, np.ones(len(y))
    for step in range(STEPS + 1):
        value, slope, growth = template.at(u - time[:, None], size[:, None])
        residual = np.where(used, y - amplitude[:, None] * value, 0.0)
        basis = np.stack([value, -amplitude[:, None] * slope, amplitude[:, None] * growth], axis=1) * used[:, None]
        normal = basis @ basis.transpose(0, 2, 1)
        normal[:, range(3), range(3)] = normal[:, range(3), range(3)] * (1.0 + 1e-9) + 1e-12
        if step == STEPS:
            break
        change = np.linalg.solve(normal, basis @ residual[:, :, None])[:, :, 0]
        amplitude = np.clip(amplitude + change[:, 0], 0.3 * amplitude, 3.0 * amplitude)
        limit = 0.25 * template.fwhm
        time = np.clip(time + np.clip(change[:, 1], -limit, limit), -template.fwhm, template.fwhm)
        size = np.clip(size + np.clip(change[:, 2], -0.2, 0.2), NARROWEST, WIDEST)
    error = echoes.noise * np.sqrt(np.abs(np.linalg.inv(normal)[:, 2, 2]))
    misfit = (residual**2).sum(axis=1) / np.maximum(used.sum(axis=1) - 3, 1) / echoes.noise**2
    return replace(echoes, amplitude=amplitude, time=time, size=size, size_sd=error, misfit=misfit)


def half_sample_mode(values: Floats) -> float:
    """The mode by halving the shortest half (Robertson and Cryer 1974); NaN of nothing."""
    x = np.sort(values)
    while len(x) > 3:
        half = (len(x) + 1) // 2
        first = int((x[half - 1 :] - x[: len(x) - half + 1]).argmin())
        x = x[first : first + half]
    return float(x.mean()) if len(x) else math.nan


def narrowest(width: Floats, error: Floats) -> float:
    """The width that all echoes have at least [ns], its noise accounted for.

    Some echoes have it (flat targets), the others have it and something exponentially distributed above (slopes,
    plants); the measured widths are normally distributed about that. Maximum likelihood.
    """
    mode = half_sample_mode(width)
    near = (width > 0.7 * mode) & (width < 1.5 * mode)
    width, error = width[near], np.maximum(error[near], 1e-3 * mode)
    if len(width) < 10:
        return mode
    if len(width) > MOST_WIDTHS:
        surest = np.sort(np.argsort(error, kind="stable")[:MOST_WIDTHS])
        width, error = width[surest], error[surest]
    typical = float(np.median(error))

    def loss(p: Floats) -> float:
        if not (np.abs(p) < FARTHEST).all():
            return math.inf
        sd = error * math.exp(p[1])
        d = width - mode - p[0] * typical
        flat = np.exp(-0.5 * (d / sd) ** 2) / (sd * math.sqrt(2.0 * math.pi))
        rate = 1.0 / (typical * (1.0 + math.exp(p[2])))
        wide = rate * np.exp(
            np.minimum(rate * (0.5 * rate * sd**2 - d) + scipy.special.log_ndtr(d / sd - rate * sd), 0.0)
        )
        share = float(scipy.special.expit(p[3]))
        likelihood = (1.0 - STRAY) * (share * flat + (1.0 - share) * wide) + STRAY / (0.8 * mode)
        # the noise is known: only a clear misfit scales the errors
        return -float(np.log(likelihood).sum()) + 0.5 * (p[1] / 0.3) ** 2 + 0.01 * p[3] ** 2

    upper = max(float(np.quantile(width, 0.75)) - mode, typical)
    start = np.array([0.0, 0.0, math.log(upper / typical), 0.0])
    simplex = np.vstack([start, start + np.diag([-1.0, 0.2, 1.0, 2.0])])
    for _ in range(2):
        options: Any = {"xatol": 0.02, "fatol": 0.02, "maxiter": 250, "initial_simplex": simplex}
        best = scipy.optimize.minimize(loss, simplex[0], method="Nelder-Mead", options=options).x
        simplex = np.vstack([best, best + np.diag([0.5, 0.1, 0.5, -1.0])])
    return mode + float(best[0]) * typical
