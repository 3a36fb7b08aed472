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

from fwclass.decompose.fitting import Fits, fit_waveforms, pulses_of
from fwclass.decompose.params import DecomposeParams, SampleParams
from fwclass.decompose.placement import Placement, offsets_of
from fwclass.decompose.placing import beams, origins_of, row_shifts
from fwclass.decompose.shapes import Profiles, height_error
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.grid import quantised
from fwclass.kernel import kernel
from fwclass.schema import Table
from fwclass.stage import Computation
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

SAMPLE_COLUMNS = ("strip", "pulse", "sample", "x", "y", "z", "gps_time", "sample_value", "returned_energy", "share")

FOOT = 0.002
"""The pulse is followed as far as it is higher than this."""
TINY = 1e-12


@kernel
def deconvolve_rows(samples, offsets, rows, level, limit, pulse, before, gold, rounds, out):  # type: ignore[no-untyped-def]
    """Backscatter at every sample of waveforms, in heights of the pulse.

    Parameters
    ----------
    samples, offsets : [DN]; waveform i is ``samples[offsets[i]:offsets[i + 1]]``.
    rows : waveforms; level : (len(rows),) of each without signal [DN].
    limit : (len(rows),) what the sum over the pulse's own shape must reach for a sample to belong to a signal [DN].
    pulse, before : heights of the pulse at whole samples, the peak at ``pulse[before]``.
    gold : Gold's ratio instead of Richardson and Lucy's; rounds : how often it is taken.
    out : filled at the rows' samples; 0 where there is no signal.
    """
    m = len(pulse)
    mass, power = pulse.sum(), (pulse * pulse).sum()
    longest = 0
    for i in rows:
        longest = max(longest, offsets[i + 1] - offsets[i])
    y, x, fold = np.empty(longest), np.empty(longest + 2 * m), np.empty(longest + 2 * m)
    seen, weight = np.empty(longest + 2 * m), np.empty(longest + 2 * m)
    signal = np.empty(longest, np.bool_)
    for r in range(len(rows)):
        low, n = offsets[rows[r]], offsets[rows[r] + 1] - offsets[rows[r]]
        for j in range(n):
            y[j] = samples[low + j] - level[r]
            signal[j] = False
        for j in range(n):
            height = 0.0
            for k in range(max(0, before - j), min(m, n - j + before)):
                height += pulse[k] * y[j + k - before]
            if height > limit[r] * power:
                for k in range(max(0, j - before), min(n, j + m - before)):
                    signal[k] = True
        start = 0
        while start < n:
            if not signal[start]:
                start += 1
                continue
            stop = start
            while stop < n and signal[stop]:
                stop += 1
            size, total = stop - start, 0.0
            for j in range(size):
                y[start + j] = max(y[start + j], 0.0)
                total += y[start + j]
            for j in range(size):
                x[j] = total / (size * mass)
                weight[j] = 0.0
                for k in range(m):
                    if 0 <= j + k - before < size:
                        weight[j] += pulse[k]
                seen[j] = 0.0
                if gold:
                    for k in range(max(0, before - j), min(m, size - j + before)):
                        seen[j] += pulse[k] * y[start + j + k - before]
            for _ in range(rounds):
                for j in range(size):
                    value = 0.0
                    for k in range(max(0, j + before - size + 1), min(m, j + before + 1)):
                        value += pulse[k] * x[j + before - k]
                    fold[j] = value if gold else y[start + j] / max(value, TINY)
                for j in range(size):
                    value = 0.0
                    for k in range(max(0, before - j), min(m, size - j + before)):
                        value += pulse[k] * fold[j + k - before]
                    if gold:
                        x[j] *= max(seen[j], 0.0) / max(value, TINY)
                    else:
                        x[j] *= value / max(weight[j], TINY)
            for j in range(size):
                out[low + start + j] = x[j]
            start = stop


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
    fits = fit_waveforms(waves, fit, pulse)
    spacing, length = waves.pulses["sample_spacing"].astype(np.float64), np.diff(waves.offsets)
    kinds, kind = pulses_of(waves, pulse)
    known = [*(c for c in pulse.channels if c.freedom > 0.0), None]
    height, energy = np.zeros(len(waves.samples)), np.zeros(len(waves.samples))
    usable = np.isfinite(fits.noise) & np.isfinite(fits.baseline) & (length > 0)
    gain = waves.pulses["gain"].astype(np.float64)
    for step, which in np.unique(np.stack([spacing, kind], axis=1)[usable], axis=0):
        rows = np.flatnonzero(usable & (spacing == step) & (kind == which))
        own = kinds[int(which)]
        shape, before = pulse_at_samples(own, float(step))
        error = _height_error(own, known[int(which)], float(step))
        limit = params.threshold * error * fits.noise[rows]
        gold, level = params.method == "gold", fits.baseline[rows]
        deconvolve_rows(waves.wide, waves.offsets, rows, level, limit, shape, before, gold, params.iterations, height)
        area = float(shape.sum()) * float(step)
        at = _samples_of(waves.offsets, rows)
        energy[at] = height[at] * area * np.repeat(gain[rows], length[rows])
    return _placed(waves, strip, fits, height, energy, params, fit, pulse, placement)


