"""The system's pulse, widened: what an echo looks like for every width, in a table that a fit reads.

Echo widths are counted as the equivalent standard deviation s. The pulse itself has s0 = FWHM / 2.3548; an echo of
width s is the pulse convolved with a Gaussian of variance s^2 - s0^2, or for s < s0 (noise may make an echo look
narrower than the pulse) the pulse compressed in time by s / s0; its peak is scaled to 1. The echo's time is where the
pulse's own peak was put. A Gaussian pulse stays a Gaussian of standard deviation s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.decompose.autoregression import WHITE, Autoregression
from fwclass.decompose.pulse_template import edge_of
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.units import FWHM_PER_SIGMA

WIDTH_STEP = 0.05
"""Cells of the table in s, as a share of s0. Quadratic interpolation inside leaves 1e-5 of the peak."""
PHASE_STEP = 0.06
"""Cells of the table in time, at most this share of the narrowest s, or of a steep rise's."""
REACH = 4.5
"""A Gaussian is followed to this many standard deviations (4e-5 of its height)."""
FOOT = 4e-5
"""A measured pulse is followed as far as it is higher than this."""
LANES = 4
"""Profiles are padded to a multiple of this many samples, so that loops over them have no rest."""
COARSEST, FINEST = 0.6, 400.0
"""Samples per full width at half maximum between which a waveform can be fitted."""
KEPT = 8
"""Tables that a process keeps, some MB each: chunk after chunk of a strip asks for the same."""
KEPT_WIDTHS = 64
"""Widths that a process keeps, a kB each: every click of the viewer asks for the same."""
TEMPLATE_FOOT = 0.011
"""The matched filter covers the pulse where it is higher than this."""


class Lookup(NamedTuple):
    """Profiles of echoes at one sample spacing; times and widths in samples.

    Attributes
    ----------
    table : (widths * phases, 6, longest): h and its derivatives by (t, s, tt, ts, ss), where t is the echo's time.
    first, length : per width, the first sample of the profile relative to the echo's whole sample, and samples.
    phases : cells per sample.
    low, step : lower end of the first cell in s, and a cell's size.
    score : (widths, 3): inverse of the information of (h_ts, h_ss) beyond (1, h, h_t, h_s), upper triangle.
    template, template_first : matched filter over its own energy, and its first sample relative to the peak.
    response, response_first : the matched filter's answer to a pulse of unit height, and its first sample relative to
        the peak.
    energy : sum of squares of the pulse.
    before, after : samples that a profile reaches at most before and after an echo.
    starts : what a peak behind the matched filter tells of its echo, (cells, 3): curvature of its logarithm, width of
        the echo, height of the echo over the peak's; empty for white noise, where Gaussians tell it.
    chances : independent chances of noise to look like an echo, over those of white noise.
    pulse_gain : root of the energy, over that of the pulse itself.

    For noise that is correlated all profiles are filtered by what makes it white; a level of b is then b times the sum
    of that filter.
    """

    table: NDArray[np.float32]
    first: NDArray[np.int64]
    length: NDArray[np.int64]
    phases: int
    low: float
    step: float
    score: NDArray[np.float64]
    template: NDArray[np.float64]
    template_first: int
    response: NDArray[np.float64]
    response_first: int
    energy: float
    before: int
    after: int
    starts: NDArray[np.float64]
    chances: float
    pulse_gain: float


@dataclass(frozen=True)
class Widths:
    """Full width at half maximum [ns] and area [ns] of an echo of unit height, over s [ns]."""

    s: NDArray[np.float64]
    fwhm: NDArray[np.float64]
    area: NDArray[np.float64]


