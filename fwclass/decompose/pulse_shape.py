"""The shape that the bright echoes of one channel share: their width, their mean, and whether it is worth it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.params import FEWEST, PulseParams
from fwclass.decompose.pulse_align import Echoes, cut_samples, fit_template, narrowest
from fwclass.decompose.pulse_template import NARROWEST, WIDEST, Template, gaussian_template, make_template, mean_shape
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.waveforms import Waveforms

Floats = NDArray[np.floating]

WIDTH_ROUNDS, SHAPE_ROUNDS, STEEP_ROUNDS = 6, 5, 12
"""Rounds at most in which widths, the shape, and a shape that rises steeply, settle."""

STEADY = 2e-3
"""Share of the width, or of the height, by which two rounds may differ at the end."""

NEAR, CLOSE = 0.25, 0.02
"""Shares of the width by which an echo's may differ to be fitted further, and beside its own error to be averaged."""

FEWEST_SAMPLES, MOST_SAMPLES = 0.7, 64.0
"""Samples per FWHM of what can be a pulse."""

FARTHEST = 30.0
"""Longest tail in FWHM."""

CAPPED = 25.0
"""Square of a standardised residual that counts at most: what is no echo must not decide on the echo's shape."""


def surest(rows: NDArray, doubt: Floats, most: int) -> NDArray:
    """At most `most` of `rows`, (n,), those of least `doubt`, (n,), in their order."""
    return rows if len(rows) <= most else rows[np.sort(np.argsort(doubt, kind="stable")[:most])]


def narrow_width(
    waves: Waveforms, rows: NDArray, peak: NDArray, level: Floats, noise: Floats, fwhm: float, params: PulseParams
) -> tuple[float, NDArray]:
    """The FWHM [ns] of a Gaussian that the narrowest echoes share, about `fwhm`, and the rows of echoes near to it.

    `rows` are the waveforms of bright echoes; `peak`, the samples of these, `level` and `noise` [DN] are (waveforms,).
    """
    near = np.ones(len(rows), np.bool_)
    for _ in range(WIDTH_ROUNDS):
        echoes = cut_samples(waves, rows, peak[rows], level[rows], noise[rows], fwhm, 2.0 * fwhm)
        echoes = fit_template(echoes, gaussian_template(fwhm))
        width, error = fwhm * echoes.size, fwhm * echoes.size_sd
        fair = _fair(echoes)
        if fair.sum() < FEWEST:
            return fwhm, rows[:0]
        best = params.width or narrowest(width[fair], error[fair])
        near = fair & (np.abs(width - best) < NEAR * best)
        if not math.isfinite(best) or best < FEWEST_SAMPLES * waves.pulses["sample_spacing"][rows].min():
            return fwhm, rows[:0]  # narrower than its samples can tell
        change, fwhm = abs(best - fwhm), best
        if change < STEADY * fwhm:
            break
    return fwhm, rows[near]


def _fair(echoes: Echoes) -> NDArray[np.bool_]:
    """Echoes that fit about as well as the others of their brightness: residuals grow with the noise and the height."""
    share = np.sqrt(echoes.misfit) * echoes.noise / echoes.amplitude
    floor = 2.0 * np.sqrt(np.maximum(echoes.misfit, 1.0)) < 4.0
    fair: NDArray[np.bool_] = floor | (share < 3.0 * np.median(share))
    inside = (echoes.size > NARROWEST) & (echoes.size < WIDEST)
    return fair & inside & np.isfinite(share) & (echoes.amplitude > 0.0)


def measure_pulse(echoes: Echoes, fwhm: float, params: PulseParams) -> SystemPulse:
    """The pulse of `echoes`, which were fitted with a Gaussian of `fwhm` [ns]."""
    smooth = gaussian_template(fwhm)
    plain, _ = _closest(echoes, smooth, params)
    given = params.shape == "gaussian" or params.width is not None
    measured, aligned = (None, plain) if given else _measure_shape(echoes, smooth, params)
    if measured is not None:
        gain, error = _trial(aligned, measured, smooth, params)
        if params.shape == "measured" or gain > params.worth:
            step = float(measured.time[1] - measured.time[0])
            return SystemPulse(
                "measured",
                measured.fwhm,
                float(measured.time[0]),
                step,
                measured.value.astype(np.float64),
                error,
                len(aligned),
            )
    error = _shape_error(plain, smooth)
    return SystemPulse("gaussian", fwhm, shape_error=error, echoes=len(plain))


def _closest(echoes: Echoes, template: Template, params: PulseParams) -> tuple[Echoes, float]:
    """Echoes of the width that the narrowest share, and that width in widths of the template."""
    width, error = template.fwhm * echoes.size, template.fwhm * echoes.size_sd
    least = narrowest(width, error)
    apart = np.abs(width - least)
    close = int((apart < 2.0 * error + CLOSE * least).sum())
    most = min(max(close, params.min_echoes), params.max_echoes)
    rows = np.flatnonzero(apart < 2.0 * error + CLOSE * least) if close >= most else np.arange(len(echoes))
    rows = surest(rows, error[rows] if close >= most else apart, most)
    return echoes.take(rows), least / template.fwhm


