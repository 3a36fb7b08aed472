"""Permutation importance: the definition in plain Python, what it must see, and that parts do not change it."""

import numpy as np
import pytest
from defaults import BASE as DEFAULTS

from fwclass.errors import ConfigError
from fwclass.model import LEAF, ClassDef
from fwclass.train.bag import bag
from fwclass.train.importance import drops, importance, mean_drop, summary
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import grow_trees, out_of_bag

BASE = DEFAULTS["train"]
CLASSES = tuple(ClassDef(n, c, (c,)) for n, c in zip("xyz", (2, 5, 6), strict=True))


def params(**values):
    return TrainParams(**{**BASE, "importance_repeats": 10, **values})


def grown(n, seed, trees=10, **values):
    """Feature 0 says almost all, 1 repeats it with noise, 2 a little, 3 nothing, 4 is constant."""
    r = np.random.default_rng(seed)
    y = r.integers(0, 3, n).astype(np.uint8)
    X = np.stack(
        [y + 0.3 * r.normal(size=n), y + r.normal(size=n), 0.4 * y + r.normal(size=n), r.normal(size=n), np.ones(n)],
        axis=1,
    ).astype(np.float32)
    X[r.random(n) < 0.05, 2] = np.nan
    key = np.arange(n, dtype=np.uint64)
    sample = Sample(tuple("abcde"), X, y, key, key, np.bincount(y))
    p = params(trees=trees, **values)
    return sample, grow_trees(sample, CLASSES, 0, trees, p), p


def answers(tree, X):
    feature, limit, child = tree
    out = np.empty(len(X), np.int64)
    for i, row in enumerate(X):
        k = 0
        while feature[k] != LEAF:
            k = int(child[k]) + (0 if row[feature[k]] < limit[k] else 1)
        out[i] = child[k]
    return out


def test_rows_out_of_bag_are_judged_by_the_trees_that_did_not_see_them():
    sample, trees, p = grown(120, 3, trees=3)
    votes = np.zeros((sample.rows, 3), np.int64)
    for number, tree in enumerate(trees):
        judged = np.flatnonzero(bag(sample.rows, number, p.drawing)[0] == 0)
        votes[judged, answers(tree, sample.X[judged])] += 1
    some = votes.any(axis=1)
    told = out_of_bag(sample, trees, 3, p)
    assert told["rows"] == some.sum() < sample.rows
    assert told["accuracy"] == (votes.argmax(axis=1) == sample.y)[some].mean()


def test_it_is_what_breiman_defines():
    """Mean over permutations, against as many drawn by numpy: the same within their standard error."""
    sample, trees, p = grown(250, 1, trees=1)
    repeats = 400
    ours, judged = drops(sample, trees, 0, p.drawing, repeats)
    outside = np.flatnonzero(bag(sample.rows, 0, p.drawing)[0] == 0)
    X, y = sample.X[outside], sample.y[outside]
    assert judged.tolist() == [len(outside)]
    right = (answers(trees[0], X) == y).sum()
    r = np.random.default_rng(0)
    for f in range(5):
        theirs = []
        for _ in range(60):
            changed = X.copy()
            changed[:, f] = r.permutation(X[:, f])
            theirs.append(right - (answers(trees[0], changed) == y).sum())
        error = np.sqrt(np.var(theirs) / 60 + ours[0, f].var() / repeats)
        assert abs(ours[0, f].mean() - np.mean(theirs)) <= 4 * error  # 4 standard errors
        if np.std(theirs):
            assert ours[0, f].std() == pytest.approx(np.std(theirs), rel=0.4)  # 60 give a spread within 9 %


def test_useful_features_are_told_from_useless_ones():
    sample, trees, p = grown(3000, 2)
    worth = importance(sample, trees, 3, p.drawing, 10).mean(axis=1)
    assert worth[0] > worth[1] > abs(worth[3])
    assert worth[0] > 0.2
    assert abs(worth[3]) < 0.01
    assert worth[4] == 0  # a constant is the same wherever it comes from
    # no feature can take away more than the trees know
    told = out_of_bag(sample, trees, 3, p)["accuracy"]
    assert worth.max() < told


@pytest.mark.slow
@pytest.mark.parametrize("values", [{}, {"bagging": 0.9, "replacement": False, "split": "exact", "criterion": "gini"}])
def test_parts_do_not_change_it(values):
    sample, trees, p = grown(600, 3, trees=6, **values)
    whole = drops(sample, trees, 0, p.drawing, 3)
    parts = [drops(sample, trees[a:b], a, p.drawing, 3) for a, b in ((0, 1), (1, 4), (4, 6))]
    np.testing.assert_array_equal(np.concatenate([d for d, _ in parts]), whole[0])
    np.testing.assert_array_equal(np.concatenate([n for _, n in parts]), whole[1])
    few = drops(sample, trees, 0, p.drawing, 2)[0]
    np.testing.assert_array_equal(few, whole[0][:, :, :2])  # another repeat does not move the first ones
    np.testing.assert_array_equal(importance(sample, trees, 3, p.drawing, 3), mean_drop(*whole))


def test_repeats_differ_and_another_seed_too():
    sample, trees, p = grown(600, 4, trees=2)
    made = drops(sample, trees, 0, p.drawing, 5)[0]
    assert len(np.unique(made[0, 0])) > 1
    other = drops(sample, trees, 0, p.model_copy(update={"seed": 99}).drawing, 5)[0]
    assert (made != other).any()


def test_the_card_says_mean_and_spread():
    sample, trees, p = grown(600, 5, trees=3)
    told = summary(sample.features, *drops(sample, trees, 0, p.drawing, 4))
    worth = importance(sample, trees, 3, p.drawing, 4)
    assert told["repeats"] == 4
    assert list(told["drop"]) == list("abcde")
    assert told["drop"]["b"]["mean"] == pytest.approx(worth[1].mean())
    assert told["drop"]["b"]["std"] == pytest.approx(worth[1].std(ddof=1))
    assert summary(sample.features, *drops(sample, trees, 0, p.drawing, 1))["drop"]["a"]["std"] is None


def test_no_row_out_of_bag_is_refused():
    sample, trees, p = grown(100, 6, trees=1, bagging=1.0, replacement=False, importance_repeats=0)
    with pytest.raises(ConfigError, match="every tree saw all"):
        importance(sample, trees, 3, p.drawing, 2)
