"""Waveforms with a known answer, and what theory allows: made with numpy alone, independent of the engine.

>>> waves, truth = survey_mix(1000, seed=1)
>>> pairs = match(truth, fits, tolerance=1.75)

Recorded samples are ``rint(baseline + sum of echoes + noise)``, clipped to the digitiser's range. An echo is
A h(t - t0): h is the system's pulse T convolved with a centred Gaussian, scaled to unit peak; t0 is where the peak of T
itself lies. For a Gaussian T this is a Gaussian of the echo's sigma.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import toeplitz

from fwclass.schema import Table
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0))
METRES_PER_NS = 0.299792458 / 2 / 1.000273
PULSE_WIDTH = 3.5
SURVEY = (0.78, 0.15, 0.05, 0.015, 0.005)
HARD = (0.2, 0.2, 0.2, 0.2, 0.2)
NODES = 32
"""Gauss-Laguerre nodes for an exponential tail: exact to 1e-9 of the peak for tails up to the core's sigma."""
BATCH = 8192


@dataclass(frozen=True)
class Pulse:
    """A system pulse: a Gaussian core, its exponential tail, and its ringing. All of it a sum of shifted Gaussians.

    Attributes
    ----------
    core : FWHM of the Gaussian core [ns].
    tail : time constant of the one-sided exponential that the core is convolved with [ns]; 0 is none.
    ringing : heights of later bumps as shares of the main one, may be negative.
    delays : how long after the main one they come [ns].
    """

    core: float = PULSE_WIDTH
    tail: float = 0.0
    ringing: tuple[float, ...] = ()
    delays: tuple[float, ...] = ()

    @cached_property
    def parts(self) -> tuple[NDArray, NDArray]:
        """Delays [ns] and weights of the shifted Gaussians, main bump first."""
        at, weight = np.zeros(1), np.ones(1)
        if self.tail > 0.0:
            nodes, weight = np.polynomial.laguerre.laggauss(NODES)
            at = self.tail * nodes
            at, weight = at[weight > 1e-14], weight[weight > 1e-14]
        at = np.concatenate([at + d for d in (0.0, *self.delays)])
        return at, np.concatenate([weight * share for share in (1.0, *self.ringing)])

    @property
    def gaussian(self) -> bool:
        return self.tail == 0.0 and not self.ringing

    def raw(self, t: NDArray, sigma: ArrayLike) -> NDArray:
        """Height at times `t` after the core's own centre, with the core broadened to `sigma`; not scaled."""
        total = np.zeros(np.broadcast_shapes(np.shape(t), np.shape(sigma)))
        scale = self.core / FWHM / np.asarray(sigma)
        for at, weight in zip(*self.parts, strict=True):
            total += weight * scale * np.exp(-0.5 * ((t - at) / sigma) ** 2)
        return total

    def crest(self, sigma: NDArray) -> tuple[NDArray, NDArray]:
        """Time and height of the highest point for every `sigma`."""
        if self.gaussian:
            return np.zeros(len(sigma)), self.core / FWHM / sigma
        grid = np.linspace(-1.0, 3.0, 81) * max(self.tail, 0.5 * self.core / FWHM)
        peak = grid[self.raw(grid, sigma[:, None]).argmax(axis=1)]
        half = grid[1] - grid[0]
        for _ in range(4):  # a parabola through three points, ever closer
            three = self.raw(peak[:, None] + half * np.array([-1.0, 0.0, 1.0]), sigma[:, None])
            bend = three[:, 0] - 2 * three[:, 1] + three[:, 2]
            peak = peak + np.clip(0.5 * half * (three[:, 0] - three[:, 2]) / bend, -half, half)
            half *= 0.2
        return peak, self.raw(peak[:, None], sigma[:, None])[:, 0]

    @cached_property
    def fwhm(self) -> float:
        """Full width at half maximum [ns]."""
        t, h = self.values(0.001)
        above = np.flatnonzero(h >= 0.5)
        first, last = above[0], above[-1]
        left = t[first] - 0.001 * (h[first] - 0.5) / (h[first] - h[first - 1])
        return float(t[last] + 0.001 * (h[last] - 0.5) / (h[last] - h[last + 1]) - left)

    def values(self, step: float) -> tuple[NDArray, NDArray]:
        """The pulse over time after its peak [ns], every `step`, 1 at the peak, 0 at both ends."""
        after = 4.0 * self.core + 25.0 * self.tail + max(self.delays, default=0.0)
        t = step * np.arange(-np.ceil(4.0 * self.core / step), np.ceil(after / step) + 1)
        return t, self.height(t[None, :], np.array([self.core / FWHM]))[0]

    def height(self, t: NDArray, core: NDArray) -> NDArray:
        """Unit-peak heights, shape (n, samples), at times `t` after the system pulse's own peak; `core` (n,) is the
        core's sigma after broadening."""
        own = self.crest(np.array([self.core / FWHM]))[0]
        return self.raw(t + own, core[:, None]) / self.crest(core)[1][:, None]

    def area(self, core: NDArray) -> NDArray:
        """Area of the unit-peak pulse for every core sigma [ns]."""
        weight = self.parts[1].sum()
        return weight * self.core / FWHM * np.sqrt(2 * np.pi) / self.crest(core)[1]


