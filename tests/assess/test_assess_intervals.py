"""Intervals by blocks, against confusion.figures, the normal theory and blocks whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import FLOAT64_UNIT

from fwclass.assess.confusion import figures
from fwclass.assess.intervals import FEW, FIGURES, LEAST, caution, class_gains, difference, intervals, scores


def blocks(r, n, accuracy, rows=1000):
    """Two classes of equal size; `accuracy` (n,) is the share of right rows of every block."""
    right = r.binomial(rows, accuracy, (2, n))
    made = np.zeros((n, 2, 2), int)
    for c in range(2):
        made[:, c, c], made[:, c, 1 - c] = right[c], rows - right[c]
    return made


def test_scores_are_those_of_the_report():
    r = np.random.default_rng(1)
    matrices = r.integers(0, 50, (20, 3, 4))
    matrices[3, 2], matrices[3, :, 2] = 0, 0  # a class that does not occur
    for m, got in zip(matrices, scores(matrices), strict=True):
        told = figures(m[:, :3], "abc", m[:, 3])
        assert got == pytest.approx([told[name] for name in FIGURES], abs=FLOAT64_UNIT)


def test_a_figure_that_is_nothing_over_nothing_is_nan():
    assert np.isnan(scores(np.zeros((1, 2, 2)))).all()
    assert np.isnan(scores([[[5, 0], [0, 0]]])[0, 1])  # kappa where all is expected by chance


def test_width_is_that_of_independent_blocks():
    """The mean of n block accuracies has the standard error sd / sqrt(n), whatever the rows of a block."""
    r = np.random.default_rng(2)
    n = 60
    made = blocks(r, n, np.clip(r.normal(0.9, 0.05, n), 0, 1), rows=5000)
    low, high = intervals(made)["overall_accuracy"]
    each = np.trace(made, axis1=1, axis2=2) / made.sum(axis=(1, 2))
    assert (high - low) / 2 == pytest.approx(1.96 * each.std() / np.sqrt(n), rel=0.06)  # 2000 draws: 2 % each end
    assert low < each.mean() < high


@pytest.mark.statistics
def test_covers_the_truth_as_often_as_it_says():
    """95 of 100 surveys of 40 blocks: the percentile interval of 40 falls short by a point or two."""
    r = np.random.default_rng(3)
    truth, hit = 0.9, 0
    for _ in range(80):
        low, high = intervals(blocks(r, 40, np.clip(r.normal(truth, 0.04, 40), 0, 1)))["overall_accuracy"]
        hit += low <= truth <= high
    assert hit >= 70  # of 80; 76 expected, a standard deviation is 2


def test_equal_blocks_leave_no_doubt():
    made = intervals(np.tile([[[8, 2], [1, 9]]], (10, 1, 1)))
    assert made["overall_accuracy"] == pytest.approx([0.85, 0.85])
    assert made["blocks"] == 10


def test_order_and_empty_blocks_do_not_matter():
    r = np.random.default_rng(4)
    made = blocks(r, 12, np.full(12, 0.8))
    other = np.concatenate([np.zeros((3, 2, 2), int), made[r.permutation(12)]])
    assert intervals(made) == intervals(other)


def test_too_few_blocks_tell_nothing():
    made = blocks(np.random.default_rng(5), LEAST, np.full(LEAST, 0.8))
    assert intervals(made) is not None
    assert intervals(made[1:]) is None
    assert difference(made[1:], made[1:]) is None


def test_what_is_hard_in_both_maps_cancels():
    """Blocks differ much in difficulty, the second map is better by one point everywhere: only the pair shows it."""
    r = np.random.default_rng(6)
    n, rows = 30, 1000
    right = np.round(rows * r.uniform(0.6, 0.95, n)).astype(int)

    def of(hits):
        return np.stack([np.stack([hits, rows - hits], 1), np.stack([rows - hits, hits], 1)], 1)

    first, second = of(right), of(right + rows // 100)
    made = difference(first, second)["overall_accuracy"]
    assert made["difference"] == pytest.approx(0.01)
    assert made["interval"] == pytest.approx([0.01, 0.01])
    a, b = (intervals(m)["overall_accuracy"] for m in (first, second))
    assert a[1] > b[0]  # alone they overlap
    assert difference(second, first)["overall_accuracy"]["difference"] == pytest.approx(-0.01)


def test_no_difference_holds_zero():
    r = np.random.default_rng(7)
    accuracy = r.uniform(0.7, 0.9, 25)
    made = difference(blocks(r, 25, accuracy), blocks(r, 25, accuracy))
    for name in FIGURES:
        low, high = made[name]["interval"]
        assert low < 0 < high


def test_other_reference_is_refused():
    made = blocks(np.random.default_rng(8), 10, np.full(10, 0.8))
    with pytest.raises(ValueError, match="same reference"):
        difference(made, made[::-1] * 2)
    with pytest.raises(ValueError, match="no confusion matrices"):
        intervals(made[0])


def test_few_blocks_are_told_with_a_caution():
    r = np.random.default_rng(9)
    few, enough = (blocks(r, n, np.full(n, 0.8)) for n in (FEW - 1, FEW))
    assert "too few blocks to lean on" in difference(few, few)["caution"]
    assert str(FEW - 1) in caution(FEW - 1)
    assert difference(enough, enough)["caution"] is None


def test_gains_of_every_class_are_differences_of_its_iou():
    r = np.random.default_rng(8)
    reference = r.integers(1, 60, (30, 3, 1))
    reference[:, 2] = 0  # does not occur
    first, second = (np.stack([r.multinomial(k, [0.6, 0.3, 0.1]) for k in reference.ravel()]) for _ in range(2))
    first, second = first.reshape(30, 3, 3), second.reshape(30, 3, 3)
    gains = class_gains(first, second)
    ious = [figures(m.sum(axis=0), list("abc"))["iou"] for m in (first, second)]
    assert gains[2] is None
    for k in range(2):
        assert gains[k]["value"] == pytest.approx(ious[1][k] - ious[0][k])
        assert gains[k]["low"] < gains[k]["value"] < gains[k]["high"]
    same = class_gains(first, first)
    assert [same[k] for k in range(2)] == [{"value": 0.0, "low": 0.0, "high": 0.0}] * 2
    assert class_gains(first[: LEAST - 1], second[: LEAST - 1])[0]["low"] is None
