"""The features stage: one tile = many tiles + halo for every kind of neighbourhood, normals, stated values, faults."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from fwclass import conf
from fwclass.columns import FEATURES as DECLARED
from fwclass.errors import InputError
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.features.params import NORMAL, FeaturesParams
from fwclass.features.stage import features
from fwclass.grid import Box, Tile, TileGrid
from fwclass.schema import Table, column
from fwclass.stage import Chunk

PARAMS = conf.section("features").model_copy(
    update={"optimal_radii": (0.5, 1.0, 2.0), "nearest_reach": 3.0, "orientation_rounds": 3, "pulse_reach": 6.0}
)
ENDS = {"r": "r150", "c": "c200", "k": "k12", "g": "g250", "o": "opt"}
EVERY = tuple(f"{c.name}_{ENDS[kind]}" for c in DECLARED for kind in c.scales) + tuple(
    c.name for c in DECLARED if not c.scales
)
SECOND = ("planarity_r75", "height_std_r300", "echo_ratio_r75", "height_above_p50_c100", "planarity_k5", "count_g100")
WHOLE = Tile(0, 0, 1e7)


def cloud(side=40.0, per_m2=3.0, seed=1):
    rng = np.random.default_rng(seed)
    pulses = int(side * side * per_m2 / 2)
    of = rng.integers(1, 4, pulses)
    pulse = np.repeat(np.arange(pulses), of)
    n = len(pulse)
    number = np.arange(n) - np.repeat(np.cumsum(of) - of, of) + 1
    x, y = (rng.uniform(0, side, (2, pulses)) + np.array([[500_000.0], [5_400_000.0]])).round(3)
    x[:100], y[:100] = np.floor(x[:100]), np.floor(y[:100])  # on the edges of tiles and cells
    x, y = x[pulse] + 1.3 * (number - 1), y[pulse]  # oblique beams
    z = 290.0 + np.where(rng.random(n) < 0.6, 0.05 * (x - 500_000.0), rng.uniform(0, 12, n))
    amplitude = np.where(rng.random(n) < 0.1, np.nan, rng.uniform(5, 200, n))
    discrete = pulse % 2 == 1  # strip 1 has no waveforms: every return is told as a pulse of its own
    return Table(
        {
            "strip": discrete.astype(int),
            "pulse": np.where(discrete, pulses + np.arange(n), pulse),
            "gps_time": pulse * 1e-5,
            "echo_number": number,
            "number_of_echoes": of[pulse],
            "x": x.round(3),
            "y": y,
            "z": z.round(3),
            "amplitude": amplitude,
            "width": rng.uniform(3, 7, n),
            "intensity": rng.integers(0, 65536, n),
            "noise": rng.random(n) < 0.02,
        }
    )


CLOUD = cloud()
BOX = Box(500_000.0, 5_400_000.0, 500_043.0, 5_400_040.0)


def whole(table, names=EVERY, params=PARAMS):
    return features(Chunk(table, np.arange(table.rows), WHOLE), names, params)


@pytest.fixture(scope="module")
def one():
    return whole(CLOUD, EVERY + SECOND)


def tiles_of(table, size, halo):
    for tile in TileGrid(size).touching(BOX):
        near = np.flatnonzero(tile.box.grown(halo).contains(table["x"], table["y"]))
        core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
        if len(core):
            yield near[core], Chunk(table.take(near), core, tile)


@pytest.mark.statistics
@pytest.mark.parametrize("size", [25.0, 9.0])
def test_one_tile_is_many_tiles_with_halo_to_the_bit(one, size):
    halo = FeatureRequest.of(EVERY + SECOND).reach(PARAMS)
    seen = np.zeros(CLOUD.rows, int)
    for rows, chunk in tiles_of(CLOUD, size, halo):
        got = features(chunk, EVERY + SECOND, PARAMS)
        assert tuple(got) == (*EVERY, *SECOND, *NORMAL)
        seen[rows] += 1
        for name, values in got.items():
            np.testing.assert_array_equal(values, one[name][rows], err_msg=name)
    assert (seen == 1).all()


@pytest.mark.parametrize("name", ["echo_ratio_r150", "zc", "planarity_k12", "count_g250", "pulse_intensity_variance"])
def test_less_than_the_halo_is_not_enough(one, name):
    """The test above can fail: without a halo the borders differ."""
    got = [(rows, features(chunk, (name,), PARAMS)[name]) for rows, chunk in tiles_of(CLOUD, 9.0, 0.0)]
    assert any((values != one[name][rows]).any() for rows, values in got)


def test_each_feature_asks_for_enough_alone(one):
    """The reach of a single name is enough for it."""
    for kind in ("c", "g", "k", "o"):
        name = next(n for n in EVERY if n.endswith(ENDS[kind]) and not n.startswith("count"))
        for rows, chunk in tiles_of(CLOUD, 20.0, FeatureRequest.of([name]).reach(PARAMS)):
            np.testing.assert_array_equal(features(chunk, [name], PARAMS)[name], one[name][rows], err_msg=name)


def test_a_feature_does_not_depend_on_what_else_is_asked(one):
    for name in EVERY[::7]:
        np.testing.assert_array_equal(whole(CLOUD, (name,))[name], one[name], err_msg=name)


def test_order_of_rows_changes_nothing_but_ties_of_the_nearest(one):
    mixed = np.random.default_rng(2).permutation(CLOUD.rows)
    names = tuple(n for n in EVERY if not n.endswith("k12"))
    other = whole(CLOUD.take(mixed), names)
    for name in names:
        np.testing.assert_array_equal(other[name], one[name][mixed], err_msg=name)


def test_columns_are_declared_and_in_their_range(one):
    for name, values in one.items():
        record = column(name)
        valid = values[~np.isnan(values)]
        assert len(valid) > 0.5 * CLOUD.rows, name
        assert record.low is None or valid.min() >= record.low, name
        assert record.high is None or valid.max() <= record.high, name
        assert values.dtype == np.float32
        assert record.meaning


@pytest.mark.parametrize("kind", ["r", "c", "k", "g", "o"])
def test_few_coincident_and_collinear_echoes_have_the_stated_values(kind):
    """The same in every kind of neighbourhood."""
    bases = [c.name for c in DECLARED if kind in c.scales and c.name != "oriented_inclination"]
    names = {base: f"{base}_{ENDS[kind]}" for base in bases}
    eigen = {
        "eigenvalue_1",
        "eigenvalue_2",
        "eigenvalue_3",
        "eigenvalue_sum",
        "linearity",
        "planarity",
        "sphericity",
        "anisotropy",
        "omnivariance",
        "eigenentropy",
        "surface_variation",
        "plane_std",
    }
    plane = {"verticality", "inclination", "roughness", "plane_range"}
    fill = CLOUD.take(np.arange(3)).with_columns({"amplitude": np.full(3, np.nan), "z": np.zeros(3)})
    places = {
        "few": ([0.2, 0.3], eigen | plane),
        "coincident": ([0.2, 0.2, 0.2], eigen | plane),
        "line": ([0.1, 0.2, 0.4], plane),
    }
    for told, (x, nothing) in places.items():
        table = fill.take(np.arange(len(x))).with_columns({"x": x, "y": np.full(len(x), 0.1)})
        got = whole(table, tuple(names.values()))
        nothing = nothing if kind != "o" or told == "line" else set(bases)  # no radius counts: nothing has a value
        nothing = nothing | {"amplitude_mean", "amplitude_std"}
        none = kind == "o" and told != "line"
        for base in bases:
            if not (none and base in ("height_skewness", "height_kurtosis")):  # 0, as of equal heights
                assert np.isnan(got[names[base]]).all() == (base in nothing), (told, base)
        if kind != "o":
            for base in ("height_std", "height_skewness", "height_kurtosis", "height_range"):
                np.testing.assert_array_equal(got[names[base]], 0.0)


def test_normals_are_those_of_their_radius():
    """Points of a tilted plane have its normal, upward; their inclination is the plane's."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0.0, 20.0, (2, 2000))
    table = CLOUD.take(np.arange(2000)).with_columns({"x": x, "y": y, "z": 0.5 * x - 0.25 * y})
    got = whole(table, ("inclination_r100", "inclination_k20", "oriented_inclination_r100"))
    expected = np.array([-0.5, 0.25, 1.0]) / np.sqrt(1.0 + 0.25 + 0.0625)
    normals = np.stack([got[n] for n in NORMAL], axis=1)
    seen = ~np.isnan(normals[:, 0])
    assert seen.mean() > 0.99
    off = np.abs(normals[seen] - expected).max(axis=1)
    assert np.quantile(off, 0.95) < 2e-3, "millimetres of rounding over a metre"
    tilt = np.degrees(np.arccos(expected[2]))
    for name in ("inclination_r100", "inclination_k20", "oriented_inclination_r100"):
        assert np.nanmedian(got[name]) == pytest.approx(tilt, abs=0.02)


