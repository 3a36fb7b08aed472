"""Split rule of Fan 2013: a node's range in equal steps."""

from __future__ import annotations

import numpy as np

from fwclass.kernel import inlined, kernel
from fwclass.train.gain import score, term

_ONE = np.uint64(1)  # unsigned places spare the compiler the test for places from the end


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
    """Draws per (step, class); step k holds cut[k] <= value < cut[k + 1], the last one also NaN."""
    last = np.uint64(len(cut) - 2)
    low = np.float64(cut[0])
    scale = (len(cut) - 2) / (np.float64(cut[last]) - low)
    for step in range(len(cut) - 1):
        for c in range(histogram.shape[1]):
            histogram[step, c] = 0
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
def _best_cut(histogram, steps, class_weight, total, whole, table, left):  # type: ignore[no-untyped-def]
    """(gain, k) of the best threshold cut[k], the lowest among equals; k = 0 if none divides the node."""
    n_classes = len(total)
    best, at = -(1 << 62), 0
    below, above, n_left = 0, 0, 0
    for c in range(n_classes):
        left[c] = 0
        above += term(table, total[c])
    for k in range(1, steps + 1):
        added = 0
        for c in range(n_classes):
            h = histogram[k - 1, c]
            if h > 0:  # a step seldom holds more than a class or two
                h *= class_weight[c]
                l, r = left[c], total[c] - left[c]
                below += term(table, l + h) - term(table, l)
                above += term(table, r - h) - term(table, r)
                left[c] = l + h
                added += h
        if added == 0:
            continue
        n_left += added
        if n_left == whole:
            break
        gain = score(table, below, above, n_left, whole - n_left)
        if gain > best:
            best, at = gain, k
    return best, at


@kernel
def _range(value, rows, column):  # type: ignore[no-untyped-def]
    """Fetch the rows' values of one feature; returns the least and the greatest."""
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for i in range(len(rows)):
        v = column[rows[i]]
        value[i] = v
        if v < low:  # false for NaN
            low = v
        if v > high:
            high = v
    return low, high


@inlined
def best_step(node, rows, column, whole, table):  # type: ignore[no-untyped-def]
    """(divides, gain, threshold) of the best step of a feature, float32 `column`, at a node."""
    low, high = _range(node.value, rows, column)
    if not low < high:
        return False, 0, np.float32(0.0)
    _cuts(low, high, node.share, node.cut)
    _histogram(node.value, node.label, node.weight, len(rows), node.cut, node.histogram)
    steps = len(node.share) - 1
    gain, k = _best_cut(node.histogram, steps, node.class_weight, node.total, whole, table, node.left)
    return k > 0, gain, node.cut[k]