@dataclass(frozen=True)
class Truth:
    """The echoes that were put in, one row each, by (row, time).

    Attributes
    ----------
    row : waveform of the echo; amplitude [DN]; time [ns from the first sample].
    sigma : equivalent sigma [ns], sigma^2 = (pulse FWHM / 2.3548)^2 + broadening^2; width is FWHM * sigma,
        which is the echo's FWHM for a Gaussian pulse.
    energy : area [DN ns]; gap : distance to the nearest other echo of the waveform [ns], infinity if alone.
    noise, baseline : per waveform [DN]; count : echoes per waveform; clipped : a sample is at the saturation.
    samples, spacing, saturation : of every waveform, samples, [ns], [DN].
    """

    row: NDArray
    amplitude: NDArray
    time: NDArray
    sigma: NDArray
    energy: NDArray
    gap: NDArray
    noise: NDArray
    baseline: NDArray
    count: NDArray
    clipped: NDArray
    samples: int
    spacing: float
    saturation: float

    @property
    def width(self) -> NDArray:
        return FWHM * self.sigma

    @property
    def ratio(self) -> NDArray:
        """Amplitude over noise of every echo."""
        return self.amplitude / self.noise[self.row]

    @property
    def place(self) -> NDArray:
        """Rank of every echo in its waveform, from 0."""
        return np.arange(len(self.row)) - (np.cumsum(self.count) - self.count)[self.row]


class Fitted(Protocol):
    """What `match` needs of a decomposition: flat echoes by (row, time)."""

    @property
    def row(self) -> NDArray: ...
    @property
    def time(self) -> NDArray: ...


