"""COPC 1.0: a LAZ file of variable chunks, one a node of an octree, with pages that say where each node lies."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.las_bytes import AT_EVLRS, AT_FORMAT, LASZIP
from fwclass.formats.las_header import EVLR_HEADER, VLR_HEADER, Header, evlr_at
from fwclass.formats.laz_writer import assemble, record

INFO = struct.Struct("<5d2Q2d88x")
"""Centre, half edge, spacing, place and size of the root page, first and last time (COPC 1.0, info VLR)."""

ENTRY = struct.Struct("<4iQ2i")
"""Level, x, y, z of a node; offset and bytes of its chunk, or of a page; echoes, or -1 for a page."""

USER, INFO_RECORD, PAGES_RECORD = "copc", 1, 1000
_COMPRESSED = 0x80
_INFO_AT = 375 + VLR_HEADER
_ROOT_AT = _INFO_AT + 40
MAX_NODES = 1 << 24
"""Nodes of a file that is read: 512 MiB of entries."""


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
    keys: NDArray[np.int64],
    counts: NDArray[np.int64],
    cube: Cube,
) -> int:
    """Write header, records, a chunk a node, and the page of nodes; returns the file's size.

    Parameters
    ----------
    file : empty, open for reading and writing.
    block : public header of LAS 1.4 (375 bytes), point format 6.
    rows : shape (n, bytes of a point), node after node.
    keys, counts : of the nodes, at least one echo each; see `publish.octree.Octree`.
    """
    laz = lazrs.LazVlr.new_for_compression(block[AT_FORMAT], rows.shape[1] - 30, True)
    info = INFO.pack(*cube.centre, cube.half, cube.spacing, 0, 0, *cube.times)
    first = [record(USER, INFO_RECORD, "copc info", info), record(*LASZIP, "", laz.record_data())]
    head = bytearray(assemble(block, [*first, *records]))
    head[AT_FORMAT] |= _COMPRESSED
    file.write(head)
    table_at = _write_chunks(file, laz, rows, counts)
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


def _write_chunks(file: BinaryIO, laz: lazrs.LazVlr, rows: NDArray[np.uint8], counts: NDArray[np.int64]) -> int:
    """Compress node after node; where the table of chunks begins."""
    start = file.tell()
    packer = lazrs.LasZipCompressor(file, laz)
    packer.reserve_offset_to_chunk_table()
    first = 0
    for k, count in enumerate(counts.tolist()):
        packer.compress_many(rows[first : first + count].reshape(-1))
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


@dataclass(frozen=True)
class Node:
    """A node of a file that is read: its key, and where its chunk lies."""

    key: tuple[int, int, int, int]
    offset: int
    size: int
    points: int


def is_copc(header: Header) -> bool:
    """The first record says so, as COPC 1.0 asks."""
    return bool(header.vlrs) and (header.vlrs[0].user, header.vlrs[0].number) == (USER, INFO_RECORD)


def nodes_of(header: Header) -> tuple[Node, ...]:
    """All nodes of a COPC file, every count and place held against the file before it is believed.

    Raises
    ------
    InputError
        No COPC file; a page outside the file, read twice or of half an entry; a node twice, outside the octree, without
        its parent, or with a chunk outside the points; or nodes with more or fewer echoes than the header says.
    """
    if not is_copc(header) or len(header.vlrs[0].body) < INFO.size:
        _refuse(header, "an info record of 160 bytes as the first record", "none")
    *_, root, size, _, _ = INFO.unpack_from(header.vlrs[0].body)
    pages, visited, nodes = [(int(root), int(size))], set[int](), dict[tuple[int, int, int, int], Node]()
    left = header.size // ENTRY.size
    with header.path.open("rb") as file:
        while pages:
            at, size = pages.pop()
            if at in visited:
                _refuse(header, "every page once", f"that at byte {at} again")
            if size % ENTRY.size or size < 0 or at + size > header.size:
                _refuse(header, f"pages of whole entries inside {header.size} bytes", f"{size} bytes at byte {at}")
            visited.add(at)
            left -= size // ENTRY.size
            if left < 0 or len(nodes) > MAX_NODES:
                _refuse(header, "no more entries than the file has room for", "more")
            file.seek(at)
            for *key, offset, length, points in ENTRY.iter_unpack(file.read(size)):
                _take(header, (key[0], key[1], key[2], key[3]), offset, length, points, nodes, pages)
    total = sum(node.points for node in nodes.values())
    if total != header.n_points:
        _refuse(header, f"{header.n_points} points in all nodes", total)
    return tuple(nodes[key] for key in sorted(nodes))


def _take(
    header: Header,
    key: tuple[int, int, int, int],
    offset: int,
    size: int,
    points: int,
    nodes: dict[tuple[int, int, int, int], Node],
    pages: list[tuple[int, int]],
) -> None:
    """One entry: a node, or a page that is read later."""
    level, *place = key
    if not 0 <= level <= 31 or any(not 0 <= p < 1 << level for p in place) or points < -1 or size < 0:
        _refuse(header, "a node inside the octree", f"node {key}, {points} points in {size} bytes")
    if offset + size > header.size:
        _refuse(header, f"chunks inside {header.size} bytes", f"{size} bytes at byte {offset}")
    if points == -1:
        pages.append((offset, size))
        return
    if key in nodes:
        _refuse(header, "every node once", f"node {key} again")
    nodes[key] = Node(key, offset, size, points)


def _refuse(header: Header, expected: object, got: object) -> None:
    raise InputError(
        "the pages of a COPC file do not fit it",
        where=header.path,
        expected=expected,
        got=got,
        do="copy the file anew; its points can be read by any LAZ reader if its chunk table is sound",
    )


__all__ = ["Cube", "Node", "evlr_at", "is_copc", "nodes_of", "write_copc"]
