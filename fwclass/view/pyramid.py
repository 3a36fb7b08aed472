"""Levels of echoes for drawing: each doubles what is shown, and every second one halves the edge of its squares.

An echo's level follows from a hash of who it is, so that the first levels are an even thinning of any area. Squares are
the tiles of the run, halved for the finer levels and joined for the coarser ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel

MAX_LEVEL = 60
"""Bits of the hash that levels may use."""

DIGIT = 11
"""Bits that keys are sorted by at a time: the counts of their values fit a processor's nearest cache."""

Node = tuple[int, int, int]
"""Level, column and row of a square, counted from the south-west corner of the root."""


@dataclass(frozen=True)
class Pyramid:
    """Attributes
    ----------
    size : edge of a tile [m].
    west, south : numbers of the tile at the root's south-west corner, in the run's grid.
    joined : the root has 2^joined tiles along its edge.
    halved : the finest squares have 2^-halved of a tile's edge.
    whole : levels up to this one have few echoes, and are sent whole.

    Echoes of levels above `whole` whose squares have several tiles are put into the first level of single tiles, `own`:
    so what must be known of all tiles at a time is bounded, whatever the survey's size.
    """

    size: float
    west: int
    south: int
    joined: int
    halved: int
    whole: int = MAX_LEVEL

    @classmethod
    def over(cls, tiles: NDArray[np.int64], echoes: int, size: float, block: int, together: int) -> Pyramid:
        """The pyramid of tiles with `echoes` altogether.

        Parameters
        ----------
        tiles : shape (n, 2), column and row in the run's grid.
        block : a block of an average tile has at most so many echoes.
        together : levels with at most so many are sent whole.
        """
        low, high = tiles.min(axis=0), tiles.max(axis=0)
        joined = int((high - low).max()).bit_length()
        halved, mean = 0, echoes / len(tiles) / 2
        while mean > block and 2 * (joined + halved) + 3 < MAX_LEVEL:
            mean, halved = mean / 4, halved + 1
        plain = cls(size, int(low[0]), int(low[1]), joined, halved)
        whole = max((k for k in plain.levels() if echoes * plain.share(k) <= together), default=-1)
        return replace(plain, whole=whole)

    @property
    def last(self) -> int:
        """The finest level."""
        return 2 * (self.joined + self.halved) + 1

    @property
    def own(self) -> int:
        """The first level whose squares lie in one tile."""
        return 2 * self.joined

    @property
    def corner(self) -> tuple[float, float]:
        """South-west corner of the root [m]."""
        return self.west * self.size, self.south * self.size

    def edge(self, level: int) -> float:
        """Edge of the squares of a level [m]."""
        return float(self.size * 2.0 ** (self.joined - level // 2))

    @property
    def coarse(self) -> int:
        """The last level whose squares have several tiles; -1 for none."""
        return min(self.whole, self.own - 1)

    def limit(self, level: int) -> int:
        """Echoes with a hash below this are in levels up to `level`; at most 2^64."""
        return 1 << (64 - self.last + level)

    def share(self, level: int) -> float:
        """Share of the echoes that a level has by itself."""
        return float(2.0 ** (level - self.last - (level > 0)))

    def levels(self) -> range:
        """All of them, the coarsest first."""
        return range(self.last + 1)

    def has(self, node: Node) -> bool:
        """Whether there can be such a node."""
        level, i, j = node
        return 0 <= level <= self.last and 0 <= i < 1 << (level // 2) and 0 <= j < 1 << (level // 2)

    def tile_of(self, node: Node) -> tuple[int, int]:
        """Column and row in the run's grid of the tile that a node of `own` or a finer level lies in."""
        level, i, j = node
        down = level // 2 - self.joined
        return self.west + (i >> down), self.south + (j >> down)


def levels_of(pyramid: Pyramid, rank: NDArray[np.uint64]) -> NDArray[np.int8]:
    """The level of every echo by its hash."""
    out = np.empty(len(rank), np.int8)
    _levels(rank, pyramid.last, out)
    out[(out > pyramid.whole) & (out < pyramid.own)] = pyramid.own
    return out


def order_blocks(
    pyramid: Pyramid, level: NDArray[np.int8], x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.int64], dict[Node, tuple[int, int]]]:
    """The order of echoes in their blocks, and the first and last row of every node in that order.

    Inside a block echoes follow a Z-order curve: neighbours compress well.
    """
    key, morton = np.empty(len(x), np.uint64), np.empty(len(x), np.uint64)
    _keys(level, x, y, pyramid.size, pyramid.joined, *pyramid.corner, key, morton)
    order = sorted_rows(key, sorted_rows(morton, np.arange(len(x))))
    of = key[order]
    new = np.ones(len(of), bool)
    new[1:] = of[1:] != of[:-1]
    nodes = {}
    for first, last in pairwise([*np.flatnonzero(new).tolist(), len(of)]):
        k = int(of[first])
        nodes[k >> 58, k >> 29 & 0x1FFFFFFF, k & 0x1FFFFFFF] = (first, last)
    return order, nodes


def sorted_rows(key: NDArray[np.uint64], order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows `order` by their keys, those with the same one as they were. Linear in their number: keys of blocks differ
    in few of their bits, and those alone are looked at."""
    out = order.copy()
    _sort(key, out, np.empty_like(out), np.empty(1 << DIGIT, np.int64))
    return out


@kernel
def _levels(rank, last, out):  # type: ignore[no-untyped-def]
    for i in range(len(rank)):
        bits, v = 0, rank[i]
        while v:
            bits += 1
            v >>= np.uint64(1)
        out[i] = max(0, bits - 64 + last)


@kernel
def _keys(level, x, y, size, joined, west, south, key, morton):  # type: ignore[no-untyped-def]
    """Node of every echo as one number, and its place on the node's curve."""
    for n in range(len(x)):
        depth = level[n] // 2
        edge = size * 2.0 ** (joined - depth)
        most = (1 << depth) - 1
        u, v = (x[n] - west) / edge, (y[n] - south) / edge
        i, j = min(max(int(u), 0), most), min(max(int(v), 0), most)
        key[n] = (np.uint64(level[n]) << np.uint64(58)) | (np.uint64(i) << np.uint64(29)) | np.uint64(j)
        a = min(max(int((u - i) * 65536.0), 0), 65535)
        b = min(max(int((v - j) * 65536.0), 0), 65535)
        code = np.uint64(0)
        for bit in range(16):
            code |= np.uint64((a >> bit & 1) << (2 * bit)) | np.uint64((b >> bit & 1) << (2 * bit + 1))
        morton[n] = code


@kernel
def _sort(key, order, spare, counts):  # type: ignore[no-untyped-def]
    """Radix sort from the lowest bits up, past those in which no two keys differ; the result is in `order`."""
    n, mask = len(order), np.uint64(len(counts) - 1)
    differ = np.uint64(0)
    for k in range(n):
        differ |= key[order[k]] ^ key[order[0]]
    shift = 0
    while shift < 64 and differ >> np.uint64(shift):
        if not differ >> np.uint64(shift) & np.uint64(1):
            shift += 1
            continue
        counts[:] = 0
        for k in range(n):
            counts[key[order[k]] >> np.uint64(shift) & mask] += 1
        first = 0
        for value in range(len(counts)):
            first, counts[value] = first + counts[value], first
        for k in range(n):
            value = key[order[k]] >> np.uint64(shift) & mask
            spare[counts[value]] = order[k]
            counts[value] += 1
        order[:] = spare
        shift += DIGIT
