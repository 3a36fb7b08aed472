"""Trimming against plain distances and imbalanced-learn, and its rules where rows are equal."""

import numpy as np
import pytest

from fwclass.train.trim import trim_rows


def plain(X, y):
    """By all distances: a row stays if a nearest other row has its class."""
    d = np.sqrt(((X[:, None] - X[None]) ** 2).sum(axis=2))
    np.fill_diagonal(d, np.inf)
    return np.array([(y[d[k] <= d[k].min() * (1 + 1e-12)] == y[k]).any() for k in range(len(y))])


def rows(n, seed, features=4, classes=3):
    r = np.random.default_rng(seed)
    y = r.integers(0, classes, n).astype(np.uint8)
    return r.normal(size=(n, features)) + 0.7 * y[:, None], y


@pytest.mark.parametrize("seed", range(3))
def test_the_rows_of_plain_distances_stay(seed):
    X, y = rows(300, seed)
    kept, whole = trim_rows(X, y, "nearest")
    np.testing.assert_array_equal(kept, plain(X, y))
    assert whole == () and 0 < kept.sum() < 300


def test_ties_and_twins_keep_whoever_has_a_friend_among_the_nearest():
    r = np.random.default_rng(5)
    X, y = r.integers(0, 6, (400, 2)).astype(np.float64), r.integers(0, 3, 400).astype(np.uint8)
    kept, _ = trim_rows(X, y, "nearest")
    np.testing.assert_array_equal(kept, plain(X, y))


@pytest.mark.parametrize("seed", range(3))
def test_the_rows_of_imbalanced_learn_stay(seed):
    under = pytest.importorskip("imblearn.under_sampling")
    X, y = rows(500, 10 + seed)
    peer = under.EditedNearestNeighbours(sampling_strategy="all", n_neighbors=1)
    peer.fit_resample(X, y)
    kept, _ = trim_rows(X, y, "nearest")
    np.testing.assert_array_equal(np.flatnonzero(kept), np.sort(peer.sample_indices_))


def test_repeated_ends_where_nothing_goes_and_order_changes_nothing():
    X, y = rows(400, 3)
    once, often = trim_rows(X, y, "nearest")[0], trim_rows(X, y, "repeated")[0]
    assert often.sum() < once.sum() and (once | ~often).all()
    assert plain(X[often], y[often]).all()
    order = np.random.default_rng(1).permutation(400)
    np.testing.assert_array_equal(trim_rows(X[order], y[order], "repeated")[0], often[order])
    assert trim_rows(X, y, "none")[0].all()


def test_a_class_that_would_go_whole_stays_untrimmed():
    X, y = rows(200, 4, classes=2)
    X, y = np.r_[X, X[:3] + 1e-6], np.r_[y, np.uint8([2, 2, 2])]
    kept, whole = trim_rows(X, y, "nearest")
    assert whole == (2,) and kept[-3:].all()


def test_all_rows_at_one_place_no_rows_and_one_row():
    y = np.array([0, 0, 1, 1, 2], np.uint8)
    kept, whole = trim_rows(np.ones((5, 3)), y, "repeated")
    assert kept.all() and whole == (2,)
    assert trim_rows(np.empty((0, 3)), np.empty(0, np.uint8), "nearest")[0].shape == (0,)
    assert trim_rows(np.ones((1, 3)), np.zeros(1, np.uint8), "nearest")[0].all()
