"""What every receiver channel records without echoes: level, noise, and how much they differ between waveforms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.decompose import pulse_scan
from fwclass.decompose.system_pulse import MOST_CHANNELS, Channel
from fwclass.units import SIGMA_PER_MAD
from fwclass.waveforms import Waveforms

Floats = NDArray[np.floating]

ROUNDING = 1.0 / math.sqrt(12.0)
"""Standard deviation of rounding to whole DN."""

MOST_FREEDOM = 1000.0
"""Degrees of freedom of a noise that varies between waveforms no more than chance lets it."""

FEWEST = 4
"""Samples that a waveform must have clear of echoes to count."""

FLAT, NEARLY, SHARE, MOST_EMPTY = 3, 0.97, 0.2, 100.0
"""A channel is clipped below its saturation if so many samples on end, in so large a share of the waveforms that come
near their highest value, stand at it; below a hundredth of the range nothing is clipped that does not rise steeply."""

STEEP, LEAST_CLIP = 5.0, 50.0
"""What the samples before that value are below it (median) where the range says little, as of tables that name no
limit, and the least such value [DN]: the top of a broad pulse, rounded, is as flat, but falls off by 3 DN at most."""

MANY = 8
"""Values of samples from which on a divisor that all have is no accident."""

PILE = 20, 4, 5.0
"""Pairs of samples at a limit, and how often it is there, over the most frequent of so many values below it."""

SWINGING = 1.5
"""From this ratio on what lies below the level is no noise; real receivers have 0.4 to 0.9 (Q680i, Leica, GeoLas)."""

PARTS, OF_PART = 8, 50
"""Parts along a strip whose noise is compared, and waveforms of each that are looked at, up to twice as many."""

QUANTILES, APART = (0.05, 0.25), 0.9704
"""Two of a waveform's samples, and how many deviations they are apart in a normal distribution."""

TRIM = 0.025
"""Share of the values on either side that is left out, or put onto the outermost inside."""

TRIM_LOSS = 0.7588
"""Variance of a normal distribution without its outer 2.5 % on both sides."""

WINSOR_LOSS = 0.9130
"""The same with the outer 2.5 % put onto the outermost inside."""


def channel_groups(waves: Waveforms) -> tuple[Floats, NDArray[np.int64]]:
    """The (spacing [ns], saturation [DN]) of the channels, shape (k, 2), and every waveform's channel.

    Of more than `MOST_CHANNELS` those with most waveforms are told apart; the others are -1.
    """
    keys = np.stack([waves.pulses["sample_spacing"], waves.pulses["saturation"]], axis=1).astype(np.float64)
    kinds, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    largest = np.sort(np.lexsort((np.arange(len(kinds)), -count))[:MOST_CHANNELS])
    place = np.full(len(kinds), -1)
    place[largest] = np.arange(len(largest))
    return kinds[largest], place[group.ravel()]


def clip_levels(waves: Waveforms, kinds: Floats, group: NDArray[np.int64]) -> Floats:
    """The highest value that every channel's samples reach [DN]: `saturation`, unless several waveforms stand at
    one lower value, and at none above it, for `FLAT` samples on end."""
    rows, samples = np.repeat(np.arange(waves.pulses.rows), np.diff(waves.offsets)), waves.samples
    levels = kinds[:, 1].copy()
    for k in range(len(kinds)):
        mine = group[rows] == k
        if not mine.any():
            continue
        top = samples[mine].max()
        flat = mine & (samples == top)
        for ahead in range(1, FLAT):
            flat[:-ahead] &= (samples[ahead:] == top) & (rows[ahead:] == rows[:-ahead])
            flat[-ahead:] = False
        reached = len(np.unique(rows[mine & (samples >= NEARLY * top)]))
        stopped = len(np.unique(rows[flat]))
        sure = top > levels[k] / MOST_EMPTY or (top > LEAST_CLIP and _rise(samples, rows, flat) >= STEEP)
        still = stopped >= FEWEST and stopped >= SHARE * reached and sure
        if still or (levels[k] > top > LEAST_CLIP and _piled(samples, rows, mine, int(top))):
            levels[k] = float(top)
    return levels


