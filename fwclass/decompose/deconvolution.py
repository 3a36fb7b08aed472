"""What sent the light back, sample by sample: waveforms freed of the system's pulse, and where every sample lies.

The recorded signal is the pulse folded with the backscatter along the beam. Both methods look for a backscatter of no
negative value that gives the samples: Richardson and Lucy (1972, 1974) multiply by the ratio of what is recorded to
what is expected, Gold (1964) by that of both seen through the pulse once more. Both keep the energy; Gold's is the
sharper one, and takes more of the noise for spikes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.deconvolution_kernel import TINY, deconvolve_rows
from fwclass.decompose.fitting import Fits, fit_waveforms, pulses_of
from fwclass.decompose.params import DecomposeParams, SampleParams
from fwclass.decompose.placement import Placement, offsets_of
from fwclass.decompose.placing import beams, origins_of, row_shifts
from fwclass.decompose.recovery import recovered
from fwclass.decompose.shapes import Profiles, height_error
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.grid import quantise
from fwclass.schema import Table
from fwclass.stage import Computation
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

SAMPLE_COLUMNS = ("strip", "pulse", "sample", "x", "y", "z", "gps_time", "sample_value", "returned_energy", "share")

FOOT = 0.002
"""The pulse is followed as far as it is higher than this."""


def backscatter_samples(
    waves: Waveforms, strip: int, params: SampleParams, fit: DecomposeParams, pulse: SystemPulse, placement: Placement
) -> tuple[Table, dict[str, float]]:
    """The samples of a chunk that belong to a signal, each with its place and what sent light back there.

    Parameters
    ----------
    waves : pulses, returns (whether there are any) and samples of a chunk.
    strip : number of the source file.
    pulse, placement : what the strip tells of its pulse and its places.

    Returns
    -------
    `SAMPLE_COLUMNS`, a row a sample, by pulse and time; and ``energy`` over all and ``dropped`` of it in samples below
    `params.least` [DN ns].
    """
    waves, doubt = recovered(waves, fit, pulse)
    fits = fit_waveforms(waves, fit, pulse, doubt)
    spacing, length = waves.pulses["sample_spacing"].astype(np.float64), np.diff(waves.offsets)
    kinds, channels, kind = pulses_of(waves, pulse)
    height, energy = np.zeros(len(waves.samples)), np.zeros(len(waves.samples))
    usable = np.isfinite(fits.noise) & np.isfinite(fits.baseline) & (length > 0)
    gain = waves.pulses["gain"].astype(np.float64)
    for step, which in np.unique(np.stack([spacing, kind], axis=1)[usable], axis=0):
        rows = np.flatnonzero(usable & (spacing == step) & (kind == which))
        own, channel = kinds[int(which)], channels[int(which)]
        shape, before = pulse_at_samples(own, float(step))
        error = height_error(own, channel) if channel else math.sqrt(float(step) / own.energy)
        limit = params.threshold * error * fits.noise[rows]
        gold, level = params.method == "gold", fits.baseline[rows]
        deconvolve_rows(waves.wide, waves.offsets, rows, level, limit, shape, before, gold, params.iterations, height)
        area = float(shape.sum()) * float(step)
        at = _samples_of(waves.offsets, rows)
        energy[at] = height[at] * area * np.repeat(gain[rows], length[rows])
    return _place_samples(waves, strip, fits, height, energy, params, fit, pulse, placement)


def pulse_at_samples(pulse: SystemPulse, spacing: float) -> tuple[Floats, int]:
    """float64 (samples,): heights of the pulse, 1 at its peak, every `spacing` [ns] around it, and how many come before
    it."""
    profiles = Profiles(pulse)
    begin, end = (math.floor(v / spacing) for v in profiles.reach(profiles.s0))
    begin, end = min(begin, -1), max(end + 1, 1)
    h = np.asarray(profiles.at(profiles.s0, begin, end - begin + 1, spacing), np.float64)
    high = np.flatnonzero(h > FOOT)
    first, last = min(int(high[0]), -begin), max(int(high[-1]), -begin)
    return np.maximum(h[first : last + 1], 0.0), -begin - first


def _samples_of(offsets: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    length = np.diff(offsets)[rows]
    begin = np.concatenate([[0], np.cumsum(length)])[:-1]
    return np.asarray(np.arange(int(length.sum())) + np.repeat(offsets[rows] - begin, length))


def _place_samples(
    waves: Waveforms,
    strip: int,
    fits: Fits,
    height: Floats,
    energy: Floats,
    params: SampleParams,
    fit: DecomposeParams,
    pulse: SystemPulse,
    placement: Placement,
) -> tuple[Table, dict[str, float]]:
    row = np.repeat(np.arange(waves.pulses.rows), np.diff(waves.offsets))
    noise, level = (np.nan_to_num(getattr(fits, n), nan=np.inf)[row] for n in ("noise", "baseline"))
    strong = np.flatnonzero(height > params.least * noise)
    total, sure = float(energy.sum()), float(energy[strong].sum())
    row, sample = row[strong], strong - waves.offsets[row[strong]]
    start, velocity = first_samples(waves, fits, fit, pulse, placement)
    pulses = waves.pulses
    time = sample * pulses["sample_spacing"].astype(np.float64)[row]
    place = start[row] + time[:, None] * velocity[row]
    names, of = np.unique(pulses["pulse"], return_inverse=True)
    whole = np.bincount(of[row], weights=energy[strong], minlength=len(names))
    columns = {
        "strip": np.full(len(row), strip),
        "pulse": pulses["pulse"][row],
        "sample": sample + _before(pulses)[row],
        **{axis: quantise(place[:, c]) for c, axis in enumerate("xyz")},
        "gps_time": pulses["gps_time"][row],
        "sample_value": waves.samples[strong] - level[strong],
        "returned_energy": energy[strong],
        "share": energy[strong] / np.maximum(whole[of[row]], TINY),
    }
    return Table({n: columns[n] for n in SAMPLE_COLUMNS}), {"energy": total, "dropped": total - sure}


def _before(pulses: Table) -> NDArray[np.int64]:
    """Samples of the pulse that lie before every row's first one."""
    late = pulses["segment_start"].astype(np.float64) / pulses["sample_spacing"]
    return np.nan_to_num(np.rint(late), nan=0.0, posinf=0.0, neginf=0.0).astype(np.int64)


