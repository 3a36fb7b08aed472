"""Terrain against planes, brute force, scipy and known truth; seams; places where there is little to go by."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree
from tolerances import COORDINATE, FLOAT32_HEIGHT, MILLIMETRE, SMALL_COORDINATE

from fwclass.errors import ConfigError, InputError
from fwclass.grid import Window
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import lowest
from fwclass.ground.terrain import nearest
from fwclass.ground.terrain import terrain as terrain_module
from fwclass.ground.terrain.blocks import terrain_by_blocks
from fwclass.ground.terrain.dsm import disk, without_pepper
from fwclass.ground.terrain.facets import facet_heights, facet_raster, facets_of
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import BEYOND, INTERPOLATED, MEASURED, terrain
from fwclass.ground.terrain.thinning import thin_points
from fwclass.ground.tin.tin import tin_of

PARAMS = TerrainParams(cell=1.0, thin=0.5, max_gap=40.0, dsm_gap=2.0, height="tin", block=256.0, block_halo=64.0)
X0, Y0 = 512000.0, 5403200.0
"""A corner of the blocks' grid: 512000 = 2000 x 256; the northing lies inside a block."""


def params(**changes):
    return TerrainParams(**{**PARAMS.model_dump(), **changes})


def scattered(n, size, seed=0):
    rng = np.random.default_rng(seed)
    step = round(size * 1000)
    return X0 + rng.integers(0, step, n) / 1000, Y0 + rng.integers(0, step, n) / 1000


def made(x, y, z, ground=None, noise=None, core=None, with_params=PARAMS, inside=None):
    x, y, z = (np.asarray(v, float) for v in (x, y, z))
    ground = np.ones(len(x), bool) if ground is None else np.asarray(ground, bool)
    noise = np.zeros(len(x), bool) if noise is None else np.asarray(noise, bool)
    core = Window(with_params.cell, 512000, 5403200, 60, 50) if core is None else core
    inside = core.box.contains(x, y) if inside is None else inside
    return terrain(x, y, z, ground, noise, inside, core, with_params)


def centres(window):
    rows, cols = np.mgrid[: window.nrows, : window.ncols]
    return (window.col + cols + 0.5) * window.cell, (window.row + rows + 0.5) * window.cell


def hills(x, y):
    u, v = x - X0, y - Y0
    return 200 + 12 * np.sin(u / 90) * np.cos(v / 70) + 3 * np.sin(u / 23 + 1) * np.sin(v / 31) + 0.03 * u


def town(size, density, noise, seed=0):
    """x, y, z, ground, true height above ground: hills, houses, halls of 50 to 90 m, some trees."""
    rng = np.random.default_rng(seed)
    x, y = scattered(int(density * size * size), size, seed)
    floor = hills(x, y)
    top, ground = floor.copy(), np.ones(len(x), bool)
    halls = [(150, 150, 70, 90), (230, 240, 50, 60), (400, 100, 60, 60), (470, 380, 40, 80), (100, 430, 66, 66)]
    houses = zip(*rng.uniform(0, size, (2, 150)), *rng.uniform(8, 20, (2, 150)), strict=True)
    for mid_x, mid_y, wide, deep in [*halls, *houses]:
        roof = (np.abs(x - X0 - mid_x) < wide / 2) & (np.abs(y - Y0 - mid_y) < deep / 2)
        top[roof] = hills(X0 + mid_x, Y0 + mid_y) + 8.0
        ground[roof] = False
    tree = ground & (rng.random(len(x)) < 0.15)
    top[tree] += rng.uniform(0.5, 15, tree.sum())
    return x, y, (top + rng.normal(0, noise, len(x))).round(3), ground & ~tree, top - floor


# thinning and facets


def test_thinned_points_are_means_by_cell():
    x, y = scattered(2000, 20)
    z = np.random.default_rng(1).normal(300, 2, 2000).round(3)
    window = Window(1.0, 512000, 5403200, 20, 20)
    mx, my, mz = thin_points(x, y, z, window, 0.5)
    cell = np.floor((y - Y0) / 0.5) * 40 + np.floor((x - X0) / 0.5)
    cells, number = np.unique(cell, return_counts=True)
    for got, given in ((mx, x), (my, y), (mz, z)):
        mean = np.array([given[cell == k].mean() for k in cells])
        np.testing.assert_allclose(got, mean, atol=MILLIMETRE if given is not z else 1e-6)
    assert len(mx) == len(cells)
    assert number.max() > 3


