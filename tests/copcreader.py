"""The nodes of a COPC file that this program wrote, as its pages have them."""

from __future__ import annotations

from typing import NamedTuple

from fwclass.formats.copc import ENTRY, INFO
from fwclass.formats.las_header import Header


class Node(NamedTuple):
    key: tuple[int, ...]
    offset: int
    size: int
    points: int


def nodes_of(header: Header) -> list[Node]:
    """All nodes, by key; the root page holds them all."""
    assert (header.vlrs[0].user, header.vlrs[0].number) == ("copc", 1)
    *_, root, size, _, _ = INFO.unpack_from(header.vlrs[0].body)
    with header.path.open("rb") as file:
        file.seek(root)
        entries = ENTRY.iter_unpack(file.read(size))
        return sorted(Node(tuple(key), offset, length, points) for *key, offset, length, points in entries)
