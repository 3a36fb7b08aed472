"""One tree of the forest (Fan 2013): histograms of equal-width steps, largest information gain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.hashing import below
from fwclass.kernel import kernel
from fwclass.model import LEAF

_FIXED = float(1 << 20)
_ONE = np.uint64(1)  # unsigned places spare the compiler the test for places from the end
_STACK = 64  # the smaller half is grown first, so at most log2(rows) halves wait


def entropy_table(n: int) -> NDArray[np.int64]:
    """k lb k for k = 0 .. n as whole multiples of 2^-20: sums are exact, so equal gains really tie."""
    k = np.arange(n + 1, dtype=np.float64)
    return np.rint(k * np.log2(np.maximum(k, 1.0)) * _FIXED).astype(np.int64)


@kernel
def draw_bag(state, draws, weight):  # type: ignore[no-untyped-def]
    """Draw rows with replacement; `weight` (rows,) int32 counts how often each was drawn."""
    weight[:] = 0
    for _ in range(draws):
        weight[below(state, len(weight))] += 1


@kernel
def _cuts(low, high, share, cut):  # type: ignore[no-untyped-def]
    """Thresholds low + share (high - low) as float32, for share = 0, 1 / steps .. 1, and infinity."""
    wide = np.float64(high) - np.float64(low)
    for k in range(len(share)):
        cut[k] = np.float32(np.float64(low) + share[k] * wide)
    cut[len(share) - 1] = high
    cut[len(share)] = np.inf


@kernel
def _histogram(value, label, weight, rows, cut, histogram):  # type: ignore[no-untyped-def]
    """Weight per (step, class); step k holds cut[k] <= value < cut[k + 1], the last one also NaN."""
    last = np.uint64(len(cut) - 2)
    low = np.float64(cut[0])
    scale = (len(cut) - 2) / (np.float64(cut[last]) - low)
    histogram[:] = 0
    for i in range(rows):
        v, k = value[i], last
        if v == v:
            k = np.uint64(np.int64((np.float64(v) - low) * scale))
            while v < cut[k]:  # what decides is the float32 comparison that a prediction makes
                k -= _ONE
            while v >= cut[k + _ONE]:
                k += _ONE
        histogram[k, np.uint64(label[i])] += weight[i]


@kernel
def _best_cut(histogram, total, rows, table, left):  # type: ignore[no-untyped-def]
    """(gain, k) of the best threshold cut[k], the lowest among equals; k = 0 if none divides the node.

    The gain is short of a constant of the node: -rows * H(c|t), in units of the table.
    """
    n_classes = len(total)
    best, at = -(1 << 62), 0
    left[:] = 0
    n_left = 0
    for k in range(1, len(histogram)):
        added = 0
        for c in range(n_classes):
            h = histogram[k - 1, c]
            left[c] += h
            added += h
        if added == 0:
            continue
        n_left += added
        if n_left == rows:
            break
        gain = -table[n_left] - table[rows - n_left]
        for c in range(n_classes):
            gain += table[left[c]] + table[total[c] - left[c]]
        if gain > best:
            best, at = gain, k
    return best, at


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


class Node(NamedTuple):
    """The node at work, in buffers that all nodes share: its rows' values, its classes, its steps."""

    value: NDArray[np.float32]  # (rows,), of the feature that is tried
    label: NDArray[np.uint8]  # (rows,)
    weight: NDArray[np.int32]  # (rows,)
    spare: NDArray[np.uint32]  # (rows,), rows on their way to the right child
    total: NDArray[np.int64]  # (classes,), weight in the node
    left: NDArray[np.int64]  # (classes,), weight left of a threshold
    share: NDArray[np.float64]  # (steps + 1,), 0 .. 1
    cut: NDArray[np.float32]  # (steps + 2,), thresholds of the feature that is tried, and infinity
    histogram: NDArray[np.int64]  # (steps + 1, classes)
    drawn: NDArray[np.int64]  # (features,), a permutation; the drawn ones come first


