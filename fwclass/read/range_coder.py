"""The range coder that LASzip and PulseWaves compress with: adaptive symbols, bits, and differences of whole numbers.

A. Said's FastAC with 32-bit numbers; the integer coding is M. Isenburg's: the number of significant bits, by a model of
the caller's context, then the bits, by a model for each number of them. All sums are of 64 bits and are cut to what the
coder has; bytes behind the end read as 0, and `passed` tells that it was passed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel

FIRST_BYTES = 4
"""Bytes that a decoder begins with."""

MOST_SYMBOLS = 256

_TOP_BITS = 8
_BIT_LIMIT, _BIT_SHIFT = 1 << 13, 13
_LIMIT, _SHIFT = 1 << 15, 15
_FULL, _LEAST = 0xFFFFFFFF, 1 << 24
_VALUE, _LENGTH, _AT, _END = 0, 1, 2, 3
_SYMBOLS, _TOTAL, _CYCLE, _LEFT = 0, 1, 2, 3
_ZEROS, _SEEN, _CHANCE, _PERIOD, _UNTIL = 0, 1, 2, 3, 4
_AT_ONCE = 19
"""Bits of equal chance that are read at once; of more, the lower 16 come first."""


class Decoder(NamedTuple):
    """Bytes, where the decoder is in them, and its models: counts and starts of symbols, what they adapt by, and those
    of single bits. Kernels take them one by one: together they would be counted at every call."""

    data: NDArray[np.uint8]
    state: NDArray[np.int64]
    counts: NDArray[np.int64]
    below: NDArray[np.int64]
    models: NDArray[np.int64]
    bits: NDArray[np.int64]


def decoder_of(data: NDArray[np.uint8], models: int, bits: int) -> Decoder:
    """A decoder of `data` with room for so many models of symbols and of single bits."""
    counts, below = (np.empty((models, MOST_SYMBOLS), np.int64) for _ in range(2))
    return Decoder(
        data, np.zeros(4, np.int64), counts, below, np.zeros((models, 4), np.int64), np.zeros((bits, 5), np.int64)
    )


@kernel
def begin(data, state, at, end):  # type: ignore[no-untyped-def]
    """Begin at byte `at` of what ends before `end`; models stay as they are."""
    state[_VALUE], state[_LENGTH], state[_AT], state[_END] = 0, _FULL, at, end
    for _ in range(FIRST_BYTES):
        _shift(data, state)


@kernel
def forget(models, bits):  # type: ignore[no-untyped-def]
    """All models as if nothing had been read; each is made when it is used first."""
    for k in range(len(models)):
        models[k, _SYMBOLS] = 0
    for k in range(len(bits)):
        bits[k, _PERIOD] = 0


@kernel
def position(state):  # type: ignore[no-untyped-def]
    """The byte behind the last that was read."""
    return state[_AT]


@kernel
def passed(state):  # type: ignore[no-untyped-def]
    """Whether more was read than there is."""
    return state[_AT] > state[_END]


@kernel
def _shift(data, state):  # type: ignore[no-untyped-def]
    at = state[_AT]
    more = np.int64(data[at]) if at < state[_END] else 0
    state[_VALUE] = ((state[_VALUE] << 8) | more) & _FULL
    state[_AT] = at + 1


@kernel
def _renew(data, state):  # type: ignore[no-untyped-def]
    while state[_LENGTH] < _LEAST:
        _shift(data, state)
        state[_LENGTH] <<= 8


@kernel
def difference(data, state, counts, below, models, bits, context, first, zero, width):  # type: ignore[no-untyped-def]
    """What a number of `width` bits is more than was expected, modulo 2^width.

    `context` is the model of the number of significant bits, ``first + k`` that of the bits where there are k, and
    `zero` the model of the single bit where there is none.
    """
    k = symbol(data, state, counts, below, models, context, width + 1)
    if k == 0:
        return bit(data, state, bits, zero)
    if k == 32:
        return -(1 << 31)
    c = symbol(data, state, counts, below, models, first + k, 1 << min(k, _TOP_BITS))
    if k > _TOP_BITS:
        c = (c << (k - _TOP_BITS)) | raw(data, state, k - _TOP_BITS)
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
def symbol(data, state, counts, below, models, k, symbols):  # type: ignore[no-untyped-def]
    """The next symbol by model `k`, which has so many."""
    if models[k, _SYMBOLS] == 0:
        _fresh(counts, below, models, k, symbols)
    upper = state[_LENGTH]
    length = upper >> _SHIFT
    wanted = min(state[_VALUE] // length, _LIMIT - 1)
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
    state[_VALUE] -= base
    state[_LENGTH] = upper - base
    _renew(data, state)
    counts[k, low] += 1
    models[k, _LEFT] -= 1
    if models[k, _LEFT] == 0:
        _adapt(counts, below, models, k)
    return low


@kernel
def bit(data, state, bits, k):  # type: ignore[no-untyped-def]
    """The next bit by model `k` of single bits."""
    m = bits[k]
    if m[_PERIOD] == 0:
        m[_ZEROS], m[_SEEN], m[_CHANCE], m[_PERIOD], m[_UNTIL] = 1, 2, 1 << 12, 4, 4
    share = m[_CHANCE] * (state[_LENGTH] >> _BIT_SHIFT)
    one = state[_VALUE] >= share
    if one:
        state[_VALUE] -= share
        state[_LENGTH] -= share
    else:
        state[_LENGTH] = share
        m[_ZEROS] += 1
    _renew(data, state)
    m[_UNTIL] -= 1
    if m[_UNTIL] == 0:
        m[_SEEN] += m[_PERIOD]
        if m[_SEEN] > _BIT_LIMIT:
            m[_SEEN] = (m[_SEEN] + 1) >> 1
            m[_ZEROS] = (m[_ZEROS] + 1) >> 1
            if m[_ZEROS] == m[_SEEN]:
                m[_SEEN] += 1
        m[_CHANCE] = (m[_ZEROS] * (0x80000000 // m[_SEEN])) >> (31 - _BIT_SHIFT)
        m[_PERIOD] = m[_UNTIL] = min((5 * m[_PERIOD]) >> 2, 64)
    return 1 if one else 0


@kernel
def raw(data, state, n):  # type: ignore[no-untyped-def]
    """`n` bits of equal chance, 1 to 32; damaged bytes may say more, which is cut off."""
    low, left = np.int64(0), n
    if n > _AT_ONCE:
        low, left = _at_once(data, state, 16), n - 16
    return (_at_once(data, state, left) << (n - left)) | low


@kernel
def _at_once(data, state, n):  # type: ignore[no-untyped-def]
    state[_LENGTH] >>= n
    value = state[_VALUE] // state[_LENGTH]
    state[_VALUE] -= value * state[_LENGTH]
    _renew(data, state)
    return value & ((1 << n) - 1)