def pulse_at_samples(pulse: SystemPulse, spacing: float) -> tuple[Floats, int]:
    """Heights of the pulse at whole samples around its peak, and how many come before it."""
    profiles = Profiles(pulse)
    begin, end = (math.floor(v / spacing) for v in profiles.reach(profiles.s0))
    begin, end = min(begin, -1), max(end + 1, 1)
    h = np.asarray(profiles.at(profiles.s0, begin, end - begin + 1, spacing), np.float64)
    high = np.flatnonzero(h > FOOT)
    first, last = min(int(high[0]), -begin), max(int(high[-1]), -begin)
    return np.maximum(h[first : last + 1], 0.0), -begin - first


def _height_error(pulse: SystemPulse, channel: Channel | None, spacing: float) -> float:
    return height_error(pulse, channel) if channel else math.sqrt(spacing / pulse.energy)


def _samples_of(offsets: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    length = np.diff(offsets)[rows]
    begin = np.concatenate([[0], np.cumsum(length)])[:-1]
    return np.asarray(np.arange(int(length.sum())) + np.repeat(offsets[rows] - begin, length))


def _placed(
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
    kept = np.flatnonzero(height > params.least * noise)
    total, sure = float(energy.sum()), float(energy[kept].sum())
    row, sample = row[kept], kept - waves.offsets[row[kept]]
    start, velocity = first_samples(waves, fits, fit, pulse, placement)
    pulses = waves.pulses
    time = sample * pulses["sample_spacing"].astype(np.float64)[row]
    place = start[row] + time[:, None] * velocity[row]
    names, of = np.unique(pulses["pulse"], return_inverse=True)
    whole = np.bincount(of[row], weights=energy[kept], minlength=len(names))
    columns = {
        "strip": np.full(len(row), strip),
        "pulse": pulses["pulse"][row],
        "sample": sample + np.rint(pulses["segment_start"] / pulses["sample_spacing"]).astype(np.int64)[row],
        **{axis: quantised(place[:, c]) for c, axis in enumerate("xyz")},
        "gps_time": pulses["gps_time"][row],
        "sample_value": waves.samples[kept] - level[kept],
        "returned_energy": energy[kept],
        "share": energy[kept] / np.maximum(whole[of[row]], TINY),
    }
    return Table({n: columns[n] for n in SAMPLE_COLUMNS}), {"energy": total, "dropped": total - sure}


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


def joined(parts: Sequence[Table]) -> Table:
    """Samples of several chunks in one order: strip, pulse, sample."""
    table = Table.concat([Table.empty(SAMPLE_COLUMNS), *parts])
    return table.take(np.lexsort((table["sample"], table["pulse"], table["strip"])))


SAMPLES = Computation("samples", 1, writes=SAMPLE_COLUMNS)
