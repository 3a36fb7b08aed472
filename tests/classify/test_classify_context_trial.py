"""Whether a second layer pays: by squares that neither layer has learned from."""

import json

import numpy as np
import pytest

from fwclass.graph.context_trial import MOST_SQUARES, Answers, LayerTrial, verdict, weighing

NAMES = ("ground", "roof", "water")
EVEN = np.array([1000, 1000, 1000])


def trial_of(first, both, squares=12, rows=200, seed=1):
    """Rows of three classes in squares, of which the layers have these shares right, by class."""
    r = np.random.default_rng(seed)
    truth = r.integers(0, 3, squares * rows)
    place = np.stack([np.repeat(np.arange(squares), rows), np.zeros(squares * rows, int)], axis=1)
    told = [np.where(r.random(len(truth)) < np.array(right)[truth], truth, (truth + 1) % 3) for right in (first, both)]
    return LayerTrial.of(place, truth, *told, 3)


@pytest.mark.parametrize(
    ("first", "both", "why"),
    [
        ((0.8, 0.8, 0.8), (0.9, 0.9, 0.9), ""),
        ((0.9, 0.9, 0.9), (0.9, 0.9, 0.9), "neither gains for sure"),
        ((0.9, 0.9, 0.9), (0.8, 0.8, 0.8), "mean IoU does not rise"),
        ((0.97, 0.97, 0.3), (0.97, 0.97, 0.6), ""),
        ((0.6, 0.6, 0.95), (0.9, 0.9, 0.5), "water loses -"),
    ],
)
def test_it_pays_where_one_figure_gains_for_sure_and_none_falls(first, both, why):
    judged = verdict(trial_of(first, both), EVEN, NAMES)
    assert judged.pays == (not why) and why in "; ".join(judged.why)
    assert "12 squares of the training areas" in judged.sentence and judged.facts["rows"] == 2400
    gain = judged.facts["gain"]["overall_accuracy"]["difference"]
    assert f"overall accuracy by {100 * gain:+.2f} (" in judged.sentence
    assert f"{100 * judged.facts['reached']['overall_accuracy']:.1f}" not in judged.sentence, "no survey's accuracy"


def test_rows_of_one_class_have_no_kappa():
    place = np.stack([np.repeat(np.arange(12), 50), np.zeros(600, int)], axis=1)
    none = np.zeros(600, int)
    judged = verdict(LayerTrial.of(place, none, none, none, 3), EVEN, NAMES)
    assert not judged.pays and judged.facts["reached"]["kappa"] is None
    assert json.loads(json.dumps(judged.facts, allow_nan=False))["reached"]["overall_accuracy"] == 1.0


def test_classes_weigh_as_in_the_survey():
    """Roofs gain as much as ground loses: what there is more of decides."""
    trial = trial_of((0.9, 0.7, 0.9), (0.8, 0.8, 0.9))
    gains = [verdict(trial, np.array(n), NAMES).facts["gain"]["overall_accuracy"] for n in ((1, 9, 1), (9, 1, 1))]
    assert gains[0]["difference"] > 0.04 and gains[1]["difference"] < -0.04


def test_few_squares_tell_nothing():
    judged = verdict(trial_of((0.8, 0.8, 0.8), (0.9, 0.9, 0.9), squares=4), EVEN, NAMES)
    assert not judged.pays and "4 squares" in judged.sentence and "5 squares" in judged.why[0]
    none = verdict(LayerTrial.joined([], 3), EVEN, NAMES)
    assert not none.pays and none.facts["rows"] == 0


def test_the_order_of_folds_changes_nothing_and_squares_are_no_more_than_can_be_drawn():
    parts = [trial_of((0.8, 0.8, 0.8), (0.9, 0.9, 0.9), squares=700, rows=3, seed=s) for s in (1, 2)]
    parts[1] = LayerTrial(parts[1].square + np.array([-900, 5]), parts[1].first, parts[1].both)
    whole, turned = LayerTrial.joined(parts, 3), LayerTrial.joined(parts[::-1], 3)
    assert len(whole.square) == 700 <= MOST_SQUARES and whole.first.sum() == 4200
    assert verdict(whole, EVEN, NAMES) == verdict(turned, EVEN, NAMES)


MANY = np.array([9000, 500, 500])


def fold_of(seed, towards=0.0, rows=3000, squares=10):
    """Shares of three classes, as many rows of each, that tell them badly apart; class 0 gets `towards` more, a number
    or one a row."""
    r = np.random.default_rng(seed)
    truth = r.integers(0, 3, rows).astype(np.uint8)
    shares = r.uniform(0, 1, (rows, 3))
    shares[np.arange(rows), truth] += 0.5
    shares[:, 0] += towards
    return Answers(shares, truth, np.stack([np.arange(rows) * squares // rows, np.full(rows, seed)], axis=1))


def test_shares_of_a_class_that_the_sample_has_too_few_of_weigh_more():
    folds = [fold_of(seed) for seed in range(4)]
    weighed = weighing(folds, MANY, NAMES, 2.0)
    assert weighed.weights[0] > 1.5 and min(weighed.weights) == 1.0
    assert weighed.sentence.startswith("the shares of the classes weigh ground 1.")
    assert "overall accuracy by +" in weighed.sentence and "mean IoU by +" in weighed.sentence
    assert weighed.sentence.endswith(") points (95 % intervals)")
    turned = [Answers(*(a[::-1] for a in fold)) for fold in folds[::-1]]
    assert weighing(turned, MANY, NAMES, 2.0) == weighed, "no order counts"
    least = weighing(folds, MANY, NAMES, 1.2)
    assert max(least.weights) == 1.189


def test_weights_that_gain_only_on_the_squares_that_they_were_chosen_on_are_none():
    """What the folds gain by opposite weights: each is judged by the others' and loses."""
    assert weighing([fold_of(1, 0.3), fold_of(2, -0.3)], EVEN, NAMES, 2.0) is None
    assert weighing([fold_of(1, 0.3), fold_of(2, 0.3)], EVEN, NAMES, 2.0).weights[0] == 1.0


@pytest.mark.parametrize(("folds", "most"), [(1, 2.0), (4, 1.0), (0, 2.0)])
def test_nothing_weighs_where_nothing_can_be_told(folds, most):
    assert weighing([fold_of(seed) for seed in range(folds)], MANY, NAMES, most) is None


def test_classes_that_are_told_apart_weigh_the_same():
    truth = np.tile(np.arange(3, dtype=np.uint8), 100)
    folds = [Answers(np.eye(3)[truth], truth, np.stack([truth, np.full(300, k)], axis=1)) for k in range(3)]
    assert weighing(folds, MANY, NAMES, 2.0) is None


@pytest.mark.parametrize(("squares", "weigh"), [(10, True), (1, False)])
def test_weights_that_gain_in_a_few_squares_are_none(squares, weigh):
    """The same rows, which gain, lie in twenty squares or in two: of so few nothing is known."""
    folds = [fold_of(seed, squares=squares) for seed in range(2)]
    assert (weighing(folds, MANY, NAMES, 2.0) is not None) == weigh


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_weights_whose_gain_chance_would_give_are_none(seed):
    """Every square has its own say for or against class 0, none by rule; what weights gain on the other folds' squares
    (0.1 to 1.5 points of both figures) is chance, and the interval says so."""
    said = np.random.default_rng(100 + seed).normal(0.0, 0.35, (4, 10))
    folds = [fold_of(4 * seed + k, np.repeat(some, 100), rows=1000) for k, some in enumerate(said)]
    assert weighing(folds, EVEN, NAMES, 2.0) is None