def simulate(
    amplitude: NDArray,
    time: NDArray,
    sigma: NDArray,
    *,
    noise: ArrayLike = 1.5,
    samples: int = 72,
    spacing: float = 1.0,
    bits: int = 8,
    baseline: ArrayLike = 10.0,
    pulse: Pulse | None = None,
    saturation: float | None = None,
    phi: Sequence[float] = (),
    growth: float = 0.0,
    seed: int = 0,
) -> tuple[Waveforms, Truth]:
    """Record echoes; `amplitude` [DN], `time` [ns], `sigma` [ns] are (n, k), NaN times where an echo is absent.

    `noise` and `baseline` [DN] are numbers or (n,). `saturation` is the highest number that can be recorded, by
    default that of the `bits`. Neighbouring samples' noise is an autoregression `phi`, of standard deviation `noise`;
    a DN of signal adds `growth` to its variance [DN].
    """
    rng = np.random.default_rng([seed, 7])
    n, most = time.shape
    pulse = pulse or Pulse()
    top = float(2**bits - 1) if saturation is None else float(saturation)
    level, sd = np.broadcast_to(baseline, n).astype(float), np.broadcast_to(noise, n).astype(float)
    t = spacing * np.arange(samples)
    core = np.sqrt(np.maximum(sigma**2 + (pulse.core**2 - pulse.fwhm**2) / FWHM**2, 1e-12))
    recorded = np.empty((n, samples), np.uint8 if bits <= 8 else np.uint16)
    for a in range(0, n, BATCH):
        part = slice(a, min(a + BATCH, n))
        rough = coloured(rng, part.stop - a, samples, phi)
        signal = np.zeros((part.stop - a, samples))
        for k in range(most):
            on = a + np.flatnonzero(np.isfinite(time[part, k]))
            signal[on - a] += amplitude[on, k, None] * pulse.height(t - time[on, k, None], core[on, k])
        spread = sd[part, None] if growth == 0.0 else np.sqrt(sd[part, None] ** 2 + growth * signal)
        recorded[part] = np.clip(np.rint(level[part, None] + spread * rough + signal), 0.0, top)
    order = np.argsort(time, axis=1)  # NaN last
    amplitude, time, sigma, core = (np.take_along_axis(v, order, axis=1) for v in (amplitude, time, sigma, core))
    beside = np.diff(time, axis=1, prepend=-np.inf, append=np.inf)
    gap = np.fmin(beside[:, :-1], beside[:, 1:])
    row, at = np.nonzero(np.isfinite(time))
    energy = amplitude[row, at] * pulse.area(core[row, at])
    truth = Truth(
        row,
        amplitude[row, at],
        time[row, at],
        sigma[row, at],
        energy,
        gap[row, at],
        sd,
        level,
        np.isfinite(time).sum(axis=1),
        (recorded >= top).any(axis=1),
        samples,
        spacing,
        top,
    )
    first = np.where(truth.count > 0, time[:, 0], 0.0) if most else np.zeros(n)
    return waves_of(recorded, spacing=spacing, saturation=top, anchor_time=first), truth


def coloured(rng: np.random.Generator, n: int, samples: int, phi: Sequence[float] = ()) -> NDArray:
    """Noise of unit variance, (n, samples), every sample of which is `phi` times those before it and something new."""
    if len(phi) == 0:
        return rng.standard_normal((n, samples))
    burn = 200
    out = regressed(phi, rng.standard_normal((n, samples + burn)))[:, burn:]
    return out / np.sqrt(covariance(phi, 1)[0])


def regressed(phi: Sequence[float], new: NDArray) -> NDArray:
    """Series, along the last axis, every value of which is `phi` times those before it and the next of `new`, as by
    `scipy.signal.lfilter`, whose import takes longer than most tests."""
    out = np.ascontiguousarray(new.T)
    for k in range(1, len(out)):
        for lag, share in enumerate(phi[:k], 1):
            out[k] += share * out[k - lag]
    return out.T


def covariance(phi: Sequence[float], lags: int) -> NDArray:
    """Autocovariance at the lags 0 to `lags` of an autoregression with innovations of unit variance, from its impulse
    response."""
    answer = regressed(phi, np.eye(1, 4001))[0]
    return np.array([answer[: len(answer) - k] @ answer[k:] for k in range(lags + 1)])


