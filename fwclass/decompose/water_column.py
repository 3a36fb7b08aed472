"""Surface, column and bottom of water in waveforms of green lasers, in the place of plain echoes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.autoregression import WHITE
from fwclass.decompose.fitting import Fits, channels_of, kind_of, pulses_of, rows_by_kind, sample_limits, signal_of
from fwclass.decompose.params import BathymetryParams, DecomposeParams
from fwclass.decompose.pulse_fit import WEAK
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.decompose.water_kernel import (
    A_B,
    A_S,
    ANSWERS,
    COVARIANCE,
    DECAY,
    DEV_B,
    DEV_S,
    FLAGS_B,
    FLAGS_S,
    FOUND,
    LEVEL,
    MISFIT,
    NOISE,
    T_B,
    T_S,
    VAR_A_B,
    VAR_A_S,
    VAR_B,
    VAR_S,
    fit_water,
)
from fwclass.decompose.water_model import Search
from fwclass.schema import Table
from fwclass.units import AREA_PER_FWHM, FWHM_PER_SIGMA, METRES_PER_NS, REFRACTIVE_INDEX
from fwclass.waveforms import Waveforms

SURFACE, BOTTOM = 1, 2
"""Values of the column `water`; 0 is no water."""


@dataclass(frozen=True)
class Waters:
    """What the echoes of a batch have to do with water.

    Attributes
    ----------
    kind : uint8 (m,), 0, `SURFACE` or `BOTTOM`; a bottom comes right after its surface.
    decay : of the column's light [1/ns of two-way time], (m,); NaN without water.
    covariance : of a bottom's time with its surface's [ns^2], (m,); NaN elsewhere.
    """

    kind: NDArray[np.uint8]
    decay: NDArray[np.float64]
    covariance: NDArray[np.float64]


def speed_in_water(params: BathymetryParams) -> float:
    """One-way distance in water [m] that one nanosecond of two-way time stands for."""
    return METRES_PER_NS * REFRACTIVE_INDEX / params.group_index


def water_counts(echoes: Table) -> dict[str, int]:
    """Surfaces and bottoms among `echoes`, and the sum of the bottoms' depths in whole millimetres."""
    bottoms = echoes["water"] == BOTTOM
    depths = np.rint(1000.0 * echoes["water_depth"][bottoms].astype(np.float64))
    return {
        "surfaces": int((echoes["water"] == SURFACE).sum()),
        "bottoms": int(bottoms.sum()),
        "depth_mm": int(depths.sum()),
    }


def water_facts(counts: Mapping[str, int]) -> dict[str, Any]:
    """``surfaces``, ``bottoms`` and their ``mean_depth`` [m] of `water_counts`, and ``remarks`` where there is none."""
    bottoms = counts["bottoms"]
    none = (
        "bathymetry.enabled: no waveform shows a bottom of water. Is this a survey by a green laser, and does it hold "
        "water?"
    )
    return {
        "surfaces": counts["surfaces"],
        "bottoms": bottoms,
        "mean_depth": round(1e-3 * counts["depth_mm"] / bottoms, 3) if bottoms else None,
        "remarks": [] if bottoms else [none],
    }


def water_words(facts: Mapping[str, Any]) -> str:
    """`water_facts` in a line."""
    deep = f", {facts['mean_depth']:.2f} m deep on average" if facts["bottoms"] else ""
    return f"{facts['surfaces']:,} surfaces, {facts['bottoms']:,} bottoms{deep}"


