"""The forest's votes: eight rows go down a tree in step, without branches, so their cache misses overlap.

Rows of a block are first brought into the order of the first tree's leaves: neighbours then go the same ways in the
other trees too, and share what is in the cache.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.kernel import kernel
from fwclass.model import LEAF, Forest

BLOCK = 16384
"""Rows at most that visit all trees before the next ones do: a tree is read once for so many."""

VALUES = 1 << 19
"""Values of a block at most, 2 MiB: those of its rows stay in the cache while all trees are walked."""

ASKED = 4
"""Trees between two looks at which rows are settled."""

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
    return lay_out(forest)


def lay_out(forest: Forest) -> Walkable:
    """The same of a forest that was checked: a damaged one is followed anywhere."""
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
def _walk(x, m, rows, nodes, first, shift, place):  # type: ignore[no-untyped-def]
    """Leaf of every row of float32 `x` (rows * m,) in the tree that begins at node `first`, into `place` (rows,)."""
    m, tree = np.uint64(m), nodes[first:]
    mask = np.uint32((1 << shift) - 1)
    top = np.uint32(0)
    rest = rows - rows % 8
    for i in range(0, rest, 8):
        k = before = (top, top, top, top, top, top, top, top)
        moving = True
        while moving:
            for _ in range(4):  # asking less often whether all have arrived costs fewer steps than it saves
                before = k
                k = _step_eight(tree, x, np.uint64(i) * m, m, k, shift, mask)
            moving = k != before
        for lane in range(8):
            place[i + lane] = k[lane]
    for i in range(rest, rows):
        one, last = top, np.uint32(1)
        while one != last:
            last = one
            one = _step(tree, x, np.uint64(i) * m, one, shift, mask)
        place[i] = one


@kernel
def _arrange(x, m, rows, nodes, offsets, shift, place, order, sorted_x):  # type: ignore[no-untyped-def]
    """Bring rows that the first tree sends near each other together: they go the same ways in the others too.

    `order` (rows,) is where each came from, `sorted_x` their values.
    """
    _walk(x, m, rows, nodes, 0, shift, place)
    start = np.zeros(offsets[1] + 1, np.int64)
    for i in range(rows):
        start[place[i] + 1] += 1
    for k in range(1, len(start)):
        start[k] += start[k - 1]
    for i in range(rows):
        at = start[place[i]]
        start[place[i]] += 1
        order[at] = i
        for f in range(m):
            sorted_x[at * m + f] = x[i * m + f]


@kernel
def _settle(votes, order, rows, remaining, x, m, winner):  # type: ignore[no-untyped-def]
    """Write the `winner` of rows that `remaining` trees cannot change, and close the gaps; returns the rows left."""
    left = 0
    for i in range(rows):
        first, second = 0, -1
        for c in range(1, votes.shape[1]):
            if votes[i, c] > votes[i, first]:
                first, second = c, first
            elif second < 0 or votes[i, c] > votes[i, second]:
                second = c
        lead = np.int64(votes[i, first]) - (np.int64(votes[i, second]) if second >= 0 else 0)
        if remaining == 0 or lead > remaining:
            winner[order[i]] = first
            continue
        order[left] = order[i]
        for c in range(votes.shape[1]):
            votes[left, c] = votes[i, c]
        for f in range(m):
            x[left * m + f] = x[i * m + f]
        left += 1
    return left


@kernel
def _cast(x, m, nodes, label, offsets, shift, block, votes, winner):  # type: ignore[no-untyped-def]
    """Every tree's vote for the rows of float32 `x` (n * m,), a block of rows after the other.

    Fills in uint16 `votes` (n, classes); or, where `winner` (n,) is not empty, writes only who wins and leaves a row
    alone once that is settled. `votes` then has no rows, only its classes.
    """
    n = len(x) // m
    trees = len(offsets) - 1
    deciding = len(winner) > 0
    place, order = np.empty(block, np.uint32), np.empty(block, np.int64)
    some_x, some = np.empty(block * m, np.float32), np.empty((block, votes.shape[1]), np.uint16)
    for low in range(0, n, block):
        rows = min(n - low, block)
        _arrange(x[low * m : (low + rows) * m], m, rows, nodes, offsets, shift, place, order, some_x)
        some[:rows] = 0
        whole = rows
        for t in range(trees):
            _walk(some_x, m, rows, nodes, offsets[t], shift, place)
            leaf = label[offsets[t] :]
            for i in range(rows):
                some[i, leaf[place[i]]] += 1
            remaining = trees - 1 - t
            if deciding and (remaining == 0 or (remaining < trees // 2 and remaining % ASKED == 0)):
                rows = _settle(some, order, rows, remaining, some_x, m, winner[low : low + whole])
        if not deciding:
            for i in range(whole):
                for c in range(votes.shape[1]):
                    votes[low + order[i], c] = some[i, c]


def count(X: NDArray[np.float32], forest: Walkable) -> NDArray[np.uint16]:
    """Votes (rows, classes) of a forest that is laid out already, for a matrix that fits it."""
    votes = np.zeros((len(X), forest.classes), np.uint16)
    _go(X, forest, votes, np.empty(0, np.uint8))
    return votes


def winners(X: NDArray[np.float32], forest: Walkable) -> NDArray[np.uint8]:
    """Index of the class with most votes, the first on a tie: ``count(X, forest).argmax(axis=1)``, sooner.

    A row is left alone as soon as the trees to come cannot change its class, so there are no shares to give.
    """
    winner = np.empty(len(X), np.uint8)
    if len(X):
        _go(X, forest, np.empty((0, forest.classes), np.uint16), winner)
    return winner


def _go(X: NDArray[np.float32], f: Walkable, votes: NDArray[np.uint16], winner: NDArray[np.uint8]) -> None:
    x = np.ascontiguousarray(X, np.float32).ravel()
    block = max(1, min(BLOCK, VALUES // f.features, len(X)))
    _cast(x, f.features, f.nodes, f.label, f.offsets, f.shift, block, votes, winner)
