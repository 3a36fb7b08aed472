"""The density that a model learned from: the same whatever the tiles, wherever on the grid."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.model.density import count_in_squares, density_of


@pytest.mark.parametrize("shift", [(0, 0), (-70_000, 5_403_200_000), (512_200_000, -30_000)])
def test_squares_are_counted_on_the_global_grid(shift):
    x, y = np.random.default_rng(1).integers(0, 60_000, (2, 5000)) + np.array(shift)[:, None]
    squares, counts = np.unique(np.stack([x // 4000, y // 4000], axis=1), axis=0, return_counts=True)
    np.testing.assert_array_equal(count_in_squares(x, y), np.column_stack([squares, counts]))


def test_parts_that_cut_squares_give_the_density_of_the_whole_and_voids_do_not_count():
    x, y = np.random.default_rng(2).integers(0, 64_000, (2, 6400))
    y[x > 32_000] += 500_000_000
    whole = density_of([count_in_squares(x, y)])
    assert whole == pytest.approx(6400 / 64**2, rel=0.1)
    for edge in (1_700, 30_001):
        parts = [count_in_squares(x[x // edge == k], y[x // edge == k]) for k in range(64_000 // edge + 1)]
        assert density_of(parts) == whole
    assert density_of([count_in_squares(x[:0], y[:0])]) is None and density_of([]) is None
