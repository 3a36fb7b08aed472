"""Places with more echoes than any survey has: what counts there, that tiles change nothing, that it is told."""

from __future__ import annotations

from types import SimpleNamespace

import laspy
import numpy as np
import pytest
from commandline import fwclass

from fwclass import conf
from fwclass.features import orientation, spheres
from fwclass.features.dense import Crowd, crowd_facts, thin_dense
from fwclass.features.gather import slices
from fwclass.features.names import FeatureRequest
from fwclass.features.params import NORMAL
from fwclass.features.stage import features
from fwclass.graph.features import compute_features
from fwclass.grid import Box, Tile, TileGrid
from fwclass.schema import Table
from fwclass.stage import Chunk

PARAMS = conf.section("features", ("features.noise_counts=true",)).model_copy(
    update={"optimal_radii": (0.5, 1.0), "nearest_reach": 2.0, "orientation_rounds": 2, "pulse_reach": 3.0}
)
NAMES = (
    "planarity_r100",
    "density_c150",
    "height_above_p50_c100",
    "plane_range_r70",
    "echo_ratio_r50",
    "verticality_opt",
    "optimal_radius",
    "linearity_k20",
    "oriented_inclination_r50",
    "count_g100",
    "amplitude_mean_c100",
    "zc",
    "pulse_intensity_variance",
)
EAST, NORTH = 500_000.0, 5_400_000.0
WHOLE = Tile(0, 0, 1e7)


def table_of(x, y, z, seed=3):
    """Echoes at the given places, in canonical order as they stand."""
    n, rng = len(x), np.random.default_rng(seed)
    return Table(
        {
            "strip": np.zeros(n, int),
            "pulse": np.arange(n),
            "gps_time": np.arange(n) * 1e-5,
            "echo_number": np.ones(n, int),
            "number_of_echoes": np.ones(n, int),
            "x": (EAST + x).round(3),
            "y": (NORTH + y).round(3),
            "z": np.round(290.0 + z, 3),
            "amplitude": rng.uniform(5, 200, n),
            "width": rng.uniform(3, 7, n),
            "intensity": rng.integers(0, 65536, n),
        }
    )


