"""Columns of the schema as LAS extra bytes."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from fwclass.publish.lasbytes import EXTRA_BYTES, POINT_SIZE, VLR_HEADER, LasHead
from fwclass.publish.lazwriter import record
from fwclass.schema import Column, column

DATA_TYPE = {
    "u1": 1,
    "i1": 2,
    "u2": 3,
    "i2": 4,
    "u4": 5,
    "i4": 6,
    "u8": 7,
    "i8": 8,
    "f4": 9,
    "f8": 10,
    "bool": 1,
}
"""Codes of LAS 1.4 R15, table 24."""

ITEM = 192
_SIZES = (0, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8)


def published(names: Iterable[str]) -> tuple[Column, ...]:
    """The columns among `names` that have a name as an extra byte, in the given order."""
    return tuple(c for c in map(column, names) if c.las)


def description(col: Column) -> str:
    """At most 32 bytes: the unit, then as many whole words of the meaning as fit."""
    words = ([f"[{col.unit}]"] if col.unit else []) + col.meaning.split()
    line = ""
    for word in words:
        longer = f"{line} {word}".strip()
        if len(longer.encode()) > 32:
            break
        line = longer
    return line.rstrip(",;")


def descriptor(col: Column) -> bytes:
    """The 192 bytes that describe `col` (LAS 1.4 R15, table 23); no scale, no offset, NaN means no value."""
    name = col.las.encode()
    if len(name) > 32:
        raise ValueError(f"extra byte name {col.las!r} is longer than 32 bytes")
    return struct.pack("<2xBB32s4x24x24x24x24x24x32s", DATA_TYPE[col.dtype], 0, name, description(col).encode())


def undescribed(length: int) -> bytes:
    """Descriptor of `length` bytes that the source does not explain; they must stand before new ones."""
    return struct.pack("<2xBB32s4x24x24x24x24x24x32s", 0, length, b"unknown", b"not described by the source")


def described_length(data: bytes) -> int:
    """Bytes of a point that the descriptors in `data` account for."""
    total = 0
    for at in range(0, len(data) - ITEM + 1, ITEM):
        kind, options = data[at + 2], data[at + 3]
        total += options if kind == 0 else _SIZES[(kind - 1) % 10 + 1] * ((kind - 1) // 10 + 1)
    return total


def extended(head: LasHead, columns: Iterable[Column]) -> list[bytes]:
    """The records of `head`, with `columns` added behind the extra bytes that the points already have."""
    added = b"".join(map(descriptor, columns))
    if not added:
        return [r.raw for r in head.records]
    have = next((r for r in head.records if (r.user, r.number) == EXTRA_BYTES), None)
    old = have.data if have else b""
    rest = head.point_size - POINT_SIZE[head.point_format] - described_length(old)
    while rest > 0:
        old += undescribed(min(rest, 255))
        rest -= 255
    made = record(*EXTRA_BYTES, "Extra Bytes Record", old + added)
    if have is None:
        return [*(r.raw for r in head.records), made]
    made = have.raw[:20] + made[20:22] + have.raw[22:VLR_HEADER] + made[VLR_HEADER:]
    return [made if r is have else r.raw for r in head.records]


def extra_size(columns: Iterable[Column]) -> int:
    """Bytes that `columns` take in a point."""
    return sum(np.dtype(c.dtype).itemsize for c in columns)


def packed(columns: Iterable[Column], values: Mapping[str, NDArray]) -> NDArray[np.uint8]:
    """Columns side by side as bytes, shape (rows, bytes)."""
    cols = tuple(columns)
    kind = np.dtype([(c.name, np.dtype(c.dtype).newbyteorder("<")) for c in cols])
    out = np.zeros(len(values[cols[0].name]) if cols else 0, kind)
    for c in cols:
        out[c.name] = values[c.name]
    return out.view(np.uint8).reshape(len(out), kind.itemsize)
