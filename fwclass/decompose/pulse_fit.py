"""One waveform to its echoes: peaks, fit, a second look, pruning, standard errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.fitted_echoes import (
    by_time,
    flags_of,
    least_known,
    leave_out,
    mark_dropped,
    rms_near,
    standard_errors,
    weakest,
)
from fwclass.decompose.least_squares import fit, lay, less, moments
from fwclass.decompose.peaks import BINS, first_echoes, level_and_noise, match_filter, surer
from fwclass.decompose.sample_weights import highest_sample, load_samples, weigh_doubt, weigh_samples, whiten
from fwclass.decompose.second_look import posterior, second_look
from fwclass.kernel import inlined, kernel
from fwclass.units import FWHM_PER_SIGMA

PRUNE = 0.8
"""Share of the detection threshold below which a fitted echo goes: a wide one is surer than its peak."""
WEAK = 0.1
"""Information of the level's prior where the receiver is not known, in samples."""
HIGHEST, HIGHEST_SATURATED = 1.25, 10.0
"""An echo is at most this many times as high as the highest sample; where samples are saturated, as the range."""
CLIPPED = 0.85
"""Degrees of freedom of the clipped estimate of the noise, per sample kept; measured on noise alone."""
USUAL = 72.0
"""Samples of a waveform that `detection` is meant for; more samples are more chances, and a threshold z becomes
sqrt(z^2 + 2 ln(n / USUAL)), which keeps the false echoes of a waveform as rare."""
FEWEST = 5
"""Samples without which nothing is fitted."""


class Kind(NamedTuple):
    """What kind of noise a channel has.

    Attributes
    ----------
    phi : coefficients of its autoregression; empty: white.
    level : what a level of 1 is in the samples made white.
    innovation : variance of those samples over the noise's.
    spread : samples that tell as much of the noise's variance as one white one.
    growth : what a DN of signal adds to the variance [DN].
    """

    phi: NDArray[np.float64]
    level: float
    innovation: float
    spread: float
    growth: float


class Echoes(NamedTuple):
    """Room for the echoes of a batch, one after the other; times and widths in samples."""

    row: NDArray[np.int64]
    amplitude: NDArray[np.float64]
    time: NDArray[np.float64]
    width: NDArray[np.float64]
    amplitude_sigma: NDArray[np.float64]
    time_sigma: NDArray[np.float64]
    width_sigma: NDArray[np.float64]
    deviation: NDArray[np.float64]
    flags: NDArray[np.uint8]


