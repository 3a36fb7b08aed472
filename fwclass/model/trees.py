"""Trees as flat arrays: what the forest and boosting share, and the check that every walk ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.model.base import LEAF

MAX_TREES = 65535
DEEPEST = 10_000
"""Nodes from a tree's root to a leaf, at most: every sample walks them. Those that are trained have some fifty."""


def offsets_fault(offsets: NDArray[np.int64], nodes: int) -> str:
    """What is wrong with `offsets` (trees + 1,), the places where trees begin; "" if nothing is."""
    if not 2 <= len(offsets) <= MAX_TREES + 1:
        return f"it has {len(offsets) - 1} trees"
    if offsets[0] != 0 or offsets[-1] != nodes or (offsets[1:] <= offsets[:-1]).any():
        return f"its trees do not fill its {nodes} nodes"
    return ""


def node_fault(
    feature: NDArray[np.uint16], child: NDArray[np.uint32], offsets: NDArray[np.int64], features: int, classes: int
) -> str:
    """What is wrong with the nodes (nodes,): every one asks for one of `features`, or is a leaf whose `child` is below
    `classes`; children come after their parent in the same tree, none more than `DEEPEST` nodes down. "" if
    nothing is."""
    return _FAULTS[_first_fault(feature, child, offsets, features, classes)]


def threshold_fault(feature: NDArray[np.uint16], threshold: NDArray[np.float32]) -> str:
    """What is wrong with the thresholds (nodes,) of inner nodes; "" if nothing is.

    Plus infinity is none: it divides samples with a value from those without. NaN and minus infinity divide nothing.
    """
    used = threshold[feature != LEAF]
    return "a node's threshold is not a number" if np.isnan(used).any() or np.isneginf(used).any() else ""


_FAULTS = (
    "",
    "a node asks for a feature that the card does not name",
    "a leaf gives a class that the card does not name",
    "a node's children do not come after it in its tree",
    f"a tree has more than {DEEPEST} nodes one after the other",
)


@kernel
def _first_fault(feature, child, offsets, n_features, n_classes):  # type: ignore[no-untyped-def]
    """Index into `_FAULTS`."""
    for t in range(len(offsets) - 1):
        first, size = offsets[t], offsets[t + 1] - offsets[t]
        depth = np.zeros(size, np.int32)
        for k in range(size):
            f, c = feature[first + k], np.int64(child[first + k])
            if f == LEAF:
                if c >= n_classes:
                    return 2
            elif f >= n_features:
                return 1
            elif c <= k or c + 1 >= size:
                return 3
            elif depth[k] >= DEEPEST:
                return 4
            else:
                depth[c] = max(depth[c], depth[k] + 1)
                depth[c + 1] = max(depth[c + 1], depth[k] + 1)
    return 0
