"""Compressed PulseWaves: pulses (.plz) in chunks that each begin with a pulse as it is, waves (.wvz) pulse by pulse.

What they are unpacked to is laid out as in a .pls and a .wvs. Source: the library's own reader and writer, version 0.3.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.checks import counts_fewer
from fwclass.formats.extents import Extents, read_extent
from fwclass.read.plz_kernels import (
    BITS,
    EXTRA_BYTES,
    MODELS,
    PULSE_0,
    SOURCE_16,
    SOURCE_32,
    TABLE_MODELS,
    WAVE_BITS,
    WAVE_MODELS,
    unpack_pulses,
    unpack_table,
    unpack_waves,
)
from fwclass.read.range_coder import decoder_of, position
from fwclass.read.wave_extents import read_waves
from fwclass.read.wave_kernels import SOUND

RECORD_NUMBER = 5
"""Of the record that says how pulses are compressed."""

NONE, DEFAULT, ARITHMETIC = 0, 1, 0
"""The compressors and the one coder that there are."""

RECORD_HEADER, PULSE = 96, 48
"""Bytes of a record's header, and of a pulse without what stands behind it."""

VARIABLE = 0xFFFFFFFF
"""The chunk size that says that sizes vary."""

_SIZES = {PULSE_0: PULSE, SOURCE_16: 2, SOURCE_32: 4}

MOST_EXTRA = 1000
"""Bytes behind a pulse: each has models of its own."""

LIKELY = 1_000
"""Bytes of samples of a pulse that room is made for at first; where more are needed all is unpacked once more."""

EXPANSION = 100
"""A file unpacks to this many times its bytes at most: constant samples reach some 60, real ones 2 to 6."""


SLACK = 16
"""Bytes of a chunk that may stand behind its last code; the library leaves none."""


@dataclass(frozen=True)
class Chunks:
    """Where compressed pulses stand: ``first[i]`` is the first pulse of chunk i, which begins at byte ``start[i]``;
    both end with what is behind the last chunk. `items`: kind and bytes of what a pulse consists of."""

    first: NDArray[np.int64]
    start: NDArray[np.int64]
    items: NDArray[np.int64]


