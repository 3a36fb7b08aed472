"""Compressed waveform packets (descriptors of compression type 1, in a `.wdz` or inside of the file).

Every packet is by itself: its first sample as it is, then the differences of neighbours in LASzip's integer coding
(the number of significant bits, then the bits, by models that adapt) on A. Said's range coder. The encoder closes a
packet so that the decoder has read all of its bytes and none behind: one that ends elsewhere is not what was written.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.read.range_coder import FIRST_BYTES, begin, decoder_of, difference, forget, passed, position

SHORTEST = FIRST_BYTES
"""Bytes of a packet behind its first sample."""

_WIDTH, _FIRST, _MODELS = 0, 0, 17
"""Models: of the number of significant bits, and from 1 on of the bits where there are so many."""


def decompress(
    data: NDArray[np.uint8],
    start: NDArray[np.int64],
    size: NDArray[np.int64],
    wide: NDArray[np.bool_],
    packed: NDArray[np.bool_],
    samples: NDArray[np.int64],
) -> tuple[NDArray[np.uint16], NDArray[np.int64], NDArray[np.bool_]]:
    """Samples of packets one after the other, where each ends (from 0), and which packets are sound.

    Parameters
    ----------
    data : bytes; packet i is ``data[start[i]:start[i] + size[i]]``, which lies inside.
    wide, packed : whether its samples have 16 bits or 8, and are compressed. A compressed packet holds its first sample
        and `SHORTEST` bytes at least, another all of its samples.
    samples : of every packet, 1 at least. The caller has seen that memory holds their sum.
    """
    ends = np.concatenate([[0], np.cumsum(samples)]).astype(np.int64)
    unpacked, sound = np.zeros(int(ends[-1]), np.uint16), np.zeros(len(start), np.bool_)
    _decompress_all(*decoder_of(data, _MODELS, 1), start, size, wide, packed, ends, unpacked, sound)
    return unpacked, ends, sound


@kernel
def _decompress_all(data, state, counts, below, models, bits, start, size, wide, packed, ends, unpacked, sound):  # type: ignore[no-untyped-def]
    for i in range(len(start)):
        a, n, b = ends[i], ends[i + 1] - ends[i], 16 if wide[i] else 8
        stored, at = 1 if packed[i] else n, start[i]
        last = np.int64(0)
        for s in range(stored):
            last = np.int64(data[at])
            if wide[i]:
                last |= np.int64(data[at + 1]) << 8
            at += b >> 3
            unpacked[a + s] = last
        if not packed[i]:
            sound[i] = True
            continue
        forget(models, bits)
        begin(data, state, at, start[i] + size[i])
        for s in range(1, n):
            last = (last + difference(data, state, counts, below, models, bits, _WIDTH, _FIRST, 0, b)) & ((1 << b) - 1)
            unpacked[a + s] = last
            if passed(state):
                break
        sound[i] = position(state) == start[i] + size[i]
