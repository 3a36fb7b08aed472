"""The forest's votes: eight rows go down a tree in step, without branches, so their cache misses overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.kernel import kernel
from fwclass.model import LEAF, Forest

BLOCK = 8192
"""Rows that visit all trees before the next ones do: they stay in the cache while a tree is read once."""

NODE = np.dtype([("threshold", "f4"), ("link", "u4")])
"""A node in one 8-byte load. ``link >> shift`` is the right child, the left one comes just before it; the low
bits are the feature. A leaf is its own right child and has threshold NaN, which no value is below: a row that
has arrived stays there."""

_U2, _U3, _U4, _U5, _U6, _U7 = (np.uint64(lane) for lane in range(2, 8))


@dataclass(frozen=True)
class Walkable:
    """A forest laid out for `votes`."""

    nodes: NDArray[np.void]
    label: NDArray[np.uint8]
    offsets: NDArray[np.int64]
    shift: np.uint32
    features: int
    classes: int


def walkable(forest: Forest) -> Walkable:
    """Lay out a forest for `votes`; `InputError` if it is damaged or a tree is too large for its links."""
    forest.check()
    shift = max(1, (len(forest.features) - 1).bit_length())
    size = np.diff(forest.offsets)
    if int(size.max()) > 1 << (32 - shift):
        raise InputError(
            "a tree of the model is too large",
            expected=f"at most {1 << (32 - shift)} nodes with {len(forest.features)} features",
            got=int(size.max()),
            do="train with fewer samples per class or a larger min_samples_split",
        )
    nodes, label = np.empty(len(forest.feature), NODE), np.zeros(len(forest.feature), np.uint8)
    _lay_out(forest.feature, forest.threshold, forest.child, forest.offsets, shift, nodes, label)
    return Walkable(nodes, label, forest.offsets, np.uint32(shift), len(forest.features), len(forest.codes))


@kernel
def _lay_out(feature, threshold, child, offsets, shift, nodes, label):  # type: ignore[no-untyped-def]
    """Fill in `nodes` and the class of every leaf, `label`."""
    for t in range(len(offsets) - 1):
        for i in range(offsets[t], offsets[t + 1]):
            if feature[i] == LEAF:
                nodes[i].threshold = np.nan
                nodes[i].link = (i - offsets[t]) << shift
                label[i] = child[i]
            else:
                nodes[i].threshold = threshold[i]
                nodes[i].link = (np.int64(child[i]) + 1) << shift | feature[i]


@kernel
def _step(tree, x, row, k, shift, mask):  # type: ignore[no-untyped-def]
    """The node after node `k` for the row whose first value is x[row]."""
    node = tree[k]
    return np.uint32(np.uint32(node.link >> shift) - np.uint32(x[row + (node.link & mask)] < node.threshold))


@kernel
def _step_eight(tree, x, row, m, k, shift, mask):  # type: ignore[no-untyped-def]
    """The same for eight rows in a row; eight named lanes stay in registers, an array of them would not."""
    return (
        _step(tree, x, row, k[0], shift, mask),
        _step(tree, x, row + m, k[1], shift, mask),
        _step(tree, x, row + m * _U2, k[2], shift, mask),
        _step(tree, x, row + m * _U3, k[3], shift, mask),
        _step(tree, x, row + m * _U4, k[4], shift, mask),
        _step(tree, x, row + m * _U5, k[5], shift, mask),
        _step(tree, x, row + m * _U6, k[6], shift, mask),
        _step(tree, x, row + m * _U7, k[7], shift, mask),
    )


@kernel
def _count(x, m, nodes, label, offsets, shift, block, votes):  # type: ignore[no-untyped-def]
    """Add every tree's vote for the rows of float32 `x` (rows * m,) to uint16 `votes` (rows, classes)."""
    n, m = len(votes), np.uint64(m)
    mask = np.uint32((1 << shift) - 1)
    top = np.uint32(0)
    for low in range(0, n, block):
        high = min(n, low + block)
        rest = high - (high - low) % 8
        for t in range(len(offsets) - 1):
            tree, leaf = nodes[offsets[t] : offsets[t + 1]], label[offsets[t] : offsets[t + 1]]
            for i in range(low, rest, 8):
                k = before = (top, top, top, top, top, top, top, top)
                moving = True
                while moving:
                    for _ in range(4):  # asking less often whether all have arrived costs fewer steps than it saves
                        before = k
                        k = _step_eight(tree, x, np.uint64(i) * m, m, k, shift, mask)
                    moving = k != before
                for lane in range(8):
                    votes[i + lane, leaf[k[lane]]] += 1
            for i in range(rest, high):
                one, last = top, np.uint32(1)
                while one != last:
                    last = one
                    one = _step(tree, x, np.uint64(i) * m, one, shift, mask)
                votes[i, leaf[one]] += 1


def count(X: NDArray[np.float32], forest: Walkable) -> NDArray[np.uint16]:
    """Votes (rows, classes) of a forest that is laid out already, for a matrix that fits it."""
    votes = np.zeros((len(X), forest.classes), np.uint16)
    x = np.ascontiguousarray(X, np.float32).ravel()
    _count(x, forest.features, forest.nodes, forest.label, forest.offsets, forest.shift, BLOCK, votes)
    return votes