def with_water(
    fits: Fits, waves: Waveforms, params: DecomposeParams, pulse: SystemPulse, asked: BathymetryParams
) -> tuple[Fits, Waters]:
    """`fits` with the echoes of waveforms of water replaced by those of its surface and bottom.

    The first plain echo is taken for the surface, later ones and what stands out of the rest for the bottom. Water is
    taken where chi-square is lower than the plain fit's by ``asked.gain``, after each has paid for its parameters.
    Beams that go up meet none.

    Parameters
    ----------
    fits : the plain decomposition of `waves`.
    pulse : of it the width counts: echoes of water are Gaussians as wide.
    asked : `BathymetryParams`.

    Returns
    -------
    The echoes, by (row, time), and what they have to do with water. Widths of its echoes are the pulse's, without a
    standard error.
    """
    answers = _answers(fits, waves, params, pulse, asked)
    count = answers[:, FOUND]
    rows = np.flatnonzero(count > 0)
    kept = np.flatnonzero(count[fits.row] == 0)
    deep = rows[count[rows] == BOTTOM]
    pulses, _, pulse_of = pulses_of(waves, pulse)
    widths = np.array([p.fwhm for p in pulses])[pulse_of]
    of_water = [
        _echoes(answers, some, at, widths) for some, at in ((rows, _AT_SURFACE), (deep, _AT_BOTTOM)) if len(some)
    ]
    columns = {f.name: getattr(fits, f.name) for f in fields(Fits)}
    kind = np.concatenate([np.zeros(len(kept)), np.full(len(rows), SURFACE), np.full(len(deep), BOTTOM)])
    echoes = {n: np.concatenate([columns[n][kept], *(m[n] for m in of_water)]) for n in _PER_ECHO}
    order = np.lexsort((echoes["time"], echoes["row"]))
    echoes = {n: v[order].astype(columns[n].dtype) for n, v in echoes.items()}
    kind, row = kind[order].astype(np.uint8), echoes["row"]
    whole = {n: columns[n].copy() for n in _PER_WAVEFORM}
    whole["count"][rows] = count[rows].astype(np.int64)
    for name, at in (("baseline", LEVEL), ("noise", NOISE), ("misfit", MISFIT)):
        whole[name][rows] = answers[rows, at]
    decay = np.where(kind > 0, answers[row, DECAY], np.nan)
    covariance = np.where(kind == BOTTOM, answers[row, COVARIANCE], np.nan)
    return replace(fits, **whole, **echoes), Waters(kind, decay, covariance)


_PER_WAVEFORM = ("count", "baseline", "noise", "misfit")
_PER_ECHO = tuple(f.name for f in fields(Fits) if f.name not in _PER_WAVEFORM)
_AT_SURFACE = {"time": T_S, "amplitude": A_S, "var_time": VAR_S, "var": VAR_A_S, "deviation": DEV_S, "flags": FLAGS_S}
_AT_BOTTOM = {"time": T_B, "amplitude": A_B, "var_time": VAR_B, "var": VAR_A_B, "deviation": DEV_B, "flags": FLAGS_B}


def _echoes(
    answers: NDArray[np.float64], rows: NDArray[np.int64], at: Mapping[str, int], widths: NDArray[np.float64]
) -> dict[str, NDArray]:
    """Columns of `Fits` for the surfaces or the bottoms of `rows`."""
    values = {name: answers[rows, k] for name, k in at.items()}
    return {
        "row": rows,
        "amplitude": values["amplitude"],
        "time": values["time"],
        "width": widths[rows],
        "energy": AREA_PER_FWHM * values["amplitude"] * widths[rows],
        "amplitude_sigma": np.sqrt(values["var"]),
        "time_sigma": np.sqrt(values["var_time"]),
        "width_sigma": np.full(len(rows), np.nan),
        "deviation": values["deviation"],
        "flags": values["flags"],
    }


def _answers(
    fits: Fits, waves: Waveforms, params: DecomposeParams, pulse: SystemPulse, asked: BathymetryParams
) -> NDArray[np.float64]:
    """What `fit_water` makes of every row."""
    n = waves.pulses.rows
    answers, receiver = np.zeros((n, ANSWERS)), np.full((n, 4), np.nan)
    if len(fits.row) == 0:
        return answers
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    channels, _, channel_of = channels_of(pulse, waves.pulses)
    starts_of = np.searchsorted(fits.row, np.arange(n + 1))
    signal, limits, lengths = signal_of(fits, waves, pulse, params), sample_limits(waves, pulse), np.diff(waves.offsets)
    up = waves.pulses["step_z"] <= 0.0
    for rows, step, special, order in rows_by_kind(spacing, lengths, channel_of, channels, pulse):
        noise = special.autoregression.shorter(order) if special else WHITE
        kind = kind_of(noise, special.growth if special else 0.0)
        mine = rows[(fits.count[rows] > 0) & ~up[rows]]
        for c, channel in enumerate((*channels, None)):
            some = mine[channel_of[mine] == c]
            receiver[some] = _receiver(fits, some, channel, noise.innovation, kind.level)
        search = _search(params, pulse.of(special), asked, step)._replace(
            growth=kind.growth, innovation=kind.innovation, level=kind.level
        )
        if len(mine):
            fit_water(
                waves.wide,
                waves.offsets,
                mine,
                signal,
                limits,
                receiver,
                fits.time,
                starts_of,
                search,
                kind.phi,
                answers,
            )
    return answers


