"""Figures against Fan 2013's published matrices, scikit-learn, He 2023's formulas, and the laws of counting."""

import json

import numpy as np
import pytest

from fwclass import conf
from fwclass.assess.confusion import confusion, count_unclassified, describe, figures
from fwclass.assess.params import AssessParams
from fwclass.assess.stage import judge
from fwclass.errors import QualityError
from fwclass.model import ClassDef

NAMES = ("ground", "building", "tree")
CLASSES = (ClassDef("ground", 2, (2,)), ClassDef("building", 6, (6,)), ClassDef("tree", 5, (3, 4, 5)))

# Fan 2013, Tables 2 and 3: matrix, overall accuracy, producer's accuracies [%]
PUBLISHED = {
    "m = 3": ([[35616, 538, 2636], [46, 16630, 774], [2026, 370, 18360]], 91.7, (91.8, 95.3, None)),
    "m = 4": ([[35516, 600, 2674], [44, 16698, 708], [2020, 504, 18300]], 91.5, (91.5, 95.6, 87.8)),
    "m = 5": ([[35564, 546, 2680], [40, 16670, 740], [2104, 552, 18168]], 91.3, (91.6, 95.5, 87.2)),
    "m = 6": ([[35204, 698, 2888], [36, 16722, 692], [2008, 636, 18180]], 90.9, (90.7, 95.8, 87.3)),
    "SVM": ([[35002, 744, 3044], [46, 16542, 862], [2048, 662, 18114]], 90.4, (90.2, 94.7, 86.9)),
}
# The paper cuts or rounds its percentages to one place.
PLACE = 0.1


@pytest.mark.parametrize("case", PUBLISHED)
def test_the_published_matrices_give_the_published_figures(case):
    matrix, overall, producers = PUBLISHED[case]
    made = figures(np.array(matrix), NAMES)
    assert 100 * made["overall_accuracy"] == pytest.approx(overall, abs=PLACE)
    for ours, theirs in zip(made["producers_accuracy"], producers, strict=True):
        if theirs is not None:
            assert 100 * ours == pytest.approx(theirs, abs=PLACE)


def test_a_misprint_in_the_published_matrix():
    """The tree row of m = 3 sums to 20 756, in the other four matrices to 20 824.

    With 68 more in its building column (438 for 370) it gives the 88.2 % that the paper prints; as printed, 88.5 %.
    """
    assert {sum(m[2]) for case, (m, _, _) in PUBLISHED.items() if case != "m = 3"} == {20824}
    printed = np.array(PUBLISHED["m = 3"][0])
    assert 100 * figures(printed, NAMES)["producers_accuracy"][2] == pytest.approx(88.46, abs=0.005)
    printed[2, 1] += 68
    assert 100 * figures(printed, NAMES)["producers_accuracy"][2] == pytest.approx(88.2, abs=PLACE)


def labels(n=5000, seed=0):
    r = np.random.default_rng(seed)
    reference = r.choice(np.array([2, 3, 4, 5, 6], np.uint8), n)
    predicted = np.where(np.isin(reference, (3, 4)), 5, reference).astype(np.uint8)
    wrong = r.random(n) < 0.3
    predicted[wrong] = r.choice(np.array([2, 6, 5], np.uint8), wrong.sum())
    return reference, predicted


def test_every_figure_equals_scikit_learns():
    metrics = pytest.importorskip("sklearn.metrics")
    reference, predicted = labels()
    truth = np.where(np.isin(reference, (3, 4)), 5, reference)
    order = [2, 6, 5]
    matrix = confusion(reference, predicted, CLASSES)
    np.testing.assert_array_equal(matrix, metrics.confusion_matrix(truth, predicted, labels=order))
    made = figures(matrix, NAMES)
    tight = {"rel": 1e-12}
    assert made["overall_accuracy"] == pytest.approx(metrics.accuracy_score(truth, predicted), **tight)
    assert made["kappa"] == pytest.approx(metrics.cohen_kappa_score(truth, predicted), **tight)
    for key, score in (
        ("producers_accuracy", metrics.recall_score),
        ("users_accuracy", metrics.precision_score),
        ("iou", metrics.jaccard_score),
    ):
        assert made[key] == pytest.approx(score(truth, predicted, labels=order, average=None), **tight)
    mean = metrics.jaccard_score(truth, predicted, labels=order, average="macro")
    assert made["mean_iou"] == pytest.approx(mean, **tight)


