"""Bytes that try to lead the decoder of compressed packets out of its arrays."""

from __future__ import annotations

import numpy as np
from wdzmaker import packed

from fwclass.read.compressed_packets import SHORTEST, decompress
from fwclass.read.plz_kernels import (
    BITS,
    EXTRA_BYTES,
    MODELS,
    PULSE_0,
    SOURCE_16,
    SOURCE_32,
    TABLE_MODELS,
    WAVE_BITS,
    WAVE_MODELS,
    unpack_pulses,
    unpack_table,
    unpack_waves,
)
from fwclass.read.range_coder import decoder_of


def drive_pulses(rng: np.random.Generator, packet: np.ndarray) -> None:
    """The same bytes as a table of chunks, as pulses and as waves."""
    n = int(rng.integers(1, 30))
    sizes, lengths = np.zeros(n, np.int64), np.zeros(n, np.int64)
    end = len(packet)
    unpack_table(*decoder_of(packet, TABLE_MODELS, 1), 0, end, bool(rng.integers(2)), sizes, lengths)
    kinds = [[PULSE_0, 48], [SOURCE_16, 2], [SOURCE_32, 4], [EXTRA_BYTES, 3]]
    items = np.array([kinds[0], *(k for k in kinds[1:] if rng.integers(2))])
    out = np.zeros((n, items[:, 1].sum()), np.uint8)
    head = rng.integers(0, 256, items[:, 1].sum()).astype(np.uint8)
    both = np.r_[head, packet]
    unpack_pulses(*decoder_of(both, MODELS + 9, BITS), 0, len(both), items, out)
    widths = rng.choice([0, 1, 2, 4], 3)
    samplings = np.array(
        [[widths[0], min(widths[1], 2), min(widths[2], 2), 2, rng.choice([0, 9, 2**32 - 1]), 1 + k] for k in range(2)]
    )
    described = np.array([[rng.integers(0, 9), 0, 2]])
    ends, start, stop = (np.zeros(3, np.int64) for _ in range(3))
    offset = rng.integers(-9, end + 9, 3)
    first, size = np.clip(offset, 0, end), end + int(rng.integers(0, 99))  # the rest of the file is not read
    unpack_waves(
        *decoder_of(packet, WAVE_MODELS, WAVE_BITS),
        first,
        np.maximum(first, rng.integers(0, end + 1, 3)),
        offset,
        size,
        np.array([0, -1, 0]),
        described,
        samplings,
        np.array([True, False]),
        0,
        100,
        100 * end,
        ends,
        start,
        stop,
        np.empty(int(rng.integers(0, 4000)), np.uint8),
    )


def drive(inputs: int, seed: int) -> int:
    """Packets of any bytes, and sound ones with a few changed; at the end of the data, too."""
    rng = np.random.default_rng(seed)
    for _ in range(inputs):
        wide = bool(rng.integers(2))
        n, size = int(rng.integers(1, 200)), int(rng.integers(1 + wide + SHORTEST, 120))
        packet = rng.integers(0, 256, size).astype(np.uint8)
        if rng.integers(2):
            values = rng.integers(0, rng.choice([2, 30, 256]), n)
            packet = np.frombuffer(packed(values, 16 if wide else 8), np.uint8).copy()
            packet[rng.integers(0, len(packet), 3)] = rng.integers(0, 256, 3)
        drive_pulses(rng, packet)
        decompress(packet, np.array([0]), np.array([len(packet)]), np.array([wide]), np.array([True]), np.array([n]))
    return inputs
