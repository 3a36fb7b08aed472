"""Samples that no receiver records: what a file shows whose converter, or whose digitiser, is out of order."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.units import SIGMA_PER_MAD
from fwclass.waveforms import Waveforms

ODD = ("waveforms", "blank", "downward", "floored", "swapped", "doubled", "stuck")
"""What `odd_waveforms` counts."""

COUNTS = (*ODD, "late")
"""These, and what `late_waveforms` counts."""

HIGH, FALLS = 8.0, 2
"""Deviations that a first sample stands above the level, and samples behind that are lower, where a record begins
behind an echo's peak."""

FLOORED = 0.25
"""Share of a waveform's samples at 0 from which on its noise cannot be told; of a level two deviations above 0.02."""

DOWNWARD, DEEP, LEAST_SAMPLES = 3.0, 8.0, 8
"""Times that a waveform of so many samples goes further below its mean than above it where its echoes point down, and
deviations that it goes below its level: noise does it in 6e-5 of 12 samples, in 1e-5 of 24 or more."""

SMOOTHER = 2.0
"""Times that samples with their bytes exchanged go less up and down from which they were stored in that order: 256
where all are below 256, 3 or more where an echo fills the 16 bits; as many times more in sound ones."""

DOUBLED, CHANGES = 8, 4
"""Samples that are looked at first, and changes of value that a waveform must have, for its samples to be there
twice."""

PERIODS, ABOVE = 4, 8
"""Times that a waveform runs through a bit's values, and samples further above the lowest than these, that change the
bit; by chance one in 2^8 has not."""

ENDS, QUIETEST = 4, 0.5
"""Samples at either end that tell the level; the least deviation, of whole numbers [DN]."""


def odd_waveforms(waves: Waveforms) -> dict[str, int]:
    """How many pulses have samples (``waveforms``), none but zeros or the limit (``blank``), echoes that point
    ``downward``, and among others so many zeros that their level was cut off (``floored``), samples that are smooth
    with their two bytes exchanged alone (``swapped``), each of which is there twice (``doubled``), or with a bit that
    never changes between such as do (``stuck``)."""
    rows = np.flatnonzero(np.diff(waves.offsets) > 0)
    if len(rows) == 0:
        return dict.fromkeys(ODD, 0)
    samples, first = waves.samples[: waves.offsets[-1]], waves.offsets[rows]
    length = np.diff(waves.offsets)[rows]
    highest, lowest = (f.reduceat(samples, first).astype(np.float64) for f in (np.maximum, np.minimum))
    mean = np.add.reduceat(samples, first, dtype=np.int64) / length
    down = (mean - lowest > DOWNWARD * (highest - mean)) & (length >= LEAST_SAMPLES)
    down[down] = _dips(samples, first[down], length[down])
    zeros = np.add.reduceat(samples == 0, first, dtype=np.int64)
    floored = (zeros > FLOORED * length) & (highest > 0)
    pulses = waves.pulses["pulse"][rows]
    waveforms = len(np.unique(pulses))
    some = (highest > 0) & ~(lowest >= waves.pulses["saturation"][rows])  # none is known: not at it
    blank = waveforms - len(np.unique(pulses[some]))
    odd = {"downward": down, "floored": floored}
    # steps that the reader of a table has counted in have bytes and bits of their own
    stored = ((waves.pulses["receiver"] > 0) | (waves.pulses["gain"] == 1.0))[rows]
    odd |= {
        "swapped": _swapped(samples, first) & stored,
        "doubled": _doubled(samples, first, length),
        "stuck": _stuck(samples, first, length, highest - lowest) & stored,
    }
    return {"waveforms": waveforms, "blank": blank} | {k: len(np.unique(pulses[v])) for k, v in odd.items()}


