"""How sure echoes are, and how many of them are right, whatever codes the classifier writes and the reference has."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.assess.confusion import confusion
from fwclass.graph.assess import automation, by_confidence
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
