"""The header of a Pulse file and its records, read with every size checked before it is used.

Source: M. Isenburg, PulseWaves specification 0.3. All numbers are little-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fwclass.errors import InputError
from fwclass.formats.checks import check_length, check_scales
from fwclass.formats.las_header import MAX_EVLR_BODY, Record, text
from fwclass.paths import open_sized
from fwclass.read.pls_compressed import PULSE, RECORD_HEADER, RECORD_NUMBER, Chunks, read_chunks
from fwclass.units import ADJUSTED, GPS_WEEK

SIGNATURE = b"PulseWavesPulse\0"
SPEC = "PulseWaves_Spec"
"""Who writes the records of the specification."""

HEADER = 352
"""Shortest length of the header."""

LAST_AVLR, MAX_AVLRS = 0xFFFFFFFF, 1000

STANDARD_TIME = 7e8
"""GPS time [s] above which it counts from 1980 (2002 and later); within a week it may count from that week's start."""


@dataclass(frozen=True)
class PulseHeader:
    """The header of a Pulse file, checked against the size of the file.

    Attributes
    ----------
    pulses_start, pulse_size : byte of the first pulse, bytes of every pulse.
    time_scale, time_offset : GPS time [s] = scale x stored + offset; standard time is adjusted as LAS has it.
    standard_gps_time : times count from the GPS epoch.
    bounds : xmin, ymin, zmin, xmax, ymax, zmax as the header states them [m].
    vlrs, avlrs : the records that lie whole in the file.
    chunks : of compressed pulses; None where they stand as they are.
    faults : what is wrong without making the file useless.
    """

    size: int
    version: tuple[int, int]
    system: str
    software: str
    pulses_start: int
    pulse_size: int
    n_pulses: int
    time_scale: float
    time_offset: float
    standard_gps_time: bool
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    bounds: tuple[float, float, float, float, float, float]
    vlrs: tuple[Record, ...]
    avlrs: tuple[Record, ...]
    faults: tuple[str, ...]
    chunks: Chunks | None

    @property
    def global_encoding(self) -> int:
        """As of a LAS header, for `crs_of`: no bit is set."""
        return 0

    def records(self, number: int, users: tuple[str, ...]) -> list[Record]:
        """Records of a number, of any of `users`."""
        return [r for r in (*self.vlrs, *self.avlrs) if r.number == number and r.user in users]


def read_pulse_header(path: Path) -> PulseHeader:
    """Parse the header of `path`; `InputError` if it is no Pulse file of version 0.3 or cannot be used."""
    stream, size = open_sized(path)
    with stream:
        return _parse(stream, path, size)


def _parse(stream: BinaryIO, path: Path, size: int) -> PulseHeader:
    head = stream.read(HEADER)
    _refuse_foreign(head, path)
    header_size, start, n_pulses, kind, _, pulse_size, compression = struct.unpack_from("<HqqIIII", head, 174)
    n_vlrs, n_avlrs = struct.unpack_from("<Ii", head, 216)
    _check_layout(path, size, header_size, start, n_pulses, kind, pulse_size)
    t_scale, t_offset = struct.unpack_from("<2d", head, 224)
    scales, offsets = struct.unpack_from("<3d", head, 256), struct.unpack_from("<3d", head, 280)
    check_scales(path, (*scales, t_scale), (*offsets, t_offset))
    b = struct.unpack_from("<6d", head, 304)
    faults: list[str] = []
    vlrs = _vlrs(stream, path, header_size, n_vlrs, start)
    chunks, packed = None, [r.body for r in vlrs if (r.user, r.number) == (SPEC, RECORD_NUMBER)]
    if compression or packed:  # the library leaves the header's word at 0
        chunks = read_chunks(path, size, start, n_pulses, pulse_size, packed[-1] if packed else b"")
    if chunks is None:
        check_length(path, size, start, pulse_size, n_pulses, "pulses")
    behind = int(chunks.start[-1]) if chunks else start + n_pulses * pulse_size
    avlrs = _avlrs(stream, behind, n_avlrs, size, faults)
    stream.seek(int(chunks.start[0]) if chunks else start)
    first = struct.unpack("<q", stream.read(8))[0] * t_scale + t_offset if n_pulses else 0.0
    return PulseHeader(
        size,
        (head[172], head[173]),
        text(head[40:104]),
        text(head[104:168]),
        start,
        pulse_size,
        n_pulses,
        t_scale,
        t_offset - ADJUSTED if first >= STANDARD_TIME else t_offset,
        first > GPS_WEEK,
        scales,
        offsets,
        (b[0], b[2], b[4], b[1], b[3], b[5]),
        vlrs,
        avlrs,
        tuple(faults),
        chunks,
    )


