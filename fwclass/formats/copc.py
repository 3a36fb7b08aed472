"""COPC 1.0: a LAZ file of variable chunks, one a node of an octree, with pages that say where each node lies."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from fwclass.formats.las_bytes import AT_EVLRS, AT_FORMAT, LASZIP
from fwclass.formats.las_header import EVLR_HEADER, VLR_HEADER
from fwclass.formats.laz_writer import assemble, record

INFO = struct.Struct("<5d2Q2d88x")
"""Centre, half edge, spacing, place and size of the root page, first and last time (COPC 1.0, info VLR)."""

ENTRY = struct.Struct("<4iQ2i")
"""Level, x, y, z of a node; offset and bytes of its chunk, or of a page; echoes, or -1 for a page."""

USER, INFO_RECORD, PAGES_RECORD = "copc", 1, 1000
_COMPRESSED = 0x80
_INFO_AT = 375 + VLR_HEADER
_ROOT_AT = _INFO_AT + 40


@dataclass(frozen=True)
class Cube:
    """What the info record says: centre and half edge [units of the file's CRS], spacing of the root, times."""

    centre: tuple[float, float, float]
    half: float
    spacing: float
    times: tuple[float, float]


def write_copc(
    file: BinaryIO,
    block: bytes,
    records: list[bytes],
    rows: NDArray[np.uint8],
    order: NDArray[np.int64],
    keys: NDArray[np.int64],
    counts: NDArray[np.int64],
    cube: Cube,
) -> int:
    """Write header, records, a chunk a node, and the page of nodes; returns the file's size.

    Parameters
    ----------
    file : empty, open for reading and writing.
    block : public header of LAS 1.4 (375 bytes), point format 6.
    rows : shape (n, bytes of a point).
    order : shape (n,), their numbers, node after node.
    keys, counts : of the nodes, at least one echo each; see `publish.octree.Octree`.
    """
    laz = lazrs.LazVlr.new_for_compression(block[AT_FORMAT], rows.shape[1] - 30, True)
    info = INFO.pack(*cube.centre, cube.half, cube.spacing, 0, 0, *cube.times)
    first = [record(USER, INFO_RECORD, "copc info", info), record(*LASZIP, "", laz.record_data())]
    head = bytearray(assemble(block, [*first, *records]))
    head[AT_FORMAT] |= _COMPRESSED
    file.write(head)
    table_at = _write_chunks(file, laz, rows, order, counts)
    entries = _entries(file, laz, len(head), table_at, keys, counts)
    file.seek(0, 2)
    at = file.tell()
    file.write(struct.pack("<H16sHQ32s", 0, USER.encode(), PAGES_RECORD, len(entries), b"EPT Hierarchy") + entries)
    size = file.tell()
    file.seek(AT_EVLRS)
    file.write(struct.pack("<QI", at, 1))
    file.seek(_ROOT_AT)
    file.write(struct.pack("<QQ", at + EVLR_HEADER, len(entries)))
    return size


def _write_chunks(
    file: BinaryIO, laz: lazrs.LazVlr, rows: NDArray[np.uint8], order: NDArray[np.int64], counts: NDArray[np.int64]
) -> int:
    """Compress node after node; where the table of chunks begins."""
    start = file.tell()
    packer = lazrs.LasZipCompressor(file, laz)
    packer.reserve_offset_to_chunk_table()
    first = 0
    for k, count in enumerate(counts.tolist()):
        packer.compress_many(rows[order[first : first + count]].reshape(-1))
        first += count
        if k + 1 < len(counts):  # `done` ends the last one: another end makes an empty chunk, which LASzip refuses
            packer.finish_current_chunk()
    packer.done()
    file.flush()
    file.seek(start)
    return int(struct.unpack("<q", file.read(8))[0])


def _entries(
    file: BinaryIO, laz: lazrs.LazVlr, start: int, table_at: int, keys: NDArray[np.int64], counts: NDArray[np.int64]
) -> bytes:
    """The page of nodes, from the table of chunks."""
    if not len(counts):
        return ENTRY.pack(0, 0, 0, 0, 0, 0, 0)
    file.seek(start)
    sizes = [int(size) for _, size in lazrs.read_chunk_table(file, laz)]
    at, out = start + 8, []
    sizes[-1] = table_at - at - sum(sizes[:-1])
    for key, size, count in zip(keys.tolist(), sizes, counts.tolist(), strict=True):
        out.append(ENTRY.pack(*key, at, size, count))
        at += size
    return b"".join(out)
