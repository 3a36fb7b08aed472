"""Waveforms that may have a weak echo where a surface predicts one: where a beam meets it, and what its samples say."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import Fits, fit_waveforms, pulses_of, signal_of
from fwclass.decompose.params import DecomposeParams, StackParams
from fwclass.decompose.placement import Placement, offsets_at, offsets_of
from fwclass.decompose.placing import beams, origins_of, row_shifts
from fwclass.decompose.pulse_sample import rows_of
from fwclass.decompose.recovery import recovered
from fwclass.decompose.shapes import Profiles
from fwclass.decompose.stack_kernels import match_around
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.grid import Box, Window
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

PHASES = 16
"""Values of the pulse's shape in a sample; straight between them, 2e-3 of the height."""
STEP = 0.5
"""Between the places that are tried [ns]; an eighth of a pulse, so that the highest is missed by 1 % of its height."""
ROUNDS, CLOSE = 8, 0.02
"""Steps of the search for the point where a beam meets the surface, and how close it must come [m]."""
FOOT = 0.01
"""The pulse is followed as far as it is higher than this."""


@dataclass(frozen=True)
class Surface:
    """Heights [m] at the middles of the cells of a window, NaN where there are none."""

    heights: NDArray[np.float32]
    window: Window

    def at(self, x: Floats, y: Floats) -> Floats:
        """Height between the four cells around every point; NaN outside, and where one of them has none."""
        w = self.window
        col, row = x / w.cell - w.col - 0.5, y / w.cell - w.row - 0.5
        with np.errstate(invalid="ignore"):
            inside = (col >= 0.0) & (row >= 0.0) & (col < w.ncols - 1) & (row < w.nrows - 1)
        c, r = (np.where(inside, v, 0.0).astype(np.int64) for v in (col, row))
        c1, r1 = np.minimum(c + 1, w.ncols - 1), np.minimum(r + 1, w.nrows - 1)
        a, b = np.where(inside, col - c, 0.0), np.where(inside, row - r, 0.0)
        south = (1.0 - a) * self.heights[r, c] + a * self.heights[r, c1]
        north = (1.0 - a) * self.heights[r1, c] + a * self.heights[r1, c1]
        return np.where(inside, (1.0 - b) * south + b * north, np.nan)


@dataclass(frozen=True)
class Candidates:
    """Pulses whose echo of a surface is looked for, in the order of strip and pulse.

    Attributes
    ----------
    strip, pulse, gps_time, echoes : who they are, and how many echoes they have.
    place : (n, 3) where they meet the surface [m]; beam : (n, 3), metres along it in a nanosecond.
    weight : one over the variance of the noise made white [1/DN2].
    product, energy, slope : (n, k) see `match_around`, `slope` by the nanosecond; below : the same products where
        nothing can be, beneath the surface; energies and slopes are those of the surface.
    fair : the waveform reaches so far down.
    """

    strip: NDArray[np.int64]
    pulse: NDArray[np.int64]
    gps_time: Floats
    echoes: NDArray[np.int64]
    place: Floats
    beam: Floats
    weight: Floats
    product: Floats
    energy: Floats
    slope: Floats
    below: Floats
    fair: NDArray[np.bool_]

    @classmethod
    def joined(cls, parts: Iterable[Candidates]) -> Candidates:
        """The candidates of all `parts` as one, every array (n, …) sorted by strip and pulse."""
        some = list(parts)
        names = cls.__dataclass_fields__
        order = np.lexsort(
            (np.concatenate([p.pulse for p in some]), np.concatenate([p.strip for p in some]))
        )  # one order, however the strips were cut
        return cls(*(np.concatenate([getattr(p, n) for p in some])[order] for n in names))


