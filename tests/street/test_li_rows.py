"""Rows that judge Li 2018's tables are independent of those that train."""

import numpy as np
import pytest

from fwclass.graph.street import Rows, Split
from fwclass.study.papers.li_work import _some


@pytest.mark.parametrize("most", [100, 1000, 10_000])
def test_rows_that_are_judged_are_no_more_often_training_rows_than_others(most):
    n = 40_000
    zero = np.zeros(n)
    rows = Rows(zero[:, None].astype(np.float32), zero.astype(np.uint8), np.arange(n, dtype=np.uint64), zero, zero)
    few = _some(rows, most, 1)
    assert len(few.key) == pytest.approx(most, rel=0.3)
    assert Split("random", 0.05, 1, (), 0.0).trains(few).mean() == pytest.approx(0.05, abs=0.05)
