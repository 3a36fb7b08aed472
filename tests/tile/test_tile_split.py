"""Every echo has exactly one owner, whatever the chunks; rows of a tile have one order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fwclass.errors import InputError
from fwclass.grid import TileGrid
from fwclass.schema import Table
from fwclass.tile.stage import assemble, assemble_points, morton, split


def echoes(n=3000, seed=0, low=-250.0, high=250.0):
    r = np.random.default_rng(seed)
    return Table(
        {
            "strip": r.integers(0, 3, n),
            "pulse": np.arange(n),
            "echo_number": r.integers(1, 4, n),
            "x": np.round(r.uniform(low, high, n), 3),
            "y": np.round(r.uniform(low, high, n), 3),
        }
    )


def fragments(chunks, grid):
    found = {}
    for chunk in chunks:
        s = split(chunk, grid)
        for k, key in enumerate(s.keys):
            found.setdefault(key, []).append(s.table.take(slice(s.offsets[k], s.offsets[k + 1])))
    return found


def test_every_row_goes_to_the_tile_that_contains_it_and_to_no_other():
    table, grid = echoes(), TileGrid(100.0)
    found = fragments([table], grid)
    assert sum(t.rows for parts in found.values() for t in parts) == table.rows
    for key, parts in found.items():
        for part in parts:
            assert grid.tile(key).box.contains(part["x"], part["y"]).all()


@given(st.integers(-(10**9), 10**9), st.sampled_from([1.0, 12.5, 100.0, 0.001]))
def test_points_on_edges_have_one_owner(k, size):
    grid = TileGrid(size)
    x = np.array([k * size])
    if abs(x[0]) < 2e6:
        ix, _ = grid.indices(x, x)
        assert ix[0] == k
        owners = [t.key for t in grid.touching(grid.tile(f"{k}_{k}").box) if t.box.contains(x, x)[0]]
        assert owners == [f"{k}_{k}"]


def test_the_order_of_a_tile_does_not_depend_on_chunks():
    table, grid = echoes(), TileGrid(100.0)
    shuffled = table.take(np.random.default_rng(5).permutation(table.rows))
    one = fragments([table], grid)
    many = fragments([shuffled.take(slice(i, i + 700)) for i in range(0, shuffled.rows, 700)], grid)
    assert set(one) == set(many)
    for key in one:
        a, b = assemble(one[key], key), assemble(many[key][::-1], key)
        for n in a:
            np.testing.assert_array_equal(a[n], b[n])


def test_a_repeated_identity_is_refused():
    table = echoes(10)
    with pytest.raises(InputError, match="same strip, pulse and echo number"):
        assemble([table, table.take([3])], "tile 0_0")


def test_morton_keeps_neighbours_together():
    """In Morton order the mean step is far shorter than in random order."""
    table = echoes(4000)
    order = np.argsort(morton(table["x"], table["y"]), kind="stable")

    def step(o):
        return np.hypot(np.diff(table["x"][o]), np.diff(table["y"][o])).mean()

    assert step(order) < 0.1 * step(np.arange(table.rows))


def test_reference_points_have_one_order():
    r = np.random.default_rng(2)
    n = 500
    cloud = Table(
        {
            "x": r.integers(0, 5, n),
            "y": r.integers(0, 5, n),
            "z": r.integers(0, 3, n),
            "gps_time": r.integers(0, 4, n),
            "source_class": r.integers(1, 7, n),
        }
    )
    a = assemble_points([cloud])
    b = assemble_points([cloud.take(slice(100, None)), cloud.take(slice(0, 100))])
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])
