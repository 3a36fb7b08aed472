"""Shores and levels of water: places along rings, which body an echo tells of, and what counts as level."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.water.level import level_of
from fwclass.water.params import WaterParams
from fwclass.water.shore import nearest_shore, shoreline

PARAMS = WaterParams(file=None, layer=None, crs=None, shore=2.0, quantile=0.1, least=20, stretch=50.0, most_spread=0.3)
SQUARE = [(0, 0), (100, 0), (100, 100), (0, 100), (0, 0)]
BESIDE = [(100, 0), (200, 0), (200, 100), (100, 100), (100, 0)]


def rings(*several, per_body=1):
    """Bodies [m] as rings of whole millimetres."""
    points = np.concatenate([np.array(r, np.int64) for r in several]) * 1000
    starts = np.cumsum([0, *(len(r) for r in several)])
    return points[:, 0], points[:, 1], starts, np.arange(0, len(several) + 1, per_body)


def test_places_lie_along_the_shore_and_are_cut_into_pieces():
    line = shoreline(*rings(SQUARE), 0.5, 50.0)
    assert len(line.x) == 800 and (np.bincount(line.stretch) == 100).all() and len(set(line.stretch)) == 8
    on = (np.isin(line.x, (0, 100)) & (line.y >= 0) & (line.y <= 100)) | (np.isin(line.y, (0, 100)))
    assert on.all()


def test_where_two_bodies_touch_there_is_no_shore():
    line = shoreline(*rings(SQUARE, BESIDE), 0.3, 50.0)
    shared = (line.x == 100) & (line.y > 0.3) & (line.y < 99.7)
    assert not shared.any() and set(line.body) == {0, 1}
    hole = [(40, 40), (40, 60), (60, 60), (60, 40), (40, 40)]
    island = shoreline(*rings(SQUARE, hole, per_body=2), 0.5, 50.0)
    assert ((island.x > 30) & (island.x < 70) & (island.y > 30) & (island.y < 70)).sum() == 160
    assert set(island.body) == {0}


def test_the_nearest_shore_does_not_depend_on_how_echoes_are_cut():
    line = shoreline(*rings(SQUARE, BESIDE), 0.5, 50.0)
    x, y = np.random.default_rng(0).uniform(-20, 220, (2, 4000)).round(3)
    rows, place = nearest_shore(line, x, y, 2.0)
    off = np.hypot(x[:, None] - line.x, y[:, None] - line.y)
    np.testing.assert_array_equal(rows, np.flatnonzero(off.min(axis=1) <= 2.0))
    np.testing.assert_allclose(off[rows, place], off[rows].min(axis=1))
    some = np.flatnonzero(x < 90)
    part, near = nearest_shore(line, x[some], y[some], 2.0)
    np.testing.assert_array_equal(line.body[near], line.body[place[np.isin(rows, some)]])
    assert (some[part] == rows[np.isin(rows, some)]).all()
    assert len(nearest_shore(line, x[:0], y[:0], 2.0)[0]) == len(nearest_shore(line, x[:3] + 1e5, y[:3], 2.0)[0]) == 0


def test_of_places_as_near_as_each_other_the_first_counts():
    line = shoreline(*rings(SQUARE, BESIDE), 0.5, 50.0)
    x, y = np.array([50.25, 100.0]), np.array([-1.0, -1.0])  # between two places of one shore, and of two
    rows, place = nearest_shore(line, x, y, 2.0)
    off = np.hypot(x[:, None] - line.x, y[:, None] - line.y)
    assert rows.tolist() == [0, 1] and place.tolist() == off.argmin(axis=1).tolist()


def banks(n, rise=0.0, seed=0):
    """Piece of shore and height of echoes at a lake of 200 m, half of them on banks up to a metre high."""
    rng = np.random.default_rng(seed)
    stretch = rng.integers(0, 20, n)
    bank = np.where(rng.random(n) < 0.5, rng.uniform(0, 1, n), 0.0)
    return stretch, 200.0 + rise * stretch / 20 + bank + rng.normal(0, 0.02, n)


NONE = np.zeros(0, np.int64)


def level(stretch, z, heights=NONE, counts=NONE):
    return level_of(stretch, z, heights, counts, PARAMS)


def test_a_lake_has_the_level_of_its_lowest_shore():
    stretch, z = banks(4000)
    made = level(stretch, z)
    assert made.level_enough and made.level == pytest.approx(200.0, abs=0.03) and made.highest - made.lowest < 0.1
    z[stretch == 3] += 2.0  # a mole
    assert level(stretch, z).level_enough
    order = np.random.default_rng(1).permutation(len(z))
    assert level(stretch[order], z[order]) == level(stretch, z)


def test_a_river_is_no_lake():
    made = level(*banks(4000, rise=1.0))
    assert not made.level_enough and made.highest - made.lowest == pytest.approx(0.8, abs=0.1)


def test_few_echoes_tell_no_level():
    made = level(*banks(19))
    assert made.level is None and not made.level_enough and made.echoes == 19
    assert not level(NONE, np.zeros(0)).level_enough


def test_water_that_sends_echoes_tells_its_own_level():
    """A canal between quays: the shore's lowest tenth is the quay, the water lies half a metre below."""
    stretch, z = banks(4000)
    heights = np.rint(1000 * np.random.default_rng(2).normal(199.5, 0.05, 501)).astype(np.int64)
    at, counts = np.unique(heights, return_counts=True)
    made = level(stretch, z, at, counts)
    assert made.level_enough and made.inside == 501 and made.level == np.median(heights) / 1000
    assert made.shore_level == level(stretch, z).level
    few = level(stretch, z, at[:5], counts[:5])
    assert few.inside_level is None and few.level == made.shore_level
    alone = level(NONE, np.zeros(0), at, counts)
    assert alone.level_enough and alone.level == made.level and alone.shore_level is None
    river = level(NONE, np.zeros(0), np.arange(199_000, 200_000, 10), np.ones(100, np.int64))
    assert not river.level_enough and river.highest - river.lowest == pytest.approx(0.8, abs=0.02)


def test_what_is_higher_than_its_shore_is_no_water():
    made = level(*banks(4000), np.array([200_250, 201_000]), np.array([10, 90]))
    assert made.inside_level == 201.0 and not made.level_enough
