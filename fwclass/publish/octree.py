"""Echoes in an octree: every node has a thinned picture of what lies below it, chosen by a hash of who an echo is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.hashing import hash_keys
from fwclass.kernel import kernel
from fwclass.schema import Table, canonical_key

GRID_BITS = 7
"""A node keeps one echo of each of 128 x 128 x 128 cells (COPC 1.0: the spacing of the root is its edge over 128)."""

MAX_BITS = 21
"""Bits an axis: three of them fit 64 bits, and the cube of the largest file is 2^32 units, halved at most so often."""

SEED = 20
"""Of the hash by which the levels, and the overview, are drawn; any other number would do as well."""


@dataclass(frozen=True)
class Octree:
    """The nodes of a file.

    Attributes
    ----------
    low : whole units from the file's offset to the cube's corner, *less half a unit*: no coordinate lies on a side of
        a node, so that no reader's rounding puts a point outside.
    bits : the cube's edge is 2^bits units.
    order : shape (n,), rows of the table, node after node; inside a node by strip, pulse and echo.
    keys : shape (nodes, 4), level and place of every node, sorted.
    counts : shape (nodes,), echoes of each.
    """

    low: NDArray[np.int64]
    bits: int
    order: NDArray[np.int64]
    keys: NDArray[np.int64]
    counts: NDArray[np.int64]


def echo_hashes(table: Table) -> NDArray[np.uint64]:
    """A random number for every echo, by strip, pulse and echo alone: the lowest ones are a fair sample of any area."""
    return hash_keys(SEED, canonical_key(table))


def octree(units: NDArray[np.int64], table: Table, leaf: int) -> Octree:
    """The octree of echoes at whole coordinates.

    A node with `leaf` echoes or fewer keeps them; a fuller one keeps of each of its cells the echo whose hash is
    lowest, and hands the others down. The result follows from the echoes alone, whatever their order.

    Parameters
    ----------
    units : shape (n, 3), coordinates in whole units, their spread below 2^32.
    table : `strip`, `pulse`, `echo_number` of the same echoes.
    """
    if not len(units):
        return Octree(
            np.zeros(3, np.int64), 1, np.zeros(0, np.int64), np.zeros((0, 4), np.int64), np.zeros(0, np.int64)
        )
    low = units.min(axis=0)
    bits = max(1, int((units.max(axis=0) - low).max()).bit_length())
    shift = max(0, bits - MAX_BITS)
    code = np.empty(len(units), np.uint64)
    _interleave(units[:, 0], units[:, 1], units[:, 2], low, shift, code)
    by_code = np.argsort(code, kind="stable")
    level = np.full(len(units), -1, np.int8)
    _levels(code[by_code], echo_hashes(table)[by_code], min(bits, MAX_BITS), leaf, level)
    depth = np.empty(len(units), np.int8)
    depth[by_code] = level
    return _nodes(low, bits, shift, code, depth, canonical_key(table))


def _nodes(
    low: NDArray[np.int64],
    bits: int,
    shift: int,
    code: NDArray[np.uint64],
    depth: NDArray[np.int8],
    identity: NDArray[np.uint64],
) -> Octree:
    """Rows by node, and the nodes' keys."""
    node = code >> (3 * (bits - shift - depth.astype(np.int64))).astype(np.uint64)
    order = np.lexsort((identity, node, depth))
    changes = np.flatnonzero((np.diff(node[order]) != 0) | (np.diff(depth[order]) != 0)) + 1
    first = np.concatenate([[0], changes])
    rows = order[first]
    place = np.stack([_every_third(node[rows], axis) for axis in range(3)], axis=1)
    keys = np.concatenate([depth[rows].astype(np.int64)[:, None], place], axis=1)
    counts = np.diff(np.append(first, len(code)))
    return Octree(low, bits, order, keys, counts)


_GATHERING = (
    *((2, 0x10C30C30C30C30C3), (4, 0x100F00F00F00F00F), (8, 0x1F0000FF0000FF)),
    *((16, 0x1F00000000FFFF), (32, 0x1FFFFF)),
)
"""Steps by which `_interleave` spreads 21 bits, backwards: how far, and the bits that stand then."""


def _every_third(code: NDArray[np.uint64], axis: int) -> NDArray[np.int64]:
    out = (code >> np.uint64(axis)) & np.uint64(0x1249249249249249)
    for by, standing in _GATHERING:
        out = (out | (out >> np.uint64(by))) & np.uint64(standing)
    return out.astype(np.int64)


@kernel
def _interleave(x, y, z, low, shift, out):  # type: ignore[no-untyped-def]
    """Bits of three coordinates in turn, x lowest."""
    for i in range(len(out)):
        code = np.uint64(0)
        for axis in range(3):
            v = np.uint64(((x[i] if axis == 0 else y[i] if axis == 1 else z[i]) - low[axis]) >> shift)
            v = (v | (v << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
            v = (v | (v << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
            v = (v | (v << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
            v = (v | (v << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
            v = (v | (v << np.uint64(2))) & np.uint64(0x1249249249249249)
            code |= v << np.uint64(axis)
        out[i] = code


@kernel
def _levels(code, rank, bits, leaf, level):  # type: ignore[no-untyped-def]
    """Level of every echo; `code` ascends, `rank` says who comes first, `level` is -1 throughout."""
    n = len(code)
    rest = np.arange(n)
    for depth in range(bits + 1):
        node_shift = np.uint64(3 * (bits - depth))
        cell_shift = np.uint64(max(0, 3 * (bits - depth - GRID_BITS)))
        count, start = 0, 0
        while start < len(rest):
            node = code[rest[start]] >> node_shift
            end = start
            while end < len(rest) and code[rest[end]] >> node_shift == node:
                end += 1
            if end - start <= leaf or depth == bits:
                for k in range(start, end):
                    level[rest[k]] = depth
                start = end
                continue
            while start < end:
                cell = code[rest[start]] >> cell_shift
                best, stop = start, start + 1
                while stop < end and code[rest[stop]] >> cell_shift == cell:
                    if rank[rest[stop]] < rank[rest[best]]:
                        best = stop
                    stop += 1
                level[rest[best]] = depth
                for k in range(start, stop):
                    if k != best:
                        rest[count] = rest[k]
                        count += 1
                start = stop
        rest = rest[:count]
        if count == 0:
            return
