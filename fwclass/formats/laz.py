"""The tables of a LAZ file, checked before a decompressor believes them.

The decompressors take every number of a file for true: a length that is none makes one allocate gigabytes and the
other write beside its memory. So whatever states a count, a length or a place is held against the file first.
"""

from __future__ import annotations

import io
import itertools
import struct
from typing import Any, BinaryIO, NoReturn

import lazrs
import numpy as np

from fwclass.errors import InputError
from fwclass.formats.checks import SECTOR, counts_fewer, first_hole
from fwclass.formats.las_header import RECORD_LENGTH, Header

VARIABLE_CHUNKS = 0xFFFFFFFF
POINTS_PER_BYTE = 64
"""No survey compresses to an eighth of a bit a point."""

CHUNKED, LAYERED = 2, 3
"""Compressors: point after point, and the fields of a chunk one after another."""

_SIZES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}
"""Bytes of an item of a point, by its type; those of bytes (0, 14) vary."""

_BYTES, _BYTES14 = 0, 14
_LEGACY = {0: (6,), 1: (6, 7), 2: (6, 8), 3: (6, 7, 8), 4: (6, 7, 9), 5: (6, 7, 8, 9)}
_MODERN = {6: (10,), 7: (10, 11), 8: (10, 12), 9: (10, 13), 10: (10, 12, 13)}
SLACK = 16
"""Bytes of a chunk that may stand behind its last code; lazrs and LASzip leave none."""

PIECE = 1 << 20
"""Bytes of points of a last chunk that are unpacked at a time to see whether it holds more."""

NO_CODE = b"\xff" * 4
"""What no arithmetic coder writes first."""

