"""The LAS header and its variable length records, read with every size checked before it is used.

Source: ASPRS LAS 1.4 R15; record layouts of LAS 1.0 to 1.3 are prefixes of it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fwclass.errors import InputError
from fwclass.formats.checks import check_length, check_scales, counts_fewer
from fwclass.formats.header_counts import Stated, stated_counts
from fwclass.paths import open_sized

WAVE_OFFSET = {4: 28, 5: 34, 9: 30, 10: 38}
"""Byte of the 29-byte wave packet block in a point record, by point format."""

RECORD_LENGTH = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Shortest point record, by point format."""

WPD_FIRST, WPD_LAST, WDP_RECORD = 100, 354, 65535
SPEC_USERS = ("LASF_Spec", "LAS_Spec")
"""User ids of the specification's own records; the second is a common misspelling."""

PACKET_ENDINGS = (".wdp", ".wdz")
"""Of the files of packets beside a file of points: as they are, and compressed."""

VLR_HEADER, EVLR_HEADER = 54, 60
MAX_EVLR_BODY = 1 << 22
"""Bytes of an extended record that are kept; longer ones (waveforms, images) are only located."""

SEEN_BEHIND = 100
"""Records behind the points that are looked at: most are points, or none is."""

NEAR = 100_000.0
"""No strip is longer than this [m]."""


@dataclass(frozen=True)
class Record:
    """A variable length record: who wrote it, where it starts in the file, its length and its bytes; `head` are those
    of its own header, kept of records in front of the points."""

    user: str
    number: int
    start: int
    length: int
    body: bytes
    head: bytes = b""

    @property
    def raw(self) -> bytes:
        """The record with its head, as the file has it."""
        return self.head + self.body

    @property
    def end(self) -> int:
        """Byte behind an extended record."""
        return self.start + EVLR_HEADER + self.length


@dataclass(frozen=True)
class Header:
    """The public header block, checked against the size of the file.

    Attributes
    ----------
    point_format : 0 to 10, without the compression bits.
    record_length : bytes of a point record.
    bounds : xmin, ymin, zmin, xmax, ymax, zmax as the header states them [m].
    wave_start : byte of the internal waveform record's header; 0 if none is stated.
    vlrs, evlrs : the records that lie whole in the file.
    faults : what is wrong without making the file useless.
    stated : points in all and by return, which nothing but a remark goes by.
    """

    path: Path
    size: int
    version: tuple[int, int]
    global_encoding: int
    system: str
    software: str
    header_size: int
    points_start: int
    point_format: int
    record_length: int
    compressed: bool
    n_points: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    bounds: tuple[float, float, float, float, float, float]
    wave_start: int
    vlrs: tuple[Record, ...]
    evlrs: tuple[Record, ...]
    faults: tuple[str, ...]
    stated: Stated

    @property
    def has_waves(self) -> bool:
        """The point format holds waveform packets."""
        return self.point_format in WAVE_OFFSET

    @property
    def has_gps_time(self) -> bool:
        """The point format has GPS times."""
        return self.point_format not in (0, 2)

    def records(self, number: int, users: tuple[str, ...]) -> list[Record]:
        """Records of a number, of any of `users`."""
        return [r for r in (*self.vlrs, *self.evlrs) if r.number == number and r.user in users]


def read_header(path: Path) -> Header:
    """Parse the header of `path`; `InputError` if it is no LAS file or cannot be used."""
    stream, size = open_sized(path)
    with stream:
        if path.suffix.lower() in PACKET_ENDINGS:
            raise InputError("this file holds waveforms, not points", where=path, do="give the .las or .laz beside it")
        return _parse(stream, path, size)


