"""One tree of the forest, grown node by node."""

from __future__ import annotations

import numpy as np

from fwclass.hashing import below
from fwclass.kernel import inlined, kernel
from fwclass.model import LEAF
from fwclass.train.equal_width import best_step
from fwclass.train.node import gather
from fwclass.train.ranked import best_rank, threshold

_ONE = np.uint64(1)
_STACK = 64  # the smaller half is grown first, so at most log2(rows) halves wait


@kernel
def _divide(column, cut, rows, spare):  # type: ignore[no-untyped-def]
    """Move rows with value < cut to the front of `rows`, in order; returns how many they are."""
    left, right = np.uint64(0), np.uint64(0)
    for i in range(len(rows)):
        row = rows[i]
        rows[left] = spare[right] = row  # without a branch: which of the two counts is a coin's throw
        below_it = np.uint64(column[row] < cut)
        left += below_it
        right += _ONE - below_it
    for i in range(right):
        rows[left + i] = spare[i]
    return np.int64(left)


@inlined
def _best_split(node, rows, columns, ranks, whole, per_split, state, table):  # type: ignore[no-untyped-def]
    """(feature, cut, threshold) of the node; feature -1 if no feature divides it.

    Features are drawn without replacement; more than `per_split` only as long as none divided the node. Rows with
    column < cut go left, which is value < threshold.
    """
    n_features = len(node.drawn)
    feature, cut, limit, best = -1, columns[0, 0], np.float32(0.0), -(1 << 62)
    for tried in range(n_features):
        if tried >= per_split and feature >= 0:
            break
        swap = tried + below(state, n_features - tried)
        f = node.drawn[swap]
        node.drawn[swap] = node.drawn[tried]
        node.drawn[tried] = f
        if ranks is None:  # decided when this is compiled
            divides, gain, at = best_step(node, rows, columns[f], whole, table)
            if divides and gain > best:
                feature, cut, limit, best = f, at, at, gain
        else:
            divides, gain, low, high = best_rank(node, rows, columns[f], ranks.missing[f] + 1, whole, table)
            if divides and gain > best:
                feature, best = f, gain
                cut, limit = high, threshold(ranks, f, low, high)
    return feature, cut, limit


@kernel
def grow(columns, ranks, classes, bag, state, per_split, min_split, table, node):  # type: ignore[no-untyped-def]
    """Grow one tree from columns (features, rows) and uint8 classes (rows,).

    `columns` are float32 and `ranks` None (equal width), or codes and their `Ranks`. `bag` (rows,) int32 is how often
    each row was drawn, `table` that of `gain`, `node` a fresh `workspace`. Returns (feature, threshold, child).
    """
    index = np.flatnonzero(bag).astype(np.uint32)
    size = 2 * len(index)
    feature = np.full(size, LEAF, np.uint16)
    limit = np.zeros(size, np.float32)
    child = np.zeros(size, np.uint32)
    stack = np.empty((_STACK, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, len(index)
    waiting, nodes = 1, 1
    while waiting > 0:
        waiting -= 1
        at, a, b = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
        draws, whole, most = gather(node, index[a:b], classes, bag)
        child[at] = most
        if node.total[most] == whole or draws < min_split:
            continue
        f, cut, t = _best_split(node, index[a:b], columns, ranks, whole, per_split, state, table)
        if f < 0:
            continue
        feature[at], limit[at], child[at] = f, t, nodes
        middle = a + _divide(columns[f], cut, index[a:b], node.spare)
        first = 0 if middle - a > b - middle else 1
        for side in (first, 1 - first):
            stack[waiting, 0] = nodes + side
            stack[waiting, 1] = a if side == 0 else middle
            stack[waiting, 2] = middle if side == 0 else b
            waiting += 1
        nodes += 2
    return feature[:nodes].copy(), limit[:nodes].copy(), child[:nodes].copy()


@kernel
def count_out_of_bag(columns, feature, threshold, child, bag, votes):  # type: ignore[no-untyped-def]
    """Add one tree's vote to `votes` (rows, classes) for every row that the tree was not grown from, of float32
    `columns` (features, rows). All rows take a step in turn: one alone would wait for its value at every node."""
    rows = np.flatnonzero(bag == 0)
    at = np.zeros(len(rows), np.uint32)
    walking = len(rows)
    while walking > 0:
        left = 0
        for i in range(walking):
            row, k = rows[i], at[i]
            f = feature[k]
            if f == LEAF:
                votes[row, child[k]] += 1
            else:
                rows[left], at[left] = row, child[k] + np.uint32(not columns[f, row] < threshold[k])
                left += 1
        walking = left
