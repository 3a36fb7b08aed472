"""The tables of a LAZ file, checked before a decompressor believes them."""

from __future__ import annotations

import struct
from typing import NoReturn

import lazrs

from fwclass.errors import InputError
from fwclass.read.header import Header

VARIABLE_CHUNKS = 0xFFFFFFFF
POINTS_PER_BYTE = 64
"""No survey compresses to an eighth of a bit a point."""


def _laz_record(header: Header) -> bytes:
    record = next((r for r in header.vlrs if r.user == "laszip encoded" and r.number == 22204), None)
    if record is None or len(record.body) < 34:
        _refuse(header, "a LASzip record of at least 34 bytes", len(record.body) if record else "none")
    return record.body


def varies_chunks(header: Header) -> bool:
    """The chunks differ in their number of points, as in COPC."""
    return _chunk_size(header) == VARIABLE_CHUNKS


def _chunk_size(header: Header) -> int:
    return int(struct.unpack_from("<I", _laz_record(header), 12)[0])


def check_laz(header: Header) -> None:
    """Refuse a LAZ file whose tables would make a decompressor allocate, or make up, more than the file can hold."""
    body = _laz_record(header)
    chunk_size = _chunk_size(header)
    (n_items,) = struct.unpack_from("<H", body, 32)
    sizes = [struct.unpack_from("<H", body, 34 + 6 * i + 2)[0] for i in range((len(body) - 34) // 6)]
    if n_items > len(sizes) or sum(sizes[:n_items]) != header.record_length:
        _refuse(header, f"items that add up to {header.record_length} bytes", f"{sizes[:n_items]}")
    if header.n_points == 0:
        return
    n_chunks = _chunk_count(header)
    if header.n_points > POINTS_PER_BYTE * header.size:
        _refuse(header, f"at most {POINTS_PER_BYTE} points a byte", f"{header.n_points} in {header.size} bytes")
    if chunk_size == VARIABLE_CHUNKS:
        most = (header.size - header.points_start) // header.record_length + 1
        if n_chunks > most:
            _refuse(header, f"at most {most} chunks", n_chunks)
        _check_variable_chunks(header, body)
    elif chunk_size == 0 or n_chunks != -(-header.n_points // chunk_size):
        _refuse(header, f"chunks of {chunk_size} for {header.n_points} points", f"{n_chunks} chunks")


def _check_variable_chunks(header: Header, body: bytes) -> None:
    with header.path.open("rb") as stream:
        stream.seek(header.points_start)
        try:
            table = lazrs.read_chunk_table(stream, lazrs.LazVlr(body))
        except Exception as error:
            _refuse(header, "a readable chunk table", error)
    points, length = sum(p for p, _ in table), sum(b for _, b in table)
    if points < header.n_points or length > header.size:
        _refuse(
            header,
            f"{header.n_points} points in {header.size} bytes",
            f"a chunk table of {points} points in {length} bytes",
        )


def _chunk_count(header: Header) -> int:
    """Chunks that the LAZ chunk table states; its place is the first word of the point data, or the file's last."""
    with header.path.open("rb") as stream:
        stream.seek(header.points_start)
        word = stream.read(8)
        at = struct.unpack("<q", word)[0] if len(word) == 8 else -1
        if at == -1:
            stream.seek(max(0, header.size - 8))
            at = struct.unpack("<q", stream.read(8))[0]
        if not header.points_start + 8 <= at <= header.size - 8:
            _refuse(header, "a chunk table inside the file", f"byte {at} of {header.size}")
        stream.seek(at)
        return int(struct.unpack("<II", stream.read(8))[1])


def _refuse(header: Header, expected: object, got: object) -> NoReturn:
    raise InputError(
        "the compressed points cannot be read",
        where=header.path,
        expected=expected,
        got=got,
        do="the file is damaged or cut short; copy or export it again",
    )
