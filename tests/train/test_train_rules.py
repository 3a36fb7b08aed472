"""Split rules, criteria, bags and weights: against plain Python, against each other, and by their laws."""

import numpy as np
import pytest
from defaults import BASE as DEFAULTS
from modelmaker import grow_tree
from pydantic import ValidationError

from fwclass.errors import ConfigError
from fwclass.model import LEAF, ClassDef
from fwclass.train import ranked
from fwclass.train.bag import bag
from fwclass.train.gain import GINI, entropy_table
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import grow_trees
from fwclass.train.weights import whole_weights

BASE = DEFAULTS["train"]
RULES = ("equal-width", "exact", "histogram")


def params(**values):
    return TrainParams(**{**BASE, **values})


def problem(n, m, n_classes, seed, gaps=0.0):
    r = np.random.default_rng(seed)
    y = r.integers(0, n_classes, n).astype(np.uint8)
    X = (r.normal(size=(n, m)) + y[:, None] * r.normal(size=m)).astype(np.float32)
    X[:, 0] = np.rint(X[:, 0])
    X[r.random(X.shape) < gaps] = np.nan
    return X, y


def impurity(counts, criterion):
    share = np.asarray(counts, float) / np.sum(counts)
    if criterion == "gini":
        return 1 - (share**2).sum()
    return -(share[share > 0] * np.log2(share[share > 0])).sum()


def worth(X, y, w, rows, f, t, n_classes, criterion):
    """Weight times the drop of impurity, by the definition; None if a side is empty."""
    left = X[rows, f] < t
    if left.all() or not left.any():
        return None
    whole = np.bincount(y[rows], w[rows], n_classes)
    sides = [np.bincount(y[rows][s], w[rows][s], n_classes) for s in (left, ~left)]
    return whole.sum() * impurity(whole, criterion) - sum(s.sum() * impurity(s, criterion) for s in sides)


def thresholds(values, edges):
    """Every threshold that an exact (edges None) or histogram node may use."""
    known = np.unique(values[~np.isnan(values)])
    if edges is None:
        middle = ((known[:-1].astype(float) + known[1:]) / 2).astype(np.float32)
        made = np.where(middle > known[:-1], middle, known[1:])
    else:
        made = edges
    return np.append(made, np.float32(np.inf))


@pytest.mark.parametrize("weights", ["none", {"0": 5.0, "2": 0.5}])
@pytest.mark.parametrize("criterion", ["entropy", "gini"])
@pytest.mark.parametrize("rule", ["exact", "histogram"])
def test_every_node_takes_the_best_threshold_there_is(rule, criterion, weights):
    """All features at every node: what the tree chose is worth as much as the best by the plain definition."""
    X, y = problem(120, 3, 3, seed=2, gaps=0.1)
    p = params(split=rule, criterion=criterion, features_per_split="all", bins=7, class_weights=weights)
    feature, limit, child = grow_tree(X, y, 3, 0, p)
    counts = bag(120, 0, p.drawing)[0]
    class_weight = whole_weights(p.class_weights, np.bincount(y), ["0", "1", "2"])
    w = (counts * class_weight[y]).astype(float)
    columns = np.ascontiguousarray(X.T)
    ranks = ranked.rank(columns, 7 if rule == "histogram" else None)[1]
    at, checked = [(0, np.flatnonzero(counts))], 0
    while at:
        k, rows = at.pop()
        if feature[k] == LEAF:
            assert child[k] == np.bincount(y[rows], w[rows], 3).argmax()
            continue
        taken = worth(X, y, w, rows, feature[k], limit[k], 3, criterion)
        best = -1.0
        for f in range(3):
            edges = ranks.edge[ranks.offsets[f] : ranks.offsets[f + 1]] if rule == "histogram" else None
            for t in thresholds(X[rows, f], edges):
                found = worth(X, y, w, rows, f, t, 3, criterion)
                best = best if found is None else max(best, found)
        assert taken == pytest.approx(best, abs=1e-3)  # the table rounds 2 (classes + 1) terms to 2^-21 each
        left = X[rows, feature[k]] < limit[k]
        at += [(child[k], rows[left]), (child[k] + 1, rows[~left])]
        checked += 1
    assert checked > 10