def sample_steps(waves: Waveforms, group: NDArray[np.int64], channels: int) -> Floats:
    """The greatest number of DN of which all samples of every channel are multiples, float64 (channels,), where these
    have `MANY` values or more; 1 of fewer. Saturated samples do not count."""
    row = np.repeat(np.arange(waves.pulses.rows), np.diff(waves.offsets))
    below = waves.samples < waves.pulses["saturation"][row]
    steps = np.ones(channels)
    for k in range(channels):
        values = np.unique(waves.samples[below & (group[row] == k)]).astype(np.int64)
        if len(values) >= MANY:
            steps[k] = max(int(np.gcd.reduce(values)), 1)
    return steps


def in_steps(waves: Waveforms, step: Floats) -> Waveforms:
    """`waves` whose samples are counted in steps, (waveforms,) [DN], as are their limits; part of a step is one."""
    if not (step > 1.0).any():
        return waves
    each = np.repeat(step, np.diff(waves.offsets)).astype(np.int64)
    samples = (-(-waves.samples.astype(np.int64) // each)).astype(np.uint16)
    limit = waves.pulses["saturation"] / step
    return replace(waves, samples=samples, pulses=waves.pulses.with_columns({"saturation": limit}))


def _piled(samples: NDArray[np.integer], rows: NDArray[np.int64], mine: NDArray[np.bool_], top: int) -> bool:
    """Whether far more samples of `mine` have the value `top` than any of the next lower ones, as where a few echoes
    barely reach a limit, in pairs and after a steep rise."""
    there = mine & (samples == top)
    pairs = there.copy()
    pairs[:-1] &= there[1:] & (rows[1:] == rows[:-1])
    pairs[-1:] = False
    if pairs.sum() < PILE[0]:
        return False
    _, count = np.unique(samples[mine & (samples < top) & (samples >= top // 2)], return_counts=True)
    below = count[-PILE[1] :].max(initial=0)
    return bool(there.sum() >= PILE[2] * below and _rise(samples, rows, pairs) >= STEEP)


def _rise(samples: NDArray[np.integer], rows: NDArray[np.int64], flat: NDArray[np.bool_]) -> float:
    """Median step up to where samples stand still [DN], where one is before them; 0 without any."""
    at = np.flatnonzero(flat[1:] & ~flat[:-1] & (rows[1:] == rows[:-1])) + 1
    steps = samples[at].astype(np.float64) - samples[at - 1]
    return float(np.median(steps)) if len(steps) else 0.0


def rough_levels(waves: Waveforms, group: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Level of every waveform, and the median noise of its channel, [DN].

    Noise is what lies below the level, for echoes lie above. Where that is far more than what most samples differ from
    it by, the receiver swings below its level behind echoes, and the latter counts.
    """
    level, spread = np.empty(waves.pulses.rows), np.empty(waves.pulses.rows)
    pulse_scan.levels(waves.wide, waves.offsets, level, spread)
    noise = np.full(len(level), ROUNDING)
    for k in range(group.max(initial=-1) + 1):
        rows = (group == k) & np.isfinite(spread)
        if rows.any():
            below, usual = float(np.median(spread[rows])), _usual_departure(waves, level, rows)
            noise[group == k] = max(usual if below > SWINGING * usual else below, ROUNDING)
    return level, noise


def noise_drift(waves: Waveforms) -> list[tuple[float, float]]:
    """(median number of the pulse, noise [DN]) of `PARTS` parts along the strip, of the commonest channel's waveforms;
    empty of fewer than `OF_PART` in a part.

    Mean distance of two low quantiles of a waveform's samples, as of normal ones: plants may fill most of a record.
    """
    _, group = channel_groups(waves)
    known, length = group >= 0, np.diff(waves.offsets)
    usual = np.bincount(group[known]).argmax() if known.any() else -1
    rows = np.flatnonzero(known & (group == usual) & (length > 0))
    if len(rows) < PARTS * OF_PART:
        return []
    parts = []
    for part in np.array_split(rows[np.argsort(waves.pulses["pulse"][rows], kind="stable")], PARTS):
        some = part[:: len(part) // OF_PART]
        each = [np.quantile(waves.samples[waves.offsets[k] : waves.offsets[k + 1]], QUANTILES) for k in some]
        noise = float((np.diff(each, axis=1) / APART).mean())
        parts.append((float(np.median(waves.pulses["pulse"][part])), max(noise, ROUNDING)))
    return parts


def _usual_departure(waves: Waveforms, level: Floats, rows: NDArray[np.bool_]) -> float:
    """Standard deviation about the level by the median departure of all samples of `rows` [DN], a step at least."""
    some = np.repeat(rows, np.diff(waves.offsets))
    apart = np.abs(waves.samples[some] - np.repeat(level, np.diff(waves.offsets))[some])
    return max(SIGMA_PER_MAD * float(np.median(apart)), 1.0)


def estimate_channels(
    waves: Waveforms, kinds: Floats, group: NDArray[np.int64], level: Floats, noise: Floats, fwhm: float, tail: float
) -> tuple[dict[int, Channel], Floats]:
    """Every channel with echo-free samples, by its number, and the level of every waveform on its own [DN].

    A waveform's own level is its mean where no echo reaches, drawn towards its channel's by their variances.
    """
    rows = waves.pulses.rows
    mean, variance, count = np.empty(rows), np.empty(rows), np.empty(rows, np.int64)
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    pulse_scan.echo_free(waves.wide, waves.offsets, spacing, level, noise, fwhm, tail, mean, variance, count)
    own = level.copy()
    channels = {}
    for k in range(len(kinds)):
        here = group == k
        clear = here & (count >= FEWEST)
        if clear.sum() < 2:
            continue
        channel = channel_from(kinds[k], mean[clear], variance[clear], count[clear])
        channels[k] = channel
        share = np.maximum(count[here], 1) / channel.noise**2
        prior = 1.0 / max(channel.baseline_sd, 1e-3) ** 2
        value = np.where(count[here] > 0, mean[here], channel.baseline)
        own[here] = (np.where(count[here] > 0, share, 0.0) * value + prior * channel.baseline) / (
            np.where(count[here] > 0, share, 0.0) + prior
        )
    return channels, own


def channel_from(kind: Floats, mean: Floats, variance: Floats, count: NDArray[np.int64]) -> Channel:
    """The channel of (spacing [ns], saturation [DN]) whose waveforms have these means and variances of so many quiet
    samples."""
    noise, freedom = prior_variance(variance, count - 1.0)
    noise = max(math.sqrt(noise), ROUNDING)
    order = np.sort(mean)
    cut = int(TRIM * len(order))
    inner = order[cut : len(order) - cut]
    between = float(inner.var()) / (TRIM_LOSS if cut else 1.0) - noise**2 * float((1.0 / count).mean())
    return Channel(
        sample_spacing=float(kind[0]),
        saturation=float(kind[1]),
        baseline=float(inner.mean()),
        baseline_sd=math.sqrt(max(between, 0.0)),
        noise=noise,
        freedom=freedom,
        clip=float(kind[1]),
    )


def prior_variance(variance: Floats, freedom: Floats) -> tuple[float, float]:
    """(s0², d0) of the scaled inverse chi-square that the true variances follow.

    `variance` holds sample variances of `freedom` degrees of freedom each. Moments of their logarithms, by Smyth
    2004, section 6.2; d0 is `MOST_FREEDOM` where they differ no more than chance lets them. Variances of constant
    samples count as half that of rounding, and the outer 2.5 % of the logarithms as the outermost inside.
    """
    half = 0.5 * freedom
    logs = np.log(np.maximum(variance, 0.5 * ROUNDING**2)) - scipy.special.digamma(half) + np.log(half)
    logs = np.clip(logs, *np.quantile(logs, [TRIM, 1.0 - TRIM]))
    centre = float(logs.mean())
    excess = float(logs.var(ddof=1)) / WINSOR_LOSS - float(scipy.special.polygamma(1, half).mean())
    if excess <= float(scipy.special.polygamma(1, 0.5 * MOST_FREEDOM)):
        return math.exp(centre), MOST_FREEDOM
    prior = 2.0 * _trigamma_inverse(excess)
    return math.exp(centre + float(scipy.special.digamma(0.5 * prior)) - math.log(0.5 * prior)), prior


def _trigamma_inverse(x: float) -> float:
    """y > 0 with trigamma(y) = x > 0, by Newton's method (Smyth 2004, appendix)."""
    y = 0.5 + 1.0 / x
    for _ in range(50):
        value = float(scipy.special.polygamma(1, y))
        step = value * (1.0 - value / x) / float(scipy.special.polygamma(2, y))
        y += step
        if abs(step) < 1e-8 * y:
            break
    return y
