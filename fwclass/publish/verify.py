"""Reading a published strip back: nothing but the classification may differ from its source."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.extra_bytes import ExtraByte, extend_records, pack_columns
from fwclass.formats.las_bytes import (
    AT_ENCODING,
    AT_EVLRS,
    AT_OFFSET,
    AT_PACKETS,
    BLOCK,
    EXTERNAL,
    INTERNAL,
    LasHead,
    class_byte,
    differs,
    extended_records,
    kept_records,
    point_chunks,
    read_head,
)
from fwclass.publish.heights import Heights
from fwclass.publish.packets import Packets, is_copied


def verify(
    head: LasHead,
    copy: Path,
    classes: NDArray[np.uint8],
    extras: tuple[ExtraByte, ...],
    extra: Mapping[str, NDArray],
    packets: Packets,
    chunk: int,
    heights: Heights | None = None,
) -> None:
    """`StoreError` naming the first thing in `copy` that is neither the source's nor meant to differ."""
    copy_head = replace(read_head(copy), path=copy)
    _same(copy, "the header", _unchanged_header(head), _unchanged_header(copy_head))
    _storage(head, copy_head, packets, copy)
    records = b"".join(extend_records(kept_records(head), extras))
    _same(copy, "the variable length records", records, b"".join(r.raw for r in kept_records(copy_head).records))
    _same(copy, "the bytes before the points", head.gap, copy_head.gap)
    _verify_extended(head, copy_head, packets)
    first = 0
    pairs = zip_longest(point_chunks(head, chunk), point_chunks(copy_head, chunk))
    for old, new in pairs:
        if old is None or new is None or len(old) != len(new):
            raise differs(copy, "the number of points", head.points, copy_head.points)
        rows = slice(first, first + len(old))
        if heights is not None:
            heights.put(old, rows)
        _verify_points(head, copy, old, new, classes[rows], first)
        if extras:
            added = pack_columns(extras, {e.name: extra[e.name][rows] for e in extras})
            _same(copy, "the added extra bytes", added.tobytes(), new[:, head.point_size :].tobytes())
        first = rows.stop


def _unchanged_header(head: LasHead) -> bytes:
    """The header block without what a copy sets anew: places, counts of records, sizes, storage of packets."""
    fixed = bytearray(head.block)
    struct.pack_into("<H", fixed, AT_ENCODING, head.encoding & ~(INTERNAL | EXTERNAL))
    struct.pack_into("<IIBH", fixed, AT_OFFSET, 0, 0, head.point_format, 0)
    if head.minor >= 3:
        struct.pack_into("<Q", fixed, AT_PACKETS, 0)
    if head.minor >= 4:
        struct.pack_into("<QI", fixed, AT_EVLRS, 0, 0)
    return bytes(fixed)


def _storage(head: LasHead, copy_head: LasHead, packets: Packets, copy: Path) -> None:
    """The header of the copy tells where its packets and extended records are."""
    encoding = head.encoding & ~INTERNAL | EXTERNAL if packets.internal else head.encoding
    if copy_head.encoding != encoding:
        raise differs(copy, "the global encoding", encoding, copy_head.encoding)
    if copy_head.packets_start:
        raise differs(copy, "the start of the packet record", 0, copy_head.packets_start)


def _verify_points(
    head: LasHead, copy: Path, old: NDArray[np.uint8], new: NDArray[np.uint8], classes: NDArray[np.uint8], first: int
) -> None:
    """Every byte but the classification is the source's, and the classification is the wanted one."""
    at = class_byte(head.point_format)
    mask = 0xFF if head.point_format >= 6 else 0x1F
    wrong = np.flatnonzero((new[:, at] & mask) != classes)
    if len(wrong):
        row = wrong[0]
        raise differs(copy, f"the class of point {first + row}", classes[row], new[row, at] & mask)
    old[:, at] = new[:, at] & mask | old[:, at] & ~np.uint8(mask)
    own = new[:, : head.point_size]
    if not np.array_equal(old, own):
        row, column = np.argwhere(old != own)[0]
        raise differs(copy, f"byte {column} of point {first + row}", old[row, column], new[row, column])


def _verify_extended(head: LasHead, copy_head: LasHead, packets: Packets) -> None:
    with head.path.open("rb") as source, copy_head.path.open("rb") as copy:
        records = [r for r in extended_records(source, head) if is_copied(r, packets)]
        copied = extended_records(copy, copy_head)
        if len(records) != len(copied):
            raise differs(copy_head.path, "the number of extended records", len(records), len(copied))
        for a, b in zip(records, copied, strict=True):
            source.seek(a.start)
            copy.seek(b.start)
            for at in range(0, a.end - a.start, BLOCK):
                size = min(BLOCK, a.end - a.start - at)
                part = source.read(size)
                _same(copy_head.path, f"extended record {a.user} {a.number}", part, copy.read(size))
                if not part:  # it states more bytes than the file has
                    break


def _same(copy: Path, what: str, wanted: bytes, got: bytes) -> None:
    if wanted != got:
        size = min(len(wanted), len(got))
        a, b = np.frombuffer(wanted[:size], np.uint8), np.frombuffer(got[:size], np.uint8)
        at = int(np.flatnonzero(a != b)[0]) if (a != b).any() else size
        raise differs(copy, f"byte {at} of {what}", wanted[at : at + 8], got[at : at + 8])
