"""What the receiver makes of a pulse's hits: waveform, samples, on-board returns, and the true echoes beside."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.simulate.echoes import cluster, peak, sort_hits
from fwclass.simulate.noise import NOISE_STREAM, NORMAL_SHIFT, SHOT_STREAM, draw, pulse_key
from fwclass.simulate.scene import in_gap
from fwclass.simulate.trace import trace
from fwclass.units import FWHM_PER_SIGMA

MAX_RETURNS = 7
"""Most returns of a pulse that point formats 1 to 5 can number."""

_S12 = np.uint64(12)
_EDGE = 0.5

SHAPE_STEP = 1.0 / 64.0
"""Step of a tabulated pulse [ns]; between its values the pulse is a straight line (1e-4 of the height at 1 ns FWHM)."""

UNSEEN, CUT, SILENT, RECORDED = 0, 1, 2, 3
"""Fate of a pulse: nothing to see, outside the survey, seen but without an on-board return, in the file."""


class Receiver(NamedTuple):
    """The sensor's numbers as the kernels need them; times in ns, levels in DN.

    `gain` turns energies into DN of the echo's peak; `radius` is the beam's 1/e² half-angle [rad].
    `sigma` is the Gaussian of the pulse's FWHM. `shape` is the pulse from `shape_first` after its peak on, every
    `SHAPE_STEP`, 1 at the peak; empty where the pulse is that Gaussian.
    """

    metres: float
    sigma: float
    shape: np.ndarray
    shape_first: float
    radius: float
    gain: float
    jitter: float
    baseline: float
    noise: float
    top: float
    short: int
    long: int
    lead: int
    tail: int
    detection: float
    dip: float
    separation: float
    visible: float


def pulse_shape(width: float, skew: float, ringing: float, delay: float) -> tuple[NDArray[np.float64], float, float]:
    """A Gaussian of FWHM `width` convolved with exp(-t / skew), then `ringing` of it again after `delay`; all [ns].

    Returns
    -------
    shape : heights every `SHAPE_STEP`, 1 at the peak; empty if there is neither tail nor ringing.
    first : time of ``shape[0]`` after the peak [ns].
    sigma : standard deviation of the Gaussian of the same FWHM [ns].
    """
    sigma = width / FWHM_PER_SIGMA
    if skew == 0.0 and ringing == 0.0:
        return np.empty(0), 0.0, sigma
    from scipy.stats import exponnorm  # its import takes most of a second, and is not needed to plan

    time = SHAPE_STEP * np.arange(-round(6.0 * sigma / SHAPE_STEP), round((6.0 * sigma + 15.0 * skew) / SHAPE_STEP))
    lobe = exponnorm.pdf(time, skew / sigma, scale=sigma) if skew > 0.0 else np.exp(-0.5 * (time / sigma) ** 2)
    lobe /= lobe.max()
    gap = round(delay / SHAPE_STEP) if ringing > 0.0 else 0
    shape = np.concatenate([lobe, np.zeros(gap)])
    shape[gap:] += ringing * lobe if gap else 0.0
    peak = int(shape.argmax())
    above = np.flatnonzero(shape >= 0.5 * shape[peak])
    fwhm = float(np.count_nonzero(np.diff(above) == 1)) * SHAPE_STEP
    return shape / shape[peak], float(-peak * SHAPE_STEP), fwhm / FWHM_PER_SIGMA


class Workspace(NamedTuple):
    """Room for one pulse; `echo` holds time, energy, variance and first hit."""

    candidates: np.ndarray
    range: np.ndarray
    energy: np.ndarray
    code: np.ndarray
    echo: np.ndarray
    echo_code: np.ndarray
    totals: np.ndarray
    wave: np.ndarray


def workspace(rays: int, long: int, candidates: int) -> Workspace:
    """Scratch of one thread for at most `rays` a pulse, waves of `long` [samples] and so many `candidates` a ray; all
    zero."""
    return Workspace(
        candidates=np.zeros(candidates, np.int64),
        range=np.zeros(rays),
        energy=np.zeros(rays),
        code=np.zeros(rays, np.int64),
        echo=np.zeros((rays, 4)),
        echo_code=np.zeros(rays, np.int64),
        totals=np.zeros(256),
        wave=np.zeros(long),
    )


@kernel
def add_pulse(wave, mean, amplitude, sigma):  # type: ignore[no-untyped-def]
    """Add a Gaussian at `mean` with `sigma` [samples] to `wave` (samples,), within ±5 sigma, by the recurrence of its
    ratios."""
    n = len(wave)
    reach = int(5.0 * sigma) + 1
    centre = int(math.floor(mean + 0.5))
    d = (centre - mean) / sigma
    value = amplitude * math.exp(-0.5 * d * d)
    half, square, lean = (math.exp(-0.5 / (sigma * sigma)), math.exp(-1.0 / (sigma * sigma)), math.exp(-d / sigma))
    g, ratio = value, half * lean
    for i in range(centre, centre + reach + 1):
        if 0 <= i < n:
            wave[i] += g
        g *= ratio
        ratio *= square
    ratio = half / lean
    g = value * ratio
    ratio *= square
    for i in range(centre - 1, centre - reach - 1, -1):
        if 0 <= i < n:
            wave[i] += g
        g *= ratio
        ratio *= square


@kernel
def add_shape(wave, mean, amplitude, shape, first):  # type: ignore[no-untyped-def]
    """Add the tabulated pulse `shape`, its peak at `mean` samples of 1 ns, to `wave`."""
    last = first + (len(shape) - 1) * SHAPE_STEP
    for i in range(max(int(math.ceil(mean + first)), 0), min(int(math.floor(mean + last)) + 1, len(wave))):
        at = (i - mean - first) / SHAPE_STEP
        k = min(max(int(at), 0), len(shape) - 2)
        wave[i] += amplitude * (shape[k] + (at - k) * (shape[k + 1] - shape[k]))


@kernel
def digitise(wave, key, normal, noise, baseline, top, samples):  # type: ignore[no-untyped-def]
    """Add baseline and noise, round to whole DN, clip to [0, top]; five noise values per random number."""
    bits = np.uint64(0)
    for i in range(len(wave)):
        if i % 5 == 0:
            bits = draw(key, NOISE_STREAM + i)
        value = wave[i] + baseline + noise * normal[bits >> NORMAL_SHIFT]
        bits = bits << _S12
        samples[i] = int(min(max(math.floor(value + 0.5), 0.0), top))


@kernel
def detect(samples, baseline, threshold, dip, location, height):  # type: ignore[no-untyped-def]
    """On-board returns: peaks of `samples` (samples,) [counts] above `threshold` that are parted by a fall and a rise
    of `dip`; their number.

    The `location` [samples] is the centre of gravity of the five samples around the peak, `height` [counts] its top
    above the baseline.
    """
    n = len(samples)
    count, rising = 0, True
    top, at, low = -1.0, 0, 0.0
    for i in range(n):
        y = samples[i] - baseline
        if rising:
            if y > top:
                top, at = y, i
            if y < top - dip or (i == n - 1 and at < n - 1):
                if top >= threshold and count < MAX_RETURNS:
                    weight, moment = 0.0, 0.0
                    for k in range(max(at - 2, 0), min(at + 3, n)):
                        w = max(samples[k] - baseline, 0.0)
                        weight += w
                        moment += w * k
                    location[count], height[count] = moment / weight, top
                    count += 1
                rising, low = False, y
        else:
            low = min(low, y)
            if y > low + dip:
                rising, top, at = True, y, i
    return count


@kernel
def _outside(scene, o, d, echo, count, metres):  # type: ignore[no-untyped-def]
    """Whether any echo lies beyond the survey area's edge or in its gap."""
    for k in range(count):
        r = echo[k, 0] * metres
        x, y = o[0] + r * d[0], o[1] + r * d[1]
        if min(x, y) < _EDGE or max(x, y) > scene.size - _EDGE or in_gap(scene.gap, x, y):
            return True
    return False


