"""The node at work while a tree grows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import inlined, kernel


class Node(NamedTuple):
    """The node's rows, classes and steps, in buffers that all nodes share."""

    value: NDArray[np.float32]  # (rows,), of the feature that is tried
    label: NDArray[np.uint8]  # (rows,)
    weight: NDArray[np.int32]  # (rows,), how often a row was drawn
    spare: NDArray[np.uint32]  # (rows,), rows on their way to the right child
    packed: NDArray[np.uint64]  # (rows,), what is sorted: code, times drawn, class
    other: NDArray[np.uint64]  # (rows,), where it is sorted to
    bucket: NDArray[np.int64]  # (2048,), of the sort
    class_weight: NDArray[np.int64]  # (classes,), what one row of a class weighs
    total: NDArray[np.int64]  # (classes,), weight in the node
    left: NDArray[np.int64]  # (classes,), weight left of a threshold
    share: NDArray[np.float64]  # (steps + 1,), 0 .. 1
    cut: NDArray[np.float32]  # (steps + 2,), thresholds of the feature that is tried, and infinity
    histogram: NDArray[np.int64]  # (steps + 1 or more, classes), times drawn
    drawn: NDArray[np.int64]  # (features,), a permutation; the drawn ones come first


def workspace(rows: int, features: int, class_weight: NDArray[np.int64], steps: int, codes: int) -> Node:
    """Buffers for trees of up to that number of `rows`, whose features have up to `codes` codes in a histogram;
    `class_weight` int64 (classes,)."""
    n_classes = len(class_weight)
    return Node(
        np.empty(rows, np.float32),
        np.empty(rows, np.uint8),
        np.empty(rows, np.int32),
        np.empty(rows, np.uint32),
        np.empty(rows, np.uint64),
        np.empty(rows, np.uint64),
        np.empty(1 << 11, np.int64),
        class_weight,
        np.empty(n_classes, np.int64),
        np.empty(n_classes, np.int64),
        np.arange(steps + 1) / steps,
        np.empty(steps + 2, np.float32),
        np.empty((max(steps + 1, codes), n_classes), np.int64),
        np.arange(features),
    )


@inlined
def gather(node, rows, classes, bag):  # type: ignore[no-untyped-def]
    """Fill in the labels, weights and totals of a node; its number of draws, its weight, its heaviest class (index).
    `rows` int64 (node's,), `classes` uint8 and `bag` int32 (sample's,): class of every row, and how often it was
    drawn."""
    return _gather(node.label, node.weight, node.class_weight, node.total, rows, classes, bag)


@kernel
def _gather(label, weight, class_weight, total, rows, classes, bag):  # type: ignore[no-untyped-def]
    """The same, from the buffers themselves: a call that hands over all of them takes longer than a small node."""
    total[:] = 0
    for i in range(len(rows)):
        label[i], weight[i] = classes[rows[i]], bag[rows[i]]
        total[label[i]] += weight[i]
    draws, whole, most = 0, 0, 0
    for c in range(len(total)):
        draws += total[c]
        total[c] *= class_weight[c]
        whole += total[c]
        if total[c] > total[most]:
            most = c
    return draws, whole, most
