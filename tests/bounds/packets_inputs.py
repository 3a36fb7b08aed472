"""Bytes that try to lead the decoder of compressed packets out of its arrays."""

from __future__ import annotations

import numpy as np
from wdzmaker import packed

from fwclass.read.compressed_packets import SHORTEST, decompress


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
        decompress(packet, np.array([0]), np.array([len(packet)]), np.array([wide]), np.array([True]), np.array([n]))
    return inputs
