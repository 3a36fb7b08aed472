"""Writing LAS or LAZ behind a head of bytes that is given."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import laszip
import numpy as np
from numpy.typing import NDArray

from fwclass.formats.las_bytes import AT_FORMAT, AT_OFFSET
from fwclass.formats.las_header import VLR_HEADER

COUNTS = (107, 131), (247, 375)
"""Bytes of a header with the number of points, in all and by return: as before LAS 1.4, and of LAS 1.4."""


def assemble(block: bytes, records: list[bytes], gap: bytes = b"") -> bytes:
    """Header block and records of an uncompressed file, with offset and count set to fit."""
    body = bytearray(block)
    struct.pack_into("<II", body, AT_OFFSET, len(block) + sum(map(len, records)) + len(gap), len(records))
    body[AT_FORMAT] &= 0x3F
    return bytes(body) + b"".join(records) + gap


def record(user: str, number: int, description: str, data: bytes) -> bytes:
    """A variable length record with its header."""
    return struct.pack("<H16sHH32s", 0, user.encode(), number, len(data), description.encode()) + data


class LazWriter:
    """Compresses points behind a given uncompressed head; `finish` puts back what LASzip changed in it.

    LASzip replaces the software's name, the bounding box, the counts and the start of the packet record; only
    the offset to the points, the number of records and the compression bit are really its own. It gets the records
    without their names, as it needs none of them, and damaged ones that it knows by name end the process.
    """

    def __init__(self, file: BinaryIO, head: bytes) -> None:
        self.file, self.head = file, head
        self.zipper = laszip.LasZipper(file, _without_names(_without_counts(head)))

    def write(self, points: NDArray[np.uint8]) -> None:
        """Append points, uint8 (points, bytes of one)."""
        if points.size:
            self.zipper.compress(np.ascontiguousarray(points).reshape(-1))

    def finish(self, block: bytes | None = None) -> int:
        """End the points and restore the header (as `block`, where given); returns the end of the points."""
        self.zipper.done()
        end = self.file.seek(0, 2)
        self.file.seek(AT_OFFSET)
        own = self.file.read(9)
        whole = bytearray(block if block is not None else self.head[: struct.unpack_from("<H", self.head, 94)[0]])
        whole[AT_OFFSET : AT_OFFSET + 9] = own
        self.file.seek(0)
        self.file.write(whole)
        for at in _records(self.head):
            self.file.seek(at)
            self.file.write(self.head[at : at + VLR_HEADER])
        self.file.seek(end)
        return end


def _records(head: bytes) -> Iterator[int]:
    """Where each of the records begins."""
    (at,), (number,) = struct.unpack_from("<H", head, 94), struct.unpack_from("<I", head, AT_OFFSET + 4)
    for _ in range(number):
        yield at
        at += VLR_HEADER + struct.unpack_from("<H", head, at + 20)[0]


def _without_names(head: bytes) -> bytes:
    """`head` with records that no program knows, of the same length."""
    cleared = bytearray(head)
    for at in _records(head):
        cleared[at + 2 : at + 20] = bytes(18)
    return bytes(cleared)


def _without_counts(head: bytes) -> bytes:
    """`head` without counts of points, which LASzip takes itself: it refuses ones that contradict each other."""
    cleared = bytearray(head)
    (length,) = struct.unpack_from("<H", head, 94)
    for first, end in COUNTS:
        cleared[first : min(end, length)] = bytes(max(0, min(end, length) - first))
    return bytes(cleared)


class LasWriter:
    """As `LazWriter`, with the points as they are."""

    def __init__(self, file: BinaryIO, head: bytes) -> None:
        self.file, self.head = file, head
        file.write(head)

    def write(self, points: NDArray[np.uint8]) -> None:
        """Append points, uint8 (points, bytes of one)."""
        self.file.write(np.ascontiguousarray(points).tobytes())

    def finish(self, block: bytes | None = None) -> int:
        """Restore the header (as `block`, where given); returns the end of the points."""
        end = self.file.seek(0, 2)
        if block is not None:
            whole = bytearray(block)
            whole[AT_OFFSET : AT_OFFSET + 9] = self.head[AT_OFFSET : AT_OFFSET + 9]
            self.file.seek(0)
            self.file.write(whole)
            self.file.seek(end)
        return end


def point_writer(path: Path, file: BinaryIO, head: bytes) -> LazWriter | LasWriter:
    """Plain points where the name of the output ends in ``.las``, compressed ones elsewhere."""
    return LasWriter(file, head) if path.suffix.lower() == ".las" else LazWriter(file, head)
