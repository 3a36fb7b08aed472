"""A tree against the paper's rule in plain Python, and against the laws of its structure."""

import math

import numpy as np
import pytest
from defaults import BASE as DEFAULTS
from modelmaker import grow_tree

from fwclass.hashing import GOLDEN, hash_keys, mix, seed_for
from fwclass.model import LEAF
from fwclass.train.gain import entropy_table
from fwclass.train.params import TrainParams

BASE = TrainParams(**DEFAULTS["train"])
MASK = (1 << 64) - 1


def changed(**values):
    return BASE.model_copy(update=values)


class Draws:
    """Splitmix64 in Python's integers."""

    def __init__(self, seed, tree):
        self.state = seed_for(seed, tree + 1)

    def below(self, n):
        self.state = (self.state + GOLDEN) & MASK
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        return ((z >> 32) * n) >> 32


def entropy(counts):
    whole = sum(counts)
    return -sum(c / whole * math.log2(c / whole) for c in counts if c)


def information_gain(rows, values, y, threshold, n_classes):
    """Fan 2013: H(c) - H(c|x<t) P(x<t) - H(c|x>=t) P(x>=t) over drawn rows; None if one side is empty."""

    def count(some):
        return [sum(1 for r in some if y[r] == c) for c in range(n_classes)]

    left = [r for r in rows if values[r] < threshold]
    right = [r for r in rows if not values[r] < threshold]
    if not left or not right:
        return None
    whole = entropy(count(rows))
    return whole - entropy(count(left)) * len(left) / len(rows) - entropy(count(right)) * len(right) / len(rows)


def paper_tree(X, y, n_classes, tree, params):
    """The tree as the paper words it: lists of drawn rows, thresholds one by one, entropies by their formula.

    Nodes are grown in the kernel's order (the side with fewer different rows first), as draws follow it.
    """
    draws = Draws(params.seed, tree)
    n, m = X.shape
    bag = sorted(draws.below(n) for _ in range(max(1, round(n * params.bagging))))
    order, feature, threshold, child = list(range(m)), [0], [0.0], [0]
    waiting = [(0, bag)]
    while waiting:
        at, rows = waiting.pop()
        counts = [sum(1 for r in rows if y[r] == c) for c in range(n_classes)]
        found = None
        if max(counts) < len(rows) >= params.min_samples_split:
            best = -1.0
            for tried in range(m):
                if tried >= params.per_split(m) and found:
                    break
                swap = tried + draws.below(m - tried)
                order[tried], order[swap] = order[swap], order[tried]
                f = order[tried]
                known = [X[r, f] for r in rows if not np.isnan(X[r, f])]
                if not known or min(known) == max(known):
                    continue
                low, high = float(min(known)), float(max(known))
                for k in range(1, params.steps + 1):
                    t = np.float32(low + k / params.steps * (high - low) if k < params.steps else high)
                    gain = information_gain(rows, X[:, f], y, t, n_classes)
                    if gain is not None and gain > best + 1e-9:
                        best, found = gain, (f, t)
        if not found:
            feature[at], child[at] = LEAF, counts.index(max(counts))
            continue
        f, t = found
        feature[at], threshold[at], child[at] = f, t, len(feature)
        sides = [[r for r in rows if X[r, f] < t], [r for r in rows if not X[r, f] < t]]
        halves = [(len(feature), sides[0]), (len(feature) + 1, sides[1])]
        if len(set(sides[0])) <= len(set(sides[1])):
            halves.reverse()
        waiting += halves
        feature += [0, 0]
        threshold += [0.0, 0.0]
        child += [0, 0]
    return np.array(feature, np.uint16), np.array(threshold, np.float32), np.array(child, np.uint32)


def problem(n, m, n_classes, seed, gaps=0.0, whole=()):
    r = np.random.default_rng(seed)
    y = r.integers(0, n_classes, n).astype(np.uint8)
    X = (r.normal(size=(n, m)) + y[:, None] * r.normal(size=m)).astype(np.float32)
    for k in whole:
        X[:, k] = np.rint(X[:, k])
    X[r.random(X.shape) < gaps] = np.nan
    return X, y


