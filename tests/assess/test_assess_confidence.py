"""How sure echoes are, and how many of them are right, whatever codes the classifier writes and the reference has."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.assess.confusion import confusion
from fwclass.graph.assess import automation, by_confidence, reliability
from fwclass.model import ClassDef
from fwclass.schema import Table

WRITTEN = {
    "as in the reference": (2, 5, 6),
    "others than in the reference": (64, 65, 66),
    "exchanged": (5, 6, 2),
    "one of them another": (2, 5, 64),
}


@pytest.mark.parametrize("codes", WRITTEN.values(), ids=WRITTEN)
def test_the_curve_ends_at_the_overall_accuracy(codes: tuple[int, ...]):
    read = ((2,), (3, 4, 5), (6, 1))
    classes = tuple(
        ClassDef(name=n, code=c, codes=r) for n, c, r in zip(("ground", "plant", "house"), codes, read, strict=True)
    )
    r = np.random.default_rng(4)
    n = 4000
    truth = r.integers(0, 3, n)
    confidence = r.uniform(0.3, 1.0, n).astype(np.float32)
    answer = np.where(r.random(n) < confidence, truth, r.integers(0, 3, n))
    reference = np.array([r.choice(read[k]) for k in truth], np.uint8)
    given = np.array(codes, np.uint8)[answer]
    table = Table({"reference": reference, "classification": given, "confidence": confidence})
    matrix = confusion(reference, given, classes)
    curve = automation(by_confidence(table, classes))
    assert curve[0][1] == 1.0 and curve[0][2] == pytest.approx(np.trace(matrix) / n, abs=1e-12)
    for least, share, right in curve[30::10]:
        sure = np.floor(100 * confidence.astype(float) + 1e-4) >= round(100 * least)
        assert share == pytest.approx(sure.mean()) and right == pytest.approx((truth == answer)[sure].mean())
    assert curve[-10][2] > curve[0][2]


def test_a_confidence_that_is_right_as_often_as_it_says_has_no_error_and_another_its_distance():
    r = np.random.default_rng(7)
    n = 200_000
    classes = (ClassDef(name="ground", code=2, codes=(2,)), ClassDef(name="plant", code=5, codes=(5,)))
    confidence = r.uniform(0.5, 1.0, n).astype(np.float32)
    for short, expected in ((0.0, 0.0), (0.1, 0.1)):
        right = r.random(n) < confidence - short
        reference = r.choice([2, 5], n).astype(np.uint8)
        given = np.where(right, reference, 7 - reference).astype(np.uint8)
        table = Table({"reference": reference, "classification": given, "confidence": confidence})
        parts = [by_confidence(table.take(rows), classes) for rows in np.array_split(r.permutation(n), 7)]
        counts = np.sum(parts, axis=0)
        assert (counts == by_confidence(table, classes)).all(), "whatever the tiles"
        told = reliability(counts)
        assert told["error"] == pytest.approx(expected, abs=0.006)
        assert told["confidence"] == pytest.approx(confidence.mean(dtype=float), abs=1e-6)
        assert told["right"] == right.mean() and sum(s for _, s, _ in told["steps"]) == pytest.approx(1)
        for k, (mean, share, hit) in enumerate(told["steps"]):
            inside = np.minimum(np.floor(10 * confidence.astype(float) + 1e-5), 9) == 5 + k
            assert mean == pytest.approx(confidence[inside].mean(dtype=float), abs=1e-5)
            assert share == pytest.approx(inside.mean()) and hit == pytest.approx(right[inside].mean(), abs=1e-6)
    assert reliability(np.zeros_like(counts)) is None
