"""How much a Parquet file holds, from the bytes of its footer and of its pages' headers.

Arrow may not be asked: of a column whose description is damaged it ends the process, and of a page it takes the memory
that its header asks for. Both are structs in Thrift's compact protocol (parquet.thrift): FileMetaData.row_groups (4) >
RowGroup.columns (1) > ColumnChunk.meta_data (3), and before every page its PageHeader.
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

SPARE, PAGE = 64 << 20, 256
"""Bytes that a file of any size may unpack to, and that a page counts beyond its own."""

_WANTED = (4, 1, 3)
_VALUES, _PACKED, _PAGES, _DICTIONARY = 5, 7, 9, 11
"""Of ColumnMetaData: num_values, total_compressed_size, data_page_offset, dictionary_page_offset."""

_UNPACKED_PAGE, _PACKED_PAGE = 2, 3
"""Of PageHeader: uncompressed_page_size, compressed_page_size."""

_HEAD = 1 << 14, 1 << 24
"""Bytes that are looked at for a page's header, at first, and at last: Arrow reads no longer one."""

_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)


def count_values(path: Path) -> int:
    """Values of all columns of all row groups; `ValueError` where the footer is damaged."""
    with path.open("rb") as stream:
        return values_in(stream, stream.seek(0, os.SEEK_END))


def check_file(path: Path, each: int) -> None:
    """As `check_unpacked`."""
    with path.open("rb") as stream:
        check_unpacked(stream, stream.seek(0, os.SEEK_END), each)


def values_in(stream: BinaryIO, size: int) -> int:
    """As `count_values`, of an open file of `size` bytes."""
    counts = [chunk.get(_VALUES, 0) for chunk in _chunks(stream, size)]
    if any(n < 0 for n in counts):
        raise ValueError("a negative number of values")
    return sum(counts)


def check_unpacked(stream: BinaryIO, size: int, each: int) -> None:
    """`ValueError` where the pages of all columns unpack to more than `SPARE` and `each` bytes for one of the file, or
    their headers are more than the file."""
    most = total = SPARE + each * size
    unread = size
    for chunk in _chunks(stream, size):
        pages, dictionary = chunk.get(_PAGES, 0), chunk.get(_DICTIONARY, 0)
        at = dictionary if 0 < dictionary < pages else pages
        end = min(at + chunk.get(_PACKED, 0), size)
        while chunk.get(_VALUES) and 0 <= at < end and total >= 0:
            header, length = _page(stream, at)
            packed = header.get(_PACKED_PAGE, 0)
            total -= max(0, header.get(_UNPACKED_PAGE, 0)) + PAGE
            at += length + packed if packed >= 0 else size
            unread -= length
            if unread < 0:
                raise ValueError("pages that several columns share")
    if total < 0:
        raise ValueError(f"{size:,} bytes that unpack to more than {most:,}")


def _chunks(stream: BinaryIO, size: int) -> list[dict[int, int]]:
    """The numbers that describe each column of each row group."""
    stream.seek(max(0, size - 8))
    tail = stream.read(8)
    length = struct.unpack("<I", tail[:4])[0] if len(tail) == 8 else 0
    if tail[4:] != b"PAR1" or not 0 < length <= min(size - 8, MOST):
        raise ValueError("no footer at its end")
    stream.seek(size - 8 - length)
    footer = _Thrift(stream.read(length))
    try:
        return list(footer.struct(_WANTED, 0))
    except IndexError:
        raise ValueError("a footer that is cut short") from None


def _page(stream: BinaryIO, at: int) -> tuple[dict[int, int], int]:
    """The numbers of the page's header that begins there, and its length."""
    for most in _HEAD:
        stream.seek(at)
        header = _Thrift(stream.read(most))
        try:
            return header.numbers(0), header.at
        except (IndexError, ValueError) as fault:
            damage = fault
    raise ValueError("a page without a header") from damage


class _Thrift:
    """Walks once over the bytes, and is `at` one of them; of structs at the end of a path of fields the numbers are
    given, the rest is passed over."""

    def __init__(self, data: bytes) -> None:
        self._data, self.at = data, 0

    def numbers(self, depth: int) -> dict[int, int]:
        """The numbers of a struct that begins here, by field."""
        number, numbers = 0, {}
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._signed()
            if head & 15 in (_I16, _I32, _I64):
                numbers[number] = self._signed()
            else:
                list(self._value(head & 15, (), False, depth))
        return numbers

    def struct(self, wanted: tuple[int, ...], depth: int) -> Iterator[dict[int, int]]:
        """Those of the structs at `wanted`, field by field, from a struct that begins here."""
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._signed()
            kind = head & 15
            if wanted and number == wanted[0]:
                yield from self._value(kind, wanted[1:], True, depth)
            else:
                yield from self._value(kind, (), False, depth)

    def _value(self, kind: int, wanted: tuple[int, ...], is_wanted: bool, depth: int) -> Iterator[dict[int, int]]:
        if depth > DEEPEST:
            raise ValueError("a footer of too many structs within each other")
        if kind in (_I16, _I32, _I64):
            self._signed()
        elif kind == _STRUCT and is_wanted and not wanted:
            yield self.numbers(depth + 1)
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

    def _list(self, wanted: tuple[int, ...], is_wanted: bool, depth: int) -> Iterator[dict[int, int]]:
        head = self._byte()
        count = head >> 4 if head >> 4 < 15 else self._number()
        kind = head & 15
        for _ in range(count):
            yield from self._element(kind, wanted, is_wanted, depth)

    def _element(self, kind: int, wanted: tuple[int, ...], is_wanted: bool, depth: int) -> Iterator[dict[int, int]]:
        """Of a list or map: truth values, which are no bytes in a struct, take one here."""
        if kind in (_TRUE, _FALSE):
            self._skip(1)
        else:
            yield from self._value(kind, wanted, is_wanted, depth + 1)

    def _map(self, depth: int) -> None:
        count = self._number()
        kinds = self._byte() if count else 0
        for _ in range(count):
            for kind in (kinds >> 4, kinds & 15):
                list(self._element(kind, (), False, depth))

    def _byte(self) -> int:
        self.at += 1
        return self._data[self.at - 1]

    def _skip(self, count: int) -> None:
        if count > len(self._data) - self.at:
            raise ValueError("a footer that is cut short")
        self.at += count

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
