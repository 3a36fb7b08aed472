"""Permutation importance on out-of-bag rows (Breiman 2001, 10; repeated as in Xiong 2018).

A tree judges the rows it did not see; then one feature's values change places among them, and what the tree loses is
the feature's worth to it. Only rows that meet the feature on their way down can change, and they walk again only from
where they met it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.hashing import below, seed_for
from fwclass.kernel import inlined, kernel
from fwclass.model import LEAF, Tree
from fwclass.train.bag import Drawing, bag
from fwclass.train.sample import Sample

_PURPOSE = 0x1357
"""Keeps the permutations' random numbers apart from those that draw bags and features."""


@inlined
def _leaf(X, row, value, swapped, k, feature, threshold, child):  # type: ignore[no-untyped-def]
    """Class of the leaf below node `k` for a row whose feature `swapped` has another `value`."""
    while feature[k] != LEAF:
        f = np.int64(feature[k])
        v = value if f == swapped else X[row, f]
        k = np.int64(child[k]) + (0 if v < threshold[k] else 1)
    return child[k]


@kernel
def _meet(X, outside, feature, threshold, child, met, offsets, rows, nodes):  # type: ignore[no-untyped-def]
    """Which rows meet which feature, and where first: rows[offsets[f]:offsets[f + 1]] are places in `outside`.

    Called twice: with empty `rows` it counts into `offsets`, then it fills in. `met` (features,) is work space.
    """
    n_features = X.shape[1]
    filling = len(rows) > 0
    met[:] = -1
    for i in range(len(outside)):
        row, k = outside[i], np.int64(0)
        while feature[k] != LEAF:
            f = np.int64(feature[k])
            if met[f] != i:
                met[f] = i
                if filling:
                    rows[offsets[f]], nodes[offsets[f]] = i, k
                    offsets[f] += 1
                else:
                    offsets[f + 1] += 1
            k = np.int64(child[k]) + (0 if X[row, f] < threshold[k] else 1)
    if filling:
        for g in range(n_features, 0, -1):  # moved by what was filled in: back to the beginnings
            offsets[g] = offsets[g - 1]
        offsets[0] = 0
    else:
        for g in range(n_features):
            offsets[g + 1] += offsets[g]


@kernel
def _drops(X, y, outside, tree, meeting, seeds, order, swaps, drop):  # type: ignore[no-untyped-def]
    """Fill in `drop` (features, repeats): right answers of one tree that permuting a feature takes away.

    Rows that meet the feature take their values from as many of all rows, drawn without replacement: what a whole
    permutation would have given them. `order` is 0 .. rows - 1, before and after.
    """
    feature, threshold, child = tree
    offsets, rows, nodes = meeting
    state = np.empty(1, np.uint64)
    column = np.empty(len(outside), np.float32)
    for f in range(drop.shape[0]):
        a, b = offsets[f], offsets[f + 1]
        for i in range(len(outside)):
            column[i] = X[outside[i], f]
        right = 0
        for j in range(a, b):
            row = outside[rows[j]]
            right += _leaf(X, row, X[row, f], f, nodes[j], feature, threshold, child) == y[row]
        for repeat in range(drop.shape[1]):
            state[0] = seeds[f, repeat]
            kept = 0
            for j in range(a, b):
                at = j - a
                swap = at + below(state, len(order) - at)
                order[at], order[swap] = order[swap], order[at]
                swaps[at] = swap
                row = outside[rows[j]]
                kept += _leaf(X, row, column[order[at]], f, nodes[j], feature, threshold, child) == y[row]
            for at in range(b - a - 1, -1, -1):
                order[at], order[swaps[at]] = order[swaps[at]], order[at]
            drop[f, repeat] = right - kept


def _of_tree(
    X: NDArray[np.float32], y: NDArray[np.uint8], tree: Tree, outside: NDArray[np.int64], seeds: NDArray[np.uint64]
) -> NDArray[np.int64]:
    met, offsets = np.empty(X.shape[1], np.int64), np.zeros(X.shape[1] + 1, np.int64)
    none = np.empty(0, np.int64)
    _meet(X, outside, *tree, met, offsets, none, none)
    rows, nodes = np.empty(int(offsets[-1]), np.int64), np.empty(int(offsets[-1]), np.int64)
    if len(rows):
        _meet(X, outside, *tree, met, offsets, rows, nodes)
    drop = np.zeros(seeds.shape, np.int64)
    order, swaps = np.arange(len(outside)), np.empty(len(outside), np.int64)
    _drops(X, y, outside, tree, (offsets, rows, nodes), seeds, order, swaps, drop)
    return drop


def drops(
    sample: Sample, trees: Sequence[Tree], first: int, drawing: Drawing, repeats: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Right answers that permuting a feature takes from each of `trees`, number `first` and on.

    Returns
    -------
    int64 (trees, features, repeats), negative where a permutation helped by chance; and int64 (trees,), the rows that
    each judged. The same whatever other trees are asked for with them: parts join in the order of the trees.
    """
    n_features = sample.X.shape[1]
    drop_counts = np.zeros((len(trees), n_features, repeats), np.int64)
    judged = np.zeros(len(trees), np.int64)
    X = np.ascontiguousarray(sample.X, np.float32)
    for t, tree in enumerate(trees):
        outside = np.flatnonzero(bag(sample.rows, first + t, drawing)[0] == 0)
        judged[t] = len(outside)
        start = seed_for(drawing.seed, _PURPOSE, first + t)
        seeds = np.array([[seed_for(start, f, r) for r in range(repeats)] for f in range(n_features)], np.uint64)
        drop_counts[t] = _of_tree(X, sample.y, tree, outside, seeds.reshape(n_features, repeats))
    return drop_counts, judged


def importance(
    sample: Sample, trees: Sequence[Tree], n_classes: int, drawing: Drawing, repeats: int
) -> NDArray[np.float64]:
    """float64 (features, repeats): mean over all trees of the drop of out-of-bag accuracy, as fractions.

    `ConfigError` where no tree has a row that it did not see.
    """
    if sample.rows and int(sample.y.max()) >= n_classes:
        raise ValueError("unknown classes in the sample")
    return mean_drop(*drops(sample, trees, 0, drawing, repeats))


def mean_drop(drop_counts: NDArray[np.int64], judged: NDArray[np.int64]) -> NDArray[np.float64]:
    """float64 (features, repeats) from `drops` of all trees."""
    some = judged > 0
    if not some.any():
        raise ConfigError(
            "importance needs rows that a tree did not see, and every tree saw all",
            where="train.bagging",
            do="draw with replacement, or a share below 1; or train.importance_repeats=0",
        )
    return (drop_counts[some] / judged[some, None, None]).sum(axis=0) / some.sum()


def summary(features: Sequence[str], drop_counts: NDArray[np.int64], judged: NDArray[np.int64]) -> Mapping[str, Any]:
    """What a card says: per feature the mean and the standard deviation (N - 1) [share of right answers] over the
    repeats, and how many; of `drop_counts` and `judged` as `drops` gives them. None for a deviation of one repeat."""
    values = mean_drop(drop_counts, judged)
    repeats = values.shape[1]
    spread = values.std(axis=1, ddof=1) if repeats > 1 else np.full(len(values), np.nan)
    return {
        "repeats": repeats,
        "drop": {
            name: {"mean": float(m), "std": None if np.isnan(s) else float(s)}
            for name, m, s in zip(features, values.mean(axis=1), spread, strict=True)
        },
    }
