"""Slope filter against its definition, PMF against plain grey openings, moving surface against known surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from fwclass.ground.filters import ground_points
from fwclass.ground.methods.moving_surface import cells, moving_surface
from fwclass.ground.methods.params import MovingSurfaceParams, PmfParams, SlopeParams
from fwclass.ground.methods.pmf import pmf, windows
from fwclass.ground.methods.quadratic_fit import fit_surfaces
from fwclass.ground.methods.slope import slope
from fwclass.ground.params import GroundParams, section_of


def section(base, name, **more):
    return {**base["ground"][name], **more}


def rough(seed, n=1500, wide=60.0):
    rng = np.random.default_rng(seed)
    x, y = np.round(rng.uniform(0, wide, (2, n)), 3)
    z = 3.0 * np.sin(x / 7.0) + rng.normal(0, 0.1, n) + (rng.random(n) < 0.3) * rng.uniform(0, 9, n)
    return x + 512_000.0, y + 5_403_000.0, np.round(z, 3)


def not_undercut(x, y, z, params):
    """The definition, pair by pair."""
    x, y, z = (np.rint(v * 1000) for v in (x, y, z))
    places = np.c_[x - x.min(), y - y.min()]
    out = np.ones(len(x), bool)
    for i, j in cKDTree(places).query_pairs(params.radius * 1000 + 1e-6):
        d = np.hypot(*(places[i] - places[j]))
        fall = params.slope * d + params.tolerance * 1000
        out[i] &= z[i] - z[j] <= fall
        out[j] &= z[j] - z[i] <= fall
    return out


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("radius", "steep"),
    [
        (1.7, 0.3),
        (9.0, 0.3),
        pytest.param(18.0, 0.15, marks=pytest.mark.statistics),
        pytest.param(200.0, 1.0, marks=pytest.mark.slow),
    ],
)
def test_slope_filter_is_its_definition(seed, radius, steep):
    params = SlopeParams(radius=radius, slope=steep, tolerance=0.2)
    x, y, z = rough(seed)
    expected = not_undercut(x, y, z, params)
    assert 0 < expected.sum() < len(x)
    np.testing.assert_array_equal(slope(x, y, z, params), expected)


@pytest.mark.parametrize(("apart", "ground"), [(18.0, False), (18.001, True)])
def test_slope_filter_looks_exactly_as_far_as_its_radius(apart, ground):
    params = SlopeParams(radius=18.0, slope=0.3, tolerance=0.2)
    found = slope(np.array([0.0, apart]), np.zeros(2), np.array([10.0, 0.0]), params)
    assert found.tolist() == [ground, True]


def test_slope_filter_radius_follows_the_largest_building(base):
    params = SlopeParams(**section(base, "slope", radius=None)).sized(30.0)
    assert params.radius == params.reach == 15.0
    assert SlopeParams(**section(base, "slope", radius=4.0)).sized(30.0).radius == 4.0


def test_pmf_windows_are_those_of_pdal(base):
    """PDAL 2: windows 3, 5, 9, 17, 33 for its default of 33, thresholds 0.15, 2.15, then 2.5."""
    own = PmfParams(**section(base, "pmf", max_window_size=33.0, slope=1.0, initial_distance=0.15, max_distance=2.5))
    assert windows(own) == [(1, 0.15), (2, 2.15), (4, 2.5), (8, 2.5), (16, 2.5)]
    linear = windows(own.model_copy(update={"exponential": False, "slope": 0.1}))
    assert [2 * r + 1 for r, _ in linear] == [3, 7, 11, 15, 19, 23, 27, 31, 33]
    assert linear[1][1] == pytest.approx(0.1 * 4 + 0.15)
    assert windows(own.model_copy(update={"max_window_size": 36.0}))[-1][0] == 18


@pytest.mark.parametrize("exponential", [True, False])
def test_pmf_against_plain_grey_openings(base, exponential):
    """One point in the middle of every cell: no hole to fill, no interpolation."""
    own = PmfParams(**section(base, "pmf", max_window_size=15.0, slope=0.3, exponential=exponential))
    rng = np.random.default_rng(3)
    z = np.round(ndimage.gaussian_filter(rng.normal(0, 30, (80, 90)), 3) + 4.0 * (rng.random((80, 90)) < 0.2), 3)
    col, row = np.meshgrid(np.arange(90) + 0.5, np.arange(80) + 0.5)
    found = pmf(col.ravel() + 512_000, row.ravel() + 5_403_000, z.ravel(), own).reshape(z.shape)
    expected, surface = np.ones(z.shape, bool), z
    for radius, difference in windows(own):
        dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1]
        foot = dx**2 + dy**2 <= radius**2
        low = ndimage.grey_erosion(surface, footprint=foot, mode="constant", cval=np.inf)
        surface = ndimage.grey_dilation(low, footprint=foot, mode="constant", cval=-np.inf)
        expected &= z - surface <= difference
    assert 0.1 < expected.mean() < 0.9
    inside = slice(30, -30), slice(30, -30)  # two windows and the filled margin away from the edge
    np.testing.assert_array_equal(found[inside], expected[inside])


def moving(base, **more):
    return MovingSurfaceParams(**section(base, "moving_surface", **more)).sized(base["ground"]["max_building_size"])


def test_moving_surface_goes_through_a_quadratic_surface():
    """Without stiffness the fit of a quadratic surface is that surface, wherever in their cells the seeds lie."""
    rng = np.random.default_rng(4)
    u, v = rng.uniform(-0.5, 0.5, (2, 9, 11))
    col, row = np.meshgrid(np.arange(11), np.arange(9))
    height = lambda a, b: 5.0 + 0.3 * a - 0.2 * b + 0.02 * a * a - 0.03 * a * b + 0.01 * b * b  # noqa: E731
    low = height(col + u, row + v)
    low[3:5, 4:7] = np.nan
    found = np.full(low.shape, np.nan)
    fit_surfaces(u, v, low, 2, 1.0, 4, 0.0, found)
    np.testing.assert_allclose(found, height(col, row), atol=1e-8)


def test_moving_surface_lets_a_seed_on_a_roof_go():
    flat, high = np.zeros((9, 9)), np.zeros((9, 9))
    high[4, 4] = 6.0
    found = np.full(flat.shape, np.nan)
    fit_surfaces(flat, flat, high, 2, 1.0, 4, 0.1, found)
    assert abs(found).max() < 0.05


def test_moving_surface_cells_are_halved_down_to_the_finest(base):
    assert cells(moving(base, cell=1.0, max_cell=18.0)) == [16.0, 8.0, 4.0, 2.0, 1.0]
    assert cells(moving(base, cell=2.0, max_cell=1.0)) == [2.0]


def test_moving_surface_follows_hills_and_leaves_a_hall_of_30_m(base):
    rng = np.random.default_rng(5)
    x, y = np.round(rng.uniform(0, 160, (2, 40_000)), 3)
    terrain = 8.0 * np.sin(x / 40.0) + 5.0 * np.cos(y / 30.0) + rng.normal(0, 0.03, len(x))
    hall = (abs(x - 80) < 15) & (abs(y - 80) < 15)
    z = np.round(np.where(hall, terrain[hall].max() + 5.0, terrain), 3)
    found = moving_surface(x, y, z, moving(base))
    assert found[~hall].mean() > 0.99
    assert found[hall].mean() < 0.01


@pytest.mark.parametrize(
    ("method", "more", "total"),
    [
        ("slope", {}, 20.5),
        ("slope", {"slope": 1.0}, 9.5),
        ("pmf", {}, 9.0),
        ("pmf", {"initial_distance": 0.5, "slope": 0.3}, 7.0),
        ("moving-surface", {}, 5.5),
    ],
)
def test_mean_total_error_on_the_isprs_samples(base, shared_data, method, more, total):
    """One set of numbers for all ten; the limits are what was measured, rounded up."""
    own = section(base, section_of(method), **more)
    params = GroundParams(**{**base["ground"], "method": method, section_of(method): own})
    errors = []
    for path in sorted((shared_data / "isprs").glob("samp*.txt")):
        x, y, z, label = np.loadtxt(path).T
        found = ground_points(x, y, z, np.ones(len(x), bool), params).ground
        errors.append(100.0 * (found != (label == 0)).mean())
    assert len(errors) >= 10
    assert np.mean(errors) < total