def late_waveforms(waves: Waveforms, pulse: SystemPulse, echoes: Mapping[str, NDArray]) -> int:
    """How many pulses' records begin behind the peak of an echo that is lost: the first sample is `HIGH` deviations
    above the channel's level, from there they fall, and none of `echoes` (``pulse``, ``time`` [ns]) lies within a pulse
    width."""
    _, first = np.unique(waves.pulses["pulse"], return_index=True)
    first = first[np.diff(waves.offsets)[first] > FALLS]
    level = np.array([c.baseline + HIGH * max(c.noise, c.baseline_sd) for c in pulse.channels] + [np.inf])
    limit = level[channel_rows(pulse.channels, waves.pulses)][first]
    start = waves.offsets[first, None] + np.arange(FALLS + 1)
    values = waves.samples[start].astype(np.float64) if len(first) else np.empty((0, FALLS + 1))
    high = (values[:, 0] > limit) & (np.diff(values, axis=1) < 0.0).all(axis=1)
    near = echoes["pulse"][echoes["time"] <= pulse.fwhm]
    return int((high & ~np.isin(waves.pulses["pulse"][first], near)).sum())


def _swapped(samples: NDArray, first: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which waveforms, each from its `first` sample on, go up and down `SMOOTHER` times less with their bytes
    exchanged: the low byte of a sound echo is as good as random."""
    if samples.dtype.itemsize != 2:
        return np.zeros(len(first), bool)
    stored, exchanged = (_ways(values, first) for values in (samples, samples.byteswap()))
    return stored > SMOOTHER * exchanged


def _ways(samples: NDArray, first: NDArray[np.int64]) -> NDArray[np.int64]:
    """How far every waveform, each from its `first` sample on, goes up and down in all [DN]."""
    steps = np.abs(np.diff(samples.astype(np.int32), prepend=np.int32(0)))
    steps[first] = 0
    return np.asarray(np.add.reduceat(steps, first, dtype=np.int64))


def _dips(samples: NDArray, first: NDArray[np.int64], length: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which waveforms go `DEEP` deviations below the level of their samples and of their ends; a broad echo that fills
    its record does not."""
    out = np.zeros(len(first), bool)
    for n in np.unique(length):
        rows = np.flatnonzero(length == n)
        values = samples[first[rows, None] + np.arange(n)].astype(np.float64)
        middle = np.median(values, axis=1)
        deviation = SIGMA_PER_MAD * np.median(np.abs(values - middle[:, None]), axis=1)
        ends = np.minimum(values[:, :ENDS].mean(axis=1), values[:, -ENDS:].mean(axis=1))
        out[rows] = np.minimum(middle, ends) - values.min(axis=1) > DEEP * np.maximum(deviation, QUIETEST)
    return out


def _doubled(samples: NDArray, first: NDArray[np.int64], length: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which waveforms change their value at every other sample alone."""
    out = np.zeros(len(first), bool)
    rows = np.flatnonzero(length > DOUBLED)
    start = samples[first[rows, None] + np.arange(DOUBLED + 1)]
    changes = start[:, 1:] != start[:, :-1]
    for row in rows[~(changes[:, ::2].any(axis=1) & changes[:, 1::2].any(axis=1))]:
        values = samples[first[row] : first[row] + length[row]]
        changed = values[1:] != values[:-1]
        one, other = int(changed[::2].sum()), int(changed[1::2].sum())
        out[row] = min(one, other) == 0 and max(one, other) >= CHANGES
    return out


def _stuck(
    samples: NDArray, first: NDArray[np.int64], length: NDArray[np.int64], spread: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which waveforms, that reach over a `spread` [DN], have a bit that is the same in all of their samples, though
    higher and lower ones change."""
    changing = np.bitwise_or.reduceat(samples, first) & ~np.bitwise_and.reduceat(samples, first)
    out = np.zeros(len(first), bool)
    for bit in range(1, 8 * samples.dtype.itemsize - 1):
        lower = changing & ((1 << bit) - 1) > 0
        rows = np.flatnonzero(lower & (changing >> bit & 1 == 0) & (spread >= PERIODS * (2 << bit)))
        for row in rows[~out[rows]]:
            values = samples[first[row] : first[row] + length[row]]
            out[row] = int((values >= int(values.min()) + (2 << bit)).sum()) >= ABOVE
    return out
