"""Waveforms to echoes: a batch of waveforms in, flat arrays of echoes out."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.autoregression import WHITE, Autoregression
from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.least_squares import add_echoes
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_channels import in_steps
from fwclass.decompose.pulse_fit import FEWEST, HIGHEST, Echoes, Kind, fit_all
from fwclass.decompose.second_look import Settings
from fwclass.decompose.shapes import Lookup, Profiles, Widths, fits_spacing, lookup, widths_of
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.schema import Table
from fwclass.units import FWHM_PER_SIGMA
from fwclass.waveforms import Waveforms

SPARED = 4
"""One of so many samples of a waveform may be spent on foretelling the others."""
LONGEST = 64
"""Samples after which noise has forgotten itself."""
AT_A_TIME = 4_000
"""Waveforms that one call of the kernel fits, some tenths of a second: between two calls an interrupt is heeded."""


NOTHING: NDArray[np.float64] = np.empty(0)


@dataclass(frozen=True)
class Fits:
    """Echoes of a batch of waveforms.

    Attributes
    ----------
    count : echoes of every waveform, shape (n,).
    baseline, noise : level and standard deviation of the noise [DN], shape (n,).
    misfit : reduced chi-square, NaN without echoes, shape (n,).
    row : waveform of every echo, shape (m,); echoes are ordered by (row, time).
    amplitude : height of the peak [DN].
    time : [ns] from the waveform's first sample.
    width : full width at half maximum [ns].
    energy : area under the echo [DN ns].
    amplitude_sigma, time_sigma, width_sigma : standard errors [DN, ns, ns].
    deviation : 1000 times the root mean square residual within one FWHM of the echo, over its amplitude.
    flags : sum of 1 saturated, 2 overlapping, 4 poor fit, 8 at the segment's edge.
    """

    count: NDArray[np.int64]
    baseline: NDArray[np.float64]
    noise: NDArray[np.float64]
    misfit: NDArray[np.float64]
    row: NDArray[np.int64]
    amplitude: NDArray[np.float64]
    time: NDArray[np.float64]
    width: NDArray[np.float64]
    energy: NDArray[np.float64]
    amplitude_sigma: NDArray[np.float64]
    time_sigma: NDArray[np.float64]
    width_sigma: NDArray[np.float64]
    deviation: NDArray[np.float64]
    flags: NDArray[np.uint8]


def fit_waveforms(
    waves: Waveforms, params: DecomposeParams, pulse: SystemPulse, doubt: NDArray[np.float64] = NOTHING
) -> Fits:
    """Decompose every waveform into echoes of the system's pulse, widened.

    Every waveform is fitted alone: neither its neighbours nor their order change its numbers.

    Parameters
    ----------
    waves : samples with their spacing and saturation; nothing else of the pulses is read.
    params : `DecomposeParams`.
    pulse : the system's pulse; where one of its `channels` recorded a waveform (`channel_rows`), that channel's own
        pulse counts, and its level and noise are prior knowledge for the waveform's.
    doubt : variance that every sample has beside the noise's [DN^2], float64 (samples,), or empty.

    Returns
    -------
    `Fits`. A waveform without echoes counts 0; one whose sample spacing is not positive, or not of the pulse's order
    of magnitude, counts 0 and has NaN level and noise.
    """
    n, most = waves.pulses.rows, params.max_echoes
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    channels, values, channel_of = channels_of(pulse, waves.pulses)
    top = sample_limits(waves, pulse)
    steps, channel_of = _steps_of(waves, top, channels, channel_of)
    waves, top = in_steps(waves, steps), top / steps
    values[:-1, :3] /= np.array([[c.step] for c in channels] or np.empty((0, 1)))
    count, row_values = np.zeros(n, np.int64), np.full((3, n), np.nan)
    lengths = np.diff(waves.offsets)
    parts, samples = [], waves.wide
    for rows, step, channel, order in rows_by_kind(spacing, lengths, channel_of, channels, pulse):
        noise, own = channel.autoregression.shorter(order) if channel else WHITE, pulse.of(channel)
        look = lookup(own, step, params.narrowest, params.widest, noise)
        widths = widths_of(own, params.narrowest, params.widest)
        for first in range(0, len(rows), AT_A_TIME):
            some = rows[first : first + AT_A_TIME]
            echoes = _room(len(some) * most)
            total = fit_all(
                samples,
                waves.offsets,
                some,
                top,
                doubt,
                values,
                channel_of,
                kind_of(noise, channel.growth / channel.step if channel else 0.0),
                _settings(params, pulse, channel, step, look),
                most,
                int(lengths[some].max()),
                look,
                count,
                *row_values,
                echoes,
            )
            parts.append(_in_ns(echoes, total, float(step), widths))
    fits = _gather(count, row_values, parts)
    return _in_dn(fits, steps) if (steps > 1.0).any() else fits


def _steps_of(
    waves: Waveforms, top: NDArray[np.float64], channels: list[Channel], channel_of: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The step of every waveform's samples [DN], and its channel: an unknown one where some are no multiples of it."""
    steps = np.array([c.step for c in channels] + [1.0])[channel_of]
    if not (steps > 1.0).any():
        return steps, channel_of
    row = np.repeat(np.arange(len(steps)), np.diff(waves.offsets))
    odd = (waves.samples % steps[row].astype(np.int64) != 0) & (waves.samples < top[row])
    other = np.bincount(row[odd], minlength=len(steps)) > 0
    return np.where(other, 1.0, steps), np.where(other, len(channels), channel_of)


