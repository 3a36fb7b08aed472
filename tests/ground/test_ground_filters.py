"""Laws that every ground filter obeys, whatever it does inside; new filters are covered as soon as they are listed."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from pydantic import ValidationError

from fwclass.ground.filters import FILTERS, ground_points
from fwclass.ground.methods.params import ConsensusParams
from fwclass.ground.params import GroundParams

EAST, NORTH = 512_000.0, 5_403_200.0
"""South-west corner of a block of 256 m."""

METHODS = list(FILTERS)


@pytest.fixture(scope="session")
def params(base):
    return lambda method, **more: GroundParams(**{**base["ground"], "method": method, **more})


def off_edges(metres):
    """Coordinates on whole millimetres that lie on no edge of a cell, so that a mirror does not change their cell."""
    mm = np.rint(np.asarray(metres) * 1000).astype(np.int64)
    return (mm + (mm % 250 == 0)) / 1000.0


def town(seed=1, wide=64.0, density=2.0):
    """A gentle slope with a house of 10 m x 8 m and a tree: x, y, z, and which points are terrain."""
    rng = np.random.default_rng(seed)
    n = int(density * wide * wide)
    x, y = off_edges(rng.uniform(0.5, wide - 0.5, n)), off_edges(rng.uniform(0.5, wide - 0.5, n))
    z = 300.0 + 0.04 * x + np.sin(y / 20.0) + rng.normal(0.0, 0.02, n)
    house = (abs(x - 20.0) < 5.0) & (abs(y - 30.0) < 4.0)
    tree = (np.hypot(x - 45.0, y - 40.0) < 4.0) & (rng.random(n) < 0.6)
    z = np.where(house, 308.0, np.where(tree, z + rng.uniform(3.0, 12.0, n), z))
    return EAST + x, NORTH + y, np.round(z, 3), ~house & ~tree


def flags(params, x, y, z):
    return ground_points(x, y, z, np.ones(len(x), bool), params)


@pytest.fixture(scope="module")
def usual(params):
    """What a method finds in the `town`, once for all laws."""
    return functools.cache(lambda method: flags(params(method), *town()[:3]))


@pytest.mark.parametrize("method", METHODS)
def test_a_flat_plain_is_all_ground(params, method):
    rng = np.random.default_rng(2)
    x, y = EAST + np.round(rng.uniform(0, 60, 4000), 3), NORTH + np.round(rng.uniform(0, 60, 4000), 3)
    z = np.round(100.0 + rng.normal(0.0, 0.01, 4000), 3)
    found = flags(params(method), x, y, z)
    assert found.ground.all()
    assert not found.noise.any()


@pytest.mark.parametrize("method", METHODS)
def test_house_and_tree_are_not_ground_and_the_slope_is(usual, method):
    terrain, found = town()[3], usual(method)
    assert (found.ground[terrain]).mean() > 0.98
    assert (found.ground[~terrain]).mean() < 0.02


@pytest.mark.parametrize("method", METHODS)
def test_heights_shifted_by_whole_millimetres_change_nothing(params, usual, method):
    x, y, z, _ = town()
    expected = usual(method)
    for shift in (1000.0, -412.357):
        found = flags(params(method), x, y, z + shift)
        np.testing.assert_array_equal(found.ground, expected.ground)
        np.testing.assert_array_equal(found.noise, expected.noise)


@pytest.mark.parametrize("method", METHODS)
def test_the_order_of_points_does_not_matter(params, usual, method):
    x, y, z, _ = town()
    order = np.random.default_rng(3).permutation(len(x))
    expected, found = usual(method), flags(params(method), x[order], y[order], z[order])
    np.testing.assert_array_equal(found.ground, expected.ground[order])
    np.testing.assert_array_equal(found.noise, expected.noise[order])


@pytest.mark.parametrize("method", METHODS)
def test_a_double_gets_what_the_point_gets_and_changes_no_other(params, usual, method):
    x, y, z, _ = town()
    rows = np.r_[np.arange(len(x)), np.arange(0, len(x), 7)]
    expected, found = usual(method), flags(params(method), x[rows], y[rows], z[rows])
    np.testing.assert_array_equal(found.ground, expected.ground[rows])


@pytest.mark.parametrize("method", METHODS)
def test_moved_by_whole_blocks_the_answer_is_the_same(params, usual, method):
    x, y, z, _ = town()
    expected = usual(method)
    found = flags(params(method), x + 3 * 256.0, y - 5 * 256.0, z)
    np.testing.assert_array_equal(found.ground, expected.ground)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turn", ["mirrored", "transposed"])
def test_mirrored_or_transposed_the_answer_is_the_same(params, usual, method, turn):
    """But for a few points: holes are filled by a fixed number of sweeps, which go from one side to the other."""
    x, y, z, _ = town()
    expected = usual(method)
    u, v = np.rint((x - EAST) * 1000) / 1000, np.rint((y - NORTH) * 1000) / 1000
    u, v = (256.0 - u, v) if turn == "mirrored" else (v, u)
    found = flags(params(method), EAST + u, NORTH + v, z)
    assert (found.ground != expected.ground).mean() <= 1e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("depth", [5.0, 300.0])
def test_one_point_far_below_changes_nothing_else(params, usual, method, depth):
    x, y, z, _ = town()
    expected = usual(method)
    stray = np.r_[x, EAST + 50.123], np.r_[y, NORTH + 15.456], np.r_[z, 301.0 - depth]
    found = flags(params(method), *stray)
    np.testing.assert_array_equal(found.ground[:-1], expected.ground)
    assert found.noise[-1] and not found.ground[-1]
    assert not found.noise[:-1].any()


def bad_geometries():
    rng = np.random.default_rng(4)
    t = np.round(rng.uniform(0, 50, 400), 3)
    zero = np.zeros(400)
    return {
        "one point": (np.zeros(1), np.zeros(1), np.zeros(1)),
        "two points": (np.array([0.0, 7.5]), np.zeros(2), np.array([0.0, 1.0])),
        "all equal": (zero, zero, zero),
        "a line": (t, np.round(0.5 * t, 3), np.round(0.1 * t, 3)),
        "a line along x": (t, zero, zero),
        "a vertical wall": (t, zero, np.round(rng.uniform(0, 20, 400), 3)),
        "one place": (zero, zero, t),
        "doubled places": (np.r_[t, t], np.r_[t[::-1], t[::-1]], np.r_[zero, zero + 8.0]),
        "one point per 100 m2": (10 * t, 10 * t[::-1], zero),
        "a grid": tuple(np.meshgrid(np.arange(20.0), np.arange(20.0))[k % 2].ravel() * (k < 2) for k in range(3)),
        "far apart": (np.array([0.0, 600.0, 1.0]), np.array([0.0, 400.0, 0.0]), np.array([0.0, 100.0, 0.0])),
    }


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", list(bad_geometries()))
def test_bad_geometry_is_survived(params, method, shape):
    x, y, z = bad_geometries()[shape]
    found = flags(params(method), EAST + x, NORTH + y, z)
    assert found.ground.shape == found.noise.shape == x.shape
    assert not (found.ground & found.noise).any()
    if shape in ("one point", "all equal", "a line along x", "one point per 100 m2", "a grid"):
        assert found.ground.all()
    lowest = z == z.min()
    # a cloth hangs on the point nearest to each of its particles, and a wall has no ground
    assert found.ground[lowest].all() or (shape == "a vertical wall" and "csf" in method)


@pytest.mark.parametrize("method", METHODS)
def test_a_filter_itself_takes_any_order_and_gives_flags(params, method):
    x, y, z, _ = town(density=0.5)
    found = FILTERS[method](x, y, z, params(method).of(method))
    assert found.dtype == bool and found.shape == x.shape
    back = FILTERS[method](x[::-1].copy(), y[::-1].copy(), z[::-1].copy(), params(method).of(method))
    np.testing.assert_array_equal(back[::-1], found)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_coordinate_that_is_no_number_is_noise_and_harms_no_other(params, bad, axis):
    x, y, z, _ = town()
    expected = flags(params("smrf"), x[1:], y[1:], z[1:])
    columns = [x.copy(), y.copy(), z.copy()]
    columns[axis][0] = bad
    found = flags(params("smrf"), *columns)
    assert found.noise[0] and not found.ground[0]
    np.testing.assert_array_equal(found.ground[1:], expected.ground)


def test_nothing_but_noise_is_no_ground(params):
    none = np.full(5, np.nan)
    found = flags(params("smrf"), none, none, none)
    assert found.noise.all() and not found.ground.any()
    assert flags(params("smrf"), none[:0], none[:0], none[:0]).ground.shape == (0,)


def test_only_last_echoes_are_ground_where_asked(params):
    x, y, z, terrain = town()
    last = np.arange(len(x)) % 3 > 0
    found = ground_points(x, y, z, last, params("smrf", last_returns=True))
    assert not found.ground[~last].any() and found.ground[last & terrain].mean() > 0.98
    assert ground_points(x, y, z, last, params("smrf", last_returns=False)).ground[~last & terrain].mean() > 0.98


@pytest.mark.parametrize("votes", [1, 2, 3])
def test_a_consensus_counts_the_votes(params, votes):
    x, y, z, _ = town(density=1.0)
    methods = ("slope", "pmf", "smrf")
    alone = sum(flags(params(m), x, y, z).ground.astype(int) for m in methods)
    found = flags(params("consensus", consensus={"methods": methods, "votes": votes}), x, y, z)
    np.testing.assert_array_equal(found.ground, alone >= votes)
    assert 0 < found.ground.sum() < len(x)


@pytest.mark.parametrize(
    ("methods", "votes", "words"),
    [(("smrf", "pmf"), 3, "votes is 3"), (("smrf", "smrf", "pmf"), 2, "names one twice"), (("smrf",), 1, "2 items")],
)
def test_a_consensus_that_cannot_be_is_refused(methods, votes, words):
    with pytest.raises(ValidationError, match=words):
        ConsensusParams(methods=methods, votes=votes)


@pytest.mark.parametrize("method", [*METHODS, "consensus"])
def test_the_halo_holds_what_noise_and_filter_reach(params, method):
    own = params(method)
    asked = own.consensus.methods if method == "consensus" else (method,)
    assert own.halo >= max(own.noise.reach + own.of(m).reach for m in asked)


@pytest.mark.parametrize(
    ("method", "change"),
    [
        ("smrf", {"smrf": {"window": 1e6}}),
        ("slope", {"slope": {"radius": 1e6}}),
        ("ptd", {"max_building_size": 1e5}),
        ("consensus", {"max_building_size": 1e5}),
    ],
)
def test_a_filter_that_would_read_the_whole_survey_is_refused(params, method, change):
    values = params("smrf").model_dump() | {"method": method}
    for key, value in change.items():
        values[key] = values[key] | value if isinstance(value, dict) else value
    with pytest.raises(ValidationError, match="around a block, more than 1,000 m"):
        GroundParams.model_validate(values)
