"""Openings against a brute-force disk, filling against the exact membrane, bilinear values against planes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve
from tolerances import SMALL_COORDINATE

from fwclass.grid import Window
from fwclass.ground.methods.smrf import objects
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.fill import SWEEPS, _relax, _relax_rows, fill_gaps
from fwclass.ground.raster.lattice import lowest
from fwclass.ground.raster.opening import disk_opening
from fwclass.ground.raster.surface import domain, gradient, low_limit


def brute_extreme(surface, radius, function):
    nrows, ncols = surface.shape
    out = np.full(surface.shape, np.nan)
    for r in range(nrows):
        for c in range(ncols):
            inside = [
                surface[i, j]
                for i in range(max(0, r - radius), min(nrows, r + radius + 1))
                for j in range(max(0, c - radius), min(ncols, c + radius + 1))
                if (i - r) ** 2 + (j - c) ** 2 <= radius**2 and not np.isnan(surface[i, j])
            ]
            if inside and not np.isnan(surface[r, c]):
                out[r, c] = function(inside)
    return out


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 3), (24, 31)])
@pytest.mark.parametrize("radius", [0, 1, 2, 3, 6, 11])
def test_opening_is_the_highest_of_the_lowest_in_a_disk(shape, radius):
    surface = np.random.default_rng(3).normal(size=shape)
    if surface.size > 20:
        surface[:5, 1] = np.nan
    expected = brute_extreme(brute_extreme(surface, radius, min), radius, max)
    np.testing.assert_array_equal(disk_opening(surface, radius), expected)


def test_opening_never_rises_and_repeats_itself():
    surface = np.random.default_rng(5).normal(size=(30, 30))
    once = disk_opening(surface, 4)
    assert (once <= surface).all()
    np.testing.assert_array_equal(disk_opening(once, 4), once)


def membrane(surface):
    """The exact solution, by a direct solver."""
    nrows, ncols = surface.shape
    rows, cols, values, right = [], [], [], np.zeros(surface.size)
    for r in range(nrows):
        for c in range(ncols):
            i = r * ncols + c
            if not np.isnan(surface[r, c]):
                rows.append(i), cols.append(i), values.append(1.0)
                right[i] = surface[r, c]
                continue
            around = [(r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)]
            around = [(a, b) for a, b in around if 0 <= a < nrows and 0 <= b < ncols]
            rows.append(i), cols.append(i), values.append(float(len(around)))
            for a, b in around:
                rows.append(i), cols.append(a * ncols + b), values.append(-1.0)
    system = sparse.csc_matrix((values, (rows, cols)), (surface.size, surface.size))
    return spsolve(system, right).reshape(surface.shape)


def hills(nrows, ncols):
    y, x = np.mgrid[:nrows, :ncols]
    return 0.1 * x + 3.0 * np.sin(x / 17.0) * np.cos(y / 23.0)


FILL_TOLERANCE = 0.02
"""[m] What a fixed number of sweeps may leave of the exact membrane where a hole is at most 40 cells wide."""


@pytest.mark.parametrize("share", [0.05, 0.3, 0.9])
def test_filling_agrees_with_the_exact_membrane(share):
    rng = np.random.default_rng(7)
    truth = hills(90, 110)
    surface = np.where(rng.random(truth.shape) < share, truth, np.nan)
    surface[30:60, 40:80] = np.nan
    out = fill_gaps(surface)
    known = np.isfinite(surface)
    np.testing.assert_array_equal(out[known], surface[known])
    assert np.abs(out - membrane(surface)).max() < FILL_TOLERANCE


def test_filling_of_nothing_everything_and_one_cell():
    nothing = np.full((5, 6), np.nan)
    assert np.isnan(fill_gaps(nothing)).all()
    everything = hills(5, 6)
    np.testing.assert_array_equal(fill_gaps(everything), everything)
    one = nothing.copy()
    one[4, 0] = 12.5
    np.testing.assert_allclose(fill_gaps(one), 12.5, atol=SMALL_COORDINATE)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 2), (5, 8), (40, 33)])
@pytest.mark.parametrize("share", [0.02, 0.09, 0.5, 0.98])
def test_a_membrane_is_the_same_cell_by_cell_and_row_by_row(shape: tuple[int, int], share: float) -> None:
    rng = np.random.default_rng(3)
    known = rng.random(shape) >= share
    apart = np.where(known, rng.normal(200, 30, shape), 180.0)
    rows, cells = apart.copy(), apart.copy()
    _relax_rows(known, SWEEPS, 1.6, rows)
    for colour in [k % 2 for k in range(2 * SWEEPS)]:
        around = np.pad(cells, 1, mode="edge")
        across, along = around[1:-1, :-2] + around[1:-1, 2:], around[:-2, 1:-1] + around[2:, 1:-1]
        drawn = cells + 1.6 * (0.25 * (across + along) - cells)
        cells = np.where(~known & (np.indices(shape).sum(0) % 2 == colour), drawn, cells)
    np.testing.assert_array_equal(rows, cells)
    _relax(known, SWEEPS, 1.6, apart)
    np.testing.assert_array_equal(apart, cells)


def test_filling_stays_between_the_known_values():
    rng = np.random.default_rng(11)
    surface = np.where(rng.random((64, 64)) < 0.02, rng.random((64, 64)), np.nan)
    out = fill_gaps(surface)
    # over-relaxation may overshoot by what it has not yet settled
    assert np.nanmin(surface) - FILL_TOLERANCE < out.min()
    assert out.max() < np.nanmax(surface) + FILL_TOLERANCE


WINDOW = Window(cell=2.0, col=1000, row=-30, ncols=12, nrows=9)


def test_bilinear_of_a_plane_is_the_plane_between_the_outermost_centres():
    rows, cols = np.mgrid[:9, :12]
    x, y = (1000 + cols + 0.5) * 2.0, (-30 + rows + 0.5) * 2.0
    rng = np.random.default_rng(13)
    px, py = rng.uniform(2001, 2023, 200).round(3), rng.uniform(-59, -43, 200).round(3)
    got = bilinear(5.0 + 0.3 * x - 0.2 * y, WINDOW, px, py)
    np.testing.assert_allclose(got, 5.0 + 0.3 * px - 0.2 * py, atol=SMALL_COORDINATE)


def test_bilinear_without_value_only_where_the_own_cell_has_none():
    raster = np.full(WINDOW.shape, 7.0)
    raster[4, 5] = np.nan
    x = np.array([2011.0, 2009.9, 2012.0, 1999.9, 2024.0])
    got = bilinear(raster, WINDOW, x, np.full(5, -51.0))
    np.testing.assert_array_equal(got, [np.nan, 7.0, 7.0, np.nan, np.nan])


def test_lowest_is_by_half_open_cell():
    w = Window(1.0, 10, 20, 2, 1)
    x = np.array([10.0, 10.999, 11.0, 9.999, 12.0])
    z = np.array([3.0, 2.0, 5.0, -9.0, -9.0])
    np.testing.assert_array_equal(lowest(x, np.full(5, 20.5), z, w), [[2.0, 5.0]])
    assert np.isnan(lowest(x[:0], x[:0], x[:0], w)).all()


def test_gradient_of_a_plane():
    y, x = np.mgrid[:5, :6].astype(float)
    np.testing.assert_allclose(gradient(3.0 * x + 4.0 * y, 0.5), 10.0)
    np.testing.assert_array_equal(gradient(np.zeros((1, 1)), 1.0), 0.0)


def test_objects_are_what_stands_out_and_is_narrower_than_the_window():
    ground = 0.1 * np.mgrid[:80, :80][1].astype(float)
    surface = ground.copy()
    surface[20:40, 20:40] += 6.0  # a house of 20 m
    surface[60, 10] += 2.0  # a bush
    found = objects(surface, 1.0, 0.15, 18.0)
    expected = surface > ground
    np.testing.assert_array_equal(found, expected)
    surface = ground.copy()
    surface[10:70, 10:70] += 6.0  # 60 m: wider than the window
    assert not objects(surface, 1.0, 0.15, 18.0)[35:45, 35:45].any()


def test_a_pit_of_a_cell_is_low_and_a_trench_is_not():
    surface = np.zeros((20, 20))
    surface[5, 5] = -300.0
    surface[10:15, :] = -8.0
    low = surface < low_limit(surface, 1.0, 5.0)
    assert low[5, 5]
    assert low.sum() == 1


def test_domain_closes_gaps_inside_and_adds_nothing_outside():
    measured = np.zeros((60, 60), bool)
    measured[20:40, 20:40] = True
    measured[28:33, 28:33] = False
    closed = domain(measured, 6.0)
    expected = np.zeros_like(measured)
    expected[20:40, 20:40] = True
    np.testing.assert_array_equal(closed, expected)


@pytest.mark.parametrize("share", [0.002, 0.05, 0.6, 1.0])
@pytest.mark.parametrize("radius", [0.0, 1.0, 2.5, 5**0.5, 3 * 2**0.5, 12.0, 200.0])
def test_domain_is_the_closing_by_distances(share, radius):
    measured = np.random.default_rng(2).random((40, 61)) < share
    measured[7, 3] = True
    near = ndimage.distance_transform_edt(~measured) <= radius
    closed = near if near.all() else (ndimage.distance_transform_edt(near) > radius) | measured
    np.testing.assert_array_equal(domain(measured, radius), closed)


def test_rows_without_a_cell_take_no_part_in_an_opening():
    surface = np.full((30, 20), np.nan)
    surface[[2, 3, 3, 15, 16], [4, 4, 9, 12, 11]] = 1.0, 3.0, 2.0, 5.0, 4.0
    expected = brute_extreme(brute_extreme(surface, 3, min), 3, max)
    np.testing.assert_array_equal(disk_opening(surface, 3), expected)