def _refuse_foreign(head: bytes, path: Path) -> None:
    if head[:16] != SIGNATURE:
        raise InputError(
            "this is no PulseWaves file" if head else "the file is empty",
            where=path,
            expected="the signature PulseWavesPulse",
            got=repr(head[:16]),
            do="give a .pls or .plz file",
        )
    if len(head) < HEADER:
        raise InputError(
            "the file ends inside its header",
            where=path,
            expected=f"at least {HEADER} bytes",
            got=f"{len(head)} bytes",
            do="copy it again",
        )
    if head[172] != 0 or head[173] < 3:
        raise InputError(
            "unknown PulseWaves version",
            where=path,
            expected="0.3",
            got=f"{head[172]}.{head[173]}",
            do="write it again with a newer PulseTools",
        )


def _check_layout(
    path: Path, size: int, header_size: int, start: int, n_pulses: int, kind: int, pulse_size: int
) -> None:
    if kind != 0 or pulse_size < PULSE:
        raise InputError(
            "unknown pulse format",
            where=path,
            expected=f"format 0, at least {PULSE} bytes",
            got=f"format {kind}, {pulse_size} bytes",
            do="write the file again with a newer PulseTools",
        )
    if not HEADER <= header_size <= start <= size or n_pulses < 0:
        raise InputError(
            "the header's offsets do not fit the file",
            where=path,
            expected=f"{HEADER} <= header size <= start of pulses <= {size} bytes",
            got=f"header size {header_size}, start of pulses {start}, {n_pulses} pulses",
            do="the file is cut short or its header damaged; copy or export it again",
        )


def _vlrs(stream: BinaryIO, path: Path, start: int, count: int, end: int) -> tuple[Record, ...]:
    records, at = [], start
    for i in range(count):
        record = _record(stream, at, at + RECORD_HEADER) if at + RECORD_HEADER <= end else None
        if record is None or not 0 <= record.length <= end - at - RECORD_HEADER:
            raise InputError(
                "the header's records run into the pulses",
                where=path,
                expected=f"{count} variable length records up to byte {end}",
                got=f"{i} whole ones",
                do="the header is damaged; copy or export the file again",
            )
        records.append(record)
        at += RECORD_HEADER + record.length
    return tuple(records)


def _avlrs(stream: BinaryIO, start: int, count: int, size: int, faults: list[str]) -> tuple[Record, ...]:
    """Records after the pulses: each ends in its header, the last in the file is read first."""
    records: list[Record] = []
    at = size
    for _ in range(min(count if count >= 0 else MAX_AVLRS, MAX_AVLRS)):
        head = at - RECORD_HEADER
        record = _record(stream, head, None) if head >= start else None
        if record is None or not 0 <= record.length <= head - start:
            faults.append(f"{len(records)} of the appended records lie whole in the file; the others are ignored")
            break
        if record.number == LAST_AVLR:
            break
        at = head - record.length
        records.append(_record(stream, head, at))
    return tuple(records)


def _record(stream: BinaryIO, head: int, body: int | None) -> Record:
    """The record whose header is at byte `head`, with the bytes from `body` on if it is short."""
    stream.seek(head)
    user, number, _, length = struct.unpack_from("<16sIIq", stream.read(RECORD_HEADER))
    if body is None or not 0 <= length <= MAX_EVLR_BODY:
        return Record(text(user), number, head, length, b"")
    stream.seek(body)
    return Record(text(user), number, head, length, stream.read(length))