@pytest.mark.parametrize("rule", ["exact", "histogram"])
def test_counting_and_sorting_find_the_same_trees(rule, monkeypatch):
    from fwclass.train import stage

    X, y = problem(3000, 5, 4, seed=3, gaps=0.05)
    X = np.rint(8 * X) / 8  # few enough values to be counted
    made = []
    for limit in (0, 1024):
        monkeypatch.setattr(stage, "COUNTED", limit)
        made.append([grow_tree(X, y, 4, t, params(split=rule)) for t in range(3)])
    for a, b in zip(*made, strict=True):
        assert all(np.array_equal(p, q) for p, q in zip(a, b, strict=True))


def test_codes_order_values_and_thresholds_part_them():
    r = np.random.default_rng(4)
    column = np.r_[r.normal(size=4000), np.repeat(7.5, 500), np.full(50, np.nan)].astype(np.float32)
    lone = np.full(len(column), np.float32(3))
    for bins in (None, 2, 30, 255):
        codes, ranks = ranked.rank(np.array([column, lone]), bins)
        assert ranks.missing[0] == codes[0].max() == codes[0][-1]
        for code in range(int(ranks.missing[0])):
            if not (codes[0] == code).any() or not (codes[0] == code + 1).any():
                continue
            t = ranked.threshold(ranks, 0, code, code + 1)
            np.testing.assert_array_equal(column < t, codes[0] <= code)
        held = np.bincount(codes[0])[:-1]
        if bins is not None:
            assert codes.dtype == np.uint8
            assert len(held) <= bins
            assert held.max() <= max(500, 2 * 4500 // bins) + 500 // bins  # about even, but for the repeated value
    assert len(np.unique(codes[1])) == 1


@pytest.mark.parametrize("rule", RULES)
def test_a_tree_answers_its_own_rows(rule):
    X, y = problem(2000, 4, 3, seed=5)
    p = params(split=rule, bins=255)
    feature, limit, child = grow_tree(X, y, 3, 1, p)
    inside = np.flatnonzero(bag(2000, 1, p.drawing)[0])
    right = 0
    for i in inside:
        k = 0
        while feature[k] != LEAF:
            k = int(child[k]) + (0 if X[i, feature[k]] < limit[k] else 1)
        right += child[k] == y[i]
    # bins hold about eight rows: what shares a bin in all features cannot be told apart
    assert right == len(inside) if rule != "histogram" else right > 0.99 * len(inside)


@pytest.mark.parametrize("rule", ["exact", "histogram"])
def test_missing_can_be_told_from_known(rule):
    X = np.array([[1.0], [np.nan]] * 50, np.float32)
    y = np.array([0, 1] * 50, np.uint8)
    feature, limit, child = grow_tree(X, y, 2, 0, params(split=rule))
    assert feature.tolist() == [0, LEAF, LEAF]
    assert np.isinf(limit[0])
    assert child[1:].tolist() == [0, 1]


def test_bags():
    with_, _ = bag(1000, 3, params(bagging=0.9).drawing)
    without, _ = bag(1000, 3, params(bagging=0.9, replacement=False).drawing)
    assert with_.sum() == without.sum() == 900
    assert with_.max() > 1
    assert without.max() == 1
    hits = np.mean([bag(50, t, params(bagging=0.3, replacement=False).drawing)[0] for t in range(3000)], axis=0)
    assert np.abs(hits - 0.3).max() < 5 * np.sqrt(0.21 / 3000)  # every row as often as another
    every, _ = bag(20, 0, params(bagging=1.0, replacement=False).drawing)
    assert (every == 1).all()


def test_weights():
    names, counts = ("a", "b", "c"), np.array([100, 300, 10])
    assert whole_weights("none", counts, names).tolist() == [1, 1, 1]
    assert whole_weights({"a": 2.0, "b": 2.0, "c": 2.0}, counts, names).tolist() == [1, 1, 1]
    np.testing.assert_allclose(whole_weights("balanced", counts, names) * counts, 300_000, rtol=1e-3)
    assert whole_weights({"c": 2.5}, counts, names).tolist() == [1000, 1000, 2500]
    with pytest.raises(ConfigError, match="no class is called 'd'"):
        whole_weights({"d": 2.0}, counts, names)
    with pytest.raises(ConfigError, match="too far apart"):
        whole_weights({"a": 1e9, "b": 1.0}, counts, names)


@pytest.mark.parametrize("rule", ["equal-width", "exact"])
@pytest.mark.parametrize("criterion", ["entropy", "gini"])
def test_a_weight_is_as_good_as_copies(rule, criterion):
    """A class that weighs 3 gives the tree of a sample that has each of its rows three times.

    One feature: of equal ones the first drawn is taken, and draws follow the rows.
    """
    X, y = problem(300, 2, 2, seed=6)
    X = X[:, 1:]
    copies = np.repeat(np.arange(300), np.where(y == 1, 3, 1))
    p = params(split=rule, criterion=criterion, bagging=1.0, replacement=False, features_per_split="all")
    q = p.model_copy(update={"class_weights": {"1": 3.0}})
    a = grow_tree(X, y, 2, 0, q)
    b = grow_tree(X[copies], y[copies], 2, 0, p)
    assert len(a[0]) == len(b[0]) > 10
    np.testing.assert_array_equal(np.sort(a[1]), np.sort(b[1]))
    fresh = problem(500, 2, 2, seed=7)[0][:, 1:]
    np.testing.assert_array_equal(answers(a, fresh), answers(b, fresh))


def answers(tree, X):
    feature, limit, child = tree
    out = []
    for row in X:
        k = 0
        while feature[k] != LEAF:
            k = int(child[k]) + (0 if row[feature[k]] < limit[k] else 1)
        out.append(child[k])
    return np.array(out)


@pytest.mark.statistics
def test_balanced_weights_find_a_rare_class():
    r = np.random.default_rng(8)
    y = (r.random(20_000) < 0.005).astype(np.uint8)
    X = r.normal(size=(20_000, 3)).astype(np.float32) + 1.5 * y[:, None]
    found = []
    for weights in ("none", "balanced"):
        p = params(class_weights=weights, min_samples_split=400)
        said = np.mean([answers(grow_tree(X[:10_000], y[:10_000], 2, t, p), X[10_000:]) for t in range(5)], axis=0)
        found.append((said > 0.5)[y[10_000:] == 1].mean())
    assert found[1] > found[0] + 0.3


def test_long_weights_leave_the_table_and_do_not_change_the_rule(monkeypatch):
    from fwclass.train import gain

    X, y = problem(400, 3, 3, seed=9)
    p = params(class_weights={"0": 2.0, "1": 3.0})
    a = grow_tree(X, y, 3, 0, p)
    monkeypatch.setattr(gain, "TABLE", 50)
    b = grow_tree(X, y, 3, 0, p)
    assert all(np.array_equal(s, t) for s, t in zip(a, b, strict=True))
    assert len(entropy_table(10**6)) == 51
    assert len(GINI) == 0


def test_trees_of_a_forest_do_not_depend_on_their_batch():
    X, y = problem(500, 4, 3, seed=10, gaps=0.02)
    key = np.arange(500, dtype=np.uint64)
    sample = Sample(tuple("abcd"), X, y, key, key, np.bincount(y))
    classes = tuple(ClassDef(n, c, (c,)) for n, c in zip("xyz", (2, 5, 6), strict=True))
    for rule in RULES:
        p = params(split=rule, class_weights={"x": 2.0})
        whole = grow_trees(sample, classes, 0, 4, p)
        parts = grow_trees(sample, classes, 0, 1, p) + grow_trees(sample, classes, 1, 3, p)
        for a, b in zip(whole, parts, strict=True):
            assert all(np.array_equal(s, t) for s, t in zip(a, b, strict=True))


@pytest.mark.parametrize(("asked", "features", "expected"), [("sqrt", 127, 11), ("all", 9, 9), (3, 2, 2), (5, 9, 5)])
def test_features_per_split(asked, features, expected):
    assert params(features_per_split=asked).per_split(features) == expected


@pytest.mark.parametrize(
    "bad",
    [
        {"split": "best"},
        {"features_per_split": 0},
        {"bins": 256},
        {"class_weights": {"a": 0.0}},
        {"importance_repeats": 1, "bagging": 1.0, "replacement": False},
    ],
)
def test_impossible_parameters_are_refused(bad):
    with pytest.raises(ValidationError):
        params(**bad)