def test_thinning_keeps_a_point_that_is_alone():
    window = Window(1.0, 512000, 5403200, 20, 20)
    mx, my, mz = thin_points(np.array([X0 + 3.217]), np.array([Y0 + 8.001]), np.array([-4.75]), window, 0.3)
    np.testing.assert_allclose([mx[0], my[0], mz[0]], [X0 + 3.217, Y0 + 8.001, -4.75], atol=COORDINATE)


def test_absurdly_fine_thinning_is_refused_with_its_setting():
    with pytest.raises(ConfigError, match=r"terrain\.thin"):
        thin_points(np.zeros(1), np.zeros(1), np.zeros(1), Window(1.0, 0, 0, 400, 400), 0.001)


@pytest.mark.parametrize("n", [40, 3000])
def test_facets_agree_with_scipy_s_interpolation(n):
    x, y = scattered(n, 50, 3)
    z = np.random.default_rng(4).normal(0, 5, n)
    window = Window(0.5, 1024010, 10806410, 70, 60)
    peer = LinearNDInterpolator(np.c_[x - X0, y - Y0], z)
    facets = facets_of(tin_of(x, y, z), np.inf)
    cx, cy = centres(window)
    np.testing.assert_allclose(facet_raster(facets, window), peer(cx - X0, cy - Y0), atol=COORDINATE)
    qx, qy = scattered(5000, 50, 5)
    kept = window.box.contains(qx, qy)
    got = facet_heights(facets, window, qx[kept], qy[kept])
    np.testing.assert_allclose(got, peer(qx[kept] - X0, qy[kept] - Y0), atol=COORDINATE)
    assert kept.sum() > 1000


def test_facets_meet_without_a_gap_on_their_edges():
    """Vertices on a grid and places on the edges between them: exactly where a careless test loses points."""
    gx, gy = (v.ravel() for v in np.meshgrid(X0 + np.arange(0, 40, 4.0), Y0 + np.arange(0, 40, 4.0)))
    facets = facets_of(tin_of(gx, gy, 0.5 * (gx - X0)), 10.0)
    window = Window(1.0, 512000, 5403200, 36, 36)
    px, py = (v.ravel() for v in np.meshgrid(X0 + np.arange(0, 36, 0.5), Y0 + np.arange(0, 36, 0.5)))
    np.testing.assert_allclose(facet_heights(facets, window, px, py), 0.5 * (px - X0), atol=SMALL_COORDINATE)


def test_only_facets_with_a_small_circle_count():
    x, y = X0 + np.array([0, 30, 0, 30.0]), Y0 + np.array([0, 0, 30, 30.5])
    tin = tin_of(x, y, np.zeros(4))
    window = Window(1.0, 512000, 5403200, 30, 30)
    assert np.isnan(facet_raster(facets_of(tin, 21.0), window)).all()
    assert np.isfinite(facet_raster(facets_of(tin, 22.0), window)).all()


# the rasters


def test_a_plane_stays_a_plane_and_its_points_have_height_0():
    x, y = scattered(20000, 60)
    z = 250 + 0.2 * (x - X0) - 0.1 * (y - Y0)
    out = made(x, y, z)
    cx, cy = centres(Window(1.0, 512000, 5403200, 60, 50))
    inner = np.s_[2:, 2:-2]
    plane = 250 + 0.2 * (cx - X0) - 0.1 * (cy - Y0)
    np.testing.assert_allclose(out.dtm[inner], plane[inner], atol=0.0005)
    inside = y < Y0 + 50
    rim = np.minimum(np.minimum(x - X0, X0 + 60 - x), y - Y0)[inside] < 2
    assert np.abs(out.height[~rim]).max() < 0.0005
    # the border of a survey is continued level, over a fraction of a metre here
    assert np.abs(out.height).max() < 0.3
    assert (out.dtm.dtype, out.dsm.dtype, out.support.dtype, out.height.dtype) == ("f4", "f4", "u1", "f4")
    assert len(out.height) == inside.sum()