class Profiles:
    """Heights of widened pulses over time; times and widths in ns."""

    def __init__(self, pulse: SystemPulse) -> None:
        self.pulse = pulse
        self.s0 = pulse.fwhm / FWHM_PER_SIGMA
        self.gaussian = pulse.shape == "gaussian"
        self.edge = pulse.fwhm
        if not self.gaussian:
            high = np.flatnonzero(np.abs(pulse.values) > FOOT)
            self.start = pulse.first + pulse.step * float(high[0])
            self.stop = pulse.first + pulse.step * float(high[-1])
            times = pulse.first + pulse.step * np.arange(len(pulse.values))
            self.edge = edge_of(times, pulse.values, pulse.fwhm)
            self.spline = scipy.interpolate.CubicSpline(times, pulse.values, bc_type="natural", extrapolate=False)

    def reach(self, s: float) -> tuple[float, float]:
        """First and last time [ns] at which an echo of width `s` [ns] counts, its own being 0."""
        if self.gaussian:
            return -REACH * s, REACH * s
        if s <= self.s0:
            return self.start * s / self.s0, self.stop * s / self.s0
        blur = REACH * math.sqrt(s * s - self.s0**2)
        centre = 0.5 * (self.start + self.stop)
        # independent spreads add in quadrature, tails do not
        return min(self.start, centre - math.hypot(self.start - centre, blur)), max(
            self.stop, centre + math.hypot(self.stop - centre, blur)
        )

    def at(self, s: float, first: int, n: int, step: float) -> NDArray[np.float64]:
        """Height at the times ``step * (first + arange(n))``."""
        t = step * (first + np.arange(n))
        if self.gaussian:
            return np.asarray(np.exp(-0.5 * (t / s) ** 2))
        if s <= self.s0:
            return np.asarray(np.nan_to_num(self.spline(t * self.s0 / s)))
        blur = math.sqrt(s * s - self.s0**2)
        pad = math.ceil((REACH + 1.0) * blur / step) + math.ceil((self.stop - self.start) / step)
        wide = np.nan_to_num(self.spline(step * (first - pad + np.arange(n + 2 * pad))))
        omega = 2.0 * np.pi * np.fft.rfftfreq(len(wide), step)
        height = np.fft.irfft(np.fft.rfft(wide) * np.exp(-0.5 * (omega * blur) ** 2), len(wide))
        return np.asarray(height[pad : pad + n] / _top(height))


def _top(height: NDArray[np.float64]) -> float:
    """Greatest value of a sampled curve, between the samples by a parabola."""
    i = int(np.clip(np.argmax(height), 1, len(height) - 2))
    a, b, c = height[i - 1 : i + 2]
    curve = 2.0 * b - a - c
    return float(b + (c - a) ** 2 / (8.0 * curve)) if curve > 0.0 else float(b)


