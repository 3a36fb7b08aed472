"""Each rule of noise removal on clouds where the noise is known, and on what must not be taken for noise."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.ground.filters import ground_points
from fwclass.ground.methods.noise import noise as noise_among
from fwclass.ground.methods.params import NoiseParams
from fwclass.ground.params import GroundParams

RULES = {"low": False, "high": False, "sigma_rule": False, "surface": False}


def noise(x, y, z, params):
    """Of points that all are the last of their pulses."""
    return noise_among(x, y, z, np.ones(len(x), bool), params)


@pytest.fixture(scope="session")
def params(base):
    return lambda **more: NoiseParams(**{**base["ground"]["noise"], **RULES, **more})


def plain(density, wide=60.0, seed=1, slope=0.0):
    rng = np.random.default_rng(seed)
    n = int(density * wide * wide)
    x, y = np.round(rng.uniform(0, wide, (2, n)), 3)
    return x, y, np.round(200.0 + slope * x + rng.normal(0, 0.02, n), 3)


def with_points(cloud, points):
    """`cloud` with rows added, and the mask of these."""
    points = np.atleast_2d(points)
    out = [np.r_[column, added] for column, added in zip(cloud, points.T, strict=True)]
    return out, np.arange(len(out[0])) >= len(cloud[0])


@pytest.mark.parametrize("density", [0.01, 0.3, 2.0, 25.0])
@pytest.mark.parametrize("depth", [40.0, 300.0])
def test_a_single_point_far_below_is_found_at_any_density(params, density, depth):
    cloud, stray = with_points(plain(density, wide=60.0 if density > 0.1 else 300.0), [31.3, 28.7, 200.0 - depth])
    np.testing.assert_array_equal(noise(*cloud, params(low=True)), stray)


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_in_dense_data_little_depth_is_enough(params, slope):
    cloud, stray = with_points(plain(25.0, slope=slope), [31.3, 28.7, 200.0 + 31.3 * slope - 4.0])
    np.testing.assert_array_equal(noise(*cloud, params(low=True)), stray)


def test_groups_at_several_depths_are_found(params):
    rng = np.random.default_rng(2)
    near = np.c_[rng.uniform(25, 32, 20), rng.uniform(30, 40, 20), rng.uniform(165, 168, 20)]
    deeper = np.c_[rng.uniform(26, 30, 5), rng.uniform(31, 36, 5), rng.uniform(90, 91, 5)]
    cloud, stray = with_points(plain(2.0), np.round(np.r_[near, deeper], 3))
    np.testing.assert_array_equal(noise(*cloud, params(low=True)), stray)


def test_a_larger_group_than_stated_stays(params):
    rng = np.random.default_rng(3)
    group = np.round(np.c_[rng.uniform(24.5, 26.5, 30), rng.uniform(30.5, 32.5, 30), rng.uniform(165, 166, 30)], 3)
    cloud, stray = with_points(plain(2.0), group)
    np.testing.assert_array_equal(noise(*cloud, params(low=True, points=30)), stray)
    assert not noise(*cloud, params(low=True, points=29)).any()


@pytest.mark.parametrize("density", [0.3, 2.0, 25.0])
@pytest.mark.parametrize(
    ("wide", "long", "deep"), [(1.0, 60.0, 1.5), (4.0, 4.0, 3.0), (12.0, 12.0, 15.0), (6.0, 60.0, 20.0)]
)
def test_ditches_pits_yards_and_streets_stay(params, density, wide, long, deep):
    """All of them, but for one point in a thousand where so few echoes came from the bottom that they look lost."""
    for seed in range(4):
        x, y, z = plain(density, seed=seed)
        inside = (abs(x - 30.2) < wide / 2) & (abs(y - 30.2) < long / 2)
        assert noise(x, y, np.where(inside, z - deep, z), params(low=True)).sum() <= 1e-3 * len(x)


@pytest.mark.parametrize("density", [0.01, 0.1, 1.0])
def test_a_steep_valley_in_sparse_data_stays(params, density):
    x, y, _ = plain(density, wide=400.0 if density < 0.5 else 100.0, seed=5)
    assert not noise(x, y, np.round(abs(x - x.mean()) * 1.0 + 0.1 * y, 3), params(low=True)).any()


def test_birds_and_clouds_are_found_and_towers_stay(params):
    cloud = plain(2.0)
    tower = np.c_[np.full(40, 12.0), np.full(40, 12.5), 200.0 + 2.0 * np.arange(1, 41)]
    cloud, _ = with_points(cloud, tower)
    cloud, bird = with_points(cloud, [[40.0, 41.0, 280.0], [40.5, 41.0, 280.5], [20.0, 50.0, 900.0]])
    np.testing.assert_array_equal(noise(*cloud, params(high=True)), bird)


def test_a_wood_and_a_high_house_stay(params):
    x, y, z = plain(2.0, seed=6)
    wood = np.random.default_rng(7).random(len(x)) < 0.7
    z = np.where(wood & (x > 30), z + np.random.default_rng(8).uniform(0, 35, len(x)), z)
    z = np.where((abs(x - 15) < 8) & (abs(y - 30) < 8), 260.0, z)
    assert not noise(x, y, z, params(low=True, high=True)).any()


def test_the_sigma_rule_is_its_definition(params):
    """Against a plain double loop over all points, on one side and on both."""
    rng = np.random.default_rng(9)
    x, y = np.round(rng.uniform(0, 6, (2, 900)), 3)
    z = np.round(50.0 + rng.normal(0, 0.05, 900) + (rng.random(900) < 0.05) * rng.normal(0, 2.0, 900), 3)
    for above in (False, True):
        own = params(sigma_rule=True, sigma_above=above)
        expected = []
        for i in range(900):
            near = (np.hypot(x - x[i], y - y[i]) <= own.sigma_radius) & (np.arange(900) != i)
            away = z[near].mean() - z[i] if near.any() else 0.0
            alone = (abs(z[near] - z[i]) > own.sigma_least + 1e-9).all()
            enough = near.sum() >= own.sigma_neighbours and alone
            expected.append(enough and (abs(away) if above else away) > own.sigma * z[near].std())
        assert sum(expected) > 5
        np.testing.assert_array_equal(noise(x, y, z, own), expected)


def test_the_sigma_rule_is_silent_in_sparse_data(params):
    cloud, _ = with_points(plain(1.0), [31.3, 28.7, 195.0])
    assert not noise(*cloud, params(sigma_rule=True)).any()


def test_a_plane_however_steep_has_no_outliers(params):
    x, y, z = plain(25.0, wide=20.0, slope=1.5)
    assert not noise(x, y, z, params(low=True, high=True, sigma_rule=True)).any()


def lowered(cloud, share, seed=12):
    """`cloud` with a share of its points 1 to 5 m too low, and the mask of these."""
    x, y, z = cloud
    rng = np.random.default_rng(seed)
    low = rng.random(len(x)) < share
    return (x, y, np.round(z - low * rng.uniform(1.0, 5.0, len(x)), 3)), low


@pytest.mark.parametrize("density", [0.5, 4.0, 28.0, 84.0])
@pytest.mark.parametrize("share", [0.002, 0.01])
def test_single_echoes_below_a_surface_are_found(params, density, share):
    (x, y, z), low = lowered(plain(density, wide=min(200.0, 400.0 / density**0.5), slope=0.02), share)
    flags = noise(x, y, z, params(surface=True))
    assert not flags[~low].any() and flags[low].mean() > (0.8 if density > 1.0 else 0.4)  # others are near in height


def test_the_ground_under_low_noise_is_that_without(base):
    """Of a town with half a percent of low noise 63 % of the ground was lost."""
    rng = np.random.default_rng(13)
    x, y, z = plain(28.0, wide=70.0, slope=0.05)
    house = (x % 35.0 < 12.0) & (y % 35.0 < 10.0)
    z = np.where(house, z + 6.0, np.where(rng.random(len(x)) < 0.2, z + rng.uniform(0.5, 12.0, len(x)), z))
    (x, y, z), low = lowered((x, y, z), 0.01)
    wrong = []
    for surface in (False, True):
        own = GroundParams(**{**base["ground"], "noise": {**base["ground"]["noise"], "surface": surface}})
        ground = ground_points(x, y, z, np.ones(len(x), bool), own).ground
        sure = ~low & ~house & (z < 200.15 + 0.05 * x)
        wrong.append(1.0 - ground[sure].mean())
    assert wrong[0] > 0.2 and wrong[1] < 0.01


@pytest.mark.parametrize("density", [2.0, 28.0])
@pytest.mark.parametrize("through", [0.03, 0.1])
def test_what_a_crop_lets_through_stays(params, density, through):
    """A level surface, and below it the ground in a few echoes of a hundred, as level."""
    x, y, z = plain(density)
    rng = np.random.default_rng(14)
    below = rng.random(len(x)) < through
    assert noise(x, y, np.round(z - 2.0 * below, 3), params(surface=True)).mean() < 1e-3


@pytest.mark.parametrize("density", [0.5, 4.0, 28.0])
@pytest.mark.parametrize(("wide", "deep"), [(1.0, 1.5), (4.0, 3.0), (12.0, 15.0)])
def test_ditches_and_yards_are_no_single_echoes(params, density, wide, deep):
    x, y, z = plain(density)
    inside = abs(x - 30.2) < wide / 2
    assert noise(x, y, np.where(inside, z - deep, z), params(surface=True)).sum() <= 2e-3 * len(x)


def test_only_last_echoes_lie_below_a_surface_or_make_one(params):
    (x, y, z), low = lowered(plain(28.0), 0.005)
    first = np.random.default_rng(15).random(len(x)) < 0.5
    flags = noise_among(x, y, z, ~first, params(surface=True))
    assert not flags[first].any() and flags[low & ~first].mean() > 0.85
    np.testing.assert_array_equal(flags[~first], noise(x[~first], y[~first], z[~first], params(surface=True)))


def test_many_echoes_at_one_place_take_no_square_of_the_time(params):
    """A hundred thousand within a square metre: each cell looks for those that may be alone, three at most."""
    rng = np.random.default_rng(16)
    x, y = np.round(rng.uniform(0, 1.0, (2, 100_000)), 3)
    z = np.round(rng.normal(100.0, 0.05, len(x)) - 3.0 * (np.arange(len(x)) < 40), 3)
    assert noise(x, y, z, params(surface=True)).sum() <= 40


def test_without_rules_nothing_is_noise_and_no_reach(params):
    cloud, _ = with_points(plain(1.0), [31.3, 28.7, -100.0])
    assert not noise(*cloud, params()).any()
    assert params().reach == 0.0
    assert not noise(*(np.empty(0),) * 3, params(low=True, sigma_rule=True)).any()


@pytest.mark.parametrize("density", [0.3, 1.0])
def test_what_lies_beyond_the_reach_changes_nothing(base, density):
    own = NoiseParams(**{**base["ground"]["noise"], "surface": True})
    rng = np.random.default_rng(10)
    x, y, z = plain(density, wide=150.0)
    rows = rng.integers(0, len(x), 60)
    z[rows] -= np.round(rng.uniform(1, 100, 60), 3)
    core = (abs(x - 75) < 20) & (abs(y - 75) < 20)
    near = (abs(x - 75) < 20 + own.reach) & (abs(y - 75) < 20 + own.reach)
    whole, part = noise(x, y, z, own), noise(x[near], y[near], z[near], own)
    order = np.random.default_rng(11).permutation(len(x))
    np.testing.assert_array_equal(noise(x[order], y[order], z[order], own), whole[order])
    assert whole[core].any()
    np.testing.assert_array_equal(part[core[near]], whole[core])


def test_the_low_groups_of_isprs_sample_41_go_and_its_ground_stays(base, shared_data):
    x, y, z, label = np.loadtxt(shared_data / "isprs" / "samp41.txt").T
    found = noise(x, y, z, GroundParams(**base["ground"]).noise)
    assert found[label == 1].sum() >= 40
    assert found[label == 0].mean() < 0.002


@pytest.mark.parametrize("sample", [21, 22, 23, 24, 42, 51, 52, 53, 54])
def test_on_the_other_isprs_samples_hardly_any_ground_goes(base, shared_data, sample):
    x, y, z, label = np.loadtxt(shared_data / "isprs" / f"samp{sample}.txt").T
    assert noise(x, y, z, GroundParams(**base["ground"]).noise)[label == 0].mean() < 1e-3
