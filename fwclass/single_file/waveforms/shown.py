"""Fitted echoes beside the returns that their vendor has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.fitted_echoes import OVERLAPPING
from fwclass.decompose.fitting import Fits, fit_waveforms, pulses_of
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.recovery import recovered
from fwclass.decompose.shapes import height_error
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.units import FWHM_PER_SIGMA
from fwclass.waveforms import Waveforms

JITTER = 1.0
"""How far a vendor's return location may be from the echo that it stands for, one standard deviation [ns]."""


@dataclass(frozen=True)
class WaveformView:
    """The echoes of a span beside the vendor's returns; times from the first sample of the pulse [ns].

    Attributes
    ----------
    ids, of_row : the pulses that have a waveform, and the place in `ids` of every row.
    pulse, time : per echo, its place in `ids` and its time.
    matched, gap : per echo, the row of `returns` that it explains or -1, and the distance of the nearest return of
        its pulse (infinite without one).
    complete : per pulse, whether the file has all the returns that its vendor counted; cropped files lack some.
    chance : per echo, the probability that noise alone makes one so high anywhere in a waveform as long.
    returns, return_pulse, return_time : rows of the returns that have a waveform, and as for the echoes.
    """

    waves: Waveforms
    fits: Fits
    ids: NDArray[np.int64]
    of_row: NDArray[np.int64]
    pulse: NDArray[np.int64]
    time: NDArray[np.float64]
    matched: NDArray[np.int64]
    gap: NDArray[np.float64]
    complete: NDArray[np.bool_]
    chance: NDArray[np.float64]
    returns: NDArray[np.int64]
    return_pulse: NDArray[np.int64]
    return_time: NDArray[np.float64]

    @property
    def missed(self) -> NDArray[np.bool_]:
        """The echoes that the vendor has not: no return explains them, and none of the pulse's is left out."""
        return np.asarray((self.matched < 0) & self.complete[self.pulse])

    @property
    def significance(self) -> NDArray[np.float64]:
        """Amplitudes over their standard deviations, one an echo."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.fits.amplitude / self.fits.amplitude_sigma)


def see(
    waves: Waveforms, params: DecomposeParams, pulse: SystemPulse, only: tuple[int, ...], inflation: float = 1.0
) -> WaveformView:
    """Fit the waveforms (of pulses `only`, if there are any) and tie echoes to returns.

    `inflation`: standard deviation of the matched filter's output over what the fit takes it for.
    """
    if only:
        waves = _rows(waves, np.flatnonzero(np.isin(waves.pulses["pulse"], only)))
    level, doubt = recovered(waves, params, pulse)
    fits = fit_waveforms(level, params, pulse, doubt)
    ids, of_row = np.unique(waves.pulses["pulse"].astype(np.int64), return_inverse=True)
    owner = of_row[fits.row]
    time = waves.pulses["segment_start"].astype(np.float64)[fits.row] + fits.time
    place = np.searchsorted(ids, waves.returns["pulse"])
    known = place < len(ids)
    known[known] &= ids[place[known]] == waves.returns["pulse"][known]
    complete = _complete(len(ids), place[known], waves.returns["number_of_returns"][known])
    returns = np.flatnonzero(known & waves.returns["has_packet"] & np.isfinite(waves.returns["location"]))
    return_time = waves.returns["location"].astype(np.float64)[returns]
    matched, gap = tie(owner, time, fits.amplitude, place[returns], return_time, params.vendor_tolerance)
    matched = np.where(matched >= 0, returns[matched], -1) if len(returns) else matched
    chance = noise_chances(fits, waves, pulse, inflation)
    return WaveformView(
        waves, fits, ids, of_row, owner, time, matched, gap, complete, chance, returns, place[returns], return_time
    )


def noise_chances(fits: Fits, waves: Waveforms, pulse: SystemPulse, inflation: float) -> NDArray[np.float64]:
    """How likely noise alone reaches every echo's height somewhere in its waveform, behind the matched filter.

    By the rate at which a stationary normal process crosses a level upwards (Rice 1945), the filter that of a Gaussian
    pulse of the system's width. NaN where the noise is not known, and for echoes that overlap: whether there are two of
    them a fit's gain tells, and no height.
    """
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    kinds, channels, kind = pulses_of(waves, pulse)
    error, sigma = np.full(len(spacing), np.nan), np.full(len(spacing), np.nan)
    for k, (own, channel) in enumerate(zip(kinds, channels, strict=True)):
        of_shape = (kind == k) & (spacing > 0.0)
        error[of_shape] = height_error(own, channel) if channel else np.sqrt(spacing[of_shape] / own.energy)
        sigma[of_shape] = own.fwhm / (FWHM_PER_SIGMA * spacing[of_shape])
    row = fits.row
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        height = fits.amplitude / (fits.noise * error * inflation)[row] if len(row) else fits.amplitude
        rate = np.diff(waves.offsets) / (2.0 * np.pi * np.sqrt(2.0) * sigma)
        chance = -np.expm1(-rate[row] * np.exp(-0.5 * height**2))
    return np.where((fits.flags & OVERLAPPING) > 0, np.nan, chance)


def _complete(n: int, pulse: NDArray[np.int64], declared: NDArray) -> NDArray[np.bool_]:
    """Whether every one of `n` pulses has a return, and as many as its returns declare."""
    most = np.zeros(n, np.int64)
    np.maximum.at(most, pulse, declared.astype(np.int64))
    here = np.bincount(pulse, minlength=n)
    return np.asarray((here > 0) & (here >= most))


def _rows(waves: Waveforms, rows: NDArray[np.int64]) -> Waveforms:
    """`waves` with only some of its rows, and all its returns."""
    sizes = np.diff(waves.offsets)[rows]
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    place = np.arange(offsets[-1]) + np.repeat(waves.offsets[rows] - offsets[:-1], sizes)
    return Waveforms(waves.pulses.take(rows), waves.returns, waves.samples[place], offsets)


def tie(
    pulse: NDArray[np.int64],
    time: NDArray[np.float64],
    height: NDArray[np.float64],
    return_pulse: NDArray[np.int64],
    return_time: NDArray[np.float64],
    within: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which return explains which echo: each at most once, none beyond `within` [ns].

    The likeliest pair of a pulse first: height x exp(-(distance / `JITTER`)² / 2). A vendor sees the higher of two
    echoes that are equally near.

    Returns the return of every echo or -1, and the distance of the nearest return of its pulse [ns], else infinite.
    """
    matched, gap = np.full(len(pulse), -1), np.full(len(pulse), np.inf)
    order = np.argsort(return_pulse, kind="stable")
    first = np.searchsorted(return_pulse[order], pulse, "left")
    count = np.searchsorted(return_pulse[order], pulse, "right") - first
    echo = np.repeat(np.arange(len(pulse)), count)
    back = order[np.arange(len(echo)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)]
    apart = np.abs(time[echo] - return_time[back])
    np.minimum.at(gap, echo, apart)
    near = np.flatnonzero(apart <= within)
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.log(height[echo[near]]) - 0.5 * (apart[near] / JITTER) ** 2
    near = near[np.argsort(-score, kind="stable")]
    echo, back = echo[near], back[near]
    used = np.zeros(len(return_pulse), bool)
    while len(echo):
        mutual = np.zeros(len(echo), bool)
        mutual[np.unique(echo, return_index=True)[1]] = True
        sole = np.zeros(len(echo), bool)
        sole[np.unique(back, return_index=True)[1]] = True
        sure = mutual & sole
        matched[echo[sure]], used[back[sure]] = back[sure], True
        left = (matched[echo] < 0) & ~used[back]
        echo, back = echo[left], back[left]
    return matched, gap
