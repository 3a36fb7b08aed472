"""Blocks that a page draws: twelve bytes an echo, as planes of differences, deflated."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.view.packing import pack
from fwclass.view.pyramid import Node, Pyramid

HEAD = struct.Struct("<5I4x5d")
"""Bytes that follow; level, column, row; echoes; south-west corner and lowest height, relative to the scene's origin
[m]; steps of the place, sideways and upwards [m]."""

BYTES = 12
"""Of an echo: three of 16 bits for its place, class, confidence, height above ground, intensity."""

MARKS = struct.Struct("<4I")
"""Level, column, row of a node; echoes that follow: their rows in its block (uint32), then a byte each, filled up to
whole words."""

STEP = 0.005
"""Finest step of a place [m]: a fifth of what a receiver's clock tells, and a byte an echo less than a millimetre."""

NO_VALUE = 255
"""Of a column's byte."""

DRAWN = ("x", "y", "z", "classification", "confidence", "height_above_ground", "intensity")
"""Columns that a block is made of."""


@dataclass(frozen=True)
class ByteScale:
    """What the bytes of a column stand for: 0 for `low`, 254 for `high`, linear between, 255 for no value."""

    low: float
    high: float

    def bytes_of(self, values: NDArray) -> NDArray[np.uint8]:
        """One byte a value; what lies outside gets the nearest end."""
        with np.errstate(invalid="ignore", over="ignore"):
            part = (values.astype(np.float64) - self.low) / (self.high - self.low or 1.0)
            whole = np.rint(np.clip(part, 0.0, 1.0) * 254.0)
        return np.where(np.isfinite(values), np.nan_to_num(whole), NO_VALUE).astype(np.uint8)


def block(
    pyramid: Pyramid,
    node: Node,
    columns: Mapping[str, NDArray],
    rows: NDArray[np.int64],
    origin: tuple[float, float, float],
) -> bytes:
    """Head and deflated planes of the echoes `rows`, in that order.

    `columns`: `DRAWN`. `origin`: of the scene [m].
    """
    edge, (west, south) = pyramid.edge(node[0]), pyramid.corner
    z = columns["z"][rows]
    finite = z[np.isfinite(z)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    corner = np.array([west + node[1] * edge, south + node[2] * edge, low])
    step, rise = max(edge / 65536.0, STEP), max((high - low) / 65535.0, STEP)
    planes = np.empty(BYTES * len(rows), np.uint8)
    pack(*(columns[name] for name in DRAWN), rows, corner, step, rise, planes)
    return _frame(node, len(rows), corner - origin, step, rise, planes)


def column_block(node: Node, values: NDArray[np.uint8]) -> bytes:
    """Head and deflated bytes of one column, a byte an echo, in the order of the node's block."""
    return _frame(node, len(values), np.zeros(3), 0.0, 0.0, values)


def marks(node: Node, rows: NDArray[np.int64], values: NDArray[np.uint8]) -> bytes:
    """Some echoes of a node's block, with a byte each."""
    return MARKS.pack(*node, len(rows)) + rows.astype("<u4").tobytes() + values.tobytes() + bytes(-len(rows) % 4)


def identity_block(
    node: Node, strip: NDArray[np.uint16], pulse: NDArray[np.uint32], echo_number: NDArray[np.uint8]
) -> bytes:
    """Head and deflated planes of who the echoes are: two bytes of the strip, four of the pulse, the number; low ones
    first."""
    bytes_ = [v.astype(kind).view(np.uint8).reshape(len(v), -1) for v, kind in ((strip, "<u2"), (pulse, "<u4"))]
    planes = np.concatenate([*bytes_, echo_number[:, None].astype(np.uint8)], axis=1).T
    return _frame(node, len(strip), np.zeros(3), 0.0, 0.0, np.ascontiguousarray(planes).reshape(-1))


def nothing(node: Node) -> bytes:
    """The block of a node without an echo."""
    return _frame(node, 0, np.zeros(3), 0.0, 0.0, np.empty(0, np.uint8))


def _frame(node: Node, count: int, corner: NDArray, step: float, rise: float, planes: NDArray[np.uint8]) -> bytes:
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
    packed = packer.compress(planes.data) + packer.flush()
    return HEAD.pack(len(packed), *node, count, *corner.tolist(), step, rise) + packed
