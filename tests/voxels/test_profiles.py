"""Vertical profiles against what was put in."""

import numpy as np
import pytest

from fwclass import conf
from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.voxels.profiles import SHARES, figures, profiles_of


def params(**changed):
    return conf.section("profile", tuple(f"profile.{k}={v}" for k, v in changed.items()))


def samples(pulses, heights, shares, x=5.0):
    n, k = pulses, len(heights)
    pulse = np.repeat(np.arange(n), k)
    share = np.tile(shares, n)
    columns = {
        "x": np.full(n * k, x),
        "y": np.full(n * k, 5.0),
        "strip": np.ones(n * k),
        "pulse": pulse,
        "share": share,
        "returned_energy": 7.0 * share,
    }
    return Table(columns), np.tile(np.array(heights, float), n)


WINDOW = Window(25.0, 0, 0, 2, 1)


def test_a_layer_over_ground():
    table, above = samples(40, (0.25, 10.25), (0.4, 0.6))
    made = profiles_of(table, above, WINDOW, params())
    assert made["pulses"].tolist() == [[40, 0]] and np.isnan(made["cover"][0, 1])
    assert made["ground_share"][0, 0] == pytest.approx(0.4)
    assert made["cover"][0, 0] == pytest.approx(0.4 / 0.8)  # plants of 1.5 times the ground's reflectance: 0.6 / 1.5
    assert made["energy"][0, 0] == pytest.approx(280.0)
    heights = dict(zip(SHARES, made["relative_height"][:, 0, 0], strict=True))
    assert 0.0 <= heights[25] <= 0.5 and 10.0 <= heights[50] <= 10.5 and heights[100] == pytest.approx(10.5)
    assert made["profile"][:, 0, 0].sum() * 0.5 == pytest.approx(1.0)


def test_few_pulses_and_samples_without_terrain():
    table, above = samples(5, (0.0, 3.0), (0.5, 0.5))
    assert np.isnan(profiles_of(table, above, WINDOW, params())["profile"]).all()
    table, above = samples(40, (0.0, 3.0), (0.5, 0.5))
    above[1::2] = np.nan
    made = profiles_of(table, above, WINDOW, params())
    assert made["ground_share"][0, 0] == 1.0 and made["cover"][0, 0] == 0.0


def test_order_does_not_matter():
    rng = np.random.default_rng(2)
    table, above = samples(300, (0.1, 2.2, 8.1, 12.3), (0.1, 0.2, 0.3, 0.4))
    above = above + rng.normal(0.0, 0.4, len(above))
    other = rng.permutation(table.rows)
    one, two = (
        profiles_of(table, above, WINDOW, params()),
        profiles_of(table.take(other), above[other], WINDOW, params()),
    )
    assert all(np.allclose(one[n], two[n], equal_nan=True) for n in one)


def test_figures_of_nothing():
    heights, cover, ground = figures(np.zeros((1, params().bins)), params())
    assert np.isnan(heights).all() and np.isnan(cover).all() and np.isnan(ground).all()
