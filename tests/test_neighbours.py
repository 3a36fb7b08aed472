"""The sorted cell grid and the nearest-neighbour search, against a k-d tree over millimetres."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from tolerances import COORDINATE

from fwclass import neighbours
from fwclass.errors import InputError
from fwclass.grid import millimetres
from fwclass.neighbours import CellIndex, nearest_within, sort_by_cell

OFFSET = np.array([512_000.0, 5_403_000.0, 290.0])


def points(seed, n, spread=20.0):
    return tuple((np.random.default_rng(seed).uniform(0, spread, (n, 3)) + OFFSET).round(3).T)


def test_every_point_is_in_its_cell_once_and_rows_keep_their_order():
    x, y, z = points(1, 2000)
    index = CellIndex.build(x, y, z, cell=1.5)
    np.testing.assert_array_equal(np.sort(index.order), np.arange(2000))
    for name, values, origin in (("x", x, index.x0), ("y", y, index.y0), ("z", z, index.z0)):
        np.testing.assert_array_equal(getattr(index, name) + origin, millimetres(values)[index.order])
    cell = (index.y // index.cell) * index.ncols + index.x // index.cell
    counts = np.diff(index.start)
    np.testing.assert_array_equal(np.repeat(np.arange(len(counts)), counts), cell)
    same = cell[1:] == cell[:-1]
    assert (np.diff(index.order)[same] > 0).all()
    assert index.x0 % index.cell == 0
    assert index.y0 % index.cell == 0


def test_no_points_make_an_empty_index():
    none = np.empty(0)
    index = CellIndex.build(none, none, none, cell=1.0)
    assert len(index.order) == 0
    assert index.start[-1] == 0


def test_points_too_far_apart_are_refused_before_anything_is_allocated():
    far = np.array([0.0, 1e6])
    with pytest.raises(InputError, match="spread too far"):
        CellIndex.build(far, far, far, cell=1.0)


@pytest.mark.parametrize("far", [16_300.0, 5e5, 1e9])
def test_memory_of_the_nearest_search_does_not_grow_with_the_extent(far):
    """Finding A8: two points a side, 16 km apart, took 4.4 GB."""
    a = tuple(np.array([0.0, far]) for _ in range(3))
    b = tuple(np.array([far, 0.5]) for _ in range(3))
    nearest_within(b, a, 1.0)  # compiled, or loaded
    tracemalloc.start()
    found, _ = nearest_within(a, b, 1.0)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.tolist() == [1, 0]
    assert most < 1e6


def test_sorted_cells_need_one_offset_each():
    order, start = sort_by_cell(np.array([3, 0, 3, 1]), 5)
    assert order.tolist() == [1, 3, 0, 2]
    assert start.tolist() == [0, 1, 2, 2, 4, 4]


@pytest.mark.parametrize("limit", [0.2, 1.0, 7.5])
def test_offsets_of_occupied_cells_alone_give_the_same_neighbours(limit, monkeypatch):
    queries, among = points(5, 700, 24.0), points(6, 900)
    plain = nearest_within(queries, among, limit)
    monkeypatch.setattr(neighbours, "FEW_CELLS", 0)
    monkeypatch.setattr(neighbours, "CELLS_PER_POINT", 0)
    index = CellIndex.build(*among, cell=limit, asked=700)
    assert len(index.start) == len(index.occupied) + 1
    for mine, other in zip(plain, nearest_within(queries, among, limit), strict=True):
        np.testing.assert_array_equal(mine, other)


def within(points_, among, limit):
    """Nearest by brute force, in exact millimetres."""
    a = np.stack([millimetres(v) for v in among], axis=1)
    out = []
    for p in np.stack([millimetres(v) for v in points_], axis=1):
        squares = ((a - p) ** 2).sum(1)
        out.append(np.sqrt(squares.min()) / 1000.0 if len(a) and squares.min() <= (limit * 1000) ** 2 else np.nan)
    return np.array(out)


@pytest.mark.parametrize("limit", [0.2, 1.0, 7.5])
def test_nearest_is_that_of_a_kd_tree(limit):
    queries, among = points(2, 500, 24.0), points(3, 800)
    found, distance = nearest_within(queries, among, limit)
    tree = cKDTree(np.stack([millimetres(v) for v in among], axis=1).astype(float))
    expected, _ = tree.query(np.stack([millimetres(v) for v in queries], axis=1).astype(float))
    hit = expected <= limit * 1000.0
    np.testing.assert_array_equal(found >= 0, hit)
    np.testing.assert_allclose(distance[hit], expected[hit] / 1000.0)
    assert np.isnan(distance[~hit]).all()
    chosen = np.stack([v[found[hit]] for v in among]) - np.stack([v[hit] for v in queries])
    np.testing.assert_allclose(np.sqrt((chosen**2).sum(0)), distance[hit], atol=COORDINATE)


def test_nearest_of_nothing_and_among_nothing():
    none = (np.empty(0),) * 3
    found, distance = nearest_within(points(4, 3), none, 1.0)
    np.testing.assert_array_equal(found, -1)
    assert np.isnan(distance).all()
    assert len(nearest_within(none, points(4, 3), 1.0)[0]) == 0


def test_a_point_at_exactly_the_limit_is_near():
    found, distance = nearest_within(
        (np.array([0.0]), np.array([0.0]), np.array([0.0])),
        (np.array([1.0, 1.001]), np.array([0.0, 0.0]), np.array([0.0, 0.0])),
        1.0,
    )
    assert (found[0], distance[0]) == (0, 1.0)


def test_ties_go_to_the_cell_in_the_south_then_west_then_to_the_lower_row():
    zero = np.zeros(1)
    among = (np.array([0.5, -0.5, -0.5, 0.0]), np.array([0.0, 0.0, 0.0, -0.5]), np.zeros(4))
    assert nearest_within((zero, zero, zero), among, 1.0)[0][0] == 3
    assert nearest_within((zero, zero, zero), tuple(v[:3] for v in among), 1.0)[0][0] == 1


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(-3000, 3000)] * 3), max_size=30),
    st.lists(st.tuples(*[st.integers(-3000, 3000)] * 3), max_size=30),
    st.sampled_from([0.001, 0.5, 1.0, 2.5]),
)
def test_nearest_of_any_points(queries, among, limit):
    q = tuple(np.array([p[k] for p in queries], float) / 1000.0 for k in range(3))
    a = tuple(np.array([p[k] for p in among], float) / 1000.0 for k in range(3))
    found, distance = nearest_within(q, a, limit)
    np.testing.assert_allclose(distance, within(q, a, limit) if len(among) else np.full(len(queries), np.nan))
    np.testing.assert_array_equal(found < 0, np.isnan(distance))


@pytest.mark.parametrize("limit", [0.2, 1.0, 7.5])
@pytest.mark.parametrize("grid", [0.001, 0.5])
def test_the_nearest_in_a_crowd_is_that_of_the_plain_search_with_its_ties(limit, grid, monkeypatch):
    queries, among = points(8, 600, 6.0), points(9, 900, 6.0)
    queries, among = (tuple((v / grid).round() * grid for v in cloud) for cloud in (queries, among))
    among = tuple(np.append(v, np.full(50, v[3])) for v in among)
    plain = nearest_within(queries, among, limit)
    monkeypatch.setattr(neighbours, "CROWDED", 0)
    monkeypatch.setattr(neighbours, "AT_A_TIME", 170)
    for mine, other in zip(plain, nearest_within(queries, among, limit), strict=True):
        np.testing.assert_array_equal(mine, other)


def test_equal_points_stand_for_one():
    """60 000 at one place, looked at from as many a millimetre beside: 3.6e9 pairs by the plain search."""
    n = 60_000
    among, queries = (np.zeros(n),) * 3, (np.full(n, 0.001),) * 3
    found, distance = nearest_within(queries, among, 1.0)
    assert (found == 0).all()
    np.testing.assert_allclose(distance, np.sqrt(3e-6))


@pytest.mark.parametrize("many", [1, 3000])
def test_heights_whose_square_no_whole_number_holds_are_far(many):
    """2^32 mm squared is 0 in 64 bits."""
    among = (np.zeros(many), np.zeros(many), np.full(many, 2**32 / 1000))
    row, distance = nearest_within((np.zeros(1), np.zeros(1), np.zeros(1)), among, 1.0)
    assert row[0] == -1 and np.isnan(distance[0])