def candidates(
    waves: Waveforms,
    strip: int,
    surface: Surface,
    box: Box,
    params: StackParams,
    fit: DecomposeParams,
    pulse: SystemPulse,
    placement: Placement,
    *,
    silent: bool = False,
) -> tuple[Candidates | None, Floats]:
    """The pulses of a chunk that meet the surface inside `box` and have no echo near it, None without any; and where
    those meet it that have one behind it (n, 2) [m].

    Parameters
    ----------
    waves : pulses and samples of a chunk, and whether its format has returns.
    surface : what predicts their echoes.
    silent : pulses without any echo are looked at, too: water mirrors the light away.
    """
    late, _ = origins_of(waves, fit, pulse, placement)
    at_return, late = waves.returns.rows > 0, np.asarray(late)
    beam, speed = beams(waves)
    start = _first_samples(waves, late, beam, speed)
    met = _meeting(start, beam * speed[:, None], surface)
    x, y = ((start + met[:, None] * beam * speed[:, None])[:, c] for c in (0, 1))
    near = np.flatnonzero(np.isfinite(met))
    near = near[box.contains(x[near], y[near])]
    if len(near) == 0:
        return None, np.empty((0, 2))
    some, late, beam, speed = rows_of(waves, near), late[near], beam[near], speed[near]
    some, doubt = recovered(some, fit, pulse)
    fits = fit_waveforms(some, fit, pulse, doubt)
    after = fits.time - offsets_of(fits, some.pulses, placement)
    after -= (some.pulses["anchor_time"].astype(np.float64) + late)[fits.row]
    shift = row_shifts(fits, after, some, fit, placement)[0] if at_return else np.zeros(len(near))
    start = _first_samples(some, late + shift + _faint_offset(some, placement, fits), beam, speed)
    velocity = beam * speed[:, None]
    met = _meeting(start, velocity, surface)
    place = start + met[:, None] * velocity
    ahead, echoes = _ahead(fits, after - shift[fits.row] if at_return else after, some, place, beam, velocity)
    through = place[ahead < -params.clear, :2]
    hidden = np.isfinite(met) & (ahead > params.clear) & ((echoes > 0) | silent)
    return _match(some, strip, fits, hidden, start, velocity, met, echoes, params, fit, pulse), through


def _first_samples(waves: Waveforms, late: Floats, beam: Floats, speed: Floats) -> Floats:
    """Where the light is that is recorded in the first sample of every row (n, 3) [m]."""
    anchor = np.stack([waves.pulses[f"anchor_{axis}"] for axis in "xyz"], axis=1)
    back = (waves.pulses["anchor_time"].astype(np.float64) + late) * speed
    return np.asarray(anchor - back[:, None] * beam)


def _faint_offset(waves: Waveforms, placement: Placement, fits: Fits) -> Floats:
    """What a vendor's location of an echo as high as the noise would be off by [ns]."""
    return offsets_at(np.nan_to_num(fits.noise, nan=1.0), channel_rows(placement.curves, waves.pulses), placement)


def _meeting(start: Floats, velocity: Floats, surface: Surface) -> Floats:
    """When every beam meets the surface, after its first sample [ns]; NaN where it does not, or grazes it."""
    with np.errstate(invalid="ignore", divide="ignore"):
        down = velocity[:, 2] < 0.0
        time = np.zeros(len(start))
        for _ in range(ROUNDS):
            height = surface.at(start[:, 0] + time * velocity[:, 0], start[:, 1] + time * velocity[:, 1])
            off = start[:, 2] + time * velocity[:, 2] - height
            time = np.where(np.isfinite(off), time - off / velocity[:, 2], time)
        height = surface.at(start[:, 0] + time * velocity[:, 0], start[:, 1] + time * velocity[:, 1])
        off = start[:, 2] + time * velocity[:, 2] - height
        return np.where(down & (np.abs(off) < CLOSE), time, np.nan)


def _ahead(
    fits: Fits, after: Floats, waves: Waveforms, place: Floats, beam: Floats, velocity: Floats
) -> tuple[Floats, NDArray[np.int64]]:
    """How far before the surface, which it meets at `place`, the last echo of every row's pulse lies along the beam
    [m], NaN where one is saturated or nothing is met, infinite without echoes; and how many it has."""
    anchor = np.stack([waves.pulses[f"anchor_{axis}"] for axis in "xyz"], axis=1)
    off = place[fits.row] - anchor[fits.row] - after[:, None] * velocity[fits.row]
    before = (off * beam[fits.row]).sum(axis=1)
    before[(fits.flags & SATURATED) != 0] = np.nan
    names, pulse = np.unique(waves.pulses["pulse"], return_inverse=True)
    least = np.full(len(names), np.inf)
    np.minimum.at(least, pulse[fits.row], before)
    count = np.bincount(pulse[fits.row], minlength=len(names))
    return least[pulse], count[pulse]


