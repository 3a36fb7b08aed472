"""Columns of the schema as LAS extra bytes."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.las_bytes import EXTRA_BYTES, POINT_SIZE, LasHead
from fwclass.formats.las_header import VLR_HEADER, text
from fwclass.formats.laz_writer import record
from fwclass.schema import Column, column

DATA_TYPE = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "u8": 7, "i8": 8, "f4": 9, "f8": 10, "bool": 1}
"""Codes of LAS 1.4 R15, table 24."""

NO_DATA, LOWEST, HIGHEST, SCALED, SHIFTED = 1, 2, 4, 8, 16
"""Bits of a descriptor's options (LAS 1.4 R15, table 25)."""

ITEM, NAME_SIZE = 192, 32
PREFIX = "fw"
"""Stands before a name that the source has already."""

_SIZES = (0, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8)
_LAYOUT = "<2xBB32s4x8s16x8s16x8s16xd16x24x32s"


@dataclass(frozen=True)
class ExtraByte:
    """How a file stores one column: value = `scale` x stored number.

    Attributes
    ----------
    name, las : the column's name, and its name in the file.
    kind : stored type, a key of `DATA_TYPE`.
    scale : 1 stores the value itself.
    no_data : stored number that stands for NaN; None where NaN is stored as such or does not occur.
    low, high : least and greatest stored number that is a value; None where there is none.
    beyond : values outside the stored type's range, which are stored as its nearest end.
    about : at most 32 bytes of text.
    """

    name: str
    las: str
    kind: str
    scale: float
    no_data: int | None
    low: float | None
    high: float | None
    beyond: int
    about: str

    @property
    def dtype(self) -> np.dtype[Any]:
        """As the file stores a value."""
        return np.dtype("u1" if self.kind == "bool" else self.kind).newbyteorder("<")


def published_columns(names: Iterable[str]) -> tuple[Column, ...]:
    """The columns among `names` that have a name as an extra byte, in the given order."""
    return tuple(c for c in map(column, names) if c.las)


def extra_bytes(
    columns: Iterable[Column], values: Mapping[str, NDArray], existing: Iterable[str] = ()
) -> tuple[ExtraByte, ...]:
    """How `columns` are stored in a file that has extra bytes named `existing` already.

    No two extra bytes of a file have the same name, whatever their case: where `existing` has it the new one is called
    ``fw <name>``, then ``fw2 <name>`` and so on.

    `values`: every value of every column, for the extremes.
    """
    used, out = set(existing), []
    for col in columns:
        name = free_name(col.las, used)
        used.add(name)
        out.append(_extra_byte(col, name, values[col.name]))
    return tuple(out)


def free_name(wanted: str, existing: Iterable[str]) -> str:
    """`wanted`, or with the first of ``fw``, ``fw2``, … before it, such that no name in `existing` is the same."""
    if not wanted:
        raise ValueError("a column without a name as an extra byte cannot be published")
    used = {name.strip().lower() for name in existing}
    name, number = wanted, 1
    while name.lower() in used:
        name = f"{PREFIX}{number if number > 1 else ''} {wanted}"
        number += 1
    if len(name.encode()) > NAME_SIZE:
        raise ValueError(f"extra byte name {name!r} is longer than {NAME_SIZE} bytes")
    return name


def _extra_byte(col: Column, name: str, values: NDArray) -> ExtraByte:
    kind = col.las_dtype or col.dtype
    no_data = None
    beyond = 0
    if col.null is not None and math.isnan(col.null) and kind[0] in "iu":
        limits = np.iinfo(kind)
        no_data = int(limits.min if kind[0] == "i" else limits.max)
    if kind[0] in "iu" and np.dtype(col.dtype).kind == "f":
        low, high = _range(kind, no_data)
        beyond = int(np.count_nonzero((values > (high + 0.5) * col.las_scale) | (values < (low - 0.5) * col.las_scale)))
    shown = ExtraByte(col.name, name, kind, col.las_scale, no_data, None, None, beyond, description(col))
    ends = [_end(shown, float(f.reduce(values))) if len(values) else None for f in (np.fmin, np.fmax)]
    return ExtraByte(col.name, name, kind, col.las_scale, no_data, ends[0], ends[1], beyond, shown.about)


def _end(extra: ExtraByte, value: float) -> float | None:
    """`value` as it is stored; None for what is no number."""
    if math.isnan(value):
        return None
    number = encode_values(extra, np.array([value]))[0]
    return float(number) if np.isfinite(number) else None


def _range(kind: str, no_data: int | None) -> tuple[int, int]:
    """Least and greatest number of a whole type that can be a value."""
    limits = np.iinfo(kind)
    low, high = int(limits.min), int(limits.max)
    return low + (no_data == low), high - (no_data == high)


def encode_values(extra: ExtraByte, values: NDArray) -> NDArray:
    """`values` as the file holds them.

    A whole type gets the nearest number (half to even), values beyond its range the nearest end of it, NaN the
    no-data number.
    """
    if extra.kind[0] not in "iu" or values.dtype.kind in "iub":
        return values.astype(extra.dtype)
    low, high = _range(extra.kind, extra.no_data)
    number = np.clip(np.rint(values.astype(np.float64) / extra.scale), low, high)
    return np.where(np.isnan(number), extra.no_data or 0, number).astype(extra.dtype)


