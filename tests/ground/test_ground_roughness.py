"""Roughness against planes fitted one by one, known noise, slopes and the order of the points."""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import FLOAT32_HEIGHT, MILLIMETRE

from fwclass.grid import Window
from fwclass.ground.terrain.blocks import terrain_by_blocks
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.roughness import LEAST_POINTS, roughness
from fwclass.ground.terrain.terrain import terrain

X0, Y0 = 512000.0, 5403200.0
PARAMS = TerrainParams(cell=1.0, thin=0.5, max_gap=40.0, dsm_gap=2.0, height="tin", block=256.0, block_halo=64.0)
WINDOW = Window(1.0, 512000, 5403200, 40, 30)


def scattered(n, size, seed=0):
    rng = np.random.default_rng(seed)
    return X0 + rng.integers(0, size * 1000, n) / 1000, Y0 + rng.integers(0, size * 1000, n) / 1000


def rough_hills(n, size, seed=0):
    x, y = scattered(n, size, seed)
    z = 200 + 12 * np.sin((x - X0) / 90) * np.cos((y - Y0) / 70) + np.random.default_rng(seed).normal(0, 0.1, n)
    return x, y, z.round(3)


def test_it_is_what_a_plane_by_least_squares_leaves():
    x, y, z = rough_hills(1800, 40)
    out = roughness(x, y, z, WINDOW)
    col, row = np.floor(x).astype(int) - WINDOW.col, np.floor(y).astype(int) - WINDOW.row
    known = 0
    for r in range(WINDOW.nrows):
        for c in range(WINDOW.ncols):
            near = (abs(col - c) <= 1) & (abs(row - r) <= 1)
            if near.sum() < LEAST_POINTS:
                assert np.isnan(out[r, c])
                continue
            plane = np.column_stack([np.ones(near.sum()), x[near] - X0, y[near] - Y0])
            rest = z[near] - plane @ np.linalg.lstsq(plane, z[near], rcond=None)[0]
            assert out[r, c] == pytest.approx(np.sqrt((rest**2).sum() / (near.sum() - 3)), abs=FLOAT32_HEIGHT)
            known += 1
    assert known > 900


@pytest.mark.parametrize("slope", [0.0, 0.7, 5.0])
def test_noise_is_told_whatever_the_slope(slope):
    x, y = scattered(40_000, 40)
    noise = np.random.default_rng(3).normal(0, 0.05, len(x))
    out = roughness(x, y, 3000.0 + slope * (x - X0) - slope * (y - Y0) + noise, WINDOW)
    inner = out[1:-1, 1:-1]
    assert np.isfinite(inner).all() and inner.mean() == pytest.approx(0.05, rel=0.01)
    flat = roughness(x, y, 3000.0 + slope * (x - X0), WINDOW)
    assert np.nanmax(flat) < MILLIMETRE  # which heights are rounded to


def test_the_order_of_points_changes_no_bit():
    x, y, z = rough_hills(5000, 40)
    z[:50] -= 900.0  # a shaft
    order = np.random.default_rng(1).permutation(len(x))
    assert roughness(x, y, z, WINDOW).tobytes() == roughness(x[order], y[order], z[order], WINDOW).tobytes()


def test_few_points_and_points_on_a_line_have_none():
    x = X0 + 20 + np.linspace(0, 0.9, 12)
    line = roughness(x, np.full(12, Y0 + 10.5), np.full(12, 5.0), WINDOW)
    assert np.isnan(line).all()
    assert np.isnan(roughness(x[:0], x[:0], x[:0], WINDOW)).all()
    same = roughness(np.full(9, X0 + 3.0), np.full(9, Y0 + 3.0), np.arange(9.0), WINDOW)
    assert np.isnan(same).all()


def test_blocks_have_no_seams():
    x, y, z = rough_hills(60_000, 300, seed=5)
    yes, no = np.ones(len(x), bool), np.zeros(len(x), bool)
    whole, window = terrain_by_blocks(x, y, z, yes, no, PARAMS)  # several blocks of 256 m
    alone = terrain(x, y, z, yes, no, no, window, PARAMS.model_copy(update={"block_halo": 80.0}))
    np.testing.assert_array_equal(whole.roughness, alone.roughness)
    assert np.isfinite(whole.roughness).mean() > 0.4