_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of an item; a byte is one layer."""

_SOUND: set[tuple[str, int, int, int, int]] = set()
"""Files whose chunks this process has found sound, by path, inode, size and times: a run opens each for every part."""

_WRITTEN: set[tuple[str, int, int, int, int]] = set()
"""Files in which this process has looked for holes."""

Item = tuple[int, int, int]
"""Type, size [bytes], version."""


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
    items = _items(header, body)
    if header.n_points == 0:
        _check_empty(header)
        return
    if header.n_points > POINTS_PER_BYTE * header.size:
        raise InputError(
            "more compressed points than a survey's file of this size can hold",
            where=header.path,
            expected=f"at most {POINTS_PER_BYTE} points a byte",
            got=f"{header.n_points} in {header.size} bytes",
            do="the file is damaged, or its points are equal: take out duplicates, or write it as LAS",
        )
    state = _looks(header)
    if state in _SOUND:
        return
    with header.path.open("rb") as stream:
        table_at, n_chunks = _chunk_table_place(header, stream)
        _check_count(header, n_chunks, _chunk_size(header))
        chunks = _chunk_table(header, stream, body, table_at)
        _check_surplus(header, stream, body, chunks)
        if struct.unpack_from("<H", body)[0] == LAYERED:
            starts = _check_layers(header, stream, items, chunks)
        else:
            starts = [at + header.record_length for _, at, _ in chunks]
        _check_codes(header, stream, starts)
    _remember(state, _SOUND)


def _looks(header: Header) -> tuple[str, int, int, int, int]:
    facts = header.path.stat()
    return str(header.path), facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


def _remember(known: tuple[str, int, int, int, int], files: set[tuple[str, int, int, int, int]]) -> None:
    if len(files) >= 1000:
        files.clear()
    files.add(known)


def check_written(header: Header) -> None:
    """`InputError` for a LAZ file with a hole of zeros in its chunks, which decompresses to points that never were.

    The points are read once for it in a process. Sound chunks hold some zeros in a row: a first point, which is stored
    whole, the lengths of its layers, and codes of what never changes (837 bytes at most were measured). Point formats 0
    to 5 code extra bytes among the points: where these never change, zeros prove nothing.
    """
    state = _looks(header)
    extra = header.record_length - RECORD_LENGTH[header.point_format]
    if state in _WRITTEN or (extra and header.point_format in _LEGACY):
        return
    with header.path.open("rb") as stream:
        end, _ = _chunk_table_place(header, stream)
    least = max(7, 5 * header.record_length // SECTOR + 2)
    hole = first_hole(header.path, header.points_start + 8, end, least)
    if hole is not None:
        raise InputError(
            "a part of the file was never written: its compressed points are nothing but zeros",
            where=header.path,
            got=f"at least {least * SECTOR} bytes of zeros from byte {hole}",
            do="wait for the end of the upload, or copy the file again",
        )
    _remember(state, _WRITTEN)


def _items(header: Header, body: bytes) -> list[Item]:
    """What a stored point is made of, as the point format demands it."""
    compressor, coder = struct.unpack_from("<HH", body)
    (n_items,) = struct.unpack_from("<H", body, 32)
    items: list[Item] = [struct.unpack_from("<3H", body, at) for at in range(34, len(body) - 5, 6)][:n_items]
    items_stated = ", ".join(f"type {t} of {size} bytes, version {v}" for t, size, v in items[:8])
    layered = header.point_format in _MODERN
    if compressor != (LAYERED if layered else CHUNKED) or coder != 0:
        wanted = f"compressor {LAYERED if layered else CHUNKED}, coder 0"
        _refuse(header, f"{wanted} for point format {header.point_format}", f"compressor {compressor}, coder {coder}")
    wanted_items = (_MODERN if layered else _LEGACY)[header.point_format]
    extra = header.record_length - RECORD_LENGTH[header.point_format]
    types = [t for t, _, _ in items]
    sizes = [_SIZES[t] for t in wanted_items]
    rest, rest_sizes = types[len(wanted_items) :], [size for _, size, _ in items[len(wanted_items) :]]
    sound = len(items) == n_items and tuple(types[: len(wanted_items)]) == wanted_items
    sound = sound and [size for _, size, _ in items[: len(wanted_items)]] == sizes
    sound = sound and set(rest) <= {_BYTES14 if layered else _BYTES} and sum(rest_sizes) == extra
    versions = {v for _, _, v in items}
    if not sound or not versions <= ({3, 4} if layered else {1, 2}):
        _refuse(
            header, f"the items of point format {header.point_format} with {extra} extra bytes", items_stated or "none"
        )
    return items


def _check_count(header: Header, n_chunks: int, chunk_size: int) -> None:
    most = (header.size - header.points_start) // header.record_length + 1  # the first point of a chunk is stored whole
    if n_chunks > most:
        _refuse(header, f"at most {most} chunks", n_chunks)
    if chunk_size == 0 or (chunk_size != VARIABLE_CHUNKS and n_chunks != -(-header.n_points // chunk_size)):
        _refuse(header, f"chunks of {chunk_size} for {header.n_points} points", f"{n_chunks} chunks")


def _chunk_table_place(header: Header, stream: BinaryIO) -> tuple[int, int]:
    """Byte of the chunk table and the chunks that it states; its place is the first word of the point data, or the
    file's last."""
    stream.seek(header.points_start)
    word = stream.read(8)
    at = struct.unpack("<q", word)[0] if len(word) == 8 else -1
    if at == -1:
        stream.seek(max(0, header.size - 8))
        at = struct.unpack("<q", stream.read(8))[0]
    if not header.points_start + 8 <= at <= header.size - 8:
        _refuse(header, "a chunk table inside the file", f"byte {at} of {header.size}")
    stream.seek(at)
    version, count = struct.unpack("<II", stream.read(8))
    if version != 0:
        _refuse(header, "a chunk table of version 0", version)
    return int(at), int(count)


def _chunk_table(header: Header, stream: BinaryIO, body: bytes, table_at: int) -> list[tuple[int, int, int]]:
    """Points, first byte and bytes of every chunk."""
    stream.seek(header.points_start)
    try:
        table = lazrs.read_chunk_table(stream, lazrs.LazVlr(body))
    except Exception as error:
        _refuse(header, "a readable chunk table", error)
    except BaseException as error:  # a panic of lazrs is no `Exception`
        if isinstance(error, KeyboardInterrupt | SystemExit | MemoryError):
            raise
        _refuse(header, "a readable chunk table", error)
    points, length = sum(p for p, _ in table), sum(b for _, b in table)
    room = table_at - header.points_start - 8
    if points < header.n_points or length > room or any(b < header.record_length for _, b in table):
        _refuse(
            header,
            f"chunks of {header.n_points} points in {room} bytes, none shorter than a point",
            f"a chunk table of {points} points in {length} bytes",
        )
    chunks, at = [], header.points_start + 8
    for count, bytes_ in table:
        chunks.append((int(count), at, int(bytes_)))
        at += bytes_
    return chunks


def _check_empty(header: Header) -> None:
    """`InputError` where a header counts no points and chunks hold some, or what they hold was never finished."""
    behind = [r.start for r in header.evlrs] + [at for at in (header.wave_start,) if at > header.points_start]
    if min([header.size, *behind]) < header.points_start + 8 + header.record_length:
        return
    with header.path.open("rb") as stream:
        _, chunks = _chunk_table_place(header, stream)
    if chunks:
        raise counts_fewer(header.path, 0, "points", f"{chunks} chunks of compressed ones")