def test_no_rows_no_core_rows_and_no_names():
    for table in (CLOUD.take(np.empty(0, np.int64)), CLOUD):
        got = features(Chunk(table, np.empty(0, np.int64), Tile(0, 0, 100.0)), EVERY, PARAMS)
        assert tuple(got) == (*EVERY, *NORMAL)
        assert got.rows == 0
    assert tuple(whole(CLOUD.take(np.arange(50)).select(("x", "y", "z", "noise")), ())) == NORMAL


@pytest.mark.parametrize(
    ("name", "lacks"),
    [
        ("single_share_r100", "number_of_echoes"),
        ("width_mean_k20", "width"),
        ("intensity_std_g200", "intensity"),
        ("pulse_amplitude_variance", "amplitude"),
    ],
)
def test_a_missing_column_is_named(name, lacks):
    table = CLOUD.select([n for n in CLOUD if n != lacks])
    with pytest.raises(InputError, match=lacks):
        features(Chunk(table, np.arange(3), Tile(0, 0, 100.0)), (name,), PARAMS)


def test_names_that_are_no_features():
    for name in (
        "planarity",
        "planarity_g100",
        "planarity_k0",
        "zc_r100",
        "height_std_r0100",
        "amplitude",
        "count_k20",
    ):
        assert not is_feature(name)
        with pytest.raises(KeyError):
            FeatureRequest.of([name])


