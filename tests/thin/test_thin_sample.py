"""The sample is even, has the asked rate, does not depend on the cut; every echo follows its nearest sampled one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tolerances import SMALL_COORDINATE

from fwclass import conf
from fwclass.grid import Tile
from fwclass.schema import Table, canonical_key
from fwclass.stage import Chunk
from fwclass.thin.follow import follow, index_of_followed
from fwclass.thin.sample import THIN, covering, thin, uniform


def _cloud(n=40_000, seed=1, edge=100.0):
    random = np.random.default_rng(seed)
    x, y = random.uniform(0.0, edge, n).round(3), random.uniform(0.0, edge, n).round(3)
    z = (300.0 + random.exponential(3.0, n) * (x > edge / 2)).round(3)
    return x, y, z, np.arange(n, dtype=np.uint64)


@pytest.fixture(scope="module")
def params():
    return conf.section("thin", ("thin.rate=0.05",))


@pytest.mark.parametrize("rate", [0.5, 0.3, 0.1, 0.01])
def test_the_rate_holds_everywhere(params, rate):
    """Of every cell ⌊n rate⌋ or one more: a hash alone would be off by the root of it."""
    x, y, z, key = _cloud()
    kept = uniform(x, y, z, key, params.model_copy(update={"rate": rate}))
    cell = (x // 20.0).astype(int) * 5 + (y // 20.0).astype(int)
    n, k = np.bincount(cell), np.bincount(cell[kept], minlength=25)
    assert (np.abs(k - n * rate) < 1.0).all()


def test_the_sample_is_more_even_than_a_random_one(params):
    x, y, z, key = _cloud()
    kept = uniform(x, y, z, key, params)
    chance = np.random.default_rng(2).permutation(len(x))[: kept.sum()]
    away = [cKDTree(np.c_[x, y][some]).query(np.c_[x, y])[0] for some in (kept, chance)]
    assert away[0].mean() < 0.95 * away[1].mean() and away[0].max() < away[1].max()


def test_rate_one_keeps_all_and_order_changes_nothing(params):
    x, y, z, key = _cloud()
    assert uniform(x, y, z, key, params.model_copy(update={"rate": 1.0})).all()
    mixed = np.random.default_rng(3).permutation(len(x))
    kept = uniform(x, y, z, key, params)
    np.testing.assert_array_equal(kept[mixed], uniform(x[mixed], y[mixed], z[mixed], key[mixed], params))


def _table(x, y, z):
    n = len(x)
    return Table({"x": x, "y": y, "z": z, "strip": np.zeros(n), "pulse": np.arange(n), "echo_number": np.ones(n)})


def test_tiles_with_their_halo_give_the_whole(params):
    """Odd tiles, whose edges cut cells, and a lone echo far from all others."""
    x, y, z, _ = _cloud(6_000)
    far = (x > 70.0) & (y > 70.0)
    x, y, z = (np.append(v[~far], p) for v, p in ((x, 90.0), (y, 90.0), (z, 300.0)))
    table = _table(x, y, z)
    whole = thin(Chunk(table, np.arange(table.rows), Tile(0, 0, 1000.0)), params)["sampled"]
    assert whole[-1]
    key = canonical_key(table)
    alone = covering(x, y, z, key, uniform(x, y, z, key, params), params.reach)
    np.testing.assert_array_equal(whole, alone)
    halo, size = THIN.halo(params), 33.0
    for ix in range(4):
        for iy in range(4):
            tile = Tile(ix, iy, size)
            rows = np.flatnonzero(tile.box.grown(halo).contains(x, y))
            core = np.flatnonzero(tile.box.contains(x[rows], y[rows]))
            found = thin(Chunk(table.take(rows), core, tile), params)["sampled"]
            np.testing.assert_array_equal(found, whole[rows[core]])


def test_every_echo_has_a_sampled_one_in_reach(params):
    x, y, z, key = _cloud(3_000)
    kept = covering(x, y, z, key, uniform(x, y, z, key, params.model_copy(update={"rate": 0.001})), params.reach)
    assert kept.sum() < len(x) / 4  # cubes of 5.8 m that hold an echo, not all echoes
    assert cKDTree(np.c_[x, y, z][kept]).query(np.c_[x, y, z])[0].max() <= params.reach


@pytest.mark.parametrize("rate", [0.3, 0.02])
def test_follow_is_the_nearest_of_a_kd_tree(params, rate):
    x, y, z, key = _cloud(8_000)
    kept = uniform(x, y, z, key, params.model_copy(update={"rate": rate}))
    some = (x[kept], y[kept], z[kept])
    found = follow((x, y, z), some, 10.0)
    away, _ = cKDTree(np.c_[some]).query(np.c_[x, y, z])
    assert ((found >= 0) == (away <= 10.0)).all()
    hit = found >= 0
    mine = np.linalg.norm(np.c_[x, y, z][hit] - np.c_[some][found[hit]], axis=1)
    np.testing.assert_allclose(mine, away[hit], atol=SMALL_COORDINATE)


def test_follow_without_any_sampled_echo():
    none = np.empty(0)
    assert (follow((np.zeros(3), np.zeros(3), np.zeros(3)), (none, none, none), 5.0) == -1).all()


def test_a_sampled_echo_follows_itself_even_beside_another_at_its_place():
    x, y, z = np.array([0.0, 0.0, 1.0, 9.0]), np.zeros(4), np.zeros(4)
    sampled = np.array([True, True, False, True])
    assert index_of_followed((x, y, z), sampled, 5.0).tolist() == [0, 1, 0, 2]
    assert index_of_followed((x, y, z), np.array([True, False, False, False]), 5.0).tolist() == [0, 0, 0, -1]
