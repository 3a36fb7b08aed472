"""The kernel machine in single precision: scikit-learn's classes, a bound that holds, rows that know of no other."""

from dataclasses import replace

import numpy as np
import pytest
from modelmaker import card as any_card

from fwclass.classify.machines import double_decisions, pair_decisions, votes_and_shares
from fwclass.classify.shares import answer
from fwclass.classify.support_blocks import LENGTH, ROUNDINGS, _kernels, _weighted, support_blocks
from fwclass.model import KernelMachine

UNIT = 2.0**-24


def card(n, features):
    plain = {"fill": [0.0] * features, "shift": [0.0] * features, "scale": [1.0] * features}
    return any_card(n, features=[f"f{k}" for k in range(features)], preparation=plain)


def machine(n, features, rows, seed, heavy=10.0, gamma=0.5):
    """Any machine: vectors of `n` classes, weights up to `heavy`."""
    r = np.random.default_rng(seed)
    counts = np.bincount(np.sort(r.integers(0, n, rows)), minlength=n).astype(np.int64)
    vectors, dual = r.normal(size=(rows, features)) * 2, r.uniform(-heavy, heavy, (n - 1, rows))
    bias = r.normal(size=n * (n - 1) // 2)
    return KernelMachine(vectors, dual, bias, counts, np.array([gamma]), card(n, features))


def problem(n, features, rows, seed):
    r, centre = np.random.default_rng(seed), np.random.default_rng(0).normal(size=(n, features)) * 1.5
    y = r.integers(0, n, rows)
    return (r.normal(size=(rows, features)) + centre[y]).astype(np.float32), y.astype(np.uint8)


@pytest.mark.parametrize(
    "n, features, c, gamma",
    [(2, 4, 100.0, 0.5), (3, 1, 1.0, 2.0), (4, 6, 10.0, 0.25), (4, 4, 1000.0, 1.0), (4, 3, 10.0, 30.0)],
)
def test_classes_are_those_of_scikit_learn(n, features, c, gamma):
    svm = pytest.importorskip("sklearn.svm")
    from fwclass.train.baselines.fit import rbf_svm

    X, y = problem(n, features, 900, 1)
    fresh = np.concatenate([problem(n, features, 4000, 2)[0], 3 * problem(n, features, 300, 3)[0]])
    fresh[-3:] = [[1e4] * features, [-3e38] * features, [np.inf] * features]
    model = KernelMachine(**rbf_svm(X.astype(np.float64), y, c, gamma, None), card=card(n, features))
    peer = svm.SVC(C=c, gamma=gamma).fit(X.astype(np.float64), y)
    expected = peer.predict(np.minimum(fresh.astype(np.float64), 1e150))
    np.testing.assert_array_equal(answer(fresh, model)[0], expected)


@pytest.mark.parametrize("n, features, rows", [(2, 1, 5), (2, 4, 700), (3, 2, 129), (5, 7, 2000)])
def test_no_decision_is_wrong_by_more_than_its_bound(n, features, rows):
    model = machine(n, features, rows, seed=rows)
    X = np.random.default_rng(1).normal(size=(3000, features)) * 4
    exact = double_decisions(X, model)
    decisions, bound = support_blocks(model)(X, model.bias)
    assert (np.abs(decisions - exact) <= bound).all()
    final = pair_decisions(X.astype(np.float32), model)
    np.testing.assert_array_equal(final > 0, double_decisions(X.astype(np.float32).astype(np.float64), model) > 0)


def test_kernels_and_sums_round_as_often_as_the_bound_says():
    t = np.concatenate([np.linspace(0, 4, 4 * LENGTH), np.linspace(0, 118, 60 * LENGTH)]).astype(np.float32)
    worst = 0.0
    for part in np.sqrt(t).reshape(-1, LENGTH):
        near = np.empty(LENGTH, np.float32)
        _kernels(np.zeros(1, np.float32), np.ascontiguousarray(part[None]), near)
        squared = (part * part).astype(np.float64)  # as the kernel rounds it
        worst = max(worst, (np.abs(near / np.exp2(-squared) - 1)).max())
    assert worst <= 6 * UNIT
    r = np.random.default_rng(2)
    for _ in range(200):
        weights, near = r.normal(size=LENGTH).astype(np.float32), r.random(LENGTH).astype(np.float32)
        terms = weights.astype(np.float64) * near
        assert abs(_weighted(weights, near) - terms.sum()) <= (ROUNDINGS - 7) * UNIT * np.abs(terms).sum()


def test_a_row_knows_of_no_other():
    model = machine(4, 5, 1500, seed=3)
    X = np.random.default_rng(4).normal(size=(1000, 5)).astype(np.float32) * 3
    X[::50] = np.nan
    whole = pair_decisions(X, model)
    for rows in (np.random.default_rng(5).permutation(1000), np.arange(7, 400, 3), np.array([999])):
        np.testing.assert_array_equal(pair_decisions(X[rows], model), whole[rows])


def test_a_decision_at_nought_is_answered_in_double_precision():
    model = machine(3, 4, 600, seed=6)
    X = np.random.default_rng(7).normal(size=(500, 4)).astype(np.float32)
    there = double_decisions(X.astype(np.float64), model)
    on_edge = replace(model, bias=model.bias - there[0])  # row 0 lies on every edge
    exact = double_decisions(X.astype(np.float64), on_edge)
    decisions = pair_decisions(X, on_edge)
    np.testing.assert_array_equal(decisions[0], exact[0])
    np.testing.assert_array_equal(decisions > 0, exact > 0)


@pytest.mark.parametrize("change", ["far", "heavy"])
def test_what_single_precision_cannot_hold_is_computed_in_double(change):
    model = machine(2, 2, 40, seed=8)
    if change == "far":
        model = replace(model, vectors=model.vectors * 1e200)
    else:
        model = replace(model, dual=model.dual * 1e60)
    assert support_blocks(model) is None
    X = np.random.default_rng(9).normal(size=(20, 2)).astype(np.float32)
    np.testing.assert_array_equal(pair_decisions(X, model), double_decisions(X.astype(np.float64), model))


def test_a_class_without_vectors_and_no_rows():
    model = machine(3, 2, 50, seed=10)
    model = replace(model, counts=np.array([50, 0, 0]))
    X = np.random.default_rng(11).normal(size=(200, 2)).astype(np.float32)
    ours, exact = pair_decisions(X, model), double_decisions(X.astype(np.float64), model)
    np.testing.assert_array_equal(votes_and_shares(ours, 3)[0], votes_and_shares(exact, 3)[0])
    assert pair_decisions(X[:0], model).shape == (0, 3)
    none = replace(model, vectors=np.empty((0, 2)), dual=np.empty((2, 0)), counts=np.zeros(3, np.int64))
    np.testing.assert_array_equal(pair_decisions(X, none), np.tile(model.bias, (200, 1)))