def crowded(n=4000, blob=(5.0, 5.0), seed=1):
    """Even ground of 10 m, and `n` echoes within a few decimetres of a place: across cubes, tiles and cells."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 10, (2, 600))
    z = 0.05 * x + rng.normal(0, 0.02, 600)
    x = np.concatenate([x, blob[0] + rng.normal(0, 0.12, n), np.full(300, 2.0)])
    y = np.concatenate([y, blob[1] + rng.normal(0, 0.12, n), np.full(300, 7.0)])
    z = np.concatenate([z, rng.normal(0.3, 0.03, n), np.full(300, 0.1)])
    mixed = rng.permutation(len(x))
    return table_of(x[mixed], y[mixed], z[mixed])


def whole(table):
    return Chunk(table, np.arange(table.rows), WHOLE)


def cubes(table, edge):
    return np.stack([np.rint(table[n] * 1000).astype(np.int64) // edge for n in "xyz"], axis=1)


def test_one_echo_of_every_small_cube_counts_and_speaks_for_it():
    table = crowded()
    thin = thin_dense(whole(table), PARAMS)
    _, cube, held = np.unique(cubes(table, 100), axis=0, return_inverse=True, return_counts=True)
    dense = held[cube.ravel()] > PARAMS.dense_echoes
    small = cubes(table, 50)
    _, first, of = np.unique(small, axis=0, return_index=True, return_inverse=True)
    owner = np.where(dense, first[of.ravel()], np.arange(table.rows))
    assert dense.sum() > 3000
    np.testing.assert_array_equal(thin.chunk.table["pulse"], np.unique(owner))
    np.testing.assert_array_equal(thin.chunk.table["pulse"][thin.chunk.core][thin.source], owner)
    made, kept = features(whole(table), NAMES, PARAMS), features(thin.chunk, NAMES, PARAMS)
    for name in (*NAMES[:9], *NORMAL):
        np.testing.assert_array_equal(made[name], kept[name][thin.source], err_msg=name)
    alone = features(whole(table.take(np.unique(owner))), NAMES[:1], PARAMS)
    np.testing.assert_array_equal(
        made["planarity_r100"], alone["planarity_r100"][np.searchsorted(np.unique(owner), owner)]
    )
    assert (made["count_g100"] > 100).any(), "cells are no neighbourhoods: all of their echoes count"


@pytest.mark.statistics
@pytest.mark.parametrize(("size", "blob"), [(5.0, (5.0, 5.0)), (5.0, (4.8, 5.2)), (2.0, (4.8, 5.2)), (1.3, (5.0, 5.0))])
def test_one_tile_is_many_tiles_with_halo_to_the_bit(size, blob):
    table = crowded(1500, blob)
    one, halo, seen = features(whole(table), NAMES, PARAMS), FeatureRequest.of(NAMES).halo(PARAMS), 0
    for tile in TileGrid(size).touching(Box(EAST - 1, NORTH - 1, EAST + 11, NORTH + 11)):
        near = np.flatnonzero(tile.box.grown(halo).contains(table["x"], table["y"]))
        core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
        if len(core):
            got, seen = features(Chunk(table.take(near), core, tile), NAMES, PARAMS), seen + len(core)
            for name, values in got.items():
                np.testing.assert_array_equal(values, one[name][near[core]], err_msg=name)
    assert seen == table.rows


def test_up_to_the_bound_all_echoes_count():
    rng = np.random.default_rng(5)
    for n, dense in ((PARAMS.dense_echoes, False), (PARAMS.dense_echoes + 1, True)):
        x, y, z = rng.uniform(0.0, 0.099, (3, n))
        table = table_of(x, y, z)
        assert (thin_dense(whole(table), PARAMS) is not None) == dense
        assert (crowd_facts(whole(table), PARAMS) is not None) == dense
    assert thin_dense(whole(table_of(*np.empty((3, 0)))), PARAMS) is None


def test_a_cube_that_only_noise_makes_dense_is_not_reported():
    n = PARAMS.dense_echoes
    x, y, z = np.random.default_rng(5).uniform(0.0, 0.099, (3, n + 50))
    table = table_of(x, y, z)
    inputs = SimpleNamespace(own={}, chunks=lambda: [(np.arange(n + 50), whole(noisy))])
    for noise, dense in ((np.arange(n + 50) >= n, False), (np.arange(n + 50) < 40, True)):
        noisy = Table({**table, "noise": noise})
        _, facts = compute_features(inputs, PARAMS.model_copy(update={"noise_counts": False}), NAMES[:1])
        assert ("dense" in facts) == dense


def test_what_counts_is_bounded_by_the_room_it_fills():
    """200 000 echoes in a cubic metre: no neighbourhood sees more of them than there are small cubes."""
    table = table_of(*np.random.default_rng(2).uniform(0, 1, (3, 200_000)))
    assert thin_dense(whole(table), PARAMS).chunk.table.rows <= 21**3
    at_one_place = table_of(*np.zeros((3, 200_000)))
    assert thin_dense(whole(at_one_place), PARAMS).chunk.table.rows == 1


def test_the_densest_place_is_told_whatever_the_tiles():
    table = crowded()
    crowd = Crowd.of_parts([crowd_facts(whole(table), PARAMS)])
    _, cube, held = np.unique(cubes(table, 100), axis=0, return_inverse=True, return_counts=True)
    assert crowd.cubes.most == held.max() and crowd.cubes.echoes == (held[cube.ravel()] > PARAMS.dense_echoes).sum()
    assert crowd.columns is None
    parts = []
    for tile in TileGrid(1.3).touching(Box(EAST, NORTH, EAST + 10, NORTH + 10)):
        near = np.flatnonzero(tile.box.grown(0.2).contains(table["x"], table["y"]))
        core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
        parts.append(crowd_facts(Chunk(table.take(near), core, tile), PARAMS))
    assert Crowd.of_parts(parts) == crowd
    assert Crowd.of_parts([None, None]) is None


def tower(n=5000, low=4.8, high=5.2, tall=15.0, seed=4):
    """Even ground of 10 m, and `n` echoes one above the other, in no dense cube: across columns, tiles and cells."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 10, (2, 600))
    tx, ty = rng.uniform(low, high, (2, n))
    mixed = rng.permutation(n + 600)
    z = np.concatenate([0.05 * x, rng.uniform(0, tall, n)])
    return table_of(*(values[mixed] for values in (np.concatenate([x, tx]), np.concatenate([y, ty]), z)))


FEW = PARAMS.model_copy(update={"dense_in_column": 100})