def test_support_is_the_distance_of_cells_even_to_ground_in_the_halo():
    rng = np.random.default_rng(7)
    ground = rng.integers((-60, -60), (120, 110), (12, 2))  # column, row of cells
    ground[0] = 5, 7
    x, y = X0 + ground[:, 0] + 0.25, Y0 + ground[:, 1] + 0.75
    out = made(x, y, np.zeros(12))
    cols, rows = np.meshgrid(np.arange(60), np.arange(50))
    distance = np.sqrt(((cols[..., None] - ground[:, 0]) ** 2 + (rows[..., None] - ground[:, 1]) ** 2).min(-1))
    expected = np.where(distance == 0, MEASURED, np.where(distance <= 40, INTERPOLATED, BEYOND))
    np.testing.assert_array_equal(out.support, expected)
    np.testing.assert_array_equal(np.isnan(out.dtm), expected == BEYOND)
    np.testing.assert_array_equal(out.distance, np.where(distance <= 40, distance, np.nan).astype(np.float32))
    np.testing.assert_array_equal(out.mask == 0, expected == BEYOND)
    np.testing.assert_array_equal(out.mask == 1, expected == MEASURED)
    assert {MEASURED, INTERPOLATED, BEYOND} == set(np.unique(expected))


def test_terrain_beyond_all_triangles_is_told_from_that_between_them():
    """Ground in a square of 30 m with a hole of 10 m in the middle: the hole is interpolated, what is around is not."""
    x, y = scattered(4000, 30)
    hole = (np.abs(x - X0 - 15) < 5) & (np.abs(y - Y0 - 15) < 5)
    out = made(x[~hole], y[~hole], np.zeros((~hole).sum()))
    assert (out.mask[12:18, 12:18] == 2).all()
    assert (out.mask[:50, 32:60] == 3).all() and (out.mask[32:, :28] == 3).all()
    assert np.mean(out.mask[1:9, 1:29] == 1) > 0.9


def test_the_border_of_a_survey_has_terrain():
    x, y = scattered(4000, 25)
    out = made(x, y, np.full(4000, 31.25))
    assert out.support[:25, :25].max() <= INTERPOLATED
    np.testing.assert_allclose(out.dtm[out.support != BEYOND], 31.25, atol=FLOAT32_HEIGHT)
    assert np.isnan(out.dtm[:, 25 + 41 :]).all()


def test_what_is_no_surface_is_in_no_raster_but_has_a_height():
    x, y = scattered(6000, 60)
    z, noise = np.full(6000, 10.0), np.zeros(6000, bool)
    noise[:50] = True
    z[:25], z[25:50] = -300.0, 900.0
    ground = np.ones(6000, bool)
    out = made(x, y, z, ground, noise)
    np.testing.assert_allclose(out.dtm, 10.0, atol=FLOAT32_HEIGHT)
    assert np.nanmax(out.dsm) == 10.0 == np.nanmin(out.dsm)
    inside = y < Y0 + 50
    np.testing.assert_allclose(out.height, (z - 10.0)[inside], atol=FLOAT32_HEIGHT)


def test_dsm_is_the_highest_echo():
    x, y = scattered(9000, 60, 2)
    z = np.random.default_rng(3).uniform(0, 30, 9000)
    out = made(x, y, z, with_params=params(dsm_gap=0.0))
    expected = -lowest(x, y, -z, Window(1.0, 512000, 5403200, 60, 50))
    np.testing.assert_array_equal(out.dsm, expected.astype(np.float32))
    assert np.isnan(expected).any()


@pytest.mark.parametrize("gap", [0.0, 1.0, 2.0, 3.0, 4.0, 6.0])
def test_gaps_that_are_filled_are_those_that_a_closing_closes(gap):
    rng = np.random.default_rng(5)
    surface = np.where(rng.random((80, 90)) < 0.6, rng.uniform(0, 9, (80, 90)), np.nan)
    surface[20:35, 20:60], surface[50:53, 10:80], surface[60:, 30:] = np.nan, np.nan, np.nan
    steps = disk(gap / 2)
    reach = max(r for r, _ in steps)
    element = np.zeros((2 * reach + 1, 2 * reach + 1), bool)
    element[tuple(np.array(steps).T + reach)] = True
    out = without_pepper(surface, gap)
    closed = ndimage.binary_closing(np.isfinite(surface), element) | np.isfinite(surface)
    np.testing.assert_array_equal(np.isfinite(out), closed)
    np.testing.assert_array_equal(out[np.isfinite(surface)], surface[np.isfinite(surface)])


