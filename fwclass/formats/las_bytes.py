"""LAS and LAZ files as bytes: header, records, points; nothing is interpreted that need not be.

Copying a strip must not lose what a library does not know, so its header and its variable length records are
carried as they are. Points go through LASzip, which keeps every byte of every point format, wave packets too.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import laszip
import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError, StoreError
from fwclass.formats.las_header import EVLR_HEADER, RECORD_LENGTH, Record, read_header, text
from fwclass.formats.laszip_input import open_for_laszip

POINT_SIZE = dict(enumerate(RECORD_LENGTH))
"""Bytes of a point record without extra bytes, by point format."""

HEADER_SIZE = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
"""Bytes of the public header block, by minor version."""

EXTRA_BYTES = ("LASF_Spec", 4)
LASZIP = ("laszip encoded", 22204)
WAVEFORM_PACKETS = 65535
INTERNAL, EXTERNAL, WKT = 2, 4, 16
"""Bits of the global encoding."""

AT_ENCODING, AT_OFFSET, AT_FORMAT, AT_PACKETS, AT_EVLRS = 6, 96, 104, 227, 235
BLOCK = 1 << 20
EVERYTHING = 0xFFFFFFFF
MAX_CHUNK = 1 << 28
"""Bytes of points held at once."""

MAX_HEAD = 1 << 28
"""Header and records above this size [bytes] are refused before they are read."""


@dataclass(frozen=True)
class LasHead:
    """Header block and variable length records of a file, as bytes.

    `block`: the public header block, user bytes included. `records`: the variable length records, in order. `gap`:
    bytes between the last record and the first point.
    """

    path: Path
    block: bytes
    records: tuple[Record, ...]
    gap: bytes
    file_size: int

    @property
    def minor(self) -> int:
        """Minor version."""
        return self.block[25]

    @property
    def point_format(self) -> int:
        """Point format without the bits of compression."""
        return self.block[AT_FORMAT] & 0x3F

    @property
    def compressed(self) -> bool:
        """The points are compressed (LAZ)."""
        return bool(self.block[AT_FORMAT] & 0x80)

    @property
    def encoding(self) -> int:
        """Global encoding."""
        return self._get("<H", AT_ENCODING)

    @property
    def point_offset(self) -> int:
        """First byte of the points."""
        return self._get("<I", AT_OFFSET)

    @property
    def point_size(self) -> int:
        """Bytes of a point."""
        return self._get("<H", 105)

    @property
    def points(self) -> int:
        """Number of points."""
        count = self._get("<Q", 247) if self.minor >= 4 else 0
        return count or self._get("<I", 107)

    @property
    def least_end(self) -> int:
        """No record behind the points begins before this byte."""
        return self.point_offset + (0 if self.compressed else self.points * self.point_size)

    @property
    def packets_start(self) -> int:
        """First byte of waveform packets in the file, 0 without any."""
        return self._get("<Q", AT_PACKETS) if self.minor >= 3 else 0

    @property
    def evlrs_start(self) -> int:
        """First byte of the records after the points, 0 without any."""
        return self._get("<Q", AT_EVLRS) if self.minor >= 4 else 0

    @property
    def evlrs(self) -> int:
        """Number of records after the points."""
        return self._get("<I", AT_EVLRS + 8) if self.minor >= 4 else 0

    def _get(self, kind: str, at: int) -> int:
        return int(struct.unpack_from(kind, self.block, at)[0])


def kept_records(head: LasHead) -> LasHead:
    """`head` without the records that say how points are stored (LASzip, COPC)."""
    records = tuple(r for r in head.records if (r.user, r.number) != LASZIP and r.user != "copc")
    return replace(head, records=records)


def class_byte(point_format: int) -> int:
    """Place of the classification in a point record."""
    return 16 if point_format >= 6 else 15


def copy_bytes(source: BinaryIO, target: BinaryIO, start: int, length: int) -> int:
    """Copy `length` bytes from `start`, in blocks; the number of bytes that were there."""
    source.seek(start)
    left = length
    while left > 0 and (block := source.read(min(left, BLOCK))):
        target.write(block)
        left -= len(block)
    return length - left


def broken(path: Path, what: str, expected: object, got: object) -> InputError:
    """What to raise for a damaged source."""
    return InputError(
        what,
        where=path,
        expected=expected,
        got=got,
        do="the file is damaged or incomplete: fetch it again from its source",
    )


def differs(copy: Path, what: str, wanted: object, got: object) -> StoreError:
    """What to raise for a copy that is not as its source."""
    return StoreError(
        f"read back, {what} differs from the source",
        where=copy,
        expected=wanted,
        got=got,
        do="nothing was published; report this with the source's point format (fwclass info)",
    )


def read_head(path: Path) -> LasHead:
    """Header and records of a LAS or LAZ file; `InputError` where sizes contradict each other."""
    header = read_header(path)
    minor, start = header.version[1], header.points_start
    if header.version[0] != 1 or not HEADER_SIZE[minor] <= header.header_size <= start <= MAX_HEAD:
        raise broken(path, "the header's sizes do not fit", f"at most {MAX_HEAD} bytes", (header.header_size, start))
    with path.open("rb") as file:
        head = file.read(start)
    at = header.vlrs[-1].start + len(header.vlrs[-1].raw) if header.vlrs else header.header_size
    return LasHead(path, head[: header.header_size], header.vlrs, head[at:], header.size)


def read_extended(file: BinaryIO, head: LasHead, start: int) -> Record:
    """The extended record at `start`; `InputError` if its header does not lie behind the points, in the file."""
    last = head.file_size - EVLR_HEADER
    if not head.least_end <= start <= last:
        wanted = f"a record that begins between the bytes {head.least_end} and {last}, behind the points"
        raise broken(head.path, "an extended record lies outside its place in the file", wanted, f"byte {start}")
    file.seek(start)
    _, user, number, length, _ = struct.unpack("<H16sHQ32s", file.read(EVLR_HEADER))
    return Record(text(user), number, start, length, b"")


def extended_records(file: BinaryIO, head: LasHead) -> list[Record]:
    """Every extended record that the header lists, in order."""
    records: list[Record] = []
    at = head.evlrs_start
    for _ in range(head.evlrs):
        record = read_extended(file, head, at)
        records.append(record)
        at = record.end
    return records


def chunk_rows(wanted: int, point_size: int) -> int:
    """`wanted` points, or fewer where a header claims a point size that would fill the memory."""
    return max(1, min(wanted, MAX_CHUNK // point_size))


def point_chunks(head: LasHead, chunk: int) -> Iterator[NDArray[np.uint8]]:
    """Points in file order as byte arrays of shape (at most `chunk`, point size); the array is used again."""
    chunk = chunk_rows(chunk, head.point_size)
    buffer = np.empty((min(chunk, head.points), head.point_size), np.uint8)
    with open_for_laszip(head.path, head.records) as file:
        take = _decompressor(head, file) if head.compressed and head.points else _plain(head, file)
        for first in range(0, head.points, chunk):
            part = buffer[: min(chunk, head.points - first)]
            take(part)
            yield part


def _plain(head: LasHead, file: BinaryIO) -> Any:
    file.seek(head.point_offset)

    def take(part: NDArray[np.uint8]) -> None:
        if file.readinto(part.reshape(-1).data) != part.size:  # type: ignore[attr-defined]
            raise broken(head.path, "the file ends before its last point", head.points, "fewer")

    return take


def _decompressor(head: LasHead, file: BinaryIO) -> Any:
    try:
        reader = laszip.LasUnZipper(file, EVERYTHING)
    except Exception as fault:
        raise broken(head.path, "the compressed points cannot be read", "LAZ", fault) from fault

    def take(part: NDArray[np.uint8]) -> None:
        try:
            reader.decompress_into(part.reshape(-1))
        except Exception as fault:
            raise broken(head.path, "the compressed points cannot be read", "LAZ", fault) from fault

    return take