@pytest.mark.parametrize(
    ("n", "m", "n_classes", "gaps", "whole", "params"),
    [
        (60, 3, 3, 0.0, (), {}),
        (90, 6, 3, 0.0, (1, 4), {}),
        (80, 4, 2, 0.25, (0,), {"features_per_split": 1}),
        (70, 5, 4, 0.1, (), {"features_per_split": 5, "steps": 7}),
        (100, 6, 5, 0.0, (2,), {"min_samples_split": 12, "bagging": 0.6}),
    ],
)
def test_the_kernel_grows_the_papers_tree(n, m, n_classes, gaps, whole, params):
    X, y = problem(n, m, n_classes, seed=n, gaps=gaps, whole=whole)
    for tree in range(4):
        made = grow_tree(X, y, n_classes, tree, changed(**params))
        expected = paper_tree(X, y, n_classes, tree, changed(**params))
        for ours, theirs in zip(made, expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        assert len(made[0]) > 5


def test_splitmix_gives_its_published_first_number():
    assert int(mix(np.array([GOLDEN], np.uint64))[0]) == 0xE220A8397B1DCDAF


def test_hashes_are_one_to_one_and_even():
    keys = np.arange(200_000, dtype=np.uint64) << np.uint64(8)
    h = hash_keys(7, keys)
    assert len(np.unique(h)) == len(h)
    counts = np.bincount((h >> np.uint64(58)).astype(int), minlength=64)
    chi2 = ((counts - len(h) / 64) ** 2 / (len(h) / 64)).sum()
    assert chi2 < 63 + 5 * math.sqrt(2 * 63)  # five standard deviations of chi-square with 63 degrees of freedom
    assert (hash_keys(8, keys) != h).all()


def test_the_entropy_table_holds_k_log_k():
    table = entropy_table(1000)
    assert table[0] == table[1] == 0
    assert table[8] == 24 << 20
    assert abs(table[1000] / 2**20 - 1000 * math.log2(1000)) < 2**-20


def leaves(tree, X):
    feature, threshold, child = tree
    out = []
    for row in X:
        k = 0
        while feature[k] != LEAF:
            k = child[k] + (0 if row[feature[k]] < threshold[k] else 1)
        out.append(k)
    return np.array(out)


def test_a_tree_grows_until_pure():
    X, y = problem(400, 4, 3, seed=3)
    tree = grow_tree(X, y, 3, 0, BASE)
    drawn = sorted({Draws(BASE.seed, 0).below(400)})
    assert drawn
    d = Draws(BASE.seed, 0)
    bag = np.unique([d.below(400) for _ in range(400)])
    assert 0.55 < len(bag) / 400 < 0.72  # 1 - 1/e of the rows
    np.testing.assert_array_equal(tree[2][leaves(tree, X[bag])], y[bag])


def test_trees_differ_by_number_and_seed_and_repeat_otherwise():
    X, y = problem(300, 4, 3, seed=4)
    first = grow_tree(X, y, 3, 0, BASE)
    again = grow_tree(np.asfortranarray(X), y, 3, 0, BASE)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    for other in (grow_tree(X, y, 3, 1, BASE), grow_tree(X, y, 3, 0, changed(seed=BASE.seed + 1))):
        assert not np.array_equal(first[1], other[1])


def test_one_class_is_one_leaf():
    X, _ = problem(20, 3, 2, seed=5)
    feature, _, child = grow_tree(X, np.ones(20, np.uint8), 2, 0, BASE)
    assert feature.tolist() == [LEAF]
    assert child.tolist() == [1]


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_rows_that_cannot_be_told_apart_end_in_a_leaf(value):
    X = np.full((50, 3), value, np.float32)
    y = np.array([0, 1] * 25, np.uint8)
    feature, _, _ = grow_tree(X, y, 2, 0, BASE)
    assert feature.tolist() == [LEAF]


def test_one_row():
    feature, _, child = grow_tree(np.ones((1, 2), np.float32), np.array([2], np.uint8), 3, 0, BASE)
    assert feature.tolist() == [LEAF]
    assert child.tolist() == [2]


def test_a_constant_feature_does_not_stop_a_node():
    X = np.zeros((200, 5), np.float32)
    X[:, 3] = np.arange(200)
    y = (X[:, 3] >= 100).astype(np.uint8)
    for tree in range(5):
        made = grow_tree(X, y, 2, tree, changed(features_per_split=1))
        assert made[0][0] == 3
        np.testing.assert_array_equal(made[2][leaves(made, X)][[0, -1]], [0, 1])


def test_neighbouring_floats_and_the_whole_range_of_float32_are_divided():
    a = np.float32(1000.0)
    b = np.nextafter(a, np.float32(2000.0))
    big = np.finfo(np.float32).max
    for low, high in ((a, b), (-big, big), (np.float32(0.0), np.float32(1e-45))):
        X = np.array([[low], [high]] * 30, np.float32)
        y = np.array([0, 1] * 30, np.uint8)
        tree = grow_tree(X, y, 2, 0, BASE)
        np.testing.assert_array_equal(tree[2][leaves(tree, X)], y)


def test_missing_values_go_right():
    X = np.array([[0.0], [np.nan], [10.0]] * 40, np.float32)
    y = np.array([0, 1, 1] * 40, np.uint8)
    tree = grow_tree(X, y, 2, 0, BASE)
    np.testing.assert_array_equal(tree[2][leaves(tree, X)], y)


def test_unusable_samples_are_refused():
    X, y = problem(10, 2, 2, seed=1)
    with pytest.raises(ValueError, match="cannot be trained"):
        grow_tree(X[:0], y[:0], 2, 0, BASE)
    X[0, 0] = np.inf
    with pytest.raises(ValueError, match="infinite"):
        grow_tree(X, y, 2, 0, BASE)


@pytest.mark.parametrize(("features", "expected"), [(1, 1), (2, 2), (6, 3), (7, 3), (8, 4), (127, 7)])
def test_the_papers_number_of_features_per_split(features, expected):
    assert BASE.per_split(features) == expected
    assert changed(features_per_split=2).per_split(features) == min(2, features)