def test_a_filled_gap_takes_a_height_that_stands_beside_it():
    surface = np.where(np.arange(10) < 5, 0.0, 8.0) * np.ones((10, 1))
    surface[4, 4], surface[6, 5], surface[8, 8] = np.nan, np.nan, np.nan
    out = without_pepper(surface, 2.0)
    assert (out[4, 4], out[6, 5], out[8, 8]) == (0.0, 8.0, 8.0)


# heights


def test_nearest_ground_agrees_with_a_search_of_all():
    x, y = scattered(3000, 60, 4)
    rng = np.random.default_rng(6)
    z, ground = rng.uniform(0, 20, 3000), rng.random(3000) < 0.05
    out = made(x, y, z, ground, with_params=params(height="nearest"))
    inside = y < Y0 + 50
    _, at = cKDTree(np.c_[x, y][ground]).query(np.c_[x, y][inside])
    np.testing.assert_allclose(out.height, (z[inside] - z[ground][at]).astype(np.float32), atol=1e-6)
    assert (out.height[ground[inside]] == 0).all()


def test_the_lower_of_two_ground_points_at_one_distance_counts():
    x, y = X0 + np.array([10.0, 14.0, 12.0, 30.0, 30.0, 30.0]), np.full(6, Y0 + 10.0)
    z, ground = np.array([5.0, 3.0, 9.0, 1.0, 4.0, 7.0]), np.array([1, 1, 0, 1, 1, 0], bool)
    for order in (np.arange(6), np.arange(6)[::-1]):
        out = made(x[order], y[order], z[order], ground[order], with_params=params(height="nearest"))
        np.testing.assert_array_equal(out.height[np.argsort(order)], [0, 0, 6, 0, 0, 6])


def test_height_by_raster_is_the_bilinear_terrain():
    x, y, z, ground, _ = town(60, 4, 0.02)
    out = made(x, y, z, ground, with_params=params(height="raster"), core=Window(1.0, 512000, 5403200, 60, 60))
    expected = z - bilinear(out.dtm, Window(1.0, 512000, 5403200, 60, 60), x, y)
    inner = (np.abs(x - X0 - 30) < 29) & (np.abs(y - Y0 - 30) < 29)
    np.testing.assert_allclose(out.height[inner], expected[inner], atol=FLOAT32_HEIGHT)


def test_tin_and_raster_see_one_ground():
    x, y, z, ground, true = town(120, 4, 0.03)
    core = Window(1.0, 512000, 5403200, 120, 120)
    by = {
        k: made(x, y, z, ground, core=core, with_params=params(height=k)).height for k in ("tin", "raster", "nearest")
    }
    rmse = {k: np.sqrt(np.mean((v - true)[ground] ** 2)) for k, v in by.items() if k != "nearest"}
    assert rmse["tin"] < 0.03
    assert rmse["raster"] < 0.05


def test_thinned_ground_lies_nearer_to_the_truth_than_single_echoes():
    """28 points/m2 with 5 cm of noise: a TIN of all of them has some 3.5 cm of error, of thinned ones half."""
    x, y = scattered(28 * 50 * 50, 50, 9)
    z = hills(x, y) + np.random.default_rng(9).normal(0, 0.05, len(x))
    core = Window(1.0, 512002, 5403202, 46, 46)
    truth = hills(*centres(core))
    fine, coarse = (made(x, y, z, core=core, with_params=params(thin=t)).dtm - truth for t in (0.03, 0.5))
    assert np.sqrt(np.mean(fine**2)) > 0.03
    assert np.sqrt(np.mean(coarse**2)) < 0.02