def fits_spacing(pulse: SystemPulse, spacing: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The sample spacings [ns] at which waveforms of this pulse can be fitted at all."""
    with np.errstate(invalid="ignore", divide="ignore"):
        per_pulse = pulse.fwhm / spacing
        return np.asarray((per_pulse >= COARSEST) & (per_pulse <= FINEST))


def lookup(
    pulse: SystemPulse, spacing: float, narrowest: float, widest: float, noise: Autoregression = WHITE
) -> Lookup:
    """The table for echoes from `narrowest` to `widest` pulse widths at a sample spacing [ns], in noise of a kind.

    It is shared with whoever asks for the same: not to be written.
    """
    values = np.ascontiguousarray(pulse.values, np.float64).tobytes()
    return _lookup(pulse.shape, pulse.fwhm, pulse.first, pulse.step, values, spacing, narrowest, widest, noise)


@lru_cache(maxsize=KEPT)
def _lookup(
    shape: Literal["gaussian", "measured"],
    fwhm: float,
    first_time: float,
    step: float,
    values: bytes,
    spacing: float,
    narrowest: float,
    widest: float,
    noise: Autoregression,
) -> Lookup:
    profiles = Profiles(SystemPulse(shape, fwhm, first_time, step, np.frombuffer(values)))
    low = 1.0 - WIDTH_STEP * math.ceil((1.0 - narrowest) / WIDTH_STEP - 1e-9)
    widths = max(math.ceil((widest - low) / WIDTH_STEP - 1e-9), 1)
    edges = (low + 0.5 * WIDTH_STEP * np.arange(2 * widths + 1)) * profiles.s0
    phases = math.ceil(spacing / (PHASE_STEP * low * profiles.edge / FWHM_PER_SIGMA))
    reach = np.array([profiles.reach(s) for s in edges[2::2]])
    first = np.floor(reach[:, 0] / spacing).astype(np.int64)
    length = np.ceil(reach[:, 1] / spacing).astype(np.int64) + 2 - first
    length += -length % LANES
    taps = noise.filter
    longer = len(taps) - 1 + -(len(taps) - 1) % LANES
    table = np.zeros((widths, phases, 6, int(length.max())), np.float32)
    score = np.empty((widths, 3))
    fine = spacing / (2 * phases)
    for k in range(widths):
        start, n = 2 * phases * (first[k] - 1), 2 * phases * (length[k] + 2)
        narrow, h, wide = (profiles.at(s, start, n, fine) for s in edges[2 * k : 2 * k + 3])
        parts = _quadratic(narrow, h, wide, 0.5 * WIDTH_STEP * profiles.s0 / spacing, 0.5 / phases)
        for phase in range(phases):
            at = 2 * phases - 2 * phase
            table[k, phase, :, : length[k]] = parts[:, at : at + 2 * phases * length[k] : 2 * phases]
    if noise.phi:
        plain, length = table, length + longer
        table = np.zeros((*table.shape[:3], table.shape[3] + longer), np.float32)
        for lag, tap in enumerate(taps):
            table[..., lag : lag + plain.shape[3]] += np.float32(tap) * plain
    for k in range(widths):
        score[k] = _score(table[k, 0].astype(np.float64))
    template, template_first, response, response_first, energy = _template(profiles, spacing, noise)
    starts, chances, gain = np.empty((0, 3)), 1.0, 1.0
    if noise.phi:
        _, _, usual, _, plain_energy = _template(profiles, spacing, WHITE)
        chances, gain = math.sqrt(_fall(response) / _fall(usual)), math.sqrt(energy / plain_energy)
        starts = _starts(
            table[:, 0, 0].astype(np.float64), first, template, template_first, np.asarray(edges[1::2] / spacing)
        )
    return Lookup(
        table.reshape(widths * phases, 6, -1),
        first,
        length,
        phases,
        low * profiles.s0 / spacing,
        WIDTH_STEP * profiles.s0 / spacing,
        score,
        template,
        template_first,
        response,
        response_first,
        energy,
        -int(first.min()) + 1,
        int((first + length).max()) + 1,
        starts,
        chances,
        gain,
    )


def _fall(response: NDArray[np.float64]) -> float:
    """How far the matched filter's answer falls from its peak to the next samples."""
    top = int(response.argmax())
    return float(1.0 - 0.5 * (response[top - 1] + response[top + 1]) / response[top])


def _starts(
    profiles: NDArray[np.float64],
    first: NDArray[np.int64],
    template: NDArray[np.float64],
    template_first: int,
    widths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """`Lookup.starts` of echoes with these profiles (k, samples) and widths [samples], the sharpest peak first."""
    starts = []
    for profile, before, width in zip(profiles, first, widths, strict=True):
        answer = np.correlate(profile, template, "full")
        peak = template_first + len(template) - 1 - int(before)
        if not 0 < peak < len(answer) - 1 or not (answer[peak - 1 : peak + 2] > 0.0).all():
            continue
        left, middle, right = np.log(answer[peak - 1 : peak + 2])
        starts.append((2.0 * middle - left - right, width, 1.0 / answer[peak]))
    return np.array(sorted(starts, reverse=True)).reshape(-1, 3)


def _quadratic(
    narrow: NDArray[np.float64], h: NDArray[np.float64], wide: NDArray[np.float64], ds: float, dt: float
) -> NDArray[np.float64]:
    """The six parts (6, n) of the quadratic through a cell's edges in width and its neighbours in time.

    Time derivatives are by the echo's time, against the sample's.
    """

    def slope(f: NDArray[np.float64]) -> NDArray[np.float64]:
        d = np.zeros_like(f)
        d[1:-1] = (f[:-2] - f[2:]) / (2.0 * dt)
        return d

    by_s = (wide - narrow) / (2.0 * ds)
    curve = np.zeros_like(h)
    curve[1:-1] = (h[2:] - 2.0 * h[1:-1] + h[:-2]) / dt**2
    return np.stack([h, slope(h), by_s, curve, slope(by_s), (wide - 2.0 * h + narrow) / ds**2])


def _score(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse information of (h_ts, h_ss) with level, height, time and width free."""
    known = np.stack([np.ones(parts.shape[1]), *parts[:3]])
    beyond = parts[4:]
    beyond = beyond - np.linalg.lstsq(known.T, beyond.T, rcond=None)[0].T @ known
    inverse = np.linalg.pinv(beyond @ beyond.T)
    return np.array([inverse[0, 0], inverse[0, 1], inverse[1, 1]])


def _template(
    profiles: Profiles, spacing: float, noise: Autoregression
) -> tuple[NDArray[np.float64], int, NDArray[np.float64], int, float]:
    """Matched filter of the pulse itself, its first sample, its answer to the pulse, that answer's first sample, and
    the energy of the pulse, all in samples made white."""
    start, stop = (int(v) for v in np.round(np.array(profiles.reach(profiles.s0)) / spacing))
    h = profiles.at(profiles.s0, start, stop - start + 1, spacing)
    high = np.flatnonzero(h > TEMPLATE_FOOT)
    h = np.convolve(h, noise.filter) if noise.phi else h
    used = h[high[0] : high[-1] + 1 + len(noise.phi)]
    energy = float(used @ used)
    first = start + int(high[0])
    last = first + len(used) - 1
    return used / energy, first, np.correlate(h, used / energy, "full"), start - last, energy


def height_error(pulse: SystemPulse, channel: Channel) -> float:
    """Standard deviation of the matched filter's output, as a share of the channel's noise [DN per DN]."""
    if not channel.phi:
        return math.sqrt(channel.sample_spacing / pulse.energy)
    energy = _template(Profiles(pulse), channel.sample_spacing, channel.autoregression)[4]
    return math.sqrt(channel.autoregression.innovation / energy)


def widths_of(pulse: SystemPulse, narrowest: float, widest: float) -> Widths:
    """FWHM and area over s, all in ns; between the given widths both are all but straight.

    They are shared with whoever asks for the same: not to be written.
    """
    values = np.ascontiguousarray(pulse.values, np.float64).tobytes()
    return _widths_of(pulse.shape, pulse.fwhm, pulse.first, pulse.step, values, narrowest, widest)


@lru_cache(maxsize=KEPT_WIDTHS)
def _widths_of(
    shape: Literal["gaussian", "measured"],
    fwhm_of_pulse: float,
    first_time: float,
    step_of_pulse: float,
    values: bytes,
    narrowest: float,
    widest: float,
) -> Widths:
    profiles = Profiles(SystemPulse(shape, fwhm_of_pulse, first_time, step_of_pulse, np.frombuffer(values)))
    s = np.unique(np.append(np.arange(narrowest, widest + WIDTH_STEP, WIDTH_STEP), 1.0)) * profiles.s0
    if profiles.gaussian:
        return Widths(s, FWHM_PER_SIGMA * s, math.sqrt(2.0 * math.pi) * s)
    step = profiles.s0 / 100.0
    fwhm, area = np.empty(len(s)), np.empty(len(s))
    for k in range(len(s)):
        first, last = (int(v) for v in np.round(np.array(profiles.reach(s[k])) / step))
        h = profiles.at(s[k], first - 1, last - first + 3, step)
        area[k] = step * h.sum()
        top = int(np.argmax(h))
        rise = top - int(np.argmax(h[top::-1] < 0.5))
        fall = top + int(np.argmax(h[top:] < 0.5))
        before = rise + (0.5 - h[rise]) / (h[rise + 1] - h[rise])
        after = fall - (0.5 - h[fall]) / (h[fall - 1] - h[fall])
        fwhm[k] = step * (after - before)
    return Widths(s, fwhm, area)