def waves_of(
    waveforms: NDArray | Sequence[NDArray],
    *,
    spacing: ArrayLike = 1.0,
    saturation: ArrayLike = 255.0,
    anchor_time: ArrayLike = 0.0,
) -> Waveforms:
    """Pulses that hold the given waveforms, each with one return at the origin, the beam straight down."""
    n = len(waveforms)
    length = np.array([len(w) for w in waveforms], np.int64)
    pulses: dict[str, Any] = dict.fromkeys(PULSE_COLUMNS, 0.0)
    pulses |= {
        "pulse": np.arange(n),
        "gps_time": 1e-5 * np.arange(n),
        "step_z": METRES_PER_NS,
        "sample_spacing": spacing,
        "saturation": saturation,
        "anchor_time": anchor_time,
        "anchor_range": np.nan,
        "outgoing_start": np.nan,
        "gain": 1.0,
    }
    returns: dict[str, Any] = dict.fromkeys(RETURN_COLUMNS, 0.0)
    returns |= {
        "pulse": np.arange(n),
        "gps_time": pulses["gps_time"],
        "return_number": 1,
        "number_of_returns": 1,
        "location": anchor_time,
        "has_packet": True,
        "vendor_amplitude": np.nan,
        "vendor_width": np.nan,
        "vendor_deviation": np.nan,
    }
    tables = [Table({c: np.broadcast_to(v, n) for c, v in t.items()}) for t in (pulses, returns)]
    samples = np.concatenate(list(waveforms)) if n else np.empty(0, np.uint8)
    return Waveforms(*tables, samples, np.concatenate([[0], np.cumsum(length)]).astype(np.int64))


def rows_of(waves: Waveforms, rows: NDArray) -> Waveforms:
    """The chosen rows of `waves`, in the order given, as waveforms of their own."""
    cut = [waves.samples[waves.offsets[i] : waves.offsets[i + 1]] for i in rows]
    offsets = np.concatenate([[0], np.cumsum([len(c) for c in cut])]).astype(np.int64)
    samples = np.concatenate(cut) if len(rows) else waves.samples[:0]
    return replace(
        waves,
        pulses=waves.pulses.take(rows),
        returns=waves.returns.take(rows),
        samples=samples,
        offsets=offsets,
        outgoing=waves.outgoing[:0],
        outgoing_offsets=np.zeros(len(rows) + 1, np.int64),
    )


def mix(
    n: int,
    shares: Sequence[float],
    *,
    amplitude: tuple[float, float] = (5.0, 200.0),
    gap: tuple[float, float] = (1.0, 30.0),
    noise: tuple[float, float] = (1.0, 2.0),
    widest: float = 1.6,
    seed: int = 0,
    samples: int = 72,
    spacing: float = 1.0,
    pulse: Pulse | None = None,
    **record: Any,
) -> tuple[Waveforms, Truth]:
    """`n` waveforms with 1, 2, ... echoes in the given `shares`.

    Amplitudes are log-uniform [DN], gaps and noise uniform ([ns], [DN]), widths 1 to `widest` pulse widths
    (1 + (widest - 1) Beta(1, 3)). A train longer than the waveform is squeezed to end 12 ns before its end.
    """
    rng = np.random.default_rng([seed, 1])
    most, system = len(shares), (pulse or Pulse()).fwhm / FWHM
    count = rng.choice(np.arange(1, most + 1), size=n, p=np.array(shares) / np.sum(shares))
    height = np.exp(rng.uniform(*np.log(amplitude), (n, most)))
    sigma = system * (1.0 + (widest - 1.0) * rng.beta(1, 3, (n, most)))
    time = 12.0 + rng.uniform(-1, 1, (n, 1)) + np.cumsum(np.c_[np.zeros(n), rng.uniform(*gap, (n, most - 1))], axis=1)
    last, end = time[np.arange(n), count - 1], spacing * samples - 12.0
    squeeze = np.where(last > end, (end - time[:, 0]) / np.maximum(last - time[:, 0], 1e-9), 1.0)
    time = time[:, :1] + (time - time[:, :1]) * squeeze[:, None]
    time[np.arange(most) >= count[:, None]] = np.nan
    sd = rng.uniform(*noise, n)
    return simulate(height, time, sigma, noise=sd, samples=samples, spacing=spacing, pulse=pulse, seed=seed, **record)


def survey_mix(n: int, *, seed: int = 0, **options: Any) -> tuple[Waveforms, Truth]:
    """As an airborne survey: 78, 15, 5, 1.5, 0.5 % of the waveforms have 1 to 5 echoes; options of `mix`."""
    return mix(n, SURVEY, seed=seed, **options)


def hard_mix(n: int, *, seed: int = 0, **options: Any) -> tuple[Waveforms, Truth]:
    """1 to 5 echoes equally often; options of `mix`."""
    return mix(n, HARD, seed=seed, **options)