def read_chunks(path: Path, size: int, start: int, pulses: int, pulse_size: int, record: bytes) -> Chunks | None:
    """The chunks of a .plz: from the record that says how it is compressed, and the table behind the pulses; None where
    it says that the pulses stand as they are.

    `size`, `start`: bytes of the file, and where its pulses begin. `pulses`, `pulse_size`: as the header has them.
    `record`: body of the record `RECORD_NUMBER`.
    """
    if record[:2] == NONE.to_bytes(2, "little"):
        return None
    chunk, items = _items(path, record, pulse_size)
    if pulses * pulse_size > EXPANSION * size:
        raise _damaged(path, f"at most {EXPANSION} times its bytes of pulses", f"{pulses} of {pulse_size} bytes")
    if start + 8 > size:
        raise _damaged(path, "a table of chunks", "the end of the file")
    at = _whole(path, start, size)
    wanted = -(-pulses // chunk) if chunk != VARIABLE else None
    if at == -1:  # written to a pipe: the place stands at the end, before the library's last record
        ends = (_whole(path, k, size) for k in (size - RECORD_HEADER - 8, size - 8) if k >= start + 8)
        at = next((e for e in ends if start + 8 <= e <= size - 8 and _head(path, e, size)[0] == 0), -1)
    if at == start:
        raise InputError(
            "the pulses were never finished: there is no table of chunks",
            where=path,
            expected="the place of the table where the pulses begin",
            got="the place itself, as a compressor leaves it that was interrupted",
            do="compress the file again",
        )
    if not start + 8 <= at <= size - 8:
        raise _damaged(path, f"a table of chunks between byte {start + 8} and the end", f"byte {at}")
    version, count = _head(path, at, size)
    if version or count > pulses or wanted not in (None, count):
        raise _damaged(
            path,
            f"a table of {count if wanted is None else wanted} chunks of {pulses} pulses",
            f"version {version}, {count} chunks",
        )
    sizes, lengths = np.zeros(count, np.int64), np.zeros(count, np.int64)
    if count:
        table = read_extent(path, at + 8, size, size)
        unpack_table(*decoder_of(table, TABLE_MODELS, 1), 0, len(table), chunk == VARIABLE, sizes, lengths)
    if chunk != VARIABLE:
        sizes[:] = chunk
        sizes[-1:] = pulses - chunk * (count - 1)
    starts = start + 8 + np.r_[0, np.cumsum(lengths)]
    if (sizes < 1).any() or sizes.sum() != pulses or (lengths < pulse_size).any() or starts[-1] > at:
        raise _damaged(path, f"chunks of {pulses} pulses up to byte {at}", f"{sizes.sum()}, up to byte {starts[-1]}")
    return Chunks(np.r_[0, np.cumsum(sizes)].astype(np.int64), starts.astype(np.int64), items)


def _whole(path: Path, at: int, size: int) -> int:
    return int.from_bytes(read_extent(path, at, at + 8, size).tobytes(), "little", signed=True)


def _head(path: Path, at: int, size: int) -> tuple[int, int]:
    """Version of a table of chunks, and their number."""
    version, count = struct.unpack("<II", read_extent(path, at, at + 8, size).tobytes())
    return version, count


def _items(path: Path, record: bytes, pulse_size: int) -> tuple[int, NDArray[np.int64]]:
    """Pulses of a chunk, and the items of a pulse."""
    if len(record) < 18:
        raise _damaged(path, "18 bytes that say how pulses are compressed", f"{len(record)}")
    compressor, coder, _, _, _, _, chunk, count = struct.unpack_from("<HHBBHIIH", record)
    if (compressor, coder) != (DEFAULT, ARITHMETIC):
        raise _unknown(path, "compressor 1 with coder 0", f"compressor {compressor} with coder {coder}")
    if len(record) < 18 + 6 * count or not count:
        raise _damaged(path, "what a pulse consists of", f"{count} items in {len(record)} bytes")
    items = np.array(struct.unpack_from(f"<{3 * count}H", record, 18), np.int64).reshape(count, 3)
    for kind, size, version in items.tolist():
        if version != 1 or size != _SIZES.get(kind, size) or kind not in (EXTRA_BYTES, *_SIZES):
            raise _unknown(
                path,
                f"items {EXTRA_BYTES} to {SOURCE_32} of version 1",
                f"item {kind} of {size} bytes, version {version}",
            )
    twice = len(np.unique(items[:, 0])) < len(items)
    if items[0, 0] != PULSE_0 or twice or items[:, 1].sum() != pulse_size or not chunk:
        raise _damaged(path, f"a pulse of {pulse_size} bytes, once each item", f"items of {items[:, 1].tolist()} bytes")
    if items[1:, 1].sum() > MOST_EXTRA:
        raise _unknown(path, f"at most {MOST_EXTRA} bytes behind a pulse", f"{items[1:, 1].sum()}")
    return int(chunk), items[:, :2].copy()


def unpacked_pulses(path: Path, chunks: Chunks, first: int, last: int) -> NDArray[np.uint8]:
    """The stored pulses [first, last), a row each; those before them in their chunk are decoded too.

    `InputError`: a chunk ends before its pulses do, or the last goes on behind those that the header counts.
    """
    length = int(chunks.items[:, 1].sum())
    every = range(
        int(np.searchsorted(chunks.first, first, "right")) - 1, int(np.searchsorted(chunks.first, last, "left"))
    )
    if first >= last:
        return np.zeros((0, length), np.uint8)
    places = chunks.start - chunks.start[every.start]
    data = read_extent(path, int(chunks.start[every.start]), int(chunks.start[every.stop]), int(chunks.start[-1]))
    decoder = decoder_of(data, MODELS + int(chunks.items[1:, 1].sum()), BITS)
    rows = []
    for c in every:
        begins, count = int(chunks.first[c]), int(min(last, chunks.first[c + 1]) - chunks.first[c])
        out = np.zeros((count, length), np.uint8)
        whole = unpack_pulses(*decoder, places[c], places[c + 1], chunks.items, out)
        if whole < count:
            raise _damaged(path, f"{count} pulses from pulse {begins} on", f"the end of their chunk after {whole}")
        behind = position(decoder.state) if count > 1 else places[c] + length
        if begins + count == chunks.first[-1] and places[c + 1] - behind > SLACK:
            raise counts_fewer(path, int(chunks.first[-1]), "pulses", "compressed pulses that go on behind them")
        rows.append(out[max(first - begins, 0) :])
    return np.concatenate(rows)


def unpacked_waves(
    path: Path,
    size: int,
    offset: NDArray[np.int64],
    descriptor: NDArray[np.int64],
    described: NDArray[np.int64],
    samplings: NDArray[np.int64],
    returning: NDArray[np.bool_],
    header: int,
    most: int,
) -> tuple[Extents, NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """What was read of the .wvz, and the waves of pulses as a .wvs has them: its bytes, where those of each pulse
    begin, what reading them ended in (`wave_kernels`), and the byte of the .wvz where each ends.

    Parameters
    ----------
    size : bytes of the .wvz.
    offset, descriptor : of every pulse; descriptor -1 for none.
    described, samplings : as `wave_kernels.find_segments` has them; `returning` (m,) tells which samplings are of what
        returns.
    header, most : bytes of a Waves file's header, and segments that a pulse may have.

    `InputError`: they are more than `EXPANSION` times the file; as `read_extents`. `OSError`: as `open`.
    """
    limit = EXPANSION * size
    ends, start, stop = (np.zeros(len(offset), np.int64) for _ in range(3))
    none, places, total = np.zeros(len(offset), np.int64), np.ascontiguousarray(offset), 0
    out = np.empty(min(limit, header + LIKELY * len(places)), np.uint8)
    arguments = (places, size, descriptor, described, samplings, returning, header, most, limit, ends, start, stop)

    def look(read: Extents) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        nonlocal total
        total = int(unpack_waves(*decoder_of(read.data, WAVE_MODELS, WAVE_BITS), read.place, read.end, *arguments, out))
        if total > limit:
            raise _damaged(path, f"waves of at most {EXPANSION} times its bytes", "more")
        return ends, none

    read = read_waves(path, size, places, descriptor >= 0, look)
    if total > len(out):
        out = np.empty(total, np.uint8)
        look(read)
    return read, out[:total], np.where(ends == SOUND, start, 0), ends, stop


def _damaged(path: Path, expected: str, got: Any) -> InputError:
    return InputError(
        "the compressed file is damaged", where=path, expected=expected, got=got, do="copy or compress it again"
    )


def _unknown(path: Path, expected: str, got: Any) -> InputError:
    return InputError(
        "the file is compressed in a way that is not known",
        where=path,
        expected=expected,
        got=got,
        do="decompress it with PulseTools: pulsezip -i IN.plz -o OUT.pls",
    )
