"""Cells of the global grid against numpy, by hand, and in any tiles."""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import ATTRIBUTE_STEP, FLOAT32_CHAIN_RTOL

from fwclass import conf
from fwclass.columns import FEATURES
from fwclass.features.cells import cells, height_in_cell
from fwclass.grid import Box, Tile, TileGrid
from fwclass.schema import Scale, Table
from fwclass.stage import Chunk

PARAMS = conf.section("features")
BASES = tuple(c.name for c in FEATURES if "g" in c.scales)
WHOLE = Tile(0, 0, 1e7)


def table_of(n=3000, side=30.0, seed=1, height=25.0):
    rng = np.random.default_rng(seed)
    of = rng.integers(1, 4, n)
    amplitude = np.where(rng.random(n) < 0.3, np.nan, rng.uniform(0, 300, n))
    return Table(
        {
            "x": rng.uniform(-side / 3, side, n).round(3),
            "y": rng.uniform(0, side, n).round(3),
            "z": (200 + rng.uniform(0, height, n)).round(3),
            "number_of_echoes": of,
            "echo_number": np.minimum(rng.integers(1, 4, n), of),
            "amplitude": amplitude,
            "width": rng.uniform(2, 9, n),
            "intensity": rng.integers(0, 65536, n),
        }
    )


def of_all(table, edge):
    return cells(Chunk(table, np.arange(table.rows), WHOLE), Scale("g", round(edge * 100)), BASES)


def reference(table, edge):
    col, row = np.floor(table["x"] / edge), np.floor(table["y"] / edge)
    out = {base: np.full(table.rows, np.nan) for base in BASES}
    for i in range(table.rows):
        at = (col == col[i]) & (row == row[i])
        z, number, of = table["z"][at], table["echo_number"][at], table["number_of_echoes"][at]
        n = at.sum()
        off, same = z - z.mean(), np.ptp(z) == 0
        found = {
            "count": n,
            "density": n / edge**2,
            "height_range": np.ptp(z),
            "height_std": z.std(),
            "height_variance": z.var(),
            "height_skewness": 0 if same else (off**3).mean() / z.var() ** 1.5,
            "height_kurtosis": 0 if same else (off**4).mean() / z.var() ** 2,
            "height_above_mean": table["z"][i] - z.mean(),
            "height_above_lowest": table["z"][i] - z.min(),
            "height_below_highest": z.max() - table["z"][i],
            "single_share": np.mean(of == 1),
            "first_share": np.mean((of > 1) & (number == 1)),
            "intermediate_share": np.mean((number > 1) & (number < of)),
            "last_share": np.mean((of > 1) & (number == of)),
            "egi": np.mean(number == of),
            "ebi": np.mean(number == 1),
            "evi": np.mean((of > 1) & (number < of)),
        }
        for name in ("amplitude", "width", "intensity"):
            v = table[name][at].astype(float)
            v = v[np.isfinite(v)]
            found[f"{name}_mean"], found[f"{name}_std"] = (v.mean(), v.std()) if len(v) else (np.nan, np.nan)
        for base in BASES:
            out[base][i] = found[base]
    return out


@pytest.mark.parametrize(("edge", "height"), [(0.5, 25.0), (2.0, 25.0), (12.0, 25.0), (100.0, 4000.0)])
def test_features_are_numpys(edge, height):
    table = table_of(600, height=height)
    got, expected = of_all(table, edge), reference(table, edge)
    assert set(got) == set(expected)
    for base in BASES:
        # steps of 1/1024 DN and ns; skewness and kurtosis of two or three heights lose digits to cancellation
        loose = 1e-4 if "osis" in base or "skew" in base else 2e-5
        loose = ATTRIBUTE_STEP if base.startswith(("amplitude", "width")) else loose
        np.testing.assert_allclose(got[base], expected[base], atol=loose, rtol=FLOAT32_CHAIN_RTOL, err_msg=base)


def test_cells_are_half_open_and_hang_on_the_origin():
    x = np.array([0.0, 1.999, 2.0, -0.001, -2.0])
    table = Table({"x": x, "y": np.full(5, 4.0), "z": np.arange(5.0)})
    got = cells(Chunk(table, np.arange(5), WHOLE), Scale("g", 200), ("count", "density", "height_above_lowest"))
    np.testing.assert_array_equal(got["count"], [2, 2, 1, 2, 2])
    np.testing.assert_array_equal(got["density"], [0.5, 0.5, 0.25, 0.5, 0.5])
    np.testing.assert_array_equal(got["height_above_lowest"], [0, 1, 0, 0, 1])


def test_tiles_and_order_of_rows_do_not_change_a_bit():
    table = table_of()
    for edge in (1.5, 4.0):
        whole = of_all(table, edge)
        mixed = np.random.default_rng(3).permutation(table.rows)
        other = of_all(table.take(mixed), edge)
        for base in BASES:
            np.testing.assert_array_equal(other[base], whole[base][mixed], err_msg=base)
        for tile in TileGrid(7.0).touching(Box(-10, 0, 30.001, 30.001)):
            near = np.flatnonzero(tile.box.grown(edge).contains(table["x"], table["y"]))
            core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
            got = cells(Chunk(table.take(near), core, tile), Scale("g", round(edge * 100)), BASES)
            for base in BASES:
                np.testing.assert_array_equal(got[base], whole[base][near[core]], err_msg=base)


def test_zc_hangs_on_the_global_cells():
    x = np.array([11.999, 12.0, 23.999, 0.0, -0.001])
    y = np.array([5.0, 5.0, 9.999, 9.999, 5.0])
    z = np.array([4.0, 1.0, 7.5, 3.0, 0.5])
    table = Table({"x": x, "y": y, "z": z})
    got = height_in_cell(Chunk(table, np.array([4, 0, 1, 2, 3]), Tile(0, 0, 100.0)), PARAMS.cell_x, PARAMS.cell_y)
    np.testing.assert_allclose(got, [0.0, 1.0, 0.0, 6.5, 0.0])


def test_no_rows():
    table = table_of(4)
    for chunk in (
        Chunk(table, np.empty(0, np.int64), WHOLE),
        Chunk(table.take(np.empty(0, np.int64)), np.empty(0, np.int64), WHOLE),
    ):
        assert all(len(v) == 0 for v in cells(chunk, Scale("g", 100), BASES).values())
        assert len(height_in_cell(chunk, PARAMS.cell_x, PARAMS.cell_y)) == 0