def test_height_by_tin_is_nearer_to_the_truth_than_by_a_membrane_over_lowest_echoes():
    x, y, z, ground, true = town(200, 4, 0.03)
    core = Window(1.0, 512000, 5403200, 200, 200)
    tin = made(x, y, z, ground, core=core).height
    membrane = z - bilinear(fill_gaps(lowest(x[ground], y[ground], z[ground], core)), core, x, y)
    rmse = [np.sqrt(np.mean((h - true)[ground] ** 2)) for h in (tin, membrane)]
    assert rmse[0] < 0.6 * rmse[1]


# what must not matter


def test_order_does_not_matter_to_the_last_bit():
    x, y, z, ground, _ = town(100, 6, 0.05)
    x[:500], y[:500] = x[500:1000], y[500:1000]  # duplicated places
    noise = np.random.default_rng(1).random(len(x)) < 0.01
    core = Window(1.0, 512020, 5403220, 60, 60)
    for kind in ("tin", "nearest", "raster"):
        one = made(x, y, z, ground, noise, core, params(height=kind))
        for seed in range(3):
            p = np.random.default_rng(seed).permutation(len(x))
            two = made(x[p], y[p], z[p], ground[p], noise[p], core, params(height=kind))
            for name in ("dtm", "dsm", "support"):
                np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
            heights = np.full(len(x), np.nan, np.float32)
            heights[p[core.box.contains(x[p], y[p])]] = two.height
            np.testing.assert_array_equal(one.height, heights[core.box.contains(x, y)])


