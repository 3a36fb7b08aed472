"""Echoes that are open, in the order of the blocks that they are drawn in."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fwclass.publish.octree import echo_hashes
from fwclass.schema import IDENTITY, Table
from fwclass.view.pyramid import Node, Pyramid, levels_of, order_blocks


class OpenTile:
    """A tile's columns, and when blocks are asked for the order of its echoes in them.

    Attributes
    ----------
    columns : places and `IDENTITY` of the echoes, and what else is wanted of them.
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
