"""The searches against worlds whose best set is known, and against scikit-learn."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass import conf
from fwclass.select.score import Score, Trial, as_good, cheapest, front, score
from fwclass.select.search import backward, by_fscore, f_scores, forward, in_given_order
from fwclass.select.work import extra_work, nominal

NAMES = ("zc", "amplitude", "width", "echo_number", "planarity_r100", "planarity_r50")


class World:
    """Sets have an accuracy: what their features bring, and a little less for every useless one."""

    def __init__(self, worth, useless=0.001):
        self.worth, self.useless, self.asked = worth, useless, []

    def __call__(self, subsets, ranked=False):
        self.asked += subsets
        return [self._trial(s, ranked) for s in subsets]

    def _trial(self, subset, ranked):
        right = 0.5 + sum(self.worth.get(n, -self.useless) for n in subset)
        k = round(10_000 * right)
        matrix = np.array([[k, 10_000 - k], [10_000 - k, k]])
        weight = np.array([self.worth.get(n, 0.0) for n in subset]) if ranked else None
        return Trial(subset, np.stack([matrix] * 5), weight)


def _scored(trial):
    return score(trial, np.ones(2), "overall")


@pytest.fixture(scope="module")
def params():
    return conf.section("select")


def test_forward_finds_the_set_and_tells_the_whole_curve(params):
    world = World({"zc": 0.3, "width": 0.1, "echo_number": 0.05})
    found = forward(NAMES, world, _scored, params)
    assert [s.tried[0] for s in found.steps[:3]] == ["zc", "width", "echo_number"]
    assert set(found.best.features) == {"zc", "width", "echo_number"}
    assert found.best.features == ("zc", "width", "echo_number")
    assert len(found.steps) == 6
    np.testing.assert_allclose([s.score.value for s in found.steps[:3]], [0.8, 0.9, 0.95])


def test_forward_ends_when_patience_is_over(params):
    few = params.model_copy(update={"patience": 1})
    assert len(forward(NAMES, World({"zc": 0.3}), _scored, few).steps) == 2


def test_equals_go_to_the_one_with_less_work_then_by_name(params):
    equal = World(dict.fromkeys(NAMES, 0.05))
    order = [s.tried[0] for s in forward(NAMES, equal, _scored, params).steps]
    assert order == ["amplitude", "echo_number", "width", "zc", "planarity_r50", "planarity_r100"]
    backwards = backward(NAMES, equal, _scored, params)
    assert [s.tried for s in backwards.steps][:3] == [(), ("planarity_r100",), ("planarity_r50",)]


def test_a_given_order_drops_what_gains_nothing():
    """As γ in Fan 2013: tried at its place, told, and not in the sets after it."""
    world = World({"zc": 0.3, "width": 0.1})
    found = in_given_order(("zc", "amplitude", "width"), NAMES, world, _scored)
    assert [s.kept for s in found.steps] == [True, False, True]
    assert [s.score.features for s in found.steps] == [("zc",), ("zc", "amplitude"), ("zc", "width")]
    assert found.best.features == ("zc", "width")


def test_backward_drops_the_least_important_first(params):
    worth = {"zc": 0.3, "width": 0.1, "echo_number": 0.05}
    found = backward(NAMES, World(worth), _scored, params)
    assert [len(s.score.features) for s in found.steps] == [6, 5, 4, 3, 2, 1]
    assert set(found.best.features) == set(worth)
    assert [n for n, _ in found.ranks[:3]] == ["zc", "width", "echo_number"]
    half = backward(NAMES, World(worth), _scored, params.model_copy(update={"drop": 0.5, "least": 2}))
    assert [len(s.score.features) for s in half.steps] == [6, 3, 2]


def test_f_scores_are_those_of_the_formula_and_of_no_scale():
    random = np.random.default_rng(3)
    y = random.integers(0, 3, 600).astype(np.uint8)
    X = (random.normal(size=(600, 4)) + np.outer(y, [0.0, 0.5, 2.0, 0.0])).astype(np.float32)
    X[:, 3] = 7.0
    X[::7, 1] = np.nan
    expected = []
    for k in range(3):
        groups = [X[(y == c) & ~np.isnan(X[:, k]), k].astype(np.float64) for c in range(3)]
        m = np.concatenate(groups).mean()
        spread = sum(((g - g.mean()) ** 2).sum() / (len(g) - 1) for g in groups)
        expected.append(sum((g.mean() - m) ** 2 for g in groups) / spread)
    np.testing.assert_allclose(f_scores(X, y), [*expected, 0.0], rtol=1e-9)
    unit = (X - np.nanmin(X, axis=0)) / np.maximum(np.nanmax(X, axis=0) - np.nanmin(X, axis=0), 1e-9)
    np.testing.assert_allclose(f_scores(unit.astype(np.float32), y)[:3], expected, rtol=1e-4)


def test_f_score_ranks_as_the_anova_of_scikit_learn_where_classes_are_equal():
    sklearn = pytest.importorskip("sklearn.feature_selection")
    random = np.random.default_rng(4)
    y = np.repeat(np.arange(3, dtype=np.uint8), 200)
    X = (random.normal(size=(600, 6)) + np.outer(y, np.linspace(0, 1.5, 6))).astype(np.float32)
    theirs = sklearn.f_classif(X, y)[0]
    np.testing.assert_allclose(f_scores(X, y) * 200 * 3 / 2, theirs, rtol=1e-4)  # n_c (C) / (C - 1) times ours


def test_fscore_adds_by_rank():
    random = np.random.default_rng(5)
    y = random.integers(0, 2, 500).astype(np.uint8)
    X = (random.normal(size=(500, 6)) + np.outer(y, [0, 3, 0, 1, 0, 2])).astype(np.float32)
    found = by_fscore(NAMES, X, y, World({"amplitude": 0.3}), _scored)
    assert [n for n, _ in found.ranks[:3]] == ["amplitude", "planarity_r50", "echo_number"]
    assert [len(s.score.features) for s in found.steps] == [1, 2, 3, 4, 5, 6]
    assert found.best.features == ("amplitude",)


def test_a_score_weighs_classes_as_they_occur():
    """Balanced rows of classes that occur 9 : 1 give the accuracy of the 9 : 1 world."""
    matrix = np.array([[90, 10], [40, 60]])
    made = score(Trial(("zc",), np.stack([matrix, matrix])), np.array([9.0, 1.0]), "overall")
    assert made.value == pytest.approx(0.9 * 0.9 + 0.1 * 0.6)
    r, c = np.array([900, 100]), np.array([810 + 40, 90 + 60])
    chance = (r * c).sum() / 1000**2
    assert made.kappa[0] == pytest.approx((0.87 - chance) / (1 - chance))
    assert score(Trial(("zc",), matrix[None]), np.array([9.0, 1.0]), "balanced").value == pytest.approx(0.75)


def _score(*folds, names=("zc",)):
    values = np.array(folds)
    return Score(names, values, values, values)


def test_as_good_compares_fold_by_fold():
    best = _score(0.70, 0.80, 0.90, 0.95)
    assert as_good(best, best)
    assert not as_good(_score(0.69, 0.79, 0.89, 0.94), best)  # worse by as much everywhere: surely worse
    assert as_good(_score(0.66, 0.84, 0.88, 0.96), best)
    assert as_good(_score(0.75, np.nan, 0.95, 0.95), best)


def test_front_and_cheapest():
    assert front([0.8, 0.9, 0.85, 0.9, 0.95], [1.0, 2.0, 3.0, 2.0, 9.0]) == (0, 1, 4)
    assert front([0.8, 0.9, 0.95], [1.0, 1.01, 1.02]) == (2,)  # as far as timings can tell, all at one cost
    scores = [_score(0.90, 0.90), _score(0.95, 0.95), _score(0.93, 0.97)]
    assert cheapest(scores, [1.0, 3.0, 2.0], scores[1]) == 2


def test_work_counts_a_neighbourhood_once():
    assert extra_work("amplitude", ()) == 0.0
    assert extra_work("planarity_r100", ()) > extra_work("planarity_r50", ()) > 0.0
    assert extra_work("height_std_r100", ("planarity_r100",)) == 0.0
    assert nominal(("planarity_r100", "height_std_r100")) == nominal(("planarity_r100",))
