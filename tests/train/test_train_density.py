"""The density that a model learned from: the same whatever the parts, wherever on the grid, and in bounded memory."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.model.density import Densities, densities_of, squares_by_count


@pytest.mark.parametrize("shift", [(0, 0), (-70_000, 5_403_200_000), (512_200_000, -30_000)])
def test_squares_are_counted_on_the_global_grid(shift):
    x, y = np.random.default_rng(1).integers(0, 60_000, (2, 5000)) + np.array(shift)[:, None]
    _, counts = np.unique(np.stack([x // 4000, y // 4000], axis=1), axis=0, return_counts=True)
    assert squares_by_count(x, y) == dict(
        zip(*(n.tolist() for n in np.unique(counts, return_counts=True)), strict=True)
    )


def test_parts_of_whole_squares_give_the_densities_of_the_whole():
    x, y = np.random.default_rng(2).integers(0, 64_000, (2, 6400))
    y[x > 32_000] += 500_000_000
    whole = densities_of([squares_by_count(x, y)])
    _, square, counts = np.unique(x // 4000 + 1_000_000 * (y // 4000), return_inverse=True, return_counts=True)
    expected = np.quantile(counts[square] / 16, (0.1, 0.5, 0.9), method="inverted_cdf")
    assert whole == Densities(*expected.tolist()) and whole.middle == pytest.approx(6400 / 64**2, rel=0.1)
    parts = [squares_by_count(x[x // 8000 == k], y[x // 8000 == k]) for k in (3, 7, 0, 1, 6, 2, 5, 4)]
    assert densities_of(parts) == whole
    assert densities_of([squares_by_count(x[:0], y[:0])]) is None and densities_of([]) is None


def test_a_small_dense_place_counts_by_its_echoes():
    """A model of a town and of country a hundred times as large knows both densities."""
    country, town = {5: 62_500}, {450: 900}
    assert densities_of([country, town]) == Densities(5 / 16, 450 / 16, 450 / 16)


def test_what_is_kept_does_not_grow_with_the_area():
    """24 bytes a square were 1.5 GB for 1,000 km²."""
    some = np.random.default_rng(3)
    kept = [len(squares_by_count(*some.integers(0, edge, (2, edge**2 // 2_000_000)))) for edge in (100_000, 1_000_000)]
    assert kept[1] < 2 * kept[0] < 100


def test_a_narrow_training_area_is_as_dense_as_what_lies_around_it():
    """Echoes beside it are neighbours of those that train: by its own ones alone 0.2 m would have a twentieth."""
    x, y = np.random.default_rng(4).integers(0, 100_000, (2, 100_000))
    narrow = (x > 50_000) & (x < 50_200)
    there, alone = (
        densities_of([one]) for one in (squares_by_count(x, y, narrow), squares_by_count(x[narrow], y[narrow]))
    )
    assert there.middle == pytest.approx(10, rel=0.1) and alone.high < 1