@pytest.mark.parametrize(
    "change",
    [
        {"optimal_radii": (1.0,)},
        {"optimal_radii": (1.0, 1.0)},
        {"optimal_radii": (-1.0, 1.0)},
        {"cell_x": 0.0},
        {"normal_radius": 0.0},
        {"normal_radius": 0.504},
        {"optimal_radii": (0.5, 0.5004)},
        {"nearest_reach": 1000.0},
        {"orientation_rounds": 0},
        {"radii": (1.0,)},
        {"pulse_reach": -1.0},
    ],
)
def test_params_that_do_not_fit_are_refused(change):
    with pytest.raises(ValidationError):
        FeaturesParams(**{**conf.section("features").model_dump(), **change})


@pytest.mark.parametrize(
    ("names", "reach"),
    [
        ((), 1.0),
        (("zc",), 12.0),
        (("height_std_r1500",), 15.0),
        (("planarity_k20",), 3.0),
        (("planarity_opt",), 2.0),
        (("optimal_radius",), 2.0),
        (("oriented_inclination_r200",), 8.0),
        (("count_g500",), 5.0),
        (("pulse_intensity_variance",), 6.0),
        (("zc", "height_std_c1300"), 13.0),
    ],
)
def test_reach_holds_what_is_asked(names, reach):
    assert FeatureRequest.of(names).reach(PARAMS) == reach


def test_noise_is_no_neighbour_and_has_all_as_neighbours(one):
    noise = CLOUD["noise"]
    names = (*EVERY, *SECOND)
    sound = whole(CLOUD.take(np.flatnonzero(~noise)), names)
    counting = whole(CLOUD, names, PARAMS.model_copy(update={"noise_counts": True}))
    differ = 0
    for name in names:
        np.testing.assert_array_equal(one[name][~noise], sound[name], err_msg=name)
        np.testing.assert_array_equal(one[name][noise], counting[name][noise], err_msg=name)
        differ += not np.array_equal(one[name], counting[name], equal_nan=True)
    assert differ > 0.9 * len(names)


def test_where_noise_counts_nobody_asks_which_echo_it_is():
    around = PARAMS.model_copy(update={"noise_counts": True})
    without = CLOUD.select([n for n in CLOUD if n != "noise"])
    some = np.arange(500)
    np.testing.assert_array_equal(
        whole(without.take(some), ("planarity_r150",), around)["planarity_r150"],
        whole(CLOUD.take(some), ("planarity_r150",), around)["planarity_r150"],
    )
    assert "noise" in FeatureRequest.of(("planarity_r150",)).columns(PARAMS)