def test_points_beyond_the_halo_do_not_matter():
    x, y, z, ground, _ = town(300, 1, 0.03)
    core = Window(1.0, 512000, 5403200, 60, 50)
    near = core.box.grown(64.0).contains(x, y)
    one, two = made(x, y, z, ground, core=core), made(x[near], y[near], z[near], ground[near], core=core)
    for name in ("dtm", "dsm", "support", "distance", "mask", "height"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert near.sum() < len(x)


SEAM, SEAM_SHARE = 0.01, 0.001
"""The terrain of blocks differs from that of one block by no more than SEAM [m], but for SEAM_SHARE of the cells."""


@pytest.mark.statistics
def test_blocks_join_without_seams_in_a_town_with_large_halls():
    x, y, z, ground, _ = town(600, 1, 0.03)
    noise = np.zeros(len(x), bool)
    blocks, window = terrain_by_blocks(x, y, z, ground, noise, PARAMS)
    whole = terrain(x, y, z, ground, noise, ~noise, window, PARAMS)
    assert np.mean(np.abs(blocks.dtm - whole.dtm) > SEAM) < SEAM_SHARE
    assert np.mean(np.abs(blocks.height - whole.height) > SEAM) < SEAM_SHARE
    np.testing.assert_array_equal(blocks.support, whole.support)
    np.testing.assert_array_equal(blocks.mask, whole.mask)
    np.testing.assert_array_equal(blocks.distance, whole.distance)
    np.testing.assert_array_equal(blocks.dsm, whole.dsm)
    assert np.isfinite(blocks.dtm).all()


@pytest.mark.statistics
def test_triangles_are_the_same_in_blocks_as_in_one():
    """An L of ground with a wide notch and a lake: only the membrane beyond the triangles may differ, and little."""
    x, y = scattered(300 * 300, 300, 8)
    water = ((x - X0 > 120) & (y - Y0 > 140)) | (np.hypot(x - X0 - 60, y - Y0 - 200) < 35)
    x, y = x[~water], y[~water]
    z = hills(x, y)
    ones, none = np.ones(len(x), bool), np.zeros(len(x), bool)
    small = params(block=64.0)
    blocks, window = terrain_by_blocks(x, y, z, ones, none, small)
    whole = terrain(x, y, z, ones, none, ones, window, small)
    np.testing.assert_array_equal(np.isnan(blocks.dtm), np.isnan(whole.dtm))
    facets = facets_of(tin_of(*thin_points(x, y, z, window, small.thin)), small.largest_circle)
    on = np.isfinite(facet_raster(facets, window))
    np.testing.assert_allclose(blocks.dtm[on], whole.dtm[on], atol=FLOAT32_HEIGHT)
    assert 0 < (~on & np.isfinite(whole.dtm)).sum() < on.sum()


@pytest.mark.parametrize("kind", ["tin", "raster"])
def test_a_halo_that_is_cut_to_what_is_needed_changes_nothing(monkeypatch, kind):
    rng = np.random.default_rng(2)
    x, y = scattered(3 * 200 * 200, 200, 11)
    z = hills(x, y) + rng.normal(0, 0.1, len(x))
    ground = rng.random(len(x)) < 0.7
    for u, v in rng.uniform(60, 140, (8, 2)):  # houses inside, none so large that the whole halo is needed
        ground &= (np.abs(x - X0 - u) > 6) | (np.abs(y - Y0 - v) > 6)
    core = Window(1.0, 512070, 5403270, 60, 50)
    cut = made(x, y, z, ground, core=core, with_params=params(height=kind))
    seen = []

    def uncut(distance, core, outer, with_params):
        seen.append(needed(distance, core, outer, with_params)[0])
        return outer, with_params.largest_circle

    needed = terrain_module._needed_ground
    monkeypatch.setattr(terrain_module, "_needed_ground", uncut)
    whole = made(x, y, z, ground, core=core, with_params=params(height=kind))
    assert seen[0].ncols < 60 + 2 * 40
    np.testing.assert_allclose(cut.dtm, whole.dtm, atol=FLOAT32_HEIGHT)
    np.testing.assert_allclose(cut.height, whole.height, atol=FLOAT32_HEIGHT)


def test_a_cloud_by_blocks_gets_heights_in_its_own_order():
    x, y, z, ground, _ = town(150, 1, 0.02)
    none = np.zeros(len(x), bool)
    p = np.random.default_rng(0).permutation(len(x))
    one, window = terrain_by_blocks(x, y, z, ground, none, params(block=64.0))
    two, _ = terrain_by_blocks(x[p], y[p], z[p], ground[p], none, params(block=64.0))
    np.testing.assert_array_equal(one.height[p], two.height)
    np.testing.assert_array_equal(one.dtm, two.dtm)
    assert np.isfinite(one.height).all()
    assert window.shape == one.dtm.shape == (150, 150)


def test_a_block_without_points_gets_terrain_from_its_neighbours():
    """Ground on both sides of a block that has no echo at all, such as one that a black roof fills."""
    west, east = np.arange(0, 64, 2.0), np.arange(128, 192, 2.0)
    x, y = (v.ravel() for v in np.meshgrid(np.r_[west, east], np.arange(0, 64, 2.0)))
    x, y = x + X0, y + 5403136.0
    none = np.zeros(len(x), bool)
    out, _ = terrain_by_blocks(x, y, np.full(len(x), 3.0), ~none, none, params(block=64.0))
    np.testing.assert_allclose(out.dtm, 3.0, atol=FLOAT32_HEIGHT)


# little to go by

FEW = {
    "none": ([], []),
    "one": ([12.5], [7.25]),
    "two": ([3.0, 20.0], [3.0, 9.0]),
    "one place": ([5.0] * 9, [5.0] * 9),
    "a line": (np.arange(40) * 1.0, np.arange(40) * 0.5),
    "a row": (np.arange(40) * 1.0, [4.0] * 40),
    "duplicated": ([3.0, 3.0, 30.0, 30.0, 12.0, 12.0], [3.0, 3.0, 4.0, 4.0, 30.0, 30.0]),
    "sparse": (np.arange(0, 60, 10.0).repeat(5), np.tile(np.arange(0, 50, 10.0), 6)),
}


@pytest.mark.parametrize("kind", ["tin", "nearest", "raster"])
@pytest.mark.parametrize("name", FEW)
def test_little_ground_is_an_ordinary_case(name, kind):
    gx, gy = (np.asarray(v, float) for v in FEW[name])
    qx, qy = scattered(300, 50, 3)
    x, y = np.r_[X0 + gx, qx], np.r_[Y0 + gy, qy]
    ground = np.arange(len(x)) < len(gx)
    z = np.where(ground, 7.5, 11.0)
    out = made(x, y, z, ground, with_params=params(height=kind))
    there = out.support != BEYOND
    np.testing.assert_allclose(out.dtm[there], 7.5, atol=FLOAT32_HEIGHT)
    assert np.isnan(out.dtm[~there]).all()
    assert there.any() == (len(gx) > 0)
    known = out.support[(y - Y0).astype(int), (x - X0).astype(int)] != BEYOND
    np.testing.assert_allclose(out.height[known], np.where(ground, 0.0, 3.5)[known], atol=FLOAT32_HEIGHT)
    assert np.isnan(out.height[~known]).all()


def test_no_points_at_all():
    out = made([], [], [])
    assert np.isnan(out.dtm).all()
    assert np.isnan(out.dsm).all()
    assert (out.support == BEYOND).all()
    assert out.height.shape == (0,)
    none = np.zeros(0, bool)
    with pytest.raises(InputError, match="no points"):
        terrain_by_blocks(np.zeros(0), np.zeros(0), np.zeros(0), none, none, PARAMS)


def test_a_point_asked_for_outside_the_block_has_no_height():
    x, y = np.array([X0 + 5, X0 - 10, X0 + 9000]), np.array([Y0 + 5, Y0 + 5, Y0 + 5])
    out = made(x, y, np.zeros(3), inside=np.ones(3, bool))
    np.testing.assert_array_equal(np.isnan(out.height), [False, True, True])


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"max_gap": 65.0}, "max_gap"),
        ({"dsm_gap": 65.0}, "dsm_gap"),
        ({"block_halo": 64.5}, "block_halo"),
        ({"block": 100.5}, "block"),
        ({"thin": 0.0}, "thin"),
    ],
)
def test_parameters_that_cannot_be_are_refused(changes, name):
    with pytest.raises(ValidationError, match=name):
        params(**changes)


