"""Compressed waveform packets (descriptors of compression type 1, in a `.wdz` or inside of the file).

Every packet is by itself: its first sample as it is, then the differences of neighbours in LASzip's integer coding
(the number of significant bits, then the bits, by models that adapt) on A. Said's range coder. The encoder closes a
packet so that the decoder has read all of its bytes and none behind: one that ends elsewhere is not what was written.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel

SHORTEST = 4
"""Bytes of a packet behind its first sample: the decoder begins with so many."""

_TOP_BITS = 8
_BIT_LIMIT, _BIT_SHIFT = 1 << 13, 13
_LIMIT, _SHIFT = 1 << 15, 15
_FULL, _LEAST = 0xFFFFFFFF, 1 << 24
_VALUE, _LENGTH, _AT, _END = 0, 1, 2, 3
_SYMBOLS, _TOTAL, _CYCLE, _LEFT = 0, 1, 2, 3
_ZEROS, _SEEN, _CHANCE, _PERIOD, _UNTIL = 0, 1, 2, 3, 4
_MODELS, _MOST_SYMBOLS = 17, 256


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
    _decompress_all(data, start, size, wide, packed, ends, unpacked, sound)
    return unpacked, ends, sound


@kernel
def _decompress_all(data, start, size, wide, packed, ends, unpacked, sound):  # type: ignore[no-untyped-def]
    counts = np.empty((_MODELS, _MOST_SYMBOLS), np.int64)
    below = np.empty((_MODELS, _MOST_SYMBOLS), np.int64)
    models = np.empty((_MODELS, 4), np.int64)
    zero = np.empty(5, np.int64)
    coder = np.empty(4, np.int64)
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
        _begin(data, coder, at, start[i] + size[i])
        for k in range(_MODELS):
            models[k, _SYMBOLS] = 0  # not used yet
        _fresh(counts, below, models, 0, b + 1)
        zero[_ZEROS], zero[_SEEN], zero[_CHANCE], zero[_PERIOD], zero[_UNTIL] = 1, 2, 1 << 12, 4, 4
        for s in range(1, n):
            last = (last + _difference(data, coder, counts, below, models, zero)) & ((1 << b) - 1)
            unpacked[a + s] = last
            if coder[_AT] > coder[_END]:
                break
        sound[i] = coder[_AT] == coder[_END]


@kernel
def _begin(data, coder, at, end):  # type: ignore[no-untyped-def]
    coder[_VALUE], coder[_LENGTH], coder[_AT], coder[_END] = 0, _FULL, at, end
    for _ in range(4):
        _shift(data, coder)


@kernel
def _shift(data, coder):  # type: ignore[no-untyped-def]
    """One byte more; zeros behind the packet's end, which `_AT` passes."""
    at = coder[_AT]
    more = np.int64(data[at]) if at < coder[_END] else 0
    coder[_VALUE] = ((coder[_VALUE] << 8) | more) & _FULL
    coder[_AT] = at + 1


@kernel
def _renew(data, coder):  # type: ignore[no-untyped-def]
    while coder[_LENGTH] < _LEAST:
        _shift(data, coder)
        coder[_LENGTH] <<= 8


@kernel
def _difference(data, coder, counts, below, models, zero):  # type: ignore[no-untyped-def]
    """What the next sample is more than the last, modulo the range of samples."""
    k = _symbol(data, coder, counts, below, models, 0)
    if k == 0:
        return _bit(data, coder, zero)
    if models[k, _SYMBOLS] == 0:
        _fresh(counts, below, models, k, 1 << min(k, _TOP_BITS))
    c = _symbol(data, coder, counts, below, models, k)
    if k > _TOP_BITS:
        c = (c << (k - _TOP_BITS)) | _raw(data, coder, k - _TOP_BITS)
    return c + 1 if c >= 1 << (k - 1) else c - ((1 << k) - 1)


@kernel
def _fresh(counts, below, models, k, symbols):  # type: ignore[no-untyped-def]
    for j in range(symbols):
        counts[k, j] = 1
    models[k, _SYMBOLS], models[k, _TOTAL], models[k, _CYCLE] = symbols, 0, symbols
    _adapt(counts, below, models, k)
    models[k, _CYCLE] = models[k, _LEFT] = (symbols + 6) >> 1


@kernel
def _adapt(counts, below, models, k):  # type: ignore[no-untyped-def]
    symbols = models[k, _SYMBOLS]
    models[k, _TOTAL] += models[k, _CYCLE]
    if models[k, _TOTAL] > _LIMIT:
        total = 0
        for j in range(symbols):
            counts[k, j] = (counts[k, j] + 1) >> 1
            total += counts[k, j]
        models[k, _TOTAL] = total
    scale, running = 0x80000000 // models[k, _TOTAL], 0
    for j in range(symbols):
        below[k, j] = (scale * running) >> (31 - _SHIFT)
        running += counts[k, j]
    models[k, _CYCLE] = models[k, _LEFT] = min((5 * models[k, _CYCLE]) >> 2, (symbols + 6) << 3)


@kernel
def _symbol(data, coder, counts, below, models, k):  # type: ignore[no-untyped-def]
    upper = coder[_LENGTH]
    length = upper >> _SHIFT
    wanted = min(coder[_VALUE] // length, _LIMIT - 1)
    low, high = 0, models[k, _SYMBOLS]
    while high - low > 1:
        middle = (low + high) >> 1
        if below[k, middle] <= wanted:
            low = middle
        else:
            high = middle
    base = below[k, low] * length
    if low + 1 < models[k, _SYMBOLS]:
        upper = below[k, low + 1] * length
    coder[_VALUE] -= base
    coder[_LENGTH] = upper - base
    _renew(data, coder)
    counts[k, low] += 1
    models[k, _LEFT] -= 1
    if models[k, _LEFT] == 0:
        _adapt(counts, below, models, k)
    return low


@kernel
def _bit(data, coder, zero):  # type: ignore[no-untyped-def]
    share = zero[_CHANCE] * (coder[_LENGTH] >> _BIT_SHIFT)
    one = coder[_VALUE] >= share
    if one:
        coder[_VALUE] -= share
        coder[_LENGTH] -= share
    else:
        coder[_LENGTH] = share
        zero[_ZEROS] += 1
    _renew(data, coder)
    zero[_UNTIL] -= 1
    if zero[_UNTIL] == 0:
        zero[_SEEN] += zero[_PERIOD]
        if zero[_SEEN] > _BIT_LIMIT:
            zero[_SEEN] = (zero[_SEEN] + 1) >> 1
            zero[_ZEROS] = (zero[_ZEROS] + 1) >> 1
            if zero[_ZEROS] == zero[_SEEN]:
                zero[_SEEN] += 1
        zero[_CHANCE] = (zero[_ZEROS] * (0x80000000 // zero[_SEEN])) >> (31 - _BIT_SHIFT)
        zero[_PERIOD] = zero[_UNTIL] = min((5 * zero[_PERIOD]) >> 2, 64)
    return 1 if one else 0


@kernel
def _raw(data, coder, bits):  # type: ignore[no-untyped-def]
    """`bits` bits of equal chance; a damaged packet may hold more, which are cut off."""
    coder[_LENGTH] >>= bits
    value = coder[_VALUE] // coder[_LENGTH]
    coder[_VALUE] -= value * coder[_LENGTH]
    _renew(data, coder)
    return value & ((1 << bits) - 1)
