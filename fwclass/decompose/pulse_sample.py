"""Which waveforms of a strip the system's pulse is estimated from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.params import PulseParams
from fwclass.decompose.system_pulse import Channel
from fwclass.hashing import hash_keys
from fwclass.schema import Table
from fwclass.waveforms import RETURN_COLUMNS, Waveforms


def sample_pulses(waves: Waveforms, strip: int, n_pulses: int, params: PulseParams) -> Waveforms:
    """The waveforms of `waves` that fall into the sample of their strip, without returns.

    A hash of (strip, pulse) decides, so that cutting into chunks cannot matter.

    Parameters
    ----------
    waves : any part of a strip.
    strip : its index in the survey.
    n_pulses : pulses of the whole strip.
    """
    pulse = waves.pulses["pulse"].astype(np.uint64)
    chosen = np.ones(len(pulse), np.bool_)
    if n_pulses > params.sample:
        key = (np.uint64(strip) << np.uint64(40)) | (pulse << np.uint64(8))
        chosen = hash_keys(params.seed, key) < np.uint64(int(params.sample / n_pulses * 2.0**64))
    return rows_of(waves, np.flatnonzero(chosen))


def join_samples(parts: Iterable[Waveforms]) -> Waveforms:
    """Samples of several chunks as one, without returns and outgoing pulses, by (pulse, segment)."""
    samples = list(parts)
    if not samples:
        raise ValueError("nothing to join")
    lengths = np.concatenate([np.diff(part.offsets) for part in samples])
    whole = Waveforms(
        Table.concat([part.pulses for part in samples]),
        Table.empty(RETURN_COLUMNS),
        np.concatenate([part.samples[part.offsets[0] : part.offsets[-1]] for part in samples]),
        np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
    )
    return rows_of(whole, np.lexsort((whole.pulses["segment_start"], whole.pulses["pulse"])))


def with_signal(waves: Waveforms) -> Waveforms:
    """`waves` without those of nothing but zeros, or of the digitiser's limit: holes in a file, which would count as
    quiet samples. All of them where there is nothing else."""
    rows = np.flatnonzero(np.diff(waves.offsets) > 0)
    if len(rows) == 0:
        return waves
    highest, lowest = (f.reduceat(waves.samples, waves.offsets[rows]) for f in (np.maximum, np.minimum))
    some = (highest > 0) & ~(lowest >= waves.pulses["saturation"][rows])  # none is known: not at it
    return rows_of(waves, rows[some]) if some.any() and not some.all() else waves


def rows_of(waves: Waveforms, rows: NDArray) -> Waveforms:
    """Waveforms `rows`, int64 (some,), of `waves`, in that order, without returns and outgoing pulses."""
    length = np.diff(waves.offsets)[rows]
    offsets = np.concatenate([[0], np.cumsum(length)]).astype(np.int64)
    at = np.arange(offsets[-1]) + np.repeat(waves.offsets[rows] - offsets[:-1], length)
    return Waveforms(waves.pulses.take(rows), Table.empty(RETURN_COLUMNS), waves.samples[at], offsets)


def outgoing_of(waves: Waveforms, rows: NDArray) -> Waveforms:
    """The recorded outgoing pulses of `rows`, int64 (some,), of `waves`, in that order, as if they were waveforms."""
    return rows_of(Waveforms(waves.pulses, waves.returns, waves.outgoing, waves.outgoing_offsets), rows)


def of_channel(waves: Waveforms, channel: Channel, channels: Sequence[Channel], most: int) -> Waveforms:
    """The waveforms of one of the `channels` of the receiver, by (pulse, segment); every n-th of them where they hold
    more than `most` samples."""
    order = np.lexsort((waves.pulses["segment_start"], waves.pulses["pulse"]))
    mine = order[(channel_rows(channels, waves.pulses) == [c.key for c in channels].index(channel.key))[order]]
    length = int(np.diff(waves.offsets)[mine].sum())
    return rows_of(waves, mine[:: max(-(-length // most), 1)])
