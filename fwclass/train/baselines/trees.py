"""Trees of scikit-learn in our layout: the right child next to the left one, value < threshold goes left."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.model import LEAF

FLAT = ("feature", "threshold", "child", "missing_left", "value")
"""Arrays of `Boosted` that have a value per node."""


def beyond(threshold: NDArray[np.float64]) -> NDArray[np.float32]:
    """The least float32 (n,) above every threshold: for a float32 x, ``x <= threshold`` is
    ``x < beyond(threshold)``."""
    with np.errstate(over="ignore"):
        near = threshold.astype(np.float32)
    return np.where(near > threshold, near, np.nextafter(near, np.float32(np.inf))).astype(np.float32)


@kernel
def pair_children(left, right):  # type: ignore[no-untyped-def]
    """(order, child): nodes from the root downwards with the two children of a node side by side, and for every node in
    that order the place of its left child, 0 in a leaf. `left` is negative in a leaf."""
    order, child = np.zeros(len(left), np.int64), np.zeros(len(left), np.uint32)
    filled = 1
    for place in range(len(left)):
        node = order[place]
        if left[node] >= 0:
            child[place] = filled
            order[filled], order[filled + 1] = left[node], right[node]
            filled += 2
    return order, child


def voting_tree(tree: Any, classes: NDArray[np.int64]) -> tuple[NDArray, NDArray, NDArray, int]:
    """(feature, threshold, child) as in `Forest` of a fitted ``sklearn.tree`` tree, and its leaves that are not pure.

    `classes`: which class every column of the tree's values is.
    """
    order, child = pair_children(tree.children_left.astype(np.int64), tree.children_right.astype(np.int64))
    leaf = tree.children_left[order] < 0
    shares = tree.value[order, 0, :]
    feature = np.where(leaf, LEAF, tree.feature[order]).astype(np.uint16)
    threshold = np.where(leaf, 0, beyond(tree.threshold[order])).astype(np.float32)
    child = np.where(leaf, classes[shares.argmax(axis=1)], child).astype(np.uint32)
    impure = leaf & (np.count_nonzero(shares, axis=1) > 1)
    return feature, threshold, child, int(impure.sum())


def boosted_tree(nodes: NDArray[np.void]) -> dict[str, NDArray]:
    """The arrays of `Boosted` of the nodes [n] of a fitted ``HistGradientBoosting`` tree."""
    leaf = nodes["is_leaf"].astype(bool)
    left = np.where(leaf, -1, nodes["left"].astype(np.int64))
    order, child = pair_children(left, nodes["right"].astype(np.int64))
    nodes, leaf = nodes[order], leaf[order]
    return {
        "feature": np.where(leaf, LEAF, nodes["feature_idx"]).astype(np.uint16),
        "threshold": np.where(leaf, 0, beyond(nodes["num_threshold"])).astype(np.float32),
        "child": child,
        "missing_left": (nodes["missing_go_to_left"].astype(bool) & ~leaf).astype(np.uint8),
        "value": np.where(leaf, nodes["value"], 0.0),
    }