def description(col: Column) -> str:
    """At most 32 bytes: the unit, then the column's short text, or as many whole words of its meaning as fit."""
    words = ([f"[{col.unit}]"] if col.unit else []) + (col.las_about or col.meaning).split()
    line = ""
    for word in words:
        longer = f"{line} {word}".strip()
        if len(longer.encode()) > 32:
            break
        line = longer
    return line.rstrip(",;")


def descriptor(extra: ExtraByte) -> bytes:
    """The 192 bytes that describe `extra` (LAS 1.4 R15, table 23).

    No-data number and extremes are stored numbers, before the scale. NaN of a floating-point type needs no no-data
    number: it says itself that there is no value.
    """
    options, fields = 0, []
    for bit, value in ((NO_DATA, extra.no_data), (LOWEST, extra.low), (HIGHEST, extra.high)):
        options |= bit if value is not None else 0
        fields.append(_wide(extra.kind, value or 0))
    scale = 0.0
    if extra.scale != 1.0:
        options, scale = options | SCALED, extra.scale
    return struct.pack(
        _LAYOUT, DATA_TYPE[extra.kind], options, extra.las.encode(), *fields, scale, extra.about.encode()
    )


def _wide(kind: str, value: float) -> bytes:
    """A number in the eight bytes of a descriptor: unsigned, signed or floating-point as its type is."""
    if kind[0] == "f":
        return struct.pack("<d", value)
    return struct.pack("<q" if kind[0] == "i" else "<Q", int(value))


def undescribed_record(length: int, name: str = "unknown") -> bytes:
    """Descriptor of `length` bytes that the source does not explain; they must stand before new ones."""
    return struct.pack("<2xBB32s4x24x24x24x24x24x32s", 0, length, name.encode(), b"not described by the source")


def described_length(data: bytes) -> int:
    """Bytes of a point that the descriptors in `data` account for."""
    total = 0
    for at in range(0, len(data) - ITEM + 1, ITEM):
        kind, options = data[at + 2], data[at + 3]
        total += options if kind == 0 else _SIZES[(kind - 1) % 10 + 1] * ((kind - 1) // 10 + 1)
    return total


def names_of(head: LasHead) -> tuple[str, ...]:
    """Names of the extra bytes that the points of `head` have, as they will stand in a copy with more of them."""
    old = _old(head)
    return tuple(text(old[at + 4 : at + 36]) for at in range(0, len(old) - ITEM + 1, ITEM))


def _record(head: LasHead) -> Any:
    return next((r for r in head.records if (r.user, r.number) == EXTRA_BYTES), None)


def _old(head: LasHead) -> bytes:
    """The source's descriptors, and as many more as describe the bytes of a point that they leave out."""
    have = _record(head)
    old: bytes = have.body if have else b""
    rest = head.point_size - POINT_SIZE[head.point_format] - described_length(old)
    names = [text(old[at + 4 : at + 36]) for at in range(0, len(old) - ITEM + 1, ITEM)]
    while rest > 0:
        names.append(free_name("unknown", names))
        length = _plain_length(rest)
        old += undescribed_record(length, names[-1])
        rest -= length
    return old


def _plain_length(rest: int) -> int:
    """Most bytes, at most `rest`, that one descriptor may leave without a type.

    Their number stands in the byte of the options; laspy takes its bits 8 and 16 for a scale and an offset all the
    same, and refuses the file.
    """
    return next(n for n in range(min(rest, 255), 0, -1) if n & (SCALED | SHIFTED) == 0)


def extend_records(head: LasHead, extras: Iterable[ExtraByte]) -> list[bytes]:
    """The records of `head`, with `extras` added behind the extra bytes that the points already have."""
    added = b"".join(map(descriptor, extras))
    if not added:
        return [r.raw for r in head.records]
    have = _record(head)
    entry = record(*EXTRA_BYTES, "Extra Bytes Record", _old(head) + added)
    if have is None:
        return [*(r.raw for r in head.records), entry]
    entry = have.raw[:20] + entry[20:22] + have.raw[22:VLR_HEADER] + entry[VLR_HEADER:]
    return [entry if r is have else r.raw for r in head.records]


def extra_size(extras: Iterable[ExtraByte]) -> int:
    """Bytes that `extras` take in a point."""
    return sum(e.dtype.itemsize for e in extras)


def pack_columns(extras: Iterable[ExtraByte], values: Mapping[str, NDArray]) -> NDArray[np.uint8]:
    """Columns side by side as bytes, shape (rows, bytes)."""
    items = tuple(extras)
    kind = np.dtype([(e.name, e.dtype) for e in items])
    out = np.zeros(len(values[items[0].name]) if items else 0, kind)
    for e in items:
        out[e.name] = encode_values(e, values[e.name])
    return out.view(np.uint8).reshape(len(out), kind.itemsize)