def test_two_classes_give_he_2023s_errors():
    a, b, c, d = 900, 100, 40, 460
    e = a + b + c + d
    made = figures(np.array([[a, b], [c, d]]), ("ground", "other"))
    assert made["type_i"] == b / (a + b)
    assert made["type_ii"] == c / (c + d)
    assert made["total_error"] == (b + c) / e
    agreed, chance = (a + d) / e, ((a + b) * (a + c) + (c + d) * (b + d)) / e**2
    assert made["kappa"] == pytest.approx((agreed - chance) / (1 - chance), rel=1e-12)
    assert "type_i" not in figures(np.eye(3, dtype=np.int64), NAMES)


def test_matrices_of_tiles_add_up():
    reference, predicted = labels()
    tile = np.random.default_rng(1).integers(0, 9, len(reference))
    parts = [confusion(reference[tile == t], predicted[tile == t], CLASSES) for t in range(10)]
    np.testing.assert_array_equal(sum(parts), confusion(reference, predicted, CLASSES))
    assert parts[9].sum() == 0


def test_rows_without_reference_are_left_out():
    matrix = confusion(np.array([0, 1, 2], np.uint8), np.array([2, 6, 2], np.uint8), CLASSES)
    assert matrix.sum() == matrix[0, 0] == 1


def test_rows_without_a_class_count_as_wrong():
    reference, predicted = np.full(10, 2, np.uint8), np.array([2] * 6 + [5] * 2 + [0] * 2, np.uint8)
    matrix, lost = (f(reference, predicted, CLASSES) for f in (confusion, count_unclassified))
    assert lost.tolist() == [2, 0, 0]
    made = figures(matrix, NAMES, lost)
    assert made["overall_accuracy"] == made["producers_accuracy"][0] == made["iou"][0] == 0.6
    assert made["users_accuracy"][0] == 1
    assert made["unclassified"] == [2, 0, 0]
    assert "none" in describe(made)
    assert "unclassified" not in figures(matrix, NAMES, np.zeros(3, np.int64))


def test_a_perfect_and_a_chance_prediction():
    assert figures(np.diag([5, 6, 7]), NAMES)["kappa"] == 1
    assert figures(np.outer([1, 2, 3], [4, 5, 6]), NAMES)["kappa"] == 0


def test_empty_classes_give_null_and_never_nan():
    for matrix in (np.zeros((3, 3), np.int64), np.diag([4, 0, 0]), np.array([[3, 2, 0], [0, 0, 0], [0, 0, 0]])):
        made = figures(matrix, NAMES)
        json.dumps(made, allow_nan=False)
        assert describe(made)
    assert made["producers_accuracy"] == [0.6, None, None]
    assert made["users_accuracy"] == [1.0, 0.0, None]
    assert made["iou"] == [0.6, 0.0, None]
    assert made["mean_iou"] == 0.6  # the reference has one class
    nothing = figures(np.zeros((2, 2), np.int64), NAMES[:2])
    for key in ("overall_accuracy", "kappa", "mean_iou", "type_i", "type_ii", "total_error"):
        assert nothing[key] is None


def test_counts_of_a_whole_country_do_not_overflow():
    matrix = np.array([[4, 1], [1, 4]], np.int64)
    assert figures(matrix * 10**12, NAMES[:2])["kappa"] == figures(matrix, NAMES[:2])["kappa"]


def test_a_matrix_of_another_size_is_refused():
    with pytest.raises(ValueError, match="does not belong"):
        figures(np.zeros((2, 2), np.int64), NAMES)


def test_the_table_for_a_terminal():
    text = describe(figures(np.array(PUBLISHED["m = 3"][0]), NAMES))
    lines = text.splitlines()
    assert lines[2].split() == ["ground", "35", "616", "538", "2", "636", "91.8"]
    assert "overall accuracy 91.7 %" in lines[-1]
    assert len({len(line) for line in lines[1:5]}) == 1  # columns are aligned
    assert max(map(len, lines)) < 100


def test_a_missed_threshold_is_a_quality_error():
    made = figures(np.array([[8, 2], [2, 8]]), NAMES[:2])
    asked = {"block": 25.0, "quantiles": (0.5,), "min_overall_accuracy": None, "min_kappa": None}
    asked |= {"pure": 0.9, "tested": 0.1, "unscored": 0.01, "objects": conf.section("assess").objects}
    judge(made, AssessParams(**asked))
    judge(made, AssessParams(**asked | {"min_overall_accuracy": 0.8, "min_kappa": 0.59}))
    with pytest.raises(QualityError, match="kappa"):
        judge(made, AssessParams(**asked | {"min_kappa": 0.61}))
    with pytest.raises(QualityError, match="overall accuracy"):
        judge(figures(np.zeros((2, 2), np.int64), NAMES[:2]), AssessParams(**asked | {"min_overall_accuracy": 0.1}))