def workspace(rows: int, features: int, n_classes: int, steps: int) -> Node:
    """Buffers for trees of up to `rows` rows."""
    return Node(
        np.empty(rows, np.float32),
        np.empty(rows, np.uint8),
        np.empty(rows, np.int32),
        np.empty(rows, np.uint32),
        np.empty(n_classes, np.int64),
        np.empty(n_classes, np.int64),
        np.arange(steps + 1) / steps,
        np.empty(steps + 2, np.float32),
        np.empty((steps + 1, n_classes), np.int64),
        np.arange(features),
    )


@kernel
def _gather(node, rows, classes, bag):  # type: ignore[no-untyped-def]
    """Fill in the labels, weights and totals of a node; returns its weight and its commonest class."""
    node.total[:] = 0
    for i in range(len(rows)):
        node.label[i], node.weight[i] = classes[rows[i]], bag[rows[i]]
        node.total[node.label[i]] += node.weight[i]
    most = 0
    for c in range(len(node.total)):
        if node.total[c] > node.total[most]:
            most = c
    return node.total.sum(), most


@kernel
def _range(node, rows, column):  # type: ignore[no-untyped-def]
    """Fetch the rows' values of one feature; returns the least and the greatest."""
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for i in range(len(rows)):
        v = column[rows[i]]
        node.value[i] = v
        if v < low:  # false for NaN
            low = v
        if v > high:
            high = v
    return low, high


@kernel
def _best_split(node, rows, columns, draws, per_split, state, table):  # type: ignore[no-untyped-def]
    """(feature, threshold) of the node; feature -1 if no feature divides it.

    Features are drawn without replacement; more than `per_split` only as long as none divided the node.
    """
    n_features = len(node.drawn)
    feature, threshold, best = -1, np.float32(0.0), -(1 << 62)
    for tried in range(n_features):
        if tried >= per_split and feature >= 0:
            break
        swap = tried + below(state, n_features - tried)
        f = node.drawn[swap]
        node.drawn[swap] = node.drawn[tried]
        node.drawn[tried] = f
        low, high = _range(node, rows, columns[f])
        if low < high:
            _cuts(low, high, node.share, node.cut)
            _histogram(node.value, node.label, node.weight, len(rows), node.cut, node.histogram)
            gain, k = _best_cut(node.histogram, node.total, draws, table, node.left)
            if k > 0 and gain > best:
                feature, threshold, best = f, node.cut[k], gain
    return feature, threshold


@kernel
def grow(columns, classes, bag, state, per_split, min_split, table, node):  # type: ignore[no-untyped-def]
    """Grow one tree from float32 columns (features, rows) and uint8 classes (rows,).

    `bag` (rows,) int32 is how often each row was drawn, `table` that of `entropy_table` up to all draws, `node`
    a fresh `workspace`. Returns (feature, threshold, child).
    """
    index = np.flatnonzero(bag).astype(np.uint32)
    size = 2 * len(index)
    feature = np.full(size, LEAF, np.uint16)
    threshold = np.zeros(size, np.float32)
    child = np.zeros(size, np.uint32)
    stack = np.empty((_STACK, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, len(index)
    waiting, nodes = 1, 1
    while waiting > 0:
        waiting -= 1
        at, a, b = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
        draws, most = _gather(node, index[a:b], classes, bag)
        f, t = -1, np.float32(0.0)
        if node.total[most] < draws and draws >= min_split:
            f, t = _best_split(node, index[a:b], columns, draws, per_split, state, table)
        if f < 0:
            child[at] = most
            continue
        feature[at], threshold[at], child[at] = f, t, nodes
        middle = a + _divide(columns[f], t, index[a:b], node.spare)
        first = 0 if middle - a > b - middle else 1
        for side in (first, 1 - first):
            stack[waiting, 0] = nodes + side
            stack[waiting, 1] = a if side == 0 else middle
            stack[waiting, 2] = middle if side == 0 else b
            waiting += 1
        nodes += 2
    return feature[:nodes].copy(), threshold[:nodes].copy(), child[:nodes].copy()


@kernel
def count_out_of_bag(X, feature, threshold, child, bag, votes):  # type: ignore[no-untyped-def]
    """Add one tree's vote to `votes` (rows, classes) for every row that the tree was not grown from."""
    for i in range(len(X)):
        if bag[i] == 0:
            k = np.int64(0)
            while feature[k] != LEAF:
                k = np.int64(child[k]) + (0 if X[i, feature[k]] < threshold[k] else 1)
            votes[i, child[k]] += 1
