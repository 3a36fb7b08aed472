"""Echoes that are open, in the order of the blocks that they are drawn in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fwclass.view.pyramid import Node


@dataclass(frozen=True)
class OpenTile:
    """A tile's columns, the order of its echoes in blocks, and the span of every node in that order."""

    columns: Mapping[str, NDArray]
    order: NDArray[np.int64]
    nodes: Mapping[Node, tuple[int, int]]

    @property
    def size(self) -> int:
        """Bytes of memory that the columns and their order take."""
        return int(sum(v.nbytes for v in self.columns.values()) + self.order.nbytes)

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