def _receiver(
    fits: Fits, rows: NDArray[np.int64], channel: Channel | None, innovation: float, level: float
) -> NDArray[np.float64]:
    """Level [DN], its information [samples], variance of the noise made white [DN^2] and its freedom, of every row."""
    if channel is None:
        unknown = fits.baseline[rows], np.full(len(rows), WEAK), fits.noise[rows] ** 2 * innovation, np.zeros(len(rows))
        return np.stack(unknown, axis=1)
    variance = channel.noise**2 * innovation
    sure = variance / max((channel.baseline_sd * level) ** 2, 1e-4 * variance)
    return np.tile([channel.baseline, sure, variance, channel.freedom], (len(rows), 1))


def _search(params: DecomposeParams, pulse: SystemPulse, asked: BathymetryParams, spacing: float) -> Search:
    return Search(
        spacing=spacing,
        sigma=pulse.fwhm / FWHM_PER_SIGMA,
        least_decay=asked.least_decay,
        most_decay=asked.most_decay,
        least_delay=asked.least_depth / speed_in_water(asked),
        gain=asked.gain,
        price=params.split_gain / 3.0,
        bottom=params.detection**2,
        shape_error=pulse.shape_error,
        growth=0.0,
        innovation=1.0,
        level=1.0,
        floor=params.noise_floor**2,
        worst=params.poor_misfit,
        iterations=params.iterations,
    )


def place_water(
    columns: Mapping[str, NDArray],
    waters: Waters,
    row: NDArray[np.int64],
    time_sigma: NDArray[np.float64],
    after: NDArray[np.float64],
    speed: NDArray[np.float64],
    asked: BathymetryParams,
) -> dict[str, NDArray]:
    """Columns that tell of water, and those of places with every bottom where light that bends and slows down has met
    it: from its surface along the refracted beam, the surface being horizontal.

    Parameters
    ----------
    columns : x, y, z, beam_x, beam_y, beam_z, beam_range, range_sigma of the echoes, as in air, (m,) each.
    waters, row, time_sigma : of the echoes [ns].
    after : how long after its anchor every echo is [ns]; speed : in air [m/ns].

    Returns
    -------
    x, y, z [m], beam_range [m], range_sigma [m, along the broken beam], water, water_decay [1/m of depth along the
    beam, two-way], water_depth [m, vertical; NaN but at bottoms].
    """
    deep = np.flatnonzero(waters.kind == BOTTOM)
    out = {name: np.array(columns[name], np.float64) for name in ("x", "y", "z", "beam_range", "range_sigma")}
    slow = speed_in_water(asked)
    decay, depth = waters.decay / slow, np.full(len(row), np.nan)
    if len(deep):
        beam = np.stack([columns[f"beam_{axis}"] for axis in "xyz"], axis=1).astype(np.float64)[deep]
        bent = refract(beam, REFRACTIVE_INDEX, asked.refractive_index)
        way = (after[deep] - after[deep - 1]) * slow
        for c, axis in enumerate("xyz"):
            out[axis][deep] = out[axis][deep - 1] + way * bent[:, c]
        out["beam_range"][deep] = out["beam_range"][deep - 1] + way
        depth[deep] = -way * bent[:, 2]
        fast = speed[deep] - slow
        surface, bottom, both = time_sigma[deep - 1], time_sigma[deep], waters.covariance[deep]
        variance = (fast * surface) ** 2 + (slow * bottom) ** 2 + 2.0 * fast * slow * both
        out["range_sigma"][deep] = np.sqrt(np.maximum(variance, 0.0))
    return {**out, "water": waters.kind, "water_decay": decay, "water_depth": depth}


def refract(beam: NDArray[np.float64], before: float, after: float) -> NDArray[np.float64]:
    """Unit vectors of `beam`, (n, 3), behind a horizontal surface, by Snell's law.

    Parameters
    ----------
    beam : unit vectors; up or down.
    before, after : refractive index on the side that the beam comes from, and behind the surface.

    Returns
    -------
    float64 (n, 3); NaN beyond the limit angle, where nothing passes, and for a beam along the surface.
    """
    ratio, down = before / after, beam[:, 2]
    with np.errstate(invalid="ignore"):
        steep = np.sqrt(1.0 - ratio**2 * (1.0 - down**2))
    out = ratio * beam
    out[:, 2] = np.where(down == 0.0, np.nan, np.copysign(steep, down))
    out[np.isnan(out[:, 2])] = np.nan
    return out
