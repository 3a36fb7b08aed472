"""Compressed waveform packets, written as LASzip writes them: FastAC's range coder, its adaptive models, integer
coding of differences. Shares nothing with the reader.

>>> packet = packed([10, 12, 11], bits=8)
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

TOP = 1 << 32


class Chance:
    """How probable a zero bit is, of 2^13."""

    def __init__(self) -> None:
        self.zeros, self.all, self.period, self.wait, self.p = 1, 2, 4, 4, 1 << 12

    def saw(self, bit: int) -> None:
        self.zeros += bit == 0
        self.wait -= 1
        if self.wait:
            return
        self.all += self.period
        if self.all > 1 << 13:
            self.all, self.zeros = (self.all + 1) // 2, (self.zeros + 1) // 2
            self.all += self.all == self.zeros
        self.p = (self.zeros * ((1 << 31) // self.all)) >> 18
        self.period = self.wait = min(5 * self.period // 4, 64)


class Frequencies:
    """How probable every symbol is, as starts of its share of 2^15."""

    def __init__(self, symbols: int) -> None:
        self.seen, self.total, self.period = [1] * symbols, 0, symbols
        self.renew()
        self.period = self.wait = (symbols + 6) // 2

    def renew(self) -> None:
        self.total += self.period
        if self.total > 1 << 15:
            self.seen = [(n + 1) // 2 for n in self.seen]
            self.total = sum(self.seen)
        scale = (1 << 31) // self.total
        self.starts = [scale * below >> 16 for below in accumulate(self.seen[:-1], initial=0)]
        self.period = self.wait = min(5 * self.period // 4, 8 * (len(self.seen) + 6))

    def saw(self, symbol: int) -> None:
        self.seen[symbol] += 1
        self.wait -= 1
        if self.wait == 0:
            self.renew()


class Coder:
    def __init__(self) -> None:
        self.low, self.span, self.out = 0, TOP - 1, bytearray()

    def _narrow(self, ahead: int, span: int) -> None:
        self.low, self.span = self.low + ahead, span
        self._carry()
        while self.span < 1 << 24:
            self._byte()
            self.span <<= 8

    def _carry(self) -> None:
        if self.low < TOP:
            return
        self.low -= TOP
        at = len(self.out) - 1
        while self.out[at] == 255:
            self.out[at] = 0
            at -= 1
        self.out[at] += 1

    def _byte(self) -> None:
        self.out.append(self.low >> 24)
        self.low = (self.low << 8) % TOP

    def bit(self, model: Chance, bit: int) -> None:
        part = model.p * (self.span >> 13)
        self._narrow(part if bit else 0, self.span - part if bit else part)
        model.saw(bit)

    def symbol(self, model: Frequencies, symbol: int) -> None:
        unit = self.span >> 15
        start = model.starts[symbol] * unit
        last = symbol + 1 == len(model.starts)
        self._narrow(start, (self.span if last else model.starts[symbol + 1] * unit) - start)
        model.saw(symbol)

    def raw(self, value: int, bits: int) -> None:
        if bits > 19:
            self.raw(value & 0xFFFF, 16)
            value, bits = value >> 16, bits - 16
        self._narrow(value * (self.span >> bits), self.span >> bits)

    def done(self) -> bytes:
        long = self.span > 1 << 25
        self.low += 1 << 24 if long else 1 << 23
        self._carry()
        for _ in range(1 if long else 2):
            self._byte()
        return bytes(self.out) + bytes(3 if long else 2)


class Differences:
    """Whole numbers of `bits` bits, as what they are more than was expected."""

    def __init__(self, coder: Coder, bits: int, contexts: int = 1) -> None:
        self.coder, self.bits, self.contexts, self.zero = coder, bits, contexts, Chance()
        self.lengths: dict[int, Frequencies] = {}
        self.known: dict[int, Frequencies] = {}

    def put(self, expected: int, value: int, context: int = 0) -> None:
        half = 1 << (self.bits - 1)
        c = (value - expected + half) % (2 * half) - half
        k = (-c if c <= 0 else c - 1).bit_length()
        assert context < self.contexts
        if context not in self.lengths:
            self.lengths[context] = Frequencies(self.bits + 1)
        self.coder.symbol(self.lengths[context], k)
        if k == 0:
            self.coder.bit(self.zero, c)
            return
        if k == 32:
            return
        c = c + (1 << k) - 1 if c < 0 else c - 1
        known = self.known.setdefault(k, Frequencies(1 << min(k, 8)))
        self.coder.symbol(known, c >> max(k - 8, 0))
        if k > 8:
            self.coder.raw(c & ((1 << (k - 8)) - 1), k - 8)


def packed(samples: Sequence[int], bits: int) -> bytes:
    """A packet: the first sample, then the coded differences."""
    values = [int(v) for v in samples]
    coder = Coder()
    differences = Differences(coder, bits)
    for before, after in zip(values, values[1:], strict=False):
        differences.put(before, after)
    return values[0].to_bytes(bits // 8, "little") + coder.done()
