"""The features stage: one tile = many tiles + halo, cells of zc, normals, faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from fwclass.errors import InputError
from fwclass.features.stage import FEATURES, FeaturesParams, features, height_in_cell, names
from fwclass.grid import Box, Tile, TileGrid
from fwclass.schema import Table, column
from fwclass.stage import Chunk

ROOT = Path(__file__).resolve().parents[2]
SECTION = yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())["features"]
PARAMS = FeaturesParams(**{**SECTION, "radii": (1.0, 2.0)})


def cloud(side=60.0, per_m2=4.0, seed=1):
    rng = np.random.default_rng(seed)
    n = int(side * side * per_m2)
    x, y = (rng.uniform(0, side, (2, n)) + np.array([[500_000.0], [5_400_000.0]])).round(3)
    z = 290.0 + np.where(rng.random(n) < 0.6, 0.05 * (x - 500_000.0), rng.uniform(0, 12, n))
    x[:200], y[:200] = np.floor(x[:200]), np.floor(y[:200])  # on the edges of tiles and cells
    of = rng.integers(1, 4, n)
    tilt = np.radians(rng.uniform(-20, 20, n))
    return Table(
        {
            "strip": np.zeros(n),
            "pulse": np.arange(n),
            "x": x,
            "y": y,
            "z": z.round(3),
            "number_of_echoes": of,
            "echo_number": np.minimum(rng.integers(1, 4, n), of),
            "amplitude": rng.uniform(5, 200, n),
            "width": rng.uniform(3, 7, n),
            "beam_x": np.sin(tilt),
            "beam_y": np.zeros(n),
            "beam_z": -np.cos(tilt),
        }
    )


CLOUD = cloud()
BOX = Box(500_000.0, 5_400_000.0, 500_060.0, 5_400_060.0)


def chunk_of(table, tile, halo):
    near = np.flatnonzero(tile.box.grown(halo).contains(table["x"], table["y"]))
    core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
    return Chunk(table.take(near), core, tile)


def by_tiles(table, size, params):
    halo = FEATURES.halo(params)
    out = {name: np.full(table.rows, -99.0, np.float32) for name in names(params)}
    tiles = list(TileGrid(size).touching(BOX))
    for tile in tiles:
        got = features(chunk_of(table, tile, halo), params)
        assert tuple(got) == names(params)
        rows = np.flatnonzero(tile.box.contains(table["x"], table["y"]))
        for name, values in got.items():
            out[name][rows] = values
    return out, len(tiles)


def whole(table, params):
    tile = Tile(0, 0, 1e7)
    return features(Chunk(table, np.arange(table.rows), tile), params)


@pytest.mark.parametrize(("size", "count"), [(100.0, 1), (30.0, 4), (20.0, 9), (7.0, 100)])
def test_one_tile_is_many_tiles_with_halo_to_the_bit(size, count):
    one = whole(CLOUD, PARAMS)
    many, tiles = by_tiles(CLOUD, size, PARAMS)
    assert tiles >= count
    for name in names(PARAMS):
        np.testing.assert_array_equal(many[name], one[name], err_msg=name)


def test_order_of_rows_does_not_change_a_bit():
    mixed = np.random.default_rng(2).permutation(CLOUD.rows)
    one, other = whole(CLOUD, PARAMS), whole(CLOUD.take(mixed), PARAMS)
    for name in names(PARAMS):
        np.testing.assert_array_equal(other[name], one[name][mixed], err_msg=name)


def test_less_than_the_halo_is_not_enough():
    """The test above can fail: without halo the border's features differ."""
    one = whole(CLOUD, PARAMS)
    tile = next(iter(TileGrid(20.0).touching(BOX)))
    rows = np.flatnonzero(tile.box.contains(CLOUD["x"], CLOUD["y"]))
    got = features(chunk_of(CLOUD, tile, 0.0), PARAMS)
    assert (got["echo_ratio_r100"] != one["echo_ratio_r100"][rows]).any()
    assert (got["zc"] != one["zc"][rows]).any()