@kernel
def fly_chunk(scene, rays, rx, normal, seed, strip, first_pulse, origins, directions, work, out):  # type: ignore[no-untyped-def]
    """Trace, record and detect consecutive pulses of a strip; fills `out`, returns (samples, returns, echoes).

    A pulse depends on (seed, strip, its number) and its own geometry only.
    """
    n_samples, n_returns, n_echoes = 0, 0, 0
    for p in range(len(origins)):
        out.fate[p] = UNSEEN
        out.sample_start[p + 1] = n_samples
        out.return_start[p + 1] = n_returns
        out.echo_start[p + 1] = n_echoes
        key = pulse_key(seed, strip, first_pulse + p)
        o, d = origins[p], directions[p]
        hits = trace(scene, rays, rx.radius, normal, key, o, d, work.candidates, work.range, work.energy, work.code)
        shot = rx.gain * (1.0 + rx.jitter * normal[draw(key, SHOT_STREAM) >> NORMAL_SHIFT])
        for k in range(hits):
            work.range[k] /= rx.metres
            work.energy[k] *= shot
        sort_hits(hits, work.range, work.energy, work.code)
        count = cluster(
            work.range,
            work.energy,
            work.code,
            hits,
            rx.sigma,
            rx.separation,
            rx.visible,
            work.echo,
            work.echo_code,
            work.totals,
        )
        if count == 0:
            continue
        if _outside(scene, o, d, work.echo, count, rx.metres):
            out.fate[p] = CUT
            continue
        begin = int(math.floor(work.echo[0, 0])) - rx.lead
        length = rx.short
        if work.echo[count - 1, 0] - begin + rx.tail > rx.short:
            length = rx.long
        while count > 1 and work.echo[count - 1, 0] - begin + rx.tail > rx.long:
            count -= 1
        wave = work.wave[:length]
        wave[:] = 0.0
        for k in range(hits):
            if len(rx.shape) > 0:
                add_shape(wave, work.range[k] - begin, work.energy[k], rx.shape, rx.shape_first)
            else:
                add_pulse(wave, work.range[k] - begin, work.energy[k], rx.sigma)
        samples = out.samples[n_samples : n_samples + length]
        digitise(wave, key, normal, rx.noise, rx.baseline, rx.top, samples)
        detected = detect(samples, rx.baseline, rx.detection, rx.dip, out.location[n_returns:], out.height[n_returns:])
        if detected == 0:
            out.fate[p] = SILENT
            continue
        out.fate[p] = RECORDED
        out.begin[p] = begin
        for k in range(count):
            out.echo_time[n_echoes + k] = work.echo[k, 0]
            out.echo_height[n_echoes + k] = peak(work.echo[k, 1], work.echo[k, 2], rx.sigma)
            out.echo_sigma[n_echoes + k] = math.sqrt(rx.sigma * rx.sigma + work.echo[k, 2])
            out.echo_class[n_echoes + k] = work.echo_code[k]
        n_samples, n_returns, n_echoes = n_samples + length, n_returns + detected, n_echoes + count
        out.sample_start[p + 1] = n_samples
        out.return_start[p + 1] = n_returns
        out.echo_start[p + 1] = n_echoes
    return n_samples, n_returns, n_echoes