def _match(
    waves: Waveforms,
    strip: int,
    fits: Fits,
    wanted: NDArray[np.bool_],
    start: Floats,
    velocity: Floats,
    met: Floats,
    echoes: NDArray[np.int64],
    params: StackParams,
    fit: DecomposeParams,
    pulse: SystemPulse,
) -> Candidates | None:
    """The products of the `wanted` rows whose samples reach around the surface, channel by channel."""
    residual = -np.repeat(np.nan_to_num(fits.baseline), np.diff(waves.offsets)) - signal_of(fits, waves, pulse, fit)
    residual += waves.samples
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    kinds, channels, kind = pulses_of(waves, pulse)
    parts = []
    for step, which in np.unique(np.stack([spacing, kind], axis=1)[wanted], axis=0):
        mine = np.flatnonzero(wanted & (spacing == step) & (kind == which))
        speed = np.sqrt((velocity[mine] ** 2).sum(axis=1))
        shape = _Shape.of(kinds[int(which)], channels[int(which)], float(step), params.window / float(speed.max()))
        parts.append(_of_kind(waves, strip, fits, mine, start, velocity, met, echoes, residual, shape, params))
    some = [p for p in parts if p is not None]
    return Candidates.joined(some) if some else None


@dataclass(frozen=True)
class _Shape:
    """What a faint echo looks like in the samples of a channel made white.

    Attributes
    ----------
    phi : coefficients of the noise; innovation : variance of the samples made white over the noise's.
    values, first : the shape, `PHASES` a sample, from `first` samples after its peak on.
    lags : places that are tried [samples]; half : samples around the predicted one that count; spacing [ns].
    """

    phi: tuple[float, ...]
    innovation: float
    values: Floats
    first: float
    lags: NDArray[np.floating]
    half: float
    spacing: float

    @classmethod
    def of(cls, pulse: SystemPulse, channel: Channel | None, spacing: float, window: float) -> _Shape:
        profiles, phi = Profiles(pulse), channel.phi if channel else ()
        begin, end = (math.floor(v / spacing) for v in profiles.reach(profiles.s0))
        h = profiles.at(profiles.s0, begin * PHASES, (end + 1 - begin) * PHASES, spacing / PHASES)
        high = np.flatnonzero(np.abs(h) > FOOT)
        h = np.where(np.arange(len(h)) <= high[-1], h, 0.0)
        h = np.concatenate([np.zeros(PHASES), h, np.zeros(PHASES * (len(phi) + 1))])
        white = h.copy()
        for k, c in enumerate(phi, 1):
            white[k * PHASES :] -= c * h[: -k * PHASES]
        tried = math.ceil(window / STEP)
        lags = STEP * np.arange(-tried, tried + 1) / spacing
        reach = max(-high[0] / PHASES - begin, high[-1] / PHASES + begin + len(phi))
        innovation = channel.autoregression.innovation if channel else 1.0
        return cls(phi, innovation, np.asarray(white, np.float64), begin - 1.0, lags, float(lags[-1] + reach), spacing)


def _of_kind(
    waves: Waveforms,
    strip: int,
    fits: Fits,
    rows: NDArray[np.int64],
    start: Floats,
    velocity: Floats,
    met: Floats,
    echoes: NDArray[np.int64],
    left: Floats,
    shape: _Shape,
    params: StackParams,
) -> Candidates | None:
    white = left.copy()
    for k, c in enumerate(shape.phi, 1):
        white[k:] -= c * left[:-k]
    length, order = np.diff(waves.offsets), len(shape.phi)
    at = met / shape.spacing
    rows = rows[(at[rows] - shape.half > order) & (at[rows] + shape.half < length[rows] - 1)]
    if len(rows) == 0:
        return None
    speed = np.sqrt((velocity[rows] ** 2).sum(axis=1))
    down = at[rows] + params.decoy / (speed * shape.spacing)
    fair = down + shape.half < length[rows] - 1
    size = (len(rows), len(shape.lags))
    product, energy, slope, below = np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
    fixed = (shape.half, shape.values, PHASES, shape.first, shape.lags)
    match_around(white, waves.offsets, rows, at[rows], *fixed, product, energy, slope)
    spare = np.empty((2, int(fair.sum()), size[1])), np.empty((int(fair.sum()), size[1]))
    match_around(white, waves.offsets, rows[fair], down[fair], *fixed, spare[1], spare[0][0], spare[0][1])
    below[fair] = spare[1]
    return Candidates(
        np.full(len(rows), strip, np.int64),
        waves.pulses["pulse"][rows].astype(np.int64),
        waves.pulses["gps_time"][rows],
        echoes[rows],
        start[rows] + met[rows, None] * velocity[rows],
        velocity[rows],
        1.0 / (fits.noise[rows] ** 2 * shape.innovation),
        product,
        energy,
        slope / shape.spacing**2,
        below,
        fair,
    )
