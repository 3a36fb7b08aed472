"""Blocks that a page draws: twelve bytes an echo, as planes of differences, deflated."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.view.pyramid import Node, Pyramid

HEAD = struct.Struct("<5I4x5d")
"""Bytes that follow; level, column, row; echoes; south-west corner and lowest height, relative to the scene's origin
[m]; steps of the place, sideways and upwards [m]."""

BYTES = 12
"""Of an echo: three of 16 bits for its place, class, confidence, height above ground, intensity."""

STEP = 0.005
"""Finest step of a place [m]: a fifth of what a receiver's clock tells, and a byte an echo less than a millimetre."""

CONFIDENCE = 200.0
"""Steps of a confidence of 1; 255 for none."""

HEIGHT_STEP, HEIGHT_LOW = 0.01, -100.0
"""Height above ground [m]: step, and what 1 stands for; 0 stands for none."""

NO_VALUE = 255
"""Of a column's byte."""

DRAWN = ("x", "y", "z", "classification", "confidence", "height_above_ground", "intensity")
"""Columns that a block is made of."""


@dataclass(frozen=True)
class Scale:
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

    Parameters
    ----------
    columns : `DRAWN`.
    origin : of the scene [m].
    """
    edge, (west, south) = pyramid.edge(node[0]), pyramid.corner
    z = columns["z"][rows]
    finite = z[np.isfinite(z)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    corner = np.array([west + node[1] * edge, south + node[2] * edge, low])
    step, rise = max(edge / 65536.0, STEP), max((high - low) / 65535.0, STEP)
    planes = np.empty(BYTES * len(rows), np.uint8)
    _pack(*(columns[name] for name in DRAWN), rows, corner, step, rise, planes)
    return _framed(node, len(rows), corner - origin, step, rise, planes)


def column_block(node: Node, values: NDArray[np.uint8]) -> bytes:
    """Head and deflated bytes of one column, a byte an echo, in the order of the node's block."""
    return _framed(node, len(values), np.zeros(3), 0.0, 0.0, values)


def nothing(node: Node) -> bytes:
    """The block of a node without an echo."""
    return _framed(node, 0, np.zeros(3), 0.0, 0.0, np.empty(0, np.uint8))


def _framed(node: Node, count: int, corner: NDArray, step: float, rise: float, planes: NDArray[np.uint8]) -> bytes:
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
    packed = packer.compress(planes.data) + packer.flush()
    return HEAD.pack(len(packed), *node, count, *corner.tolist(), step, rise) + packed


@kernel
def _pack(x, y, z, code, confidence, height, intensity, rows, corner, step, rise, out):  # type: ignore[no-untyped-def]
    """Planes of low and high bytes. Places are differences to the echo before, their sign in the lowest bit, and so is
    what a height above ground differs from z: the terrain, which is smooth."""
    n = len(rows)
    before = np.zeros(4, np.int64)
    now = np.zeros(4, np.int64)
    for k in range(n):
        row = rows[k]
        now[0] = min(max(int((x[row] - corner[0]) / step), 0), 65535)
        now[1] = min(max(int((y[row] - corner[1]) / step), 0), 65535)
        now[2] = min(max(int(np.floor((z[row] - corner[2]) / rise + 0.5)), 0), 65535) if np.isfinite(z[row]) else 0
        h = height[row]
        code_of_h = min(max(int(np.floor((h - HEIGHT_LOW) / HEIGHT_STEP + 1.5)), 1), 65535) if np.isfinite(h) else 0
        now[3] = code_of_h - int(now[2] * rise / HEIGHT_STEP)
        for axis in range(4):
            d = ((now[axis] - before[axis] + 32768) & 65535) - 32768
            d = ((d << 1) ^ (d >> 15)) & 65535
            out[2 * axis * n + k] = d & 255
            out[(2 * axis + 1) * n + k] = d >> 8
            before[axis] = now[axis]
        out[8 * n + k] = intensity[row] & 255
        out[9 * n + k] = (intensity[row] >> 8) & 255
        out[10 * n + k] = code[row]
        sure = confidence[row]
        out[11 * n + k] = min(max(int(sure * CONFIDENCE + 0.5), 0), 200) if np.isfinite(sure) else 255
