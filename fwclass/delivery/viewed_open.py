"""Echoes of a run that are open, in the order of the blocks that they are drawn in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery
from fwclass.errors import InputError
from fwclass.publish.octree import echo_hashes
from fwclass.schema import IDENTITY, Table
from fwclass.view.blocks import DRAWN
from fwclass.view.cache import Cache
from fwclass.view.pyramid import Node, Pyramid, levels_of, order_blocks

THREADS = 2
"""That read tiles ahead; more take turns at the interpreter's lock."""


class OpenTile:
    """A tile's columns, and when blocks are asked for the order of its echoes in them.

    `columns`: places and `IDENTITY` of the echoes, and what else is wanted of them.
    """

    def __init__(self, pyramid: Pyramid, columns: Mapping[str, NDArray]) -> None:
        self.columns, self._pyramid = columns, pyramid
        self._blocks: tuple[NDArray[np.int64], dict[Node, tuple[int, int]]] | None = None

    @classmethod
    def empty(cls, pyramid: Pyramid) -> OpenTile:
        """One without echoes."""
        return cls(pyramid, {n: np.empty(0) for n in ("x", "y", *IDENTITY)})

    @property
    def rank(self) -> NDArray[np.uint64]:
        """The hash of every echo, which its level follows from."""
        return echo_hashes(Table({n: self.columns[n] for n in IDENTITY}))

    @property
    def order(self) -> NDArray[np.int64]:
        """Rows of the echoes as they stand in blocks, node after node."""
        return self._arranged[0]

    @property
    def nodes(self) -> Mapping[Node, tuple[int, int]]:
        """The nodes, and the first and last place of each in `order`."""
        return self._arranged[1]

    @property
    def _arranged(self) -> tuple[NDArray[np.int64], dict[Node, tuple[int, int]]]:
        if self._blocks is None:  # no lock: threads that meet here get the same
            c = self.columns
            self._blocks = order_blocks(self._pyramid, levels_of(self._pyramid, self.rank), c["x"], c["y"])
        return self._blocks

    @property
    def size(self) -> int:
        """Bytes of memory that the columns and their order take."""
        return int(sum(v.nbytes for v in self.columns.values()) + 8 * len(self.columns["x"]))

    @cached_property
    def place(self) -> NDArray[np.int32]:
        """Where in `order` each echo stands."""
        out = np.empty(len(self.order), np.int32)
        out[self.order] = np.arange(len(self.order), dtype=np.int32)
        return out

    @cached_property
    def firsts(self) -> tuple[list[Node], NDArray[np.int64]]:
        """The nodes, and where in `order` each begins, ascending."""
        return list(self.nodes), np.array([first for first, _ in self.nodes.values()], np.int64)