def fixed(
    n: int,
    amplitude: Sequence[float],
    *,
    gap: float | Sequence[float] = 10.0,
    width: float | Sequence[float] = PULSE_WIDTH,
    first: float = 20.0,
    seed: int = 0,
    spacing: float = 1.0,
    **record: Any,
) -> tuple[Waveforms, Truth]:
    """`n` waveforms with the same echoes: heights [DN], gaps [ns], FWHM [ns], the first at `first` [ns] plus a
    uniform share of a sample; options of `simulate`."""
    k = len(amplitude)
    phase = np.random.default_rng([seed, 2]).uniform(-0.5, 0.5, n) * spacing
    after = np.concatenate([[0.0], np.cumsum(np.broadcast_to(gap, max(k - 1, 0)))])[:k]
    time = first + phase[:, None] + after
    height, sigma = (np.broadcast_to(v, (n, k)).astype(float) for v in (amplitude, np.asarray(width) / FWHM))
    return simulate(height, time, sigma, spacing=spacing, seed=seed, **record)


def noise_only(n: int, *, seed: int = 0, **record: Any) -> tuple[Waveforms, Truth]:
    """`n` waveforms without an echo, noise uniform in 1 to 2 DN unless given; options of `simulate`."""
    record.setdefault("noise", np.random.default_rng([seed, 3]).uniform(1, 2, n))
    nothing = np.empty((n, 0))
    return simulate(nothing, nothing, nothing, seed=seed, **record)


def jacobian(t: NDArray, amplitude: NDArray, time: NDArray, sigma: NDArray) -> NDArray:
    """Derivatives of baseline + Gaussians, shape (n, samples, 1 + 3k): baseline, then A, t, sigma of each echo.

    d/dA = g, d/dt0 = A g d / sigma, d/dsigma = A g d^2 / sigma with d = (t - t0) / sigma and g = exp(-d^2 / 2).
    """
    n, k = time.shape
    out = np.ones((n, len(t), 1 + 3 * k))
    for j in range(k):
        d = (t - time[:, j, None]) / sigma[:, j, None]
        g = np.exp(-0.5 * d * d)
        slope = amplitude[:, j, None] * g * d / sigma[:, j, None]
        out[..., 1 + 3 * j], out[..., 2 + 3 * j], out[..., 3 + 3 * j] = g, slope, slope * d
    return out


def crb(
    amplitude: NDArray,
    time: NDArray,
    sigma: NDArray,
    noise: ArrayLike,
    *,
    samples: int = 72,
    spacing: float = 1.0,
    baseline_sd: float = np.inf,
    phi: Sequence[float] = (),
) -> NDArray:
    """Cramér-Rao bounds as standard deviations, shape (n, 1 + 3k): baseline, then A, t, sigma of each echo.

    Inverse of the Fisher information J^T J / variance of Gaussian echoes in white noise; the variance is
    noise^2 + 1/12, the latter from rounding to whole numbers. The baseline is free, or known beforehand to
    `baseline_sd` [DN]. Shapes (n, k); (k,) is one waveform. Noise that is an autoregression `phi`: J^T C^-1 J with
    the covariance of the whole waveform, rounding white.
    """
    amplitude, time, sigma = (np.atleast_2d(np.asarray(v, float)) for v in (amplitude, time, sigma))
    n, k = time.shape
    variance = np.broadcast_to(np.asarray(noise, float) ** 2 + 1.0 / 12.0, n)
    bound = np.empty((n, 1 + 3 * k))
    for a in range(0, n, BATCH):
        part = slice(a, a + BATCH)
        j = jacobian(spacing * np.arange(samples), amplitude[part], time[part], sigma[part])
        if len(phi) == 0:
            information = np.swapaxes(j, 1, 2) @ j / variance[part, None, None]
        else:
            lags = covariance(phi, samples)
            shape = toeplitz(lags[:samples] / lags[0])
            information = np.empty((len(j), j.shape[2], j.shape[2]))
            for i, v in enumerate(variance[part]):
                information[i] = j[i].T @ np.linalg.solve((v - 1.0 / 12.0) * shape + np.eye(samples) / 12.0, j[i])
        information[:, 0, 0] += baseline_sd**-2
        bound[part] = np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
    return bound


