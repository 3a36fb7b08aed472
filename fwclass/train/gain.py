"""What a split is worth, in whole numbers: sums are exact, so equal gains really tie, whatever the order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import inlined

FIXED = float(1 << 20)
"""Parts of one bit, or of one row, that a gain is counted in."""

TABLE = 1 << 22
"""Longest table [entries]; of larger weights the logarithm is taken anew."""


def entropy_table(n: int) -> NDArray[np.int64]:
    """int64 (n + 1,), at most `TABLE` of them: k lb k for k = 0 .. n as whole multiples of 2^-20."""
    k = np.arange(min(n, TABLE) + 1, dtype=np.float64)
    return np.rint(k * np.log2(np.maximum(k, 1.0)) * FIXED).astype(np.int64)


GINI = np.empty(0, np.int64)
"""In place of the table: impurity by Gini."""


@inlined
def term(table, k):  # type: ignore[no-untyped-def]
    """int64: what weight k (int64, a count of rows) of one class adds to a child's sum: k lb k in 2^-20, or k² for
    Gini. `table` int64 (n,) has the first terms; it is empty for Gini."""
    if k < len(table):
        return table[k]
    if len(table) == 0:
        return k * k
    return np.int64(np.rint(k * np.log2(np.float64(k)) * FIXED))


@inlined
def score(table, left, right, n_left, n_right):  # type: ignore[no-untyped-def]
    """int64: worth of a division into children of weights `n_left` and `n_right`, whose classes' terms sum to `left`,
    `right`.

    Entropy: -n H(c|t). Gini: the sum of n p² over classes and children, rounded to 2^-20 so that equals tie.
    Both are multiples [2^-20], short of what all divisions of a node have in common; weights are counts of rows.
    """
    if len(table) == 0:
        return np.int64(np.rint((left / n_left + right / n_right) * FIXED))
    return left + right - term(table, n_left) - term(table, n_right)