def template_of(pulse: SystemPulse) -> Template:
    """The template that has the shape of `pulse`."""
    if pulse.shape == "gaussian":
        return gaussian_template(pulse.fwhm)
    return make_template(pulse.first + pulse.step * np.arange(len(pulse.values)), pulse.values, pulse.fwhm)


def _measure_shape(echoes: Echoes, template: Template, params: PulseParams) -> tuple[Template | None, Echoes]:
    """The mean shape of `echoes`, and those of its width, as fitted with it."""
    for k in range(STEEP_ROUNDS):
        close, least = _closest(echoes, template, params)
        mean_shape = _average(close, template, params, least)
        if mean_shape is None:
            return None, echoes
        change = np.abs(mean_shape.at(template.time, np.ones(1))[0] - template.value).max()
        template, echoes = mean_shape, fit_template(echoes, mean_shape)
        if change < STEADY or (k + 1 >= SHAPE_ROUNDS and not template.steep):
            break
    return template, _closest(echoes, template, params)[0]


def predicted_gain(echoes: Echoes, own: Template, other: Template, params: PulseParams) -> float:
    """Mean gain of chi-square of an echo where one half of `echoes` is predicted by the shape of the other half, from
    their `own` on, in place of the `other` shape; that of all echoes would follow the noise of few."""
    return _trial(_closest(fit_template(echoes, own), own, params)[0], own, other, params)[0]


def _trial(echoes: Echoes, measured: Template, smooth: Template, params: PulseParams) -> tuple[float, float]:
    """How one half of `echoes` is predicted by the shape of the other: (mean gain of chi-square of an echo over the
    Gaussian `smooth`, shape error)."""
    even = np.arange(len(echoes)) % 2 == 0
    gain, errors = 0.0, []
    for half in (even, ~even):
        shape = _average(echoes.take(half), measured, params, 1.0)
        if shape is None:
            return -math.inf, _shape_error(echoes, measured)
        judged = fit_template(echoes.take(~half), shape)
        errors.append(_shape_error(judged, shape))
        gain += chi(fit_template(judged, smooth), smooth) - chi(judged, shape)
    return gain / len(echoes), float(np.mean(errors))


def _average(echoes: Echoes, template: Template, params: PulseParams, size: float) -> Template | None:
    """The mean shape of echoes aligned and scaled as fitted, each brought to `size` times the template's width."""
    u = echoes.u - echoes.time[:, None]
    v = echoes.y / echoes.amplitude[:, None]
    v += template.at(u, np.full(1, size))[0] - template.at(u, echoes.size[:, None])[0]
    sigma = np.sqrt((echoes.noise / echoes.amplitude) ** 2 + 1e-6)[:, None]
    used, spacing = np.isfinite(v), float(echoes.u[0, 1] - echoes.u[0, 0])
    return mean_shape(
        u[used],
        v[used],
        np.broadcast_to(sigma, v.shape)[used],
        template.fwhm,
        min(params.tail, FARTHEST * template.fwhm),
        max(template.edge, min(spacing, template.fwhm)),
    )


def _residuals(echoes: Echoes, template: Template) -> tuple[Floats, Floats, Floats]:
    """(residual, model) [DN] of all samples, NaN outside, and their time after the peak [ns]."""
    u = echoes.u - echoes.time[:, None]
    model = echoes.amplitude[:, None] * template.at(u, echoes.size[:, None])[0]
    return echoes.y - model, model, u


def chi(echoes: Echoes, template: Template) -> float:
    """Sum of the squared standardised residuals of the samples of `echoes` (all, not NaN), each capped."""
    residual = _residuals(echoes, template)[0] / echoes.noise[:, None]
    return float(np.nansum(np.minimum(residual**2, CAPPED)))


def _shape_error(echoes: Echoes, template: Template) -> float:
    """Root mean square residual beyond the noise within one FWHM of the peak, as a share of the model there."""
    residual, model, u = _residuals(echoes, template)
    near = np.isfinite(residual) & (np.abs(u) <= template.fwhm)
    count = near.sum(axis=1)
    noise = echoes.noise**2 * np.maximum(count - 3, 1)
    excess = np.where(near, residual**2, 0.0).sum(axis=1) - noise
    scale = np.where(near, model**2, 0.0).sum(axis=1)
    # a hidden second echo is no error of the shape
    inliers = np.argsort(excess / np.maximum(scale, 1e-12), kind="stable")[: max(int(0.98 * len(scale)), 1)]
    return math.sqrt(max(float(excess[inliers].sum() / scale[inliers].sum()), 0.0))