def bounds(truth: Truth, baseline_sd: float = np.inf, phi: Sequence[float] = ()) -> NDArray:
    """Cramér-Rao bounds of A [DN], t [ns], FWHM [ns] of every echo of `truth`, shape (m, 3), Gaussian pulse."""
    out = np.empty((len(truth.row), 3))
    for k in np.unique(truth.count[truth.count > 0]):
        at = np.flatnonzero(truth.count[truth.row] == k)
        a, t, s = (v[at].reshape(-1, k) for v in (truth.amplitude, truth.time, truth.sigma))
        noise = truth.noise[truth.row[at]].reshape(-1, k)[:, 0]
        found = crb(a, t, s, noise, samples=truth.samples, spacing=truth.spacing, baseline_sd=baseline_sd, phi=phi)
        out[at] = found[:, 1:].reshape(-1, 3)
    return out * np.array([1.0, 1.0, FWHM])


def match(truth: Truth, fits: Fitted, tolerance: float) -> tuple[NDArray, NDArray]:
    """Indices (of truth, of fits) of the pairs that belong together, one to one, by ascending index of truth.

    Of all pairs of a waveform at most `tolerance` [ns] apart, the nearest is taken first, both leave, and so on. A
    true echo left over was missed, a fitted one left over is false.
    """
    first, last = np.searchsorted(fits.row, truth.row, "left"), np.searchsorted(fits.row, truth.row, "right")
    size = last - first
    a = np.repeat(np.arange(len(truth.row)), size)
    b = np.arange(len(a)) - np.repeat(np.cumsum(size) - size, size) + np.repeat(first, size)
    apart = np.abs(truth.time[a] - np.asarray(fits.time, float)[b])
    near = apart <= tolerance
    order = np.lexsort((b[near], a[near], apart[near]))
    a, b = a[near][order], b[near][order]
    got_a, got_b = [a[:0]], [b[:0]]
    while len(a):
        nearest = _first_of(a) & _first_of(b)
        got_a.append(a[nearest])
        got_b.append(b[nearest])
        left = ~np.isin(a, a[nearest]) & ~np.isin(b, b[nearest])
        a, b = a[left], b[left]
    i, j = np.concatenate(got_a), np.concatenate(got_b)
    order = np.argsort(i)
    return i[order], j[order]


def errors(truth: Truth, fits: Any, tolerance: float) -> tuple[NDArray, NDArray, NDArray]:
    """(index of truth, errors (m, 3) of A, t, width, their standard errors) of the echoes that `match`."""
    i, j = match(truth, fits, tolerance)
    names = ("amplitude", "time", "width")
    error = np.stack([getattr(fits, n)[j] - getattr(truth, n)[i] for n in names], axis=1)
    return i, error, np.stack([getattr(fits, f"{n}_sigma")[j] for n in names], axis=1)


def rms(standard: NDArray) -> tuple[NDArray, NDArray]:
    """Root mean square of every column, and its sampling error."""
    square = standard**2
    value = np.sqrt(square.mean(axis=0))
    return value, square.std(axis=0) / np.sqrt(len(square)) / (2 * value)


def _first_of(values: NDArray) -> NDArray:
    """True where a value occurs for the first time."""
    first = np.zeros(len(values), bool)
    first[np.unique(values, return_index=True)[1]] = True
    return first


@cache
def skewed(tail: float = 0.9) -> Pulse:
    """The pulse with a tail that a Gaussian fit takes for a second echo."""
    return Pulse(tail=tail)


@cache
def ringing(share: float = 0.03, delay: float = 10.0) -> Pulse:
    """The pulse of a receiver that rings once more."""
    return Pulse(ringing=(share,), delays=(delay,))