def test_columns_are_declared_and_in_their_range():
    for name, values in whole(CLOUD, PARAMS).items():
        record = column(name)
        valid = values[~np.isnan(values)]
        assert len(valid) > 0.5 * CLOUD.rows, name  # a sparse crown has too few neighbours at 1 m
        assert record.low is None or valid.min() >= record.low, name
        assert record.high is None or valid.max() <= record.high, name
        assert record.meaning


def test_zc_hangs_on_the_global_cells():
    x = np.array([11.999, 12.0, 23.999, 0.0, -0.001])
    y = np.array([5.0, 5.0, 9.999, 9.999, 5.0])
    z = np.array([4.0, 1.0, 7.5, 3.0, 0.5])
    table = Table({"x": x, "y": y, "z": z})
    got = height_in_cell(Chunk(table, np.array([4, 0, 1, 2, 3]), Tile(0, 0, 100.0)), PARAMS)
    np.testing.assert_allclose(got, [0.0, 1.0, 0.0, 6.5, 0.0])


def test_normals_are_those_of_their_radius():
    """Points of a tilted plane have its normal, upward; their inclination is the plane's."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0.0, 20.0, (2, 2000))
    table = CLOUD.take(np.arange(2000)).with_columns({"x": x, "y": y, "z": 0.5 * x - 0.25 * y})
    got = features(Chunk(table, np.arange(2000), Tile(0, 0, 100.0)), PARAMS)
    expected = np.array([-0.5, 0.25, 1.0]) / np.sqrt(1.0 + 0.25 + 0.0625)
    normals = np.stack([got[n] for n in ("normal_x", "normal_y", "normal_z")], axis=1)
    seen = ~np.isnan(normals[:, 0])
    assert seen.mean() > 0.99
    off = np.abs(normals[seen] - expected).max(axis=1)
    assert np.quantile(off, 0.95) < 2e-3, "millimetres of rounding over a metre"
    tilt = np.degrees(np.arccos(expected[2]))
    assert np.nanmedian(got["inclination_r100"]) == pytest.approx(tilt, abs=0.02)
    wide = features(
        Chunk(CLOUD, np.arange(CLOUD.rows), Tile(0, 0, 100.0)),
        FeaturesParams(**{**PARAMS.model_dump(), "normal_radius": 2.0}),
    )
    tilt = np.degrees(np.arccos(np.clip(wide["normal_z"], 0.0, 1.0)))
    np.testing.assert_allclose(tilt, wide["inclination_r200"], atol=0.05)


def test_no_rows_and_no_core_rows():
    for table in (CLOUD.take(np.empty(0, np.int64)), CLOUD):
        got = features(Chunk(table, np.empty(0, np.int64), Tile(0, 0, 100.0)), PARAMS)
        assert tuple(got) == names(PARAMS)
        assert got.rows == 0


def test_a_missing_column_is_named():
    table = CLOUD.select(["x", "y", "z"])
    with pytest.raises(InputError, match="echo_number"):
        features(Chunk(table, np.arange(3), Tile(0, 0, 100.0)), PARAMS)


@pytest.mark.parametrize(
    "change",
    [
        {"radii": ()},
        {"radii": (1.0, 1.0)},
        {"radii": (0.125,)},
        {"radii": (-1.0,)},
        {"cell_x": 0.0},
        {"normal_radius": 3.0},
        {"radius": 1.0},
    ],
)
def test_params_that_do_not_fit_are_refused(change):
    with pytest.raises(ValidationError):
        FeaturesParams(**{**SECTION, **change})


def test_halo_holds_radius_and_cell():
    assert FEATURES.halo(PARAMS) == 12.0
    assert FEATURES.halo(FeaturesParams(**{**SECTION, "radii": (15.0,), "normal_radius": 15.0})) == 15.0
