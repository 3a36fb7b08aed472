"""Few numbers are sorted as numpy sorts them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.sorting import sort_few


@settings(deadline=None)
@given(st.lists(st.integers(0, 40), max_size=300))
@pytest.mark.parametrize("dtype", [np.float64, np.uint64])
def test_numbers_are_sorted_as_numpy_does(dtype: type, numbers: list[int]) -> None:
    values = np.array(numbers, dtype)
    expected = np.sort(values)
    sort_few(values)
    assert np.array_equal(values, expected)
