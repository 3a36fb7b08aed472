"""New heights for the points of a LAS file: z as stored, with a scale and offset that can hold it."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.las_bytes import LasHead

AT_Z_SCALE, AT_Z_OFFSET, AT_Z_RANGE, AT_Z = 147, 171, 211, 8
"""Bytes of the header block: scale and offset of z, highest and lowest z; byte of z in a point."""

NO_HEIGHT = -9999.0
"""Height of a point that has none: LAS coordinates know no NaN."""

_LARGEST = 2**31 - 1


@dataclass(frozen=True)
class Heights:
    """New z of every point: `stored` × `scale` (int32; the offset is 0)."""

    stored: NDArray[np.int32]
    scale: float

    def put(self, points: NDArray[np.uint8], rows: slice) -> None:
        """Write the z of `rows` into their point records."""
        values = np.ascontiguousarray(self.stored[rows], "<i4")
        points[:, AT_Z : AT_Z + 4] = values.view(np.uint8).reshape(-1, 4)


def store_heights(head: LasHead, z: NDArray[np.float64]) -> Heights:
    """`z` in whole steps of the file's own scale, or of the next power of ten times it that can hold all of them.

    `InputError`: `z` has another length than the file, or holds something that is not finite.
    """
    if len(z) != head.points or not np.isfinite(z).all():
        raise InputError(
            "the new heights do not fit the file",
            where=head.path,
            expected=f"{head.points} finite numbers",
            got=f"{len(z)}, of which {int((~np.isfinite(z)).sum())} are not finite",
        )
    scale = abs(struct.unpack_from("<d", head.block, AT_Z_SCALE)[0])
    most = float(np.abs(z).max()) if len(z) else 0.0
    if most > scale * _LARGEST:
        scale *= 10.0 ** math.ceil(math.log10(most / (scale * _LARGEST)))
    return Heights(np.rint(z / scale).astype(np.int32), scale)


def with_heights(head: LasHead, heights: Heights) -> LasHead:
    """`head` with scale, offset and range of z as `heights` have them."""
    block = bytearray(head.block)
    struct.pack_into("<d", block, AT_Z_SCALE, heights.scale)
    struct.pack_into("<d", block, AT_Z_OFFSET, 0.0)
    if len(heights.stored):
        high, low = int(heights.stored.max()) * heights.scale, int(heights.stored.min()) * heights.scale
        struct.pack_into("<2d", block, AT_Z_RANGE, high, low)
    return replace(head, block=bytes(block))