def _parse(stream: BinaryIO, path: Path, size: int) -> Header:
    head = stream.read(375)
    _refuse_foreign(head, path, size)
    faults: list[str] = []
    version = (head[24], head[25])
    header_size, points_start, n_vlrs = struct.unpack_from("<HII", head, 94)
    raw_format, record_length, legacy_count = struct.unpack_from("<BHI", head, 104)
    point_format = raw_format & 0x3F
    compressed = bool(raw_format & 0xC0)
    wave_start, n_points, first_evlr, n_evlrs = 0, legacy_count, 0, 0
    if version >= (1, 3) and header_size >= 235 and len(head) >= 235:
        (wave_start,) = struct.unpack_from("<Q", head, 227)
    if version >= (1, 4) and header_size >= 375 and len(head) >= 375:
        first_evlr, n_evlrs, count = struct.unpack_from("<QIQ", head, 235)
        n_points = count
        if legacy_count > count == 0:
            raise InputError(
                "the header of LAS 1.4 counts no points, and its field of older versions does",
                where=path,
                expected=f"{legacy_count} in both",
                got="0 in the one that readers of LAS 1.4 go by",
                do="export the file again, or as LAS 1.2",
            )
    elif version >= (1, 4):
        faults.append(f"header of {header_size} bytes is too short for LAS 1.4 (375)")
    _check_layout(path, size, header_size, points_start, point_format, record_length)
    if not compressed:
        check_length(path, size, points_start, record_length, n_points, "points")
    scales = struct.unpack_from("<3d", head, 131)
    offsets = struct.unpack_from("<3d", head, 155)
    check_scales(path, scales, offsets)
    b = struct.unpack_from("<6d", head, 179)
    vlrs = _vlrs(stream, path, header_size, n_vlrs, points_start)
    points_end = points_start + (0 if compressed else n_points * record_length)
    evlrs = _evlrs(stream, first_evlr, n_evlrs, points_end, size, faults)
    if not compressed:
        behind = min([at for at in (wave_start, first_evlr) if points_end <= at <= size], default=size)
        _check_count(stream, path, points_end, behind, record_length, n_points, (scales, offsets, b))
    return Header(
        path,
        size,
        version,
        struct.unpack_from("<H", head, 6)[0],
        text(head[26:58]),
        text(head[58:90]),
        header_size,
        points_start,
        point_format,
        record_length,
        compressed,
        n_points,
        scales,
        offsets,
        (b[1], b[3], b[5], b[0], b[2], b[4]),
        wave_start,
        vlrs,
        evlrs,
        tuple(faults),
        stated_counts(head, version >= (1, 4) and min(header_size, len(head)) >= 375),
    )


def _refuse_foreign(head: bytes, path: Path, size: int) -> None:
    if size == 0:
        raise InputError(
            "the file is empty", where=path, expected="a LAS or LAZ file", got="0 bytes", do="copy it again"
        )
    if head[:4] != b"LASF":
        raise InputError(
            "this is no LAS or LAZ file",
            where=path,
            expected="the signature LASF",
            got=repr(head[:4]),
            do="give a LAS, LAZ or COPC file",
        )
    if len(head) < 227:
        raise InputError(
            "the file ends inside its header",
            where=path,
            expected="at least 227 bytes",
            got=f"{len(head)} bytes",
            do="copy it again",
        )
    version = (head[24], head[25])
    if not (1, 0) <= version <= (1, 4):
        raise InputError(
            "unknown LAS version",
            where=path,
            expected="1.0 to 1.4",
            got=f"{version[0]}.{version[1]}",
            do="convert the file to LAS 1.4",
        )


def _check_layout(
    path: Path, size: int, header_size: int, points_start: int, point_format: int, record_length: int
) -> None:
    if point_format >= len(RECORD_LENGTH):
        raise InputError(
            "unknown point format", where=path, expected="0 to 10", got=point_format, do="convert the file"
        )
    if record_length < RECORD_LENGTH[point_format]:
        raise InputError(
            "the point records are too short for their format",
            where=path,
            expected=f"at least {RECORD_LENGTH[point_format]} bytes for format {point_format}",
            got=f"{record_length} bytes",
            do="the header is damaged; export the file again",
        )
    if not 227 <= header_size <= points_start <= size:
        raise InputError(
            "the header's offsets do not fit the file",
            where=path,
            expected=f"227 <= header size <= start of points <= {size} bytes",
            got=f"header size {header_size}, start of points {points_start}",
            do="the file is cut short or its header damaged; copy or export it again",
        )


