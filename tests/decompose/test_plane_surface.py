"""Weak echoes of roofs under trees and of water, along planes of strong ones; waveforms written with numpy alone."""

import numpy as np
import pytest
import wavemaker as wm
from woodmaker import OPEN, pond, under_tree

from fwclass import conf
from fwclass.classes import BUILDING, WATER
from fwclass.decompose.placement import AS_STORED
from fwclass.decompose.plane_surface import planar, plane_surface
from fwclass.decompose.stack_candidates import Surface, candidates
from fwclass.decompose.stacking import stack
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.grid import Box, Window

ASKED, FIT = conf.section("stack", ()), conf.section("decompose", ())
WINDOW, INNER, ROUGH = Window(1.0, -10, -10, 60, 60), Box(3.0, 3.0, 21.0, 21.0), 0.03
REACHED = OPEN + ASKED.plane_reach


def shown(waves, surface, known, code):
    box = INNER.grown(ASKED.radius)
    pulse = SystemPulse.gaussian(wm.PULSE_WIDTH)
    some, through = candidates(waves, 1, surface, box, ASKED, FIT, pulse, AS_STORED, silent=True)
    return stack(some, np.concatenate([known, through]), INNER, ROUGH, ASKED, code)


def on_roofs(ratio, runs, **kind):
    """Roof echoes with their errors [m] and those over the errors stated, and how many there could be."""
    places, errors, pulls, tried, false, decoys = [], [], [], 0, 0, 0
    for seed in range(runs):
        waves, truth, strong = under_tree(ratio, seed=seed, **kind)
        echoes = strong[planar(strong, ASKED)]
        table, counts = shown(waves, plane_surface(echoes, WINDOW, ASKED), echoes[:, :2], BUILDING)
        off = table["z"] - truth[table["pulse"].astype(int), 2]
        places.append(np.c_[table["x"], table["y"]])
        errors.append(off)
        pulls.append(off / table["range_sigma"])
        tried, false, decoys = tried + counts["candidates"], false + counts["false"], decoys + counts["decoys"]
        assert (table["classification"] == BUILDING).all() and (table["stacked_pulses"] >= ASKED.least).all()
    return np.concatenate(places), np.concatenate(errors), np.concatenate(pulls), tried, false, decoys


def test_a_roof_under_a_tree():
    places, errors, pulls, tried, false, decoys = on_roofs(1.5, 6)
    assert tried > 500 and len(places) >= 0.95 * tried and false <= 1e-3 * decoys + 3.0
    assert (places[:, 0] > OPEN + 1.5).all() and (places[:, 0] < REACHED + 1.0).all()
    assert abs(np.median(errors)) < 0.03 and 0.8 < np.sqrt(np.mean(pulls**2)) < 1.2


def test_no_roof_no_echo():
    places, _, _, tried, false, decoys = on_roofs(0.0, 10)
    assert tried > 800 and len(places) <= 1e-3 * tried + 2.0 and false <= 1e-3 * decoys + 3.0


def test_leaves_beside_a_house_are_no_roof():
    """The plane is carried on beyond the eaves, where a branch hangs in it and light goes through."""
    places, *_ = on_roofs(1.5, 4, leaves=2, eaves=12.0)
    assert (places[:, 0] < 12.3).all()


def test_water_that_mirrors():
    nowhere, level = np.empty((0, 2)), Surface(np.full((60, 60), 100.0, np.float32), WINDOW)
    there = tried = none = 0
    for seed in range(3):
        waves, truth = pond(1.5, seed=seed)
        table, counts = shown(waves, level, nowhere, WATER)
        there, tried = there + table.rows, tried + counts["candidates"]
        assert (table["classification"] == WATER).all() and (table["echo_number"] == 1).all()
        assert abs(np.median(table["z"] - truth[table["pulse"].astype(int), 2])) < 0.03
        none += shown(pond(0.0, seed=10 + seed)[0], level, nowhere, WATER)[0].rows
    assert tried > 2000 and there >= 0.95 * tried and none == 0


@pytest.mark.parametrize("steep", [0.0, 0.5, 1.5])
def test_planes(steep):
    """An exact plane is planar and carried on exactly, whatever its slope; a wall, a line and leaves are not."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0.0, 10.0, (2, 400))
    plane = np.c_[x, y, 500.0 + steep * x - 0.2 * y]
    assert planar(plane, ASKED).mean() > 0.97  # now and then eight in a row are nearest
    surface = plane_surface(plane, WINDOW, ASKED)
    at = np.array([5.0, 12.0]), np.array([5.0, 6.0])
    assert np.allclose(surface.at(*at), 500.0 + steep * at[0] - 0.2 * at[1], atol=2e-3)
    assert np.isnan(surface.at(np.array([20.0]), np.array([5.0]))).all()


def test_what_is_no_plane():
    rng = np.random.default_rng(2)
    a, b, c = rng.uniform(0.0, 10.0, (3, 400))
    assert not planar(np.c_[a, np.full(400, 5.0), b], ASKED).any()
    assert not planar(np.c_[a, a, np.full(400, 5.0)], ASKED).any()
    assert planar(np.c_[a, b, c], ASKED).mean() < 0.01
    assert not planar(np.c_[a, b, c][:8], ASKED).any()
    assert np.isnan(plane_surface(np.c_[a, b, c][:5], WINDOW, ASKED).heights).all()


def test_a_ridge_is_no_plane_and_outliers_are_none():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0.0, 10.0, (2, 800))
    ridge = np.c_[x, y, 50.0 - 0.8 * np.abs(x - 5.0)]
    surface = plane_surface(ridge, Window(0.5, 0, 0, 20, 20), ASKED)
    inside = np.isfinite(surface.heights)
    column = (np.arange(20) + 0.5) * 0.5
    expected = np.broadcast_to(50.0 - 0.8 * np.abs(column - 5.0), (20, 20))
    assert inside.mean() > 0.7 and np.abs(surface.heights - expected)[inside].max() < 0.15
    flat = np.c_[x, y, np.where(rng.random(800) < 0.08, 51.5, 50.0)]
    heights = plane_surface(flat, Window(0.5, 0, 0, 20, 20), ASKED).heights
    assert np.isfinite(heights).mean() > 0.8 and np.nanmax(np.abs(heights - 50.0)) < 0.05