def first_samples(
    waves: Waveforms, fits: Fits, fit: DecomposeParams, pulse: SystemPulse, placement: Placement
) -> tuple[Floats, Floats]:
    """Where the light is that is recorded in the first sample of every row, and its metres a nanosecond, both (n, 3).

    The vendor's offset is that of the row's highest echo: samples have no height of their own to tell it by.
    """
    late, _ = origins_of(waves, fit, pulse, placement)
    pulses = waves.pulses
    offsets = offsets_of(fits, pulses, placement)
    after = fits.time - offsets - (pulses["anchor_time"].astype(np.float64) + late)[fits.row]
    shift = np.zeros(pulses.rows)
    if waves.returns.rows:
        shift, _ = row_shifts(fits, after, waves, fit, placement)
    usual = np.zeros(pulses.rows)
    order = np.argsort(fits.amplitude, kind="stable")
    usual[fits.row[order]] = offsets[order]
    beam, speed = beams(waves)
    anchor = np.stack([pulses[f"anchor_{axis}"] for axis in "xyz"], axis=1)
    back = pulses["anchor_time"].astype(np.float64) + late + shift + usual
    velocity = beam * speed[:, None]
    return anchor - back[:, None] * velocity, velocity


def join_samples(parts: Sequence[Table]) -> Table:
    """Samples of several chunks in one order: strip, pulse, sample."""
    table = Table.concat([Table.empty(SAMPLE_COLUMNS), *parts])
    return table.take(np.lexsort((table["sample"], table["pulse"], table["strip"])))


SAMPLES = Computation("samples", 1, writes=SAMPLE_COLUMNS)