def _vlrs(stream: BinaryIO, path: Path, start: int, count: int, end: int) -> tuple[Record, ...]:
    records, at = [], start
    for i in range(count):
        stream.seek(at)
        head = stream.read(VLR_HEADER) if at + VLR_HEADER <= end else b""
        user, number, length = struct.unpack_from("<16sHH", head, 2) if head else (b"", 0, end)
        if at + VLR_HEADER + length > end:
            raise InputError(
                "the header's records run into the points",
                where=path,
                expected=f"{count} variable length records up to byte {end}",
                got=f"{i} whole ones",
                do="the header is damaged; copy or export the file again",
            )
        records.append(Record(text(user), number, at, length, stream.read(length), head))
        at += VLR_HEADER + length
    return tuple(records)


def _check_count(
    stream: BinaryIO,
    path: Path,
    start: int,
    end: int,
    record_length: int,
    count: int,
    places: tuple[tuple[float, ...], ...],
) -> None:
    """`InputError` where bytes `start` to `end`, behind the points that the header counts, read as more of them:
    whose writer was cut off, or to which points were added. Zeros and what lies elsewhere are none: outside of the
    header's bounds, or, as a header that counts none has none, beyond `NEAR` of the first of them."""
    room = max(0, min(end - start, SEEN_BEHIND * record_length)) // record_length
    stream.seek(start)
    records = np.frombuffer(stream.read(room * record_length), np.uint8).reshape(-1, record_length)
    scales, offsets, bounds = places
    with np.errstate(all="ignore"):  # of a damaged header
        place = records[:, :12].copy().view("<i4") * np.array(scales) + np.array(offsets)
        high, low = np.array(bounds[::2]), np.array(bounds[1::2])
        if not count:
            high, low = place[:1] + NEAR / 2, place[:1] - NEAR / 2
        near = (place >= low - (high - low)) & (place <= high + (high - low))
    if room and 2 * (near.all(axis=1) & records.any(axis=1)).sum() > room:
        more = (end - start) // record_length
        raise counts_fewer(path, count, "points", f"room for {more} more, which read as points")


def _evlrs(
    stream: BinaryIO, start: int, count: int, points_end: int, size: int, faults: list[str]
) -> tuple[Record, ...]:
    records: list[Record] = []
    at = start
    for i in range(count):
        record = evlr_at(stream, at, size) if at >= points_end else None
        if record is None:
            faults.append(f"the header promises {count} extended records, {i} lie in the file")
            break
        records.append(record)
        at += EVLR_HEADER + record.length
        if at > size and record.number != WDP_RECORD:  # of packets the reader tells it
            faults.append(f"the file ends {at - size} bytes before its extended record {record.user} {record.number}")
    return tuple(records)


def evlr_at(stream: BinaryIO, at: int, size: int) -> Record | None:
    """The extended record whose header starts at byte `at`, or None; its body only where it is short and whole."""
    if at < 227 or at + EVLR_HEADER > size:
        return None
    stream.seek(at)
    user, number, length = struct.unpack_from("<16sHQ", stream.read(EVLR_HEADER), 2)
    whole = length <= min(MAX_EVLR_BODY, size - at - EVLR_HEADER)
    return Record(text(user), number, at, length, stream.read(length) if whole else b"")


def packet_endings(records: Iterable[Record]) -> tuple[str, ...]:
    """Endings of the file beside that may hold the packets of descriptors, the likeliest first."""
    described = [r.body for r in records if r.user in SPEC_USERS and WPD_FIRST <= r.number <= WPD_LAST]
    return PACKET_ENDINGS[::-1] if any(len(b) > 1 and b[1] for b in described) else PACKET_ENDINGS[:1]


def text(raw: bytes) -> str:
    """A field of the header up to its first zero byte."""
    return raw.split(b"\0")[0].decode("latin1").strip()
