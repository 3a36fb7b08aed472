"""Boosted trees: the sum of what the leaves add, and its softmax."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.model import LEAF, Boosted, scores_of

BLOCK = 4096
"""Rows that visit all trees before the next ones do: they stay in the cache while a tree is read once."""


def raw_scores(X: NDArray[np.float32], model: Boosted) -> NDArray[np.float64]:
    """Scores (rows, scores) of a matrix (rows, features) that fits the checked `model`; see `Boosted`.

    The trees add in the order they were grown. NaN goes to the side that the node's `missing_left` says.
    """
    scores = np.tile(model.baseline, (len(X), 1))
    x = np.ascontiguousarray(X, np.float32)
    _add(x, model.feature, model.threshold, model.child, model.missing_left, model.value, model.offsets, BLOCK, scores)
    return scores


@kernel
def _add(x, feature, threshold, child, missing_left, value, offsets, block, scores):  # type: ignore[no-untyped-def]
    n, outputs = scores.shape
    for low in range(0, n, block):
        high = min(n, low + block)
        for t in range(len(offsets) - 1):
            first, out = offsets[t], t % outputs
            for i in range(low, high):
                k = first
                while feature[k] != LEAF:
                    v = x[i, feature[k]]
                    left = missing_left[k] == 1 if np.isnan(v) else v < threshold[k]
                    k = first + child[k] + (0 if left else 1)
                scores[i, out] += value[k]


def probabilities(scores: NDArray[np.float64], classes: int) -> NDArray[np.float64]:
    """Softmax (rows, classes) of scores; of one score, which is the second of two classes', the logistic."""
    if scores_of(classes) == 1:
        scores = np.concatenate([np.zeros_like(scores), scores], axis=1)
    raised = np.exp(scores - scores.max(axis=1, keepdims=True))
    return raised / raised.sum(axis=1, keepdims=True)
