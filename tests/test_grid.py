"""Tiles and windows: one owner for every point, whole millimetres, slices that fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.errors import ConfigError
from fwclass.grid import Box, TileGrid, Window, millimetres, quantise, whole_millimetres

coordinate = st.integers(-(10**10), 10**10)


@settings(max_examples=200)
@given(coordinate, coordinate, st.sampled_from([0.5, 7.0, 50.0, 100.0, 150.0]))
def test_every_point_has_exactly_one_owner(mx, my, size):
    x, y = np.array([mx / 1000.0]), np.array([my / 1000.0])
    grid = TileGrid(size)
    ix, iy = grid.indices(x, y)
    owner = grid.tile(f"{ix[0]}_{iy[0]}")
    assert owner.box.contains(x, y)[0]
    around = [tile for tile in grid.touching(owner.box.grown(size)) if tile.box.contains(x, y)[0]]
    assert around == [owner]


@settings(max_examples=200)
@given(st.integers(-(10**7), 10**7), st.integers(1, 10**6))
def test_a_place_on_an_edge_is_the_edge_to_the_last_bit(ix, mm):
    """Tiles of 11.3 m: one part in a million of the places lay outside of the box of the tile that owned them."""
    edge = np.array([ix * mm / 1000.0])
    owner = TileGrid(mm / 1000.0).tile(f"{ix}_{ix}")
    assert owner.box.xmin == quantise(edge)[0] == owner.box.ymin
    assert owner.box.holds(owner.box) and not owner.box.holds(owner.box.moved(0.001, 0.0))


@given(coordinate)
def test_millimetres_go_there_and_back(mm):
    metres = np.array([mm / 1000.0])
    assert millimetres(metres)[0] == mm
    assert millimetres(quantise(metres))[0] == mm


def test_touching_is_every_tile_that_shares_area_and_no_other():
    keys = [t.key for t in TileGrid(10.0).touching(Box(-10.0, 0.0, 10.001, 10.0))]
    assert keys == ["-1_0", "0_0", "1_0"]


@pytest.mark.parametrize("length", [0.0, -1.0, 0.0005, 1.00049])
def test_lengths_that_are_no_whole_millimetres_are_refused(length):
    with pytest.raises(ConfigError):
        whole_millimetres(length, "cell")
    with pytest.raises(ConfigError):
        TileGrid(length)


@pytest.mark.parametrize("key", ["", "3", "3_", "a_b", "1_2_3", "1.5_2"])
def test_what_is_no_tile_key_is_refused(key):
    with pytest.raises(ConfigError):
        TileGrid(10.0).tile(key)


def test_boxes_are_half_open():
    box = Box(0.0, 0.0, 1.0, 1.0)
    np.testing.assert_array_equal(box.contains(np.array([0.0, 1.0, 0.5]), np.array([0.0, 0.5, 0.999])), [1, 0, 1])
    assert not box.touches(Box(1.0, 0.0, 2.0, 1.0))
    assert box.touches(box.grown(-0.25))


def test_window_covers_its_box_and_no_cell_more():
    w = Window.covering(Box(-0.5, 2.0, 3.0, 4.25), 1.0)
    assert (w.col, w.row, w.ncols, w.nrows) == (-1, 2, 4, 3)
    assert w.shape == (3, 4)
    assert w.box == Box(-1.0, 2.0, 3.0, 5.0)
    grown = Window.covering(Box(-0.5, 2.0, 3.0, 4.25), 1.0, margin=2)
    assert (grown.col, grown.row, grown.ncols, grown.nrows) == (-3, 0, 8, 7)
    assert w.within(grown) == (slice(2, 5), slice(2, 6))


@given(st.tuples(coordinate, coordinate), st.tuples(st.integers(0, 10**6), st.integers(0, 10**6)))
def test_points_on_the_upper_edge_open_no_cell_of_their_own(low, lengths):
    high = [a + b for a, b in zip(low, lengths, strict=True)]
    box = Box(*(v / 1000.0 for v in low), *((v + 1) / 1000.0 for v in high))
    w, wide = Window.of_points(box, 0.5), Window.covering(box, 0.5)
    assert (w.col, w.row) == (wide.col, wide.row) and min(w.shape) > 0
    for cells, every, first, last in ((w.ncols, wide.ncols, w.col, high[0]), (w.nrows, wide.nrows, w.row, high[1])):
        assert (first + cells) * 500 >= last > (first + cells - 1) * 500 or cells == 1
        assert every - cells == (last % 500 == 0 and every > 1)


def test_common_cells_of_two_windows_index_the_same_ground():
    one, other = Window(1.0, 0, 0, 6, 5), Window(1.0, 4, 3, 6, 5)
    common = one.common(other)
    assert common == Window(1.0, 4, 3, 2, 2)
    rows, cols = np.mgrid[:5, :6]
    a = (rows * 100 + cols)[common.within(one)]
    b = ((rows + 3) * 100 + cols + 4)[common.within(other)]
    np.testing.assert_array_equal(a, b)
    assert one.common(Window(1.0, 6, 0, 2, 2)) is None


def test_a_window_outside_or_of_another_cell_does_not_lie_within():
    outer = Window(1.0, 0, 0, 6, 5)
    for inner in (Window(1.0, -1, 0, 2, 2), Window(1.0, 5, 0, 2, 2), Window(2.0, 0, 0, 2, 2)):
        with pytest.raises(ValueError, match="does not lie inside"):
            inner.within(outer)


@pytest.mark.parametrize("origin", [(0.0, 0.0), (50.0, 50.0), (-12.345, 730.001), (99.999, 0.001)])
def test_a_grid_may_have_another_origin(origin):
    """As the grid of origin 0 over points moved back: owners, boxes and what a box touches."""
    r = np.random.default_rng(7)
    x, y = np.round(512_000 + r.uniform(-300, 300, 500), 3), np.round(5_403_000 + r.uniform(-300, 300, 500), 3)
    grid = TileGrid(100.0, origin)
    ix, iy = grid.indices(x, y)
    back = TileGrid(100.0).indices(x - origin[0], y - origin[1])
    assert (ix == back[0]).all() and (iy == back[1]).all()
    for k in range(0, 500, 25):
        tile = grid.tile(f"{ix[k]}_{iy[k]}")
        assert tile.origin == origin and tile.box.contains(x[k : k + 1], y[k : k + 1]).all()
        assert [t.key for t in grid.touching(Box(x[k], y[k], x[k] + 0.001, y[k] + 0.001))] == [tile.key]
        assert {t.key for t in grid.touching(tile.box)} == {tile.key}
        wider = tile.box.grown(0.001)
        assert len(list(grid.touching(wider))) == 9
        assert list(grid.keys_touching(wider)) == [t.key for t in grid.touching(wider)]


def test_boxes_move_and_meet():
    box = Box(0.0, 0.0, 10.0, 5.0)
    assert box.moved(2.0, -1.0) == Box(2.0, -1.0, 12.0, 4.0)
    assert box.common(Box(5.0, 4.0, 20.0, 20.0)) == Box(5.0, 4.0, 10.0, 5.0)
    assert box.common(Box(10.0, 0.0, 11.0, 5.0)) is None


@pytest.mark.parametrize("size", [0.003, 1.0, 12.345, 250.0])
def test_corners_of_tiles_lie_in_the_middle_of_those_halfway(size):
    grid = TileGrid(size, (0.2, -7.0))
    x, y = 0.2 + 3 * size, -7.0 - 5 * size
    columns, rows = grid.halfway().indices(np.array([x]), np.array([y]))
    box = grid.halfway().tile(f"{columns[0]}_{rows[0]}").box
    for edge, point in zip(box.bounds, (x, y, x, y), strict=True):
        assert abs(abs(edge - point) - size / 2) < 0.00101