def _check_surplus(header: Header, stream: BinaryIO, body: bytes, chunks: list[tuple[int, int, int]]) -> None:
    """`InputError` where the chunks hold more points than the header counts. Chunks of equal size leave open how many
    the last one holds: one of layers states it, of the others the code goes on behind the last point that is counted.
    """
    held = sum(points for points, _, _ in chunks)
    if not varies_chunks(header):
        points, at, length = chunks[-1]
        held -= points
        last = header.n_points - held
        stream.seek(at)
        if struct.unpack_from("<H", body)[0] == LAYERED:
            held += int.from_bytes(stream.read(header.record_length + 4)[-4:], "little")
        elif last > 0 and _decodes(_ChunkFile(stream, at, length - SLACK, points, body), body, last, header):
            raise counts_fewer(header.path, header.n_points, "points", "compressed points that go on behind them")
    if held > header.n_points:
        raise counts_fewer(header.path, header.n_points, "points", f"chunks of {held}")


class _ChunkFile(io.RawIOBase):
    """Points of a LAZ file that has one chunk, the `length` bytes of `stream` from `at`; reading ends behind them, and
    the chunk table lies beyond that end."""

    def __init__(self, stream: BinaryIO, at: int, length: int, points: int, body: bytes) -> None:
        self._stream, self._at, self._place = stream, at, 0
        self._end = 8 + max(0, length)
        table = io.BytesIO()
        lazrs.write_chunk_table(table, [(points, length)], lazrs.LazVlr(body))
        self._first, self._table = struct.pack("<q", self._end + 1), table.getvalue()

    def seekable(self) -> bool:
        return True

    def seek(self, place: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._place, io.SEEK_END: self._end + 1 + len(self._table)}[whence]
        self._place = start + place
        return self._place

    def tell(self) -> int:
        return self._place

    def readinto(self, buffer: Any) -> int:
        at, size = self._place, len(buffer)
        if at < 8:
            data = self._first[at:][:size]
        elif at <= self._end:
            self._stream.seek(self._at + at - 8)
            data = self._stream.read(min(size, self._end - at))
        else:
            data = self._table[at - self._end - 1 :][:size]
        buffer[: len(data)] = data
        self._place += len(data)
        return len(data)


def _decodes(chunk: _ChunkFile, body: bytes, points: int, header: Header) -> bool:
    """The bytes of a chunk hold so many points."""
    room = np.empty(max(1, PIECE // header.record_length) * header.record_length, np.uint8)
    left = points * header.record_length
    try:
        decompressor = lazrs.LasZipDecompressor(chunk, body)
        while left:
            decompressor.decompress_many(room[:left])
            left -= min(left, len(room))
    except BaseException as error:  # a panic of lazrs is no `Exception`
        if isinstance(error, KeyboardInterrupt | SystemExit | MemoryError):
            raise
        return False
    return True


def _check_layers(header: Header, stream: BinaryIO, items: list[Item], chunks: list[tuple[int, int, int]]) -> list[int]:
    """First bytes of all layers. Those of every chunk must fill it: their stated lengths are what is allocated."""
    starts = []
    layers = sum(_LAYERS.get(kind, size) for kind, size, _ in items)
    head = header.record_length + 4 + 4 * layers
    for number, (_, at, length) in enumerate(chunks):
        stream.seek(at + header.record_length)
        stated = stream.read(head - header.record_length) if head <= length else b""
        sizes = struct.unpack(f"<I{layers}I", stated)[1:] if len(stated) == head - header.record_length else ()
        if not sizes or head + sum(sizes) != length:
            _refuse(
                header,
                f"chunk {number} of {length} bytes to be {layers} layers behind {head} bytes",
                f"layers of {sum(sizes)} bytes" if sizes else "no room for them",
            )
        ends = [at + head + n for n in itertools.accumulate(sizes)]
        starts += [end - size for end, size in zip(ends, sizes, strict=True) if size]
    return starts


def _check_codes(header: Header, stream: BinaryIO, starts: list[int]) -> None:
    """A code lies below the coder's range, which begins as 32 bits of ones: LASzip leaves its tables for others."""
    for at in starts:
        stream.seek(at)
        if stream.read(4) == NO_CODE:
            _refuse(header, "an arithmetic code", f"{NO_CODE.hex()} at byte {at}")


def _refuse(header: Header, expected: object, got: object) -> NoReturn:
    raise InputError(
        "the compressed points cannot be read",
        where=header.path,
        expected=expected,
        got=got,
        do="the file is damaged or cut short; copy or export it again",
    )