@inlined
def fit_pulse(  # type: ignore[no-untyped-def]
    samples, first, n, top, doubt, channel, kind, settings, most, look, p, errors, y, white, weight, bins, work, spare
):
    """Echoes of one waveform into `p`, sorted by time, level less the returned base, and their standard errors into
    `errors`: (count, base, noise, misfit).

    `doubt` is variance that every sample has beside the noise's [DN^2], (n,), or empty.
    `channel` is (baseline, its standard deviation, noise, freedom) of the receiver; freedom 0 where it is unknown.
    `kind` is `Kind` of its noise. Samples `y` of correlated noise are fitted as `white`, with a level times
    ``kind.level``, and so `p` has it.
    """
    residual, basis, window = work[0], work[1], work[2]
    filtered = spare[1]
    level, noise, kept = level_and_noise(samples, first, n, settings.noise_floor, bins)
    quiet = CLIPPED * max(kept - 1.0, 0.0) / kind.spread
    variance = noise * noise * kind.innovation
    known = (channel[2] * channel[2] * kind.innovation, channel[3], settings.noise_floor * settings.noise_floor)
    prior_level, information = level, WEAK
    if channel[3] > 0.0:
        variance = (known[0] * known[1] + variance * quiet) / (known[1] + quiet)
        quiet += known[1]
        prior_level, information = channel[0], _information(variance, channel[1] * kind.level)
        level = (level * kept + prior_level * information) / (kept + information)
    p[0] = level * kind.level
    noise = math.sqrt(variance)
    marginal = noise / math.sqrt(kind.innovation)
    if n < FEWEST:
        return 0, 0.0, marginal, np.nan
    base = math.floor(level)
    level -= base
    p[0] = level * kind.level
    pad = look.before + 2
    used = load_samples(samples, first, n, base, pad, look.after + 2, top, y, weight)
    if len(kind.phi) > 0:
        used = whiten(y, weight, pad, n, look.after + 2, used, kind.phi, white)
    longer = math.log(max(n * look.chances / USUAL, 1.0))
    detection = surer(math.sqrt(settings.detection**2 + 2.0 * longer), quiet)
    threshold = detection * noise / math.sqrt(look.energy)
    less(white[pad:], p[0], n, residual[pad:])
    # profiles of the waveform before have reached into the padding; what nothing was foretold from says nothing
    residual[: pad + len(kind.phi)] = 0.0
    residual[pad + n : pad + n + look.after + 2] = 0.0
    match_filter(residual, pad, n, look.template, look.template_first, filtered)
    count = first_echoes(
        filtered,
        n,
        threshold,
        settings.further * threshold,
        settings.sigma,
        look.response,
        look.response_first,
        look.starts,
        min(most, max((used - 2) // 3, 0)),
        p,
    )
    if count == 0:
        return 0, base, marginal, np.nan
    if settings.shape_error > 0.0 or kind.growth > 0.0:
        weigh_samples(y[pad:], n, level, variance, settings.shape_error, kind.growth * kind.innovation, weight[pad:])
    if len(doubt) > 0:
        weigh_doubt(doubt, n, variance, kind.innovation, weight[pad:])
    sums = moments(white, weight, pad, n)
    highest = highest_sample(y, pad, n) - level
    highest = HIGHEST_SATURATED * (top - base) if used < n else settings.between * highest + 5.0 * marginal
    prior = ((prior_level - base) * kind.level, information)
    limits = (settings.narrowest, settings.widest, settings.iterations, settings.tolerance * variance, highest)
    chi = fit(p, count, white, weight, pad, n, prior, limits, look, sums, work)
    count, chi = second_look(
        p,
        count,
        chi,
        white,
        weight,
        pad,
        n,
        prior,
        limits,
        float(used),
        (variance, quiet),
        known,
        settings,
        most,
        look,
        sums,
        work,
        spare,
    )
    while count > 0:
        final, freedom = posterior(chi, used - 3.0 * count - 1.0, known)
        least, k = weakest(p, count, weight, basis, window, math.sqrt(final))
        if least >= PRUNE * surer(settings.detection, freedom):
            break
        count = leave_out(p, count, k)
        if count > 0:
            chi = fit(p, count, white, weight, pad, n, prior, limits, look, sums, work)
            lay(p, count, white, pad, n, look, residual, basis, window)
    if count == 0:
        return 0, base, marginal, np.nan
    if by_time(p, count):
        lay(p, count, white, pad, n, look, residual, basis, window)
    while True:
        freedom = max(used - 3.0 * count - 1.0, 1.0)
        misfit = chi / (freedom * variance)
        final, freedom = posterior(chi, freedom, known)
        information = WEAK
        if channel[3] > 0.0:
            information = _information(final, channel[1] * kind.level)
        standard_errors(p, count, weight, math.sqrt(final), information, sums, work, errors)
        k = least_known(p, count, n, errors) if count > 1 else -1
        if k < 0:
            break
        count = leave_out(p, count, k)
        chi = fit(p, count, white, weight, pad, n, prior, limits, look, sums, work)
        lay(p, count, white, pad, n, look, residual, basis, window)
    return count, base, math.sqrt(final / kind.innovation), misfit


@inlined
def _information(variance, sd):  # type: ignore[no-untyped-def]
    """Information of a level known to `sd`, in samples of noise of this variance."""
    return variance / max(sd * sd, 1e-4 * variance)


@inlined
def _write(echoes, at, row, p, errors, k):  # type: ignore[no-untyped-def]
    """Echo k of waveform `row`, and its standard errors, at place `at` of `echoes`."""
    a = 3 * k + 1
    echoes.row[at] = row
    echoes.amplitude[at], echoes.time[at], echoes.width[at] = p[a], p[a + 1], p[a + 2]
    echoes.amplitude_sigma[at], echoes.time_sigma[at], echoes.width_sigma[at] = errors[a], errors[a + 1], errors[a + 2]


@inlined
def _buffers(most, length, look, correlated):  # type: ignore[no-untyped-def]
    """Room for one waveform of up to `length` samples and `most` echoes, of `correlated` noise or white."""
    size, padded = 3 * most + 1, length + look.before + look.after + 4
    work = (
        np.zeros(padded),
        np.empty((most, 3, look.table.shape[2])),
        np.zeros((most, 4), np.int64),
        np.empty((size, size)),
        np.empty(size),
        np.empty((size, size)),
        np.empty(size),
        np.empty(size),
        np.zeros(size),
    )
    spare = (np.zeros(padded), np.empty(length), np.empty(size), np.empty(size), np.zeros(most, np.bool_))
    y, weight, p, errors = np.zeros(padded), np.zeros(padded), np.empty(size), np.empty(size)
    white = np.zeros(padded) if correlated else y
    bins, drop = np.empty((3, BINS + 1), np.int32), np.zeros(most, np.bool_)
    return p, errors, y, white, weight, bins, drop, work, spare


@kernel
def fit_all(  # type: ignore[no-untyped-def]
    samples,
    offsets,
    rows,
    top,
    doubt,
    channels,
    channel_of,
    kind,
    settings,
    most,
    length,
    look,
    count,
    baseline,
    noise,
    misfit,
    echoes,
):
    """The waveforms `rows` of a batch, all of one sample spacing and kind of noise; how many echoes.

    Parameters
    ----------
    samples, offsets : ragged samples [DN].
    top : saturation per waveform [DN].
    doubt : variance of every sample beside the noise's [DN^2], or empty.
    channels, channel_of : (c, 4) baseline, its standard deviation, noise [DN] and freedom of the receiver's channels,
        and every waveform's channel; the last is all zeros: unknown.
    kind : `Kind` of their noise.
    settings : `Settings`.
    most, length : echoes at most; samples of the longest waveform.
    look : `Lookup`.
    count, baseline, noise, misfit : per waveform, filled at `rows`.
    echoes : `Echoes`, filled from the start in the order of `rows`.
    """
    p, errors, y, white, weight, bins, drop, work, spare = _buffers(most, length, look, len(kind.phi) > 0)
    pad = look.before + 2
    total = 0
    for w in rows:
        first, n = offsets[w], offsets[w + 1] - offsets[w]
        spare[0][pad + n : pad + n + look.after + 2] = 0.0
        own = doubt[first : first + n] if len(doubt) > 0 else doubt
        channel = channels[channel_of[w]]
        fitted, base, sigma, chi = fit_pulse(
            samples,
            first,
            n,
            top[w],
            own,
            channel,
            kind,
            settings,
            most,
            look,
            p,
            errors,
            y,
            white,
            weight,
            bins,
            work,
            spare,
        )
        baseline[w], noise[w], misfit[w] = p[0] / kind.level + base, sigma, chi
        if fitted == 0:
            count[w] = 0
            continue
        mark_dropped(p, fitted, n, settings.tail_share, settings.tail_reach, drop)
        written = total
        for k in range(fitted):
            if drop[k]:
                continue
            _write(echoes, total, w, p, errors, k)
            rms = rms_near(work[0], weight, pad, n, p[3 * k + 2], FWHM_PER_SIGMA * p[3 * k + 3])
            echoes.deviation[total] = 1000.0 * rms / (math.sqrt(kind.innovation) * p[3 * k + 1])
            echoes.flags[total] = flags_of(p, fitted, k, y, pad, n, top[w] - base, chi, settings.poor_misfit, drop)
            total += 1
        count[w] = total - written
        if total == written:
            misfit[w] = np.nan
    return total
