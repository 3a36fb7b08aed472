"""The mean shape of aligned echoes: a cubic spline with few knots, robust against what else a waveform holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.units import FWHM_PER_SIGMA, SIGMA_PER_MAD

Floats = NDArray[np.floating]

KNOTS_PER_FWHM = 8.0
"""A cubic spline on these knots is within 5e-5 of a Gaussian (5 / 384 h^4 |f''''|, Hall and Meyer 1976)."""

STEEP, LEAST_EDGE = 0.75, 0.1
"""A pulse rises steeply where a Gaussian that rises as fast has less than this share of its width; the least share."""

GAUSSIAN_RISE = 0.7166
"""Rise time of a Gaussian, 10 to 90 % of its height, over its FWHM."""

STEPS_PER_FWHM = 64.0
"""Times at which the pulse is stored."""

BEFORE, LEAST_AFTER = 2.5, 1.5
"""Reach of the template ahead of the peak, and its least reach behind it, in FWHM."""

BISQUARE = 4.685
"""Tuning constant of the biweight: 95 % efficient where there are no outliers (Holland and Welsch 1977)."""

SYSTEMATIC = 12.0
"""Where half of the samples of a piece depart by more than this many times the common scale, it is the spline that is
wrong there (a steep rise, an end that is cut off), not the samples: they are judged by their own scale. So wide that
receivers' noise never reaches it: the RIEGL sample's pulse stays byte for byte what it is without."""

ROUNDS = 6
"""Fits of the spline, after each of which samples far from it count less."""

SURE, FAINTEST = 4.0, 1e-3
"""Standard errors, and share of the height, above which the far part of the pulse is believed."""

RIDGE = 1e-3
"""Of the normal equations' mean diagonal, put onto second differences of coefficients that no sample determines."""


NARROWEST, WIDEST, SIZES = 0.6, 1.8, 65
"""Range of an echo's width in pulse widths, and the widths between which a shape is a straight line (1e-4)."""


@dataclass(frozen=True)
class Template:
    """A pulse shape, its peak of 1 at time 0, and how it looks when targets widen it.

    Attributes
    ----------
    time, value : evenly spaced [ns], and the height there.
    fwhm : [ns].
    edge : FWHM of a Gaussian that rises as fast [ns], `fwhm` of a pulse that does not rise steeply.
    first : time of the first column of `family` [ns]; columns are spaced as `time`.
    family : shapes of unit peak, shape (SIZES, m), of `NARROWEST` to `WIDEST` times the equivalent sigma,
        fwhm / 2.3548: wider ones convolved with a Gaussian, narrower ones compressed in time. 0 at both ends.
    """

    time: Floats
    value: Floats
    fwhm: float
    edge: float
    first: float
    family: Floats

    @property
    def steep(self) -> bool:
        """Whether the pulse rises more steeply than a Gaussian of its width."""
        return self.edge < self.fwhm

    def at(self, u: Floats, size: Floats) -> tuple[Floats, Floats, Floats]:
        """Height, its derivative in time [1/ns] and in `size`, at times `u` [ns] after the peak, for echoes of
        `size` times the pulse's width."""
        step = self.time[1] - self.time[0]
        rows, columns = self.family.shape
        across = np.clip((u - self.first) / step, 0.0, columns - 1.000001)
        along = np.clip((size - NARROWEST) / (WIDEST - NARROWEST) * (rows - 1), 0.0, rows - 1.000001)
        i, k = across.astype(np.int64), along.astype(np.int64)
        a, b = across - i, along - k
        flat = self.family.ravel()
        corner = k * columns + i
        low, high = flat[corner], flat[corner + columns]
        low_step, high_step = flat[corner + 1] - low, flat[corner + columns + 1] - high
        slope = low_step + b * (high_step - low_step)
        below, above = low + a * low_step, high + a * high_step
        return below + b * (above - below), slope / step, (above - below) * ((rows - 1) / (WIDEST - NARROWEST))


def make_template(time: Floats, value: Floats, fwhm: float) -> Template:
    """The `Template` of a shape given at even times, with its family."""
    step = float(time[1] - time[0])
    margin = int(2.0 * fwhm / step)
    padded = np.pad(value, (margin, margin))
    first = float(time[0]) - margin * step
    grid = first + step * np.arange(len(padded))
    # room behind, so that what the transform folds round falls on zeros
    length = len(padded) + 4 * margin
    spectrum = np.fft.rfft(padded, length)
    squared = (2.0 * np.pi * np.fft.rfftfreq(length, step)) ** 2 * (fwhm / FWHM_PER_SIGMA) ** 2
    family = np.empty((SIZES, len(padded)))
    for k, size in enumerate(np.linspace(NARROWEST, WIDEST, SIZES)):
        if size < 1.0:
            family[k] = np.interp(grid / size, grid, padded)
        else:
            family[k] = np.fft.irfft(spectrum * np.exp(-0.5 * (size**2 - 1.0) * squared), length)[: len(padded)]
        family[k] /= family[k].max()
    family[:, [0, -1]] = 0.0
    return Template(time, value, fwhm, edge_of(time, value, fwhm), first, family)


def rise_time(time: Floats, value: Floats) -> float:
    """How long a shape given at even times (n,) [ns] takes from 10 to 90 % of its height [ns]."""
    rising = np.maximum.accumulate(value[: int(value.argmax()) + 1])
    low, high = np.interp([0.1, 0.9], rising, time[: len(rising)])
    return float(high - low)


def edge_of(time: Floats, value: Floats, fwhm: float) -> float:
    """`Template.edge` of a shape of `fwhm` [ns] given at even times (n,) [ns]."""
    edge = rise_time(time, value) / GAUSSIAN_RISE
    return fwhm if edge > STEEP * fwhm else max(edge, LEAST_EDGE * fwhm)


def gaussian_template(fwhm: float) -> Template:
    """A Gaussian of `fwhm` [ns] as a `Template`."""
    half = round(BEFORE * STEPS_PER_FWHM)
    time = np.arange(-half, half + 1) * (fwhm / STEPS_PER_FWHM)
    return make_template(time, np.exp(-0.5 * (time / fwhm * FWHM_PER_SIGMA) ** 2), fwhm)


def mean_shape(u: Floats, v: Floats, sigma: Floats, fwhm: float, tail: float, edge: float = np.inf) -> Template | None:
    """The shape that aligned, scaled samples have in common.

    A penalised cubic spline by iterated biweight regression (Holland and Welsch 1977), which a second weak echo on a
    few waveforms does not move. Behind the peak it lasts as long as it is significant, at most `tail`; then it is 0.

    Parameters
    ----------
    u, v, sigma : time after the echo's peak [ns], height as a share of the echo's, and its standard deviation.
    fwhm : about the pulse's [ns]; gives the knots.
    tail : longest reach behind the peak [ns].
    edge : FWHM of a Gaussian that rises as fast [ns], where that is less; gives the knots around the peak.

    Returns
    -------
    Template, or None where the samples show no single peak.
    """
    first, last = -BEFORE * fwhm, max(tail, LEAST_AFTER * fwhm)
    inside = (u >= first) & (u < last)
    u, v, sigma = u[inside], v[inside], sigma[inside]
    edge = min(edge, fwhm)
    knots = _knots(first, last, fwhm, edge)
    pieces = len(knots) - 7
    if len(u) < 2 * pieces:
        return None
    design = scipy.interpolate.BSpline.design_matrix(u, knots, 3)
    basis = design.data.reshape(-1, 4)
    start = design.indices.reshape(-1, 4)[:, 0]
    coefficients, error = _biweight(basis, start, v, 1.0 / sigma**2, pieces + 3)
    if coefficients is None or error is None:
        return None
    return _normalise(scipy.interpolate.BSpline(knots, coefficients, 3), error, (first, last), fwhm, edge)


def _knots(first: float, last: float, fwhm: float, edge: float) -> Floats:
    """Even knots from `first` to `last` [ns] and three beyond either, so many to a `fwhm`, around the peak to an
    `edge`."""
    if edge == fwhm:
        pieces = max(int(np.ceil((last - first) / fwhm * KNOTS_PER_FWHM)), 8)
        return np.asarray(first + (last - first) / pieces * np.arange(-3, pieces + 4))
    middle = min(LEAST_AFTER * fwhm, last)
    fine = int(np.ceil((middle - first) / edge * KNOTS_PER_FWHM))
    coarse = max(int(np.ceil((last - middle) / fwhm * KNOTS_PER_FWHM)), 1)
    inner = np.concatenate([np.linspace(first, middle, fine, endpoint=False), np.linspace(middle, last, coarse + 1)])
    ahead, behind = inner[1] - inner[0], inner[-1] - inner[-2]
    return np.concatenate([first + ahead * np.arange(-3, 0), inner, last + behind * np.arange(1, 4)])


def _biweight(
    basis: Floats, start: NDArray[np.integer], v: Floats, weight: Floats, size: int
) -> tuple[Floats | None, Floats | None]:
    """Spline coefficients (size,) with a small penalty on their second differences, and their standard errors; None
    where they are not determined."""
    scaled, robust = np.sqrt(weight), weight.copy()
    coefficients, banded, residual = np.zeros(size), np.empty((4, size)), v
    for _ in range(ROUNDS):
        right = np.zeros(size)
        banded = np.zeros((4, size))
        _normal_equations(basis, start, v, robust, banded, right)
        ridge = RIDGE * float(banded[0].mean())
        for shift, value in ((0, 6.0), (1, -4.0), (2, 1.0)):
            banded[shift, : size - shift] += ridge * value
        try:
            banded = scipy.linalg.cholesky_banded(banded, lower=True)
        except np.linalg.LinAlgError:
            return None, None
        coefficients = scipy.linalg.cho_solve_banded((banded, True), right)
        residual = np.empty(len(v))
        _departures(basis, start, v, scaled, coefficients, residual)
        scale = max(SIGMA_PER_MAD * float(np.median(np.abs(residual))), 1e-12)
        scales = _scales(np.abs(residual), start, size, scale)[start]
        robust = weight * np.clip(1.0 - (residual / (BISQUARE * scales)) ** 2, 0.0, None) ** 2
    share = robust / weight
    spread = float(np.sqrt((share * residual**2).sum() / max(share.sum(), 1.0)))
    inverse = scipy.linalg.cho_solve_banded((banded, True), np.eye(size))
    return coefficients, spread * np.sqrt(np.diag(inverse))


def _scales(departure: Floats, piece: NDArray[np.integer], pieces: int, scale: float) -> Floats:
    """Scale that every piece (pieces,) is judged by: `scale`, or its own where half of it departs `SYSTEMATIC` far."""
    scales, count = np.full(pieces, scale), np.bincount(piece, minlength=pieces)
    near = np.bincount(piece[SIGMA_PER_MAD * departure <= SYSTEMATIC * scale], minlength=pieces)
    for k in np.flatnonzero((count > 0) & (near <= count // 2)).tolist():
        scales[k] = SIGMA_PER_MAD * np.sort(departure[piece == k])[count[k] // 2]
    return scales


@kernel
def _normal_equations(basis, start, v, weight, banded, right):  # type: ignore[no-untyped-def]
    """Add B^T W B, lower band by band, to `banded` (4, k) and B^T W v to `right` (k,); the row i of B holds
    ``basis[i]`` from column ``start[i]`` on."""
    for i in range(len(v)):
        for a in range(4):
            wa = weight[i] * basis[i, a]
            right[start[i] + a] += wa * v[i]
            for b in range(a, 4):
                banded[b - a, start[i] + a] += wa * basis[i, b]


@kernel
def _departures(basis, start, v, scale, coefficients, out):  # type: ignore[no-untyped-def]
    """``out`` = (v - B c) * scale."""
    for i in range(len(v)):
        value = 0.0
        for a in range(4):
            value += basis[i, a] * coefficients[start[i] + a]
        out[i] = (v[i] - value) * scale[i]


def _normalise(
    spline: scipy.interpolate.BSpline, error: Floats, ends: tuple[float, float], fwhm: float, edge: float
) -> Template | None:
    """`spline`, known between `ends` [ns], with its peak of 1 at time 0, tapered to 0 where it is not significant."""
    first, last = ends
    step = edge / STEPS_PER_FWHM
    grid = np.arange(first, last, step)
    value = spline(grid)
    near = np.flatnonzero(np.abs(grid) < 0.75 * fwhm)
    top = near[int(value[near].argmax())]
    if top in (near[0], near[-1]) or not value[top] > 0.0:
        return None
    slope = spline.derivative()
    low, high = grid[top - 1], grid[top + 1]
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(middle) > 0.0 else (low, middle)
    peak, height = 0.5 * (low + high), float(spline(0.5 * (low + high)))
    begin, end = _reach(spline, error, peak, fwhm)
    count = (int(np.ceil((peak - begin) / step)), int(np.ceil((end - peak) / step)))
    time = np.arange(-count[0], count[1] + 1) * step
    at = np.clip(time + peak, first, last - 1e-9)
    fade = np.clip(np.minimum(time - time[0], time[-1] - time) / (0.5 * fwhm), 0.0, 1.0)
    value = spline(at) / height * (fade * fade * (3.0 - 2.0 * fade))
    value[count[0]] = 1.0
    width = _fwhm(time, value)
    if width is None:
        return None
    return make_template(time, value, width)


def _reach(spline: scipy.interpolate.BSpline, error: Floats, peak: float, fwhm: float) -> tuple[float, float]:
    """First and last time of the part that is significant, half a FWHM for the fading included [ns]."""
    at = spline.t[2:-2]
    sure = np.abs(spline.c) > np.maximum(SURE * error, FAINTEST)
    begin, end = peak - 1.5 * fwhm, peak + LEAST_AFTER * fwhm
    if sure.any():
        begin, end = min(begin, at[sure][0]), max(end, at[sure][-1])
    return max(begin - 0.5 * fwhm, spline.t[3]), min(end + 0.5 * fwhm, spline.t[-4])


def _fwhm(time: Floats, value: Floats) -> float | None:
    """Full width at half maximum around the peak, by straight lines; None if it does not fall to half."""
    top = int(value.argmax())
    left, right = np.flatnonzero(value[:top] < 0.5), np.flatnonzero(value[top:] < 0.5)
    if not len(left) or not len(right):
        return None
    a, b = left[-1], top + right[0]
    step = time[1] - time[0]
    rise = (0.5 - value[a]) / (value[a + 1] - value[a])
    fall = (value[b - 1] - 0.5) / (value[b - 1] - value[b])
    return float((b - 1 + fall - a - rise) * step)