def test_cells_of_another_size_are_refused():
    with pytest.raises(ValueError, match=r"terrain\.cell"):
        made([], [], [], core=Window(2.0, 0, 0, 5, 5))


@pytest.mark.parametrize("most", [1, 10, 10**9])
def test_nearest_ground_is_the_same_in_a_crowd(monkeypatch, most):
    """Of the tree for crowded cells and of the walk over cells, against all distances; few places, so that many tie."""
    monkeypatch.setattr(nearest, "CROWDED", most)
    rng = np.random.default_rng(most % 7)
    gx, gy = rng.integers(0, 40, (2, 900)) * 0.05 + 3.0
    gz = rng.normal(100.0, 1.0, 900).round(3)
    px, py = rng.integers(0, 160, (2, 500)) * 0.05
    pz = np.full(500, 110.0)
    above = nearest.nearest_height((gx, gy, gz), (px, py, pz), Window(1.0, 0, 0, 8, 8), 8.0)
    square = (np.rint(gx * 1000)[:, None] - np.rint(px * 1000)) ** 2 + (
        np.rint(gy * 1000)[:, None] - np.rint(py * 1000)
    ) ** 2
    lowest = np.where(square == square.min(axis=0), gz[:, None], np.inf).min(axis=0)
    assert (above == pz - lowest).all()


def test_a_crowd_of_ground_points_takes_no_walk_over_all_of_them(monkeypatch):
    met = []
    monkeypatch.setattr(nearest, "_nearest", lambda *words: met.append(words))
    rng = np.random.default_rng(2)
    x, y, z = rng.uniform(0, 0.5, 50_000).round(3), rng.uniform(0, 0.5, 50_000).round(3), np.zeros(50_000)
    above = nearest.nearest_height((x, y, z), (x, y, z + 3.0), Window(1.0, 0, 0, 1, 1), 5.0)
    assert not met and (above == 3.0).all()


def test_equal_distances_of_more_places_than_are_looked_at(monkeypatch):
    monkeypatch.setattr(nearest, "CROWDED", 1)
    legs = [(a, b) for a, b in ((25, 0), (7, 24), (15, 20), (20, 15), (24, 7), (0, 25))]
    ring = np.array(sorted({(s * a, t * b) for a, b in legs for s in (1, -1) for t in (1, -1)}), float)
    z = np.arange(len(ring), 0, -1.0)
    place = 0.5 + ring.T / 1000
    above = nearest.nearest_height(
        (*place, z), (np.array([0.5]), np.array([0.5]), np.array([50.0])), Window(1.0, 0, 0, 1, 1), 5.0
    )
    assert len(ring) == 20 and above[0] == 49.0
