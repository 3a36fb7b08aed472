"""What a model has seen, and how much of other data lies outside of it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fwclass.model.ranges import RANGES, RangeCounter, ranges_of, shares

NAMES = ("amplitude", "zc", "width")


def rows(n=20_000, seed=0):
    rng = np.random.default_rng(seed)
    X = np.c_[rng.uniform(100, 900, n), rng.exponential(3, n), np.full(n, np.nan)].astype(np.float32)
    X[rng.random(n) < 0.1, 1] = np.nan
    return X


def counted(card, *pieces):
    outside = RangeCounter.of(card, NAMES)
    for X in pieces:
        outside.add(X)
    return outside.counts()


def test_two_of_a_hundred_training_rows_lie_outside():
    X = rows()
    card = json.loads(json.dumps({RANGES: ranges_of(X, NAMES)}))
    share = shares([counted(card, X)])
    assert share["amplitude"] == pytest.approx(0.02, abs=0.001) and share["zc"] == pytest.approx(0.02, abs=0.001)
    assert "width" not in share and card[RANGES]["width"] is None


def test_another_scale_is_all_outside_and_others_stay():
    X = rows()
    card = {RANGES: ranges_of(X, NAMES)}
    X[:, 0] *= 200
    share = shares([counted(card, X)])
    assert share["amplitude"] == 1.0 and share["zc"] < 0.03 and next(iter(share)) == "amplitude"


def test_pieces_in_any_order_count_the_same():
    X, card = rows(), {RANGES: ranges_of(rows(seed=1), NAMES)}
    whole = counted(card, X)
    pieces = [X[k::7] for k in range(7)]
    assert counted(card, *pieces) == counted(card, *pieces[::-1]) == whole
    assert shares([counted(card, p) for p in pieces]) == shares([whole])


@pytest.mark.parametrize("ranges", [None, 7, [], "x", {"amplitude": 3}, {"amplitude": ["a", "b"]}, {"zc": [1]}, {}])
def test_a_card_that_says_nothing_counts_nothing(ranges):
    outside = RangeCounter.of({RANGES: ranges}, NAMES)
    if outside is not None:
        outside.add(rows())
        assert not outside.outside.any()


def test_a_single_row_and_none():
    assert ranges_of(np.empty((0, 3), np.float32), NAMES) == dict.fromkeys(NAMES)
    assert ranges_of(np.array([[1, 2, np.nan]], np.float32), NAMES)["zc"] == [2.0, 2.0]
