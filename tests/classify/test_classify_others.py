"""Answers of boosted trees and machines against plain walks and sums, and laws of the shares."""

import numpy as np
import pytest
from tolerances import FLOAT64_UNIT

from fwclass.classify.boosted import probabilities, raw_scores
from fwclass.classify.machines import double_decisions, votes_and_shares
from fwclass.classify.shares import answer, entropy
from fwclass.errors import InputError
from fwclass.model import FORMAT, LEAF, Boosted, KernelMachine, LinearMachine

NAMES = ("zc", "width", "amplitude")


def card(n):
    ready = {"fill": [0.0, 1.0, 2.0], "shift": [0.5, 0.0, -1.0], "scale": [1.0, 2.0, 4.0]}
    classes = [{"name": f"c{k}", "code": 2 + k, "codes": [2 + k]} for k in range(n)]
    return {"format": FORMAT, "features": list(NAMES), "classes": classes, "preparation": ready}


def boosted(r, n, rounds=4, splits=6):
    parts, scores = [], 1 if n == 2 else n
    for _ in range(rounds * scores):
        feature, threshold, child, side, value = [LEAF], [0.0], [0], [0], [float(r.normal())]
        for _ in range(splits):
            at = int(r.choice(np.flatnonzero(np.array(feature) == LEAF)))
            feature[at], threshold[at], child[at] = int(r.integers(3)), float(r.normal()), len(feature)
            side[at], value[at] = int(r.integers(2)), 0.0
            feature += [LEAF, LEAF]
            threshold += [0, 0]
            child += [0, 0]
            side += [0, 0]
            value += r.normal(size=2).tolist()
        parts.append((feature, threshold, child, side, value))
    kinds = (np.uint16, np.float32, np.uint32, np.uint8, np.float64)
    flat = [np.concatenate([np.array(p[k], kind) for p in parts]) for k, kind in enumerate(kinds)]
    size = 2 * splits + 1
    return Boosted(*flat, np.arange(len(parts) + 1) * size, r.normal(size=scores), card(n))


def rows(r, n):
    X = r.normal(size=(n, 3)).astype(np.float32)
    X[r.random(X.shape) < 0.2] = np.nan
    return X


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_boosted_scores_are_those_of_a_plain_walk(n):
    r = np.random.default_rng(n)
    model, X = boosted(r, n), rows(r, 50)
    expected = np.tile(model.baseline, (50, 1))
    for i, row in enumerate(X):
        for t, first in enumerate(model.offsets[:-1]):
            k = first
            while model.feature[k] != LEAF:
                v = row[model.feature[k]]
                left = model.missing_left[k] if np.isnan(v) else v < model.threshold[k]
                k = first + model.child[k] + (0 if left else 1)
            expected[i, t % len(model.baseline)] += model.value[k]
    np.testing.assert_array_equal(raw_scores(X, model), expected)
    winner, shares = answer(X, model)
    np.testing.assert_array_equal(winner, shares.argmax(axis=1))
    np.testing.assert_allclose(shares.sum(axis=1), 1)


def test_softmax_of_one_score_is_the_logistic_and_large_scores_do_not_overflow():
    scores = np.array([[0.0], [2.0], [-900.0]])
    np.testing.assert_allclose(probabilities(scores, 2)[:, 1], [0.5, 1 / (1 + np.exp(-2.0)), 0.0], atol=1e-15)
    np.testing.assert_allclose(probabilities(np.array([[800.0, 0, -800]]), 3), [[1, 0, 0]])


@pytest.mark.parametrize("n", [2, 3, 4])
def test_pair_decisions_are_the_sums_of_libsvm(n):
    r = np.random.default_rng(n)
    counts = r.integers(1, 5, n)
    total = int(counts.sum())
    model = KernelMachine(
        r.normal(size=(total, 3)),
        r.normal(size=(n - 1, total)),
        r.normal(size=n * (n - 1) // 2),
        counts,
        np.array([0.7]),
        card(n),
    )
    X = rows(r, 20)
    ready = model.preparation(X)
    k = np.exp(-0.7 * ((ready[:, None, :] - model.vectors[None]) ** 2).sum(axis=2))
    ends, expected = np.r_[0, np.cumsum(counts)], []
    for i in range(n):
        for j in range(i + 1, n):
            mine, yours = slice(ends[i], ends[i + 1]), slice(ends[j], ends[j + 1])
            d = k[:, mine] @ model.dual[j - 1, mine] + k[:, yours] @ model.dual[i, yours]
            expected.append(d + model.bias[len(expected)])
    np.testing.assert_allclose(double_decisions(ready, model), np.stack(expected, axis=1), atol=FLOAT64_UNIT)


def test_two_classes_share_by_the_logistic():
    d = np.array([[0.0], [3.0], [-1.0], [5000.0]])
    votes, shares = votes_and_shares(d, 2)
    np.testing.assert_allclose(shares[:, 0], 1 / (1 + np.exp(-np.clip(d[:, 0], -700, 700))))
    np.testing.assert_array_equal(votes.argmax(axis=1), [1, 0, 1, 0])


def test_pairs_that_agree_make_one_class_sure_and_sign_alone_decides_the_vote():
    votes, shares = votes_and_shares(np.array([[40.0, 40.0, 0.1], [1e-9, 1e-9, -50.0]]), 3)
    np.testing.assert_array_equal(votes, [[2, 1, 0], [2, 0, 1]])
    np.testing.assert_allclose(shares[0], [1, 0, 0], atol=FLOAT64_UNIT)
    assert np.isfinite(shares).all()


def test_entropy_is_zero_when_sure_one_when_undecided():
    shares = np.array([[1.0, 0, 0, 0], [0.25] * 4, [0.5, 0.5, 0, 0], [0.7, 0.1, 0.1, 0.1]])
    expected = [0, 1, 0.5, -(0.7 * np.log(0.7) + 0.3 * np.log(0.1)) / np.log(4)]
    np.testing.assert_allclose(entropy(shares), expected, atol=FLOAT64_UNIT)
    np.testing.assert_array_equal(entropy(np.ones((3, 1))), 0)


def test_a_matrix_that_does_not_fit_is_refused():
    model = LinearMachine(np.ones((3, 3)), np.zeros(3), card(3))
    for shape in ((4, 2), (4, 4), (3,)):
        with pytest.raises(InputError, match="do not fit the linear-svm"):
            answer(np.zeros(shape, np.float32), model)


@pytest.mark.parametrize("n", [2, 3])
def test_no_rows(n):
    model = LinearMachine(np.ones((1 if n == 2 else n, 3)), np.zeros(1 if n == 2 else n), card(n))
    winner, shares = answer(np.empty((0, 3), np.float32), model)
    assert winner.shape == (0,) and shares.shape == (0, n)