class OpenRun:
    """Tiles of a run that are open, as many as there is room for, and its coarse echoes, which several tiles have.

    `tiles`: what the delivery says of each, by its column and row. `cache`: of tiles, and of what else is made of them.
    `pool`: threads that read ahead.
    """

    def __init__(self, delivery: Delivery, pyramid: Pyramid, most: int) -> None:
        self.delivery, self.pyramid = delivery, pyramid
        self.tiles = {str(t["tile"]): t for t in delivery.tiles}
        self.cache, self.pool = Cache(most), ThreadPoolExecutor(THREADS)
        self._lock = Lock()
        self._skimmed: OpenTile | None = None

    def tile(self, key: str) -> OpenTile:
        """A tile, by its column and row."""
        return self.cache.get(key, lambda: OpenTile(self.pyramid, self.read(key)), lambda tile: tile.size)

    def coarse(self) -> OpenTile:
        """The echoes of the levels that squares of several tiles have."""
        with self._lock:
            if self._skimmed is None:
                self._skimmed = OpenTile(self.pyramid, self._coarsest())
            return self._skimmed

    def holder(self, node: Node) -> OpenTile:
        """What has the echoes of a node; nothing where no tile lies."""
        key = self.key_of(node)
        if not key:
            return self.coarse()
        return self.tile(key) if key in self.tiles else OpenTile.empty(self.pyramid)

    def key_of(self, node: Node) -> str:
        """The tile that a node lies in, "" for one over several."""
        return "" if node[0] < self.pyramid.own else "{}_{}".format(*self.pyramid.tile_of(node))

    def echo_at(self, node: Node, row: int) -> tuple[OpenTile, int]:
        """What holds an echo of a block, and its row there."""
        opened = self.holder(node)
        first, last = opened.nodes.get(node, (0, 0))
        if not 0 <= row < last - first:
            raise InputError("no such echo", where=node, expected=f"0 to {last - first - 1}", got=row)
        return opened, int(opened.order[first + row])

    def row_of(self, node: Node, row: int) -> tuple[str, int]:
        """Tile, and row of it, of an echo of a block."""
        opened, at = self.echo_at(node, row)
        if "row" in opened.columns:
            return list(self.tiles)[int(opened.columns["tile"][at])], int(opened.columns["row"][at])
        return "{}_{}".format(*self.pyramid.tile_of(node)), at

    def find(self, strip: int, pulse: int, echo_number: int) -> tuple[str, int]:
        """Tile, and row of it, of the echo with this identity; `InputError` where there is none."""
        for key in self.tiles:
            who = self.columns(key, IDENTITY)
            here = (who["strip"] == strip) & (who["pulse"] == pulse) & (who["echo_number"] == echo_number)
            if here.any():
                return key, int(np.flatnonzero(here)[0])
        raise InputError("there is no such echo", where=self.delivery.path, got=f"{strip}, {pulse}, {echo_number}")

    def in_blocks(self, key: str, rows: NDArray[np.int64]) -> list[tuple[Node, NDArray, NDArray]]:
        """Nodes that have echoes `rows` of a tile, their rows in the node's block, and indices into `rows`."""
        out = [part for part in by_node(self.tile(key), rows) if part[0][0] >= self.pyramid.own]
        if self.pyramid.own:
            at, index = self._coarse_rows(key, rows)
            out += [(node, r, index[i]) for node, r, i in by_node(self.coarse(), at)]
        return out

    def for_coarse(self, of_tile: Callable[[str], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """A byte of each coarse echo, of those that `of_tile` gives of all echoes of a tile."""
        columns = self.coarse().columns
        tile, row = columns["tile"], columns["row"]
        bounds = np.searchsorted(tile, np.arange(len(self.tiles) + 1))
        out = np.empty(len(tile), np.uint8)
        for number, key in enumerate(self.tiles):
            mine = slice(bounds[number], bounds[number + 1])
            out[mine] = of_tile(key)[row[mine]]
        return out

    def columns(self, key: str, names: Sequence[str]) -> dict[str, NDArray]:
        """Those of the columns that a tile has, in its table's order."""
        return table_columns(self.delivery.table(key), names)

    def read(self, key: str) -> dict[str, NDArray]:
        """What blocks are made of, of a tile."""
        columns = self.columns(key, (*DRAWN, *IDENTITY))
        lacking = [n for n in (*DRAWN, *IDENTITY) if n not in columns]
        if lacking:
            raise InputError("a delivered tile lacks columns", where=key, got=", ".join(lacking), do="run again")
        return columns

    def _coarsest(self) -> dict[str, NDArray]:
        """Columns of the coarse echoes, and the tile and row that each comes from."""
        parts = list(self.pool.map(self._coarse_of, range(len(self.tiles)), self.tiles))
        return {n: np.concatenate([p[n] for p in parts]) for n in parts[0]}

    def _coarse_of(self, number: int, key: str) -> dict[str, NDArray]:
        tile = self.tile(key)
        limit = self.pyramid.limit(self.pyramid.coarse) if self.pyramid.coarse >= 0 else 0
        rows = np.flatnonzero(tile.rank < np.uint64(limit))
        return {**{n: v[rows] for n, v in tile.columns.items()}, "tile": np.full(len(rows), number), "row": rows}

    def _coarse_rows(self, key: str, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Where echoes `rows` of a tile stand among the coarse ones, for those that do, and indices into `rows`."""
        columns, number = self.coarse().columns, list(self.tiles).index(key)
        first, last = np.searchsorted(columns["tile"], [number, number + 1])
        at, index = positions(columns["row"][first:last], rows)
        return first + at, index


def positions(ascending: NDArray, values: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where those of `values` that are among `ascending` stand there, and their indices."""
    if not len(ascending):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    at = np.minimum(np.searchsorted(ascending, values), len(ascending) - 1)
    index = np.flatnonzero(ascending[at] == values)
    return at[index], index


def by_node(opened: OpenTile, rows: NDArray[np.int64]) -> list[tuple[Node, NDArray, NDArray]]:
    """Nodes that have `rows` of what is open, rows in their blocks, indices into `rows`."""
    nodes, firsts = opened.firsts
    place = opened.place[rows]
    of = np.searchsorted(firsts, place, "right") - 1
    order = np.argsort(of, kind="stable")
    cuts = np.flatnonzero(np.diff(of[order], prepend=-1))
    return [(nodes[of[i[0]]], place[i] - firsts[of[i[0]]], i) for i in np.split(order, cuts[1:]) if len(i)]