def test_of_columns_the_smallest_cubes_that_leave_no_more_count():
    """Against a slow reading of the rule, column by column."""
    table = tower()
    thin = thin_dense(whole(table), FEW)
    place, owner = cubes(table, 1), np.arange(table.rows)
    for column in np.unique(place[:, :2] // 200, axis=0):
        rows = np.flatnonzero((place[:, :2] // 200 == column).all(axis=1))
        step, first, of = 1, np.arange(len(rows)), np.arange(len(rows))
        while len(first) > FEW.dense_in_column:
            step = 50 if step == 1 else 2 * step
            _, first, of = np.unique(place[rows] // step, axis=0, return_index=True, return_inverse=True)
        owner[rows] = rows[first[of.ravel()]]
    assert (owner != np.arange(table.rows)).sum() > 3000
    np.testing.assert_array_equal(thin.chunk.table["pulse"], np.unique(owner))
    np.testing.assert_array_equal(thin.chunk.table["pulse"][thin.chunk.core][thin.source], owner)
    held = np.unique(place[:, :2] // 200, axis=0, return_counts=True)[1]
    crowd = Crowd.of_parts([crowd_facts(whole(table), FEW)])
    assert crowd.cubes is None
    assert crowd.columns.most == held.max() and crowd.columns.echoes == held[held > FEW.dense_in_column].sum()
    assert "columns of 0.2 m" in crowd.text(FEW)


@pytest.mark.statistics
@pytest.mark.parametrize("size", [5.0, 1.3])
def test_dense_columns_are_the_same_in_one_tile_and_in_many(size):
    table = tower(2500, 4.7, 5.3)
    one, halo, seen = features(whole(table), NAMES, FEW), FeatureRequest.of(NAMES).halo(FEW), 0
    parts = []
    for tile in TileGrid(size).touching(Box(EAST - 1, NORTH - 1, EAST + 11, NORTH + 11)):
        near = np.flatnonzero(tile.box.grown(halo).contains(table["x"], table["y"]))
        core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
        if len(core):
            chunk, seen = Chunk(table.take(near), core, tile), seen + len(core)
            parts.append(crowd_facts(chunk, FEW))
            for name, values in features(chunk, NAMES, FEW).items():
                np.testing.assert_array_equal(values, one[name][near[core]], err_msg=name)
    assert seen == table.rows
    assert Crowd.of_parts(parts) == Crowd.of_parts([crowd_facts(whole(table), FEW)])


@pytest.mark.statistics
@pytest.mark.parametrize("echoes", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_a_column_never_counts_with_more_however_tall(echoes):
    """So many echoes in 1 m2, 15 m and 10 km tall: no cylinder sees more than its columns may hold."""
    rng = np.random.default_rng(6)
    for tall in (15.0, 10_000.0):
        x, y, z = rng.uniform(0, 1, (3, echoes))
        kept = thin_dense(whole(table_of(x, y, z * tall)), PARAMS).chunk.table
        held = np.unique(cubes(kept, 200)[:, :2], axis=0, return_counts=True)[1]
        assert held.max() <= PARAMS.dense_in_column


def test_features_of_a_file_tell_it(tmp_path):
    table = crowded(1500)
    data = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    data.header.scales, data.header.offsets = [0.001] * 3, [EAST, NORTH, 0.0]
    data.x, data.y, data.z = (table[name] for name in "xyz")
    data.return_number[:], data.number_of_returns[:] = 1, 1
    data.write(tmp_path / "a.las")
    words = ("features", tmp_path / "a.las", tmp_path / "a.parquet", "--features", "zc,planarity_r100", "--crs")
    ended = fwclass(*words, "EPSG:25832", "--accept-implausible")  # 300 points at one place
    assert ended.returncode == 0, ended.stderr
    assert "there one echo counts in each cube of 0.05 m" in ended.stderr


def test_steps_divide_cells():
    with pytest.raises(ValueError, match="dense_step must divide dense_cell"):
        type(PARAMS)(**(PARAMS.model_dump() | {"dense_step": 0.03}))


@pytest.mark.parametrize("most", [1, 5_000])
def test_a_walk_in_slices_is_the_walk(monkeypatch, most):
    """Between slices an interrupt is heeded; they change no bit, wherever they cut."""
    table = crowded(800).take(np.arange(1200))
    one = features(whole(table), NAMES, PARAMS)
    monkeypatch.setattr(spheres, "AT_A_TIME", most)
    monkeypatch.setattr(orientation, "AT_A_TIME", most)
    for name, values in features(whole(table), NAMES, PARAMS).items():
        np.testing.assert_array_equal(values, one[name], err_msg=name)


def test_slices_are_as_long_as_the_candidates_they_meet_allow():
    """One cell may hold all echoes: it is cut too."""
    start = np.array([0, 2, 2, 1002, 1005])
    cuts = slices(start, 4, 1, np.array([1, 0]), 50_000)
    assert cuts[0] == 0 and cuts[-1] == 1005 and (np.diff(cuts) > 0).all()
    inside = np.diff(cuts[(cuts >= 2) & (cuts <= 1002)])
    assert inside.max() * 1003 <= 50_000 and len(cuts) >= 1000 * 1003 // 50_000
