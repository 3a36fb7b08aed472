"""Folds are whole blocks, apart from one another, the same whatever the order of the rows."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.errors import InputError
from fwclass.select.folds import check_folds, spatial_folds


def _rows(n=4000, seed=1):
    random = np.random.default_rng(seed)
    x, y = random.uniform(512_000.0, 512_100.0, n), random.uniform(5_403_000.0, 5_403_100.0, n)
    return x.round(3), y.round(3), (x > 512_060.0).astype(np.uint8) + (y > 5_403_080.0).astype(np.uint8)


def test_a_block_belongs_to_one_fold_and_every_row_is_judged_once():
    x, y, c = _rows()
    folds = spatial_folds(x, y, c, 10.0, 2.0, 5)
    block = np.floor(x / 10.0) * 1e6 + np.floor(y / 10.0)
    assert folds.blocks == len(np.unique(block)) == 100
    for b in np.unique(block):
        assert len(np.unique(folds.fold[block == b])) == 1
    assert sum(folds.judged(f).sum() for f in range(5)) == len(x)


@pytest.mark.parametrize("gap", [0.0, 2.0, 5.0, 5.002, 9.0])
def test_the_gap_is_free_of_training_rows_and_no_wider(gap):
    """Also where it is wider than half a block, so that three blocks may be nearer."""
    x, y, c = _rows()
    folds = spatial_folds(x, y, c, 10.0, gap, 5)
    for f in range(5):
        blocks = np.unique(np.stack([np.floor(x / 10.0), np.floor(y / 10.0)], axis=1)[folds.judged(f)], axis=0) * 10.0
        dx = np.maximum(np.maximum(blocks[:, 0] - x[:, None], x[:, None] - blocks[:, 0] - 10.0), 0.0)
        dy = np.maximum(np.maximum(blocks[:, 1] - y[:, None], y[:, None] - blocks[:, 1] - 10.0), 0.0)
        away = np.maximum(dx, dy).min(axis=1)
        assert away[folds.trains(f)].min() >= gap - 1e-6
        assert folds.trains(f)[away > gap + 1e-3].all()


def test_order_of_rows_changes_nothing():
    x, y, c = _rows()
    mixed = np.random.default_rng(2).permutation(len(x))
    one, other = spatial_folds(x, y, c, 10.0, 2.0, 5), spatial_folds(x[mixed], y[mixed], c[mixed], 10.0, 2.0, 5)
    np.testing.assert_array_equal(one.fold[mixed], other.fold)
    np.testing.assert_array_equal(one.near[:, mixed], other.near)


def test_a_rare_class_is_spread_over_all_folds():
    """A class in five of a hundred blocks must reach five folds, whichever blocks these are."""
    x, y, _ = _rows()
    block = (np.floor((x - 512_000.0) / 10.0) * 10 + np.floor((y - 5_403_000.0) / 10.0)).astype(int)
    for seed in range(20):
        rare = np.isin(block, np.random.default_rng(seed).choice(100, 5, replace=False)).astype(np.uint8)
        folds = spatial_folds(x, y, rare, 10.0, 0.0, 5)
        assert sorted(np.unique(folds.fold[rare == 1]).tolist()) == [0, 1, 2, 3, 4]
        sizes = np.bincount(folds.fold, minlength=5)
        assert sizes.max() < 1.25 * sizes.min()


def test_a_class_in_one_block_is_refused_and_one_in_few_is_told():
    x, y, _ = _rows()
    here = (x < 512_010.0) & (y < 5_403_010.0)
    one = here.astype(np.uint8)
    with pytest.raises(InputError, match="'cars' cannot be judged in places that did not train it"):
        check_folds(spatial_folds(x, y, one, 10.0, 0.0, 5), one, ("ground", "cars"))
    two = (here | ((x > 512_090.0) & (y > 5_403_090.0))).astype(np.uint8)
    assert check_folds(spatial_folds(x, y, two, 10.0, 0.0, 5), two, ("ground", "cars")) == (
        "class 'cars' is judged in 2 of 5 folds only",
    )


def test_too_few_blocks_are_refused():
    x, y, c = _rows()
    with pytest.raises(InputError, match="too few blocks"):
        spatial_folds(x, y, c, 200.0, 0.0, 5)