def _in_dn(fits: Fits, steps: NDArray[np.float64]) -> Fits:
    """`fits` of samples that were counted in `steps`, (waveforms,) [DN]."""
    own = steps[fits.row]
    return replace(
        fits,
        baseline=fits.baseline * steps,
        noise=fits.noise * steps,
        amplitude=fits.amplitude * own,
        energy=fits.energy * own,
        amplitude_sigma=fits.amplitude_sigma * own,
    )


def rows_by_kind(
    spacing: NDArray[np.float64],
    lengths: NDArray[np.int64],
    channel_of: NDArray[np.int64],
    channels: list[Channel],
    pulse: SystemPulse,
) -> Iterator[tuple[NDArray[np.int64], float, Channel | None, int]]:
    """int64 (rows,) of waveforms that are fitted in one way, their sample spacing, their channel where it is special,
    and from how many samples it is foretold: as many as the waveform can spare at its start. Rows whose spacing does
    not fit their pulse are left out."""
    special = np.array([c.special for c in channels] + [False])
    own = np.where(special[channel_of], channel_of, len(channels))
    most = np.array([len(c.phi) for c in channels] + [0])[own]
    order = np.clip((lengths - FEWEST) // SPARED, 0, most)
    for rows in _alike_rows(spacing, own, order):
        step, k, m = spacing[rows[0]], own[rows[0]], order[rows[0]]
        channel = channels[k] if k < len(channels) else None
        if fits_spacing(pulse.of(channel), spacing[rows[:1]])[0]:
            yield rows, float(step), channel, int(m)


def _alike_rows(*keys: NDArray[Any]) -> Iterator[NDArray[np.int64]]:
    """Rows that agree in all `keys`, each of shape (n,)."""
    group = np.zeros(len(keys[0]), np.int64)
    for key in keys:
        if len(key) and (key != key[0]).any():
            values, inverse = np.unique(key, return_inverse=True)
            group = group * len(values) + inverse
    order = np.argsort(group, kind="stable")
    yield from (r for r in np.split(order, np.flatnonzero(np.diff(group[order])) + 1) if len(r))


def kind_of(noise: Autoregression, growth: float) -> Kind:
    """`Kind` of a channel whose noise is correlated as `noise`, and grows by `growth` a DN of signal [DN]."""
    phi, correlation = np.array(noise.phi), noise.correlation(LONGEST if noise.phi else 0)
    spread = float(2.0 * (correlation @ correlation) - 1.0)
    return Kind(phi, 1.0 - float(phi.sum()), noise.innovation, spread, growth)


def further_share(channel: Channel | None, params: DecomposeParams) -> float:
    """Share of the threshold, 0 to 1, that a further echo of a waveform must reach.

    Where single echoes of its `channel` leave more than noise (`Channel.misfit`), it is as much higher; 1 where nothing
    is known of that, and where the noise is correlated: its likeness to echoes is what a strip's sample knows least.
    """
    if channel is None or channel.misfit is None or channel.phi:
        return 1.0
    return min(params.further_detection * math.sqrt(max(channel.misfit, 1.0)), 1.0)


def _settings(
    params: DecomposeParams, strip: SystemPulse, channel: Channel | None, spacing: float, look: Lookup
) -> Settings:
    pulse = strip.of(channel)
    sigma = pulse.fwhm / (FWHM_PER_SIGMA * spacing)
    return Settings(
        detection=params.detection,
        split_gain=params.split_gain,
        narrowest=params.narrowest * sigma,
        widest=params.widest * sigma,
        separation=params.separation / spacing,
        noise_floor=params.noise_floor,
        shape_error=pulse.shape_error * look.pulse_gain,
        poor_misfit=params.poor_misfit,
        iterations=params.iterations,
        tolerance=params.tolerance,
        tail_share=params.tail_share,
        tail_reach=params.tail_reach / spacing,
        sigma=sigma,
        between=HIGHEST * 2.0 ** (spacing / pulse.fwhm) ** 2,
        further=further_share(channel, params),
    )


def channels_of(pulse: SystemPulse, pulses: Table) -> tuple[list[Channel], NDArray[np.float64], NDArray[np.int64]]:
    """The receiver's channels, also as (c + 1, 4) numbers, the last for an unknown channel; every row's channel."""
    channels = [c for c in pulse.channels if c.freedom > 0.0]
    values = [(c.baseline, c.baseline_sd, c.noise, c.freedom) for c in channels]
    return channels, np.array([*values, (0.0, 0.0, 0.0, 0.0)]), channel_rows(channels, pulses)


def sample_limits(waves: Waveforms, pulse: SystemPulse) -> NDArray[np.float64]:
    """The highest value that every waveform's samples can reach [DN]: the saturation, or its channel's clip level where
    that is lower; infinite where neither is known."""
    saturation = waves.pulses["saturation"].astype(np.float64)
    clip = np.array([c.clip for c in pulse.channels] + [np.inf])[channel_rows(pulse.channels, waves.pulses)]
    return np.minimum(np.where(np.isnan(saturation), np.inf, saturation), clip)


def _room(capacity: int) -> Echoes:
    """Room for echoes; pages that are never written cost nothing."""
    a, t, w, da, dt, dw, deviation = (np.empty(capacity) for _ in range(7))
    return Echoes(np.empty(capacity, np.int64), a, t, w, da, dt, dw, deviation, np.empty(capacity, np.uint8))


def _in_ns(echoes: Echoes, total: int, spacing: float, widths: Widths) -> tuple[Echoes, NDArray[np.float64]]:
    """The filled part, in ns, with widths as full width at half maximum; and the echoes' areas [DN ns]."""
    timed = ("time", "width", "time_sigma", "width_sigma")
    e = Echoes(**{n: getattr(echoes, n)[:total] * (spacing if n in timed else 1) for n in echoes._fields})
    slope = np.interp(e.width, widths.s, np.gradient(widths.fwhm, widths.s))
    energy = e.amplitude * np.interp(e.width, widths.s, widths.area)
    return e._replace(width=np.interp(e.width, widths.s, widths.fwhm), width_sigma=e.width_sigma * slope), energy


def _gather(
    count: NDArray[np.int64], row_values: NDArray[np.float64], parts: list[tuple[Echoes, NDArray[np.float64]]]
) -> Fits:
    """Echoes of all parts by row."""
    parts = parts or [(_room(0), np.empty(0))]
    columns = {name: np.concatenate([getattr(e, name) for e, _ in parts]) for name in Echoes._fields}
    columns["energy"] = np.concatenate([energy for _, energy in parts])
    if len(parts) > 1:
        order = np.argsort(columns["row"], kind="stable")
        columns = {name: values[order] for name, values in columns.items()}
    baseline, noise, misfit = row_values
    return Fits(count=count, baseline=baseline, noise=noise, misfit=misfit, **columns)


def signal_of(fits: Fits, waves: Waveforms, pulse: SystemPulse, params: DecomposeParams) -> NDArray[np.float64]:
    """The sum of the fitted echoes at every sample, without the level [DN]; shape of ``waves.samples``."""
    signal = np.zeros(len(waves.samples))
    spacing = waves.pulses["sample_spacing"].astype(np.float64)[fits.row]
    kinds, _, kind = pulses_of(waves, pulse)
    for rows in _alike_rows(spacing, kind[fits.row]):
        step, own = spacing[rows[0]], kinds[kind[fits.row[rows[0]]]]
        widths = widths_of(own, params.narrowest, params.widest)
        width = np.interp(fits.width[rows], widths.fwhm, widths.s)
        add_echoes(
            fits.amplitude[rows],
            fits.time[rows] / step,
            width / step,
            waves.offsets[fits.row[rows]],
            waves.offsets[fits.row[rows] + 1],
            lookup(own, float(step), params.narrowest, params.widest),
            signal,
        )
    return signal


def pulses_of(
    waves: Waveforms, pulse: SystemPulse
) -> tuple[list[SystemPulse], list[Channel | None], NDArray[np.int64]]:
    """The pulses of the channels, the strip's last; their channels, of that one None; and int64 (waveforms,): which of
    them each is fitted with."""
    known, _, channel_of = channels_of(pulse, waves.pulses)
    channels = [*known, None]
    return [pulse.of(channel) for channel in channels], channels, channel_of


def model_of(
    fits: Fits, row: int, n_samples: int, spacing: float, pulse: SystemPulse
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The fitted sum (n_samples,) with the level, and every echo's own curve (k, n_samples) without it [DN]; `pulse` is
    the row's.

    Independent of the fit's table: the profiles are made anew for the echoes' widths.
    """
    first, last = np.searchsorted(fits.row, [row, row + 1])
    curves = np.zeros((last - first, n_samples))
    if last > first:
        profiles = Profiles(pulse)
        ratio = fits.width[first:last] / pulse.fwhm
        widths = widths_of(pulse, 0.9 * float(ratio.min()), 1.2 * float(ratio.max()))
        for k, i in enumerate(range(first, last)):
            s = float(np.interp(fits.width[i], widths.fwhm, widths.s))
            # a fine grid whose points fall on the samples
            fine = max(round(60.0 * spacing / profiles.s0), 1)
            whole = math.floor(fits.time[i] / spacing * fine)
            h = profiles.at(s, -whole - fine, fine * (n_samples + 1) + 2, spacing / fine)
            at = fine * np.arange(n_samples) + fine - (fits.time[i] / spacing * fine - whole)
            curves[k] = fits.amplitude[i] * np.interp(at, np.arange(len(h)), h)
    return fits.baseline[row] + curves.sum(axis=0), curves
