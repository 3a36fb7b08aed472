"""How many values a Parquet file says it holds, from the bytes of its footer.

Arrow may not be asked: of a column whose description is damaged it ends the process. The footer is a struct in Thrift's
compact protocol (parquet.thrift): FileMetaData.row_groups (4) > RowGroup.columns (1) > ColumnChunk.meta_data (3) >
ColumnMetaData.num_values (5).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

MOST = 256 << 20
"""Bytes of a footer."""

DEEPEST = 32
"""Structs and lists within each other."""

_WANTED = (4, 1, 3, 5)
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)


def count_values(path: Path) -> int:
    """Values of all columns of all row groups; `ValueError` where the footer is damaged."""
    with path.open("rb") as stream:
        return values_in(stream, stream.seek(0, os.SEEK_END))


def values_in(stream: BinaryIO, size: int) -> int:
    """As `count_values`, of an open file of `size` bytes."""
    stream.seek(max(0, size - 8))
    tail = stream.read(8)
    length = struct.unpack("<I", tail[:4])[0] if len(tail) == 8 else 0
    if tail[4:] != b"PAR1" or not 0 < length <= min(size - 8, MOST):
        raise ValueError("no footer at its end")
    stream.seek(size - 8 - length)
    footer = _Footer(stream.read(length))
    try:
        counts = list(footer.struct(_WANTED, 0))
    except IndexError:
        raise ValueError("a footer that is cut short") from None
    if any(n < 0 for n in counts):
        raise ValueError("a negative number of values")
    return sum(counts)


class _Footer:
    """Walks once over the bytes; numbers at the end of a path of fields are given, the rest is passed over."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def struct(self, wanted: tuple[int, ...], depth: int) -> Iterator[int]:
        """The numbers at `wanted`, field by field, from a struct that begins here."""
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._signed()
            kind = head & 15
            if wanted and number == wanted[0]:
                yield from self._value(kind, wanted[1:], True, depth)
            else:
                yield from self._value(kind, (), False, depth)

    def _value(self, kind: int, wanted: tuple[int, ...], is_wanted: bool, depth: int) -> Iterator[int]:
        if depth > DEEPEST:
            raise ValueError("a footer of too many structs within each other")
        if kind in (_I16, _I32, _I64):
            value = self._signed()
            if is_wanted and not wanted:
                yield value
        elif kind == _STRUCT:
            yield from self.struct(wanted, depth + 1)
        elif kind in (_LIST, _SET):
            yield from self._list(wanted, is_wanted, depth)
        elif kind == _MAP:
            self._map(depth)
        elif kind == _BINARY:
            self._skip(self._number())
        elif kind in (_BYTE, _DOUBLE):
            self._skip(1 if kind == _BYTE else 8)
        elif kind not in (_TRUE, _FALSE):
            raise ValueError("a footer of unknown kinds")

    def _list(self, wanted: tuple[int, ...], is_wanted: bool, depth: int) -> Iterator[int]:
        head = self._byte()
        count = head >> 4 if head >> 4 < 15 else self._number()
        kind = head & 15
        for _ in range(count):
            if kind in (_TRUE, _FALSE):
                self._skip(1)
            else:
                yield from self._value(kind, wanted, is_wanted, depth + 1)

    def _map(self, depth: int) -> None:
        count = self._number()
        kinds = self._byte() if count else 0
        for _ in range(count):
            for kind in (kinds >> 4, kinds & 15):
                list(self._value(kind, (), False, depth + 1))

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def _skip(self, count: int) -> None:
        if count > len(self._data) - self._at:
            raise ValueError("a footer that is cut short")
        self._at += count

    def _number(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7
            if shift > 63:
                raise ValueError("a footer with a number of too many bytes")

    def _signed(self) -> int:
        value = self._number()
        return (value >> 1) ^ -(value & 1)