class Recorded(NamedTuple):
    """What `fly_chunk` fills: pulse p has samples, returns and echoes ``start[p]:start[p + 1]``; times in ns.

    `begin` is the time of the first sample since the pulse left; `location` counts from it.
    """

    fate: np.ndarray
    begin: np.ndarray
    sample_start: np.ndarray
    return_start: np.ndarray
    echo_start: np.ndarray
    samples: np.ndarray
    location: np.ndarray
    height: np.ndarray
    echo_time: np.ndarray
    echo_height: np.ndarray
    echo_sigma: np.ndarray
    echo_class: np.ndarray


def empty_record(pulses: int, rays: int, long: int) -> Recorded:
    """Room, all zero, for what a chunk of this many pulses [count] records, whatever they meet; `long` [samples] the
    longest wave."""
    return Recorded(
        fate=np.zeros(pulses, np.uint8),
        begin=np.zeros(pulses, np.int64),
        sample_start=np.zeros(pulses + 1, np.int64),
        return_start=np.zeros(pulses + 1, np.int64),
        echo_start=np.zeros(pulses + 1, np.int64),
        samples=np.zeros(pulses * long, np.uint16),
        location=np.zeros((pulses + 1) * MAX_RETURNS),
        height=np.zeros((pulses + 1) * MAX_RETURNS),
        echo_time=np.zeros(pulses * rays),
        echo_height=np.zeros(pulses * rays),
        echo_sigma=np.zeros(pulses * rays),
        echo_class=np.zeros(pulses * rays, np.uint8),
    )
