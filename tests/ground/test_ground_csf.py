"""The cloth: physical laws, seams, another program's answer, absurd sizes, and the cloth before SMRF."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.errors import InputError
from fwclass.ground.blocks import blocks_of
from fwclass.ground.methods.cloth import drop_cloth, without_holes
from fwclass.ground.methods.csf import csf
from fwclass.ground.methods.params import CsfParams

PARAMS = CsfParams(
    cloth_resolution=1.0,
    class_threshold=0.5,
    scalar=0.0,
    rigidness=3,
    iterations=500,
    time_step=0.65,
    slope_smooth=True,
)
EAST, NORTH = 512_000.0, 5_403_000.0


def scene(edge=120.0, density=3.0, slope=0.0, seed=1):
    """A plane with a house of 12 m in the middle and a tree; x, y, z [m] and what is ground."""
    rng = np.random.default_rng(seed)
    n = int(edge * edge * density)
    x, y = rng.uniform(0, edge, n), rng.uniform(0, edge, n)
    z = 200.0 + slope * x + rng.normal(0, 0.02, n)
    house = (np.abs(x - edge / 2) < 6) & (np.abs(y - edge / 2) < 6)
    tree = (np.hypot(x - 30, y - 30) < 4) & (rng.random(n) < 0.7)
    z[house] += 6.0
    z[tree] += rng.uniform(2, 12, n)[tree]
    return np.round(x + EAST, 3), np.round(y + NORTH, 3), np.round(z, 3), ~(house | tree)


def town(edge, density=2.0, seed=5):
    """Hills with a house on every lot of 30 m."""
    rng = np.random.default_rng(seed)
    n = int(edge * edge * density)
    x, y = rng.uniform(0, edge, n), rng.uniform(0, edge, n)
    z = 300.0 + 20.0 * np.sin(x / 150.0) * np.cos(y / 190.0) + rng.normal(0, 0.03, n)
    house = (np.abs(x % 30 - 15) < 6) & (np.abs(y % 30 - 15) < 4)
    z[house] += 7.0
    return np.round(x + EAST, 3), np.round(y + NORTH, 3), np.round(z, 3), ~house


def test_a_plain_with_a_house_and_a_tree():
    x, y, z, truth = scene()
    assert (csf(x, y, z, PARAMS) != truth).mean() < 0.002


@pytest.mark.parametrize("rise", [-150.0, 0.25, 1234.567])
def test_a_higher_cloud_has_the_same_ground(rise):
    x, y, z, _ = town(100)
    np.testing.assert_array_equal(csf(x, y, z, PARAMS), csf(x, y, np.round(z + rise, 3), PARAMS))


def test_order_of_points_does_not_matter():
    x, y, z, _ = town(100)
    order = np.random.default_rng(2).permutation(len(x))
    flags = csf(x, y, z, PARAMS)
    np.testing.assert_array_equal(csf(x[::-1], y[::-1], z[::-1], PARAMS)[::-1], flags)
    np.testing.assert_array_equal(csf(x[order], y[order], z[order], PARAMS), flags[order])


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_cloud_has_mirrored_ground(axis):
    x, y, z, _ = town(100)
    # an edge between two cells mirrors into one that belongs to the other cell: points on it are moved
    x, y = x + 0.001 * (x % 1.0 < 5e-4), y + 0.001 * (y % 1.0 < 5e-4)
    mirrored = (2 * EAST - x, y) if axis == 0 else (x, 2 * NORTH - y)
    np.testing.assert_array_equal(csf(*np.round(mirrored, 3), z, PARAMS), csf(x, y, z, PARAMS))


def test_a_soft_cloth_follows_a_slope():
    x, y, z, truth = scene(slope=0.4)
    flags = csf(x, y, z, PARAMS.model_copy(update={"rigidness": 1}))
    assert (flags != truth).mean() < 0.01


def test_a_lower_rigidness_hangs_deeper():
    """A roof too wide for the cloth to stay flat: over its middle each softer cloth lies nearer to it."""
    heights = np.full((128, 128), -300_000.0)
    heights[24:104, 24:104] -= 20_000.0
    stiff = [drop_cloth(heights, 60, r, 500, 0.65, slope_smooth=False)[64, 64] for r in (3, 2, 1)]
    assert -300_000.0 > stiff[0] > stiff[1] + 50.0 > stiff[2] + 100.0


def test_the_distance_may_grow_with_the_slope():
    """Stones 0.7 m high: too high on the plain, near enough on a slope of 40 %."""
    for slope, kept in ((0.0, 0.0), (0.4, 1.0)):
        x, y, z, truth = scene(slope=slope)
        stone = truth & (np.arange(len(x)) % 50 == 0)
        z = np.round(z + 0.7 * stone, 3)
        flags = csf(x, y, z, PARAMS.model_copy(update={"rigidness": 1, "scalar": 1.25}))
        middle = (np.abs(x - EAST - 60) < 40) & (np.abs(y - NORTH - 100) < 15)
        assert abs(flags[stone & middle].mean() - kept) < 0.3


def test_the_slope_is_lost_without_letting_the_cloth_down():
    x, y, z, truth = scene(slope=0.25)
    update = {"slope_smooth": False, "iterations": 60}
    hung = csf(x, y, z, PARAMS.model_copy(update=update))
    let_down = csf(x, y, z, PARAMS.model_copy(update={**update, "slope_smooth": True}))
    assert (let_down & truth).sum() > (hung & truth).sum()


def test_holes_take_the_nearest_height_and_of_two_the_lower_point():
    heights = np.full((5, 7), np.nan)
    heights[2, 0], heights[2, 6], heights[0, 3] = -4.0, -9.0, -7.0
    filled = without_holes(heights)
    assert filled[2, 1] == -4.0
    assert filled[4, 6] == -9.0
    # three rows from one, three columns from two: the point that lies lowest has the highest inverted height
    assert without_holes(np.where(np.arange(7) == 3, np.nan, heights))[2, 3] == -4.0


def test_far_holes_are_filled_too():
    heights = np.full((100, 160), np.nan)
    heights[3, 2] = -4.0
    np.testing.assert_array_equal(without_holes(heights), -4.0)


BAD = {
    "one point": ([0.0], [0.0], [3.0]),
    "two points": ([0.0, 40.0], [0.0, 7.0], [3.0, 4.0]),
    "all equal": ([1.0] * 50, [2.0] * 50, [3.0] * 50),
    "a line": (np.arange(200.0), np.zeros(200), np.zeros(200)),
    "a wall": (np.zeros(200), np.arange(200) % 20.0, np.arange(200) / 10.0),
    "a point in 100 m2": (10.0 * (np.arange(400) % 20), 10.0 * (np.arange(400) // 20), np.zeros(400)),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_geometry_has_flags(name):
    x, y, z = (np.asarray(v, float) for v in BAD[name])
    flags = csf(x + EAST, y + NORTH, z + 100.0, PARAMS)
    assert flags[np.argmin(z)]
    assert flags.shape == x.shape
    if name in ("a line", "all equal", "a point in 100 m2"):
        assert flags.all()


def test_a_stray_point_far_away_is_refused_with_the_number():
    x, y, z, _ = scene(edge=20)
    with pytest.raises(InputError, match=r"csf\.cloth_resolution") as told:
        csf(np.append(x, EAST + 90_000.0), np.append(y, NORTH + 90_000.0), np.append(z, 200.0), PARAMS)
    assert "90,0" in str(told.value)


def test_a_point_far_below_spoils_its_surroundings_only():
    x, y, z, truth = scene()
    x, y, z = np.append(x, EAST + 20.0), np.append(y, NORTH + 90.0), np.append(z, -100.0)
    flags = csf(x, y, z, PARAMS)[:-1]
    far = np.hypot(x[:-1] - EAST - 20.0, y[:-1] - NORTH - 90.0) > 60.0
    assert (flags != truth)[far].mean() < 0.01


@pytest.mark.slow
def test_blocks_and_one_block_agree():
    x, y, z, _ = town(600.0)
    whole, parts = csf(x, y, z, PARAMS), np.zeros(len(x), bool)
    for _, rows, own in blocks_of(x, y, 256.0, 64.0):
        parts[rows[own]] = csf(x[rows], y[rows], z[rows], PARAMS)[own]
    assert (whole != parts).mean() <= 1e-4


@pytest.mark.parametrize("rigidness", [1, 2, 3])
def test_the_package_says_the_same_of_most_points(rigidness):
    package = pytest.importorskip("CSF")
    x, y, z, _ = town(200.0)
    run = package.CSF()
    run.params.bSloopSmooth, run.params.cloth_resolution, run.params.rigidness = True, 1.0, rigidness
    run.params.time_step, run.params.class_threshold, run.params.interations = 0.65, 0.5, 500
    run.setPointCloud(np.c_[x, y, z])
    ground, other = package.VecInt(), package.VecInt()
    run.do_filtering(ground, other, False)
    theirs = np.zeros(len(x), bool)
    theirs[np.array(ground, int)] = True
    ours = csf(x, y, z, PARAMS.model_copy(update={"rigidness": rigidness}))
    assert (ours == theirs).mean() >= 0.98
