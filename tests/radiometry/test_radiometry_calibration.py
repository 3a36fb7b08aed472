"""Relative and absolute calibration: known gains come back, whatever the tiles, the order and the names of strips."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from fwclass import conf
from fwclass.errors import InputError
from fwclass.grid import Box, Tile, TileGrid
from fwclass.radiometry.calibration import Calibration, calibrate
from fwclass.radiometry.overlap import PARTS, STEP, Overlap, merge, overlap, within
from fwclass.radiometry.params import RadiometryParams
from fwclass.radiometry.stage import OVERLAP, radiometry
from fwclass.schema import Table
from fwclass.stage import Chunk

SECTION: dict[str, Any] = {
    "platform_altitude": 600.0,
    "max_time_gap": 2.0,
    "max_incidence": 80.0,
    "grazing": 85.0,
    "calibration": None,
    "extinction": 0.0,
    "divergence": 0.5,
    "balance": True,
    "target": None,
    "overlap": {"cell": 2.0, "least_echoes": 4, "max_spread": 0.3, "max_incidence": 30.0, "least_cells": 20},
    "sound": conf.section("radiometry").sound.model_dump(),
}
CONSTANT = 3e-15
LEFT, BOTTOM = 500_000.0, 5_400_000.0


def params_of(**change: Any) -> RadiometryParams:
    return RadiometryParams(**{**SECTION, **change})


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Reflectance: fields with sharp edges and a slow change."""
    field = np.array([0.12, 0.5, 0.25, 0.33])[(np.floor((x + 0.3 * y) / 17.0) % 4).astype(int)]
    return np.asarray(field * (1.0 + 0.1 * np.sin(y / 9.0)))


def survey(gains: dict[int, float], spans: dict[int, tuple[float, float]], seed: int, length: float = 60.0) -> Table:
    """Strips over level ground, flown along y at 600 m; every strip covers its span of x at 4 echoes/m2."""
    rng = np.random.default_rng(seed)
    rows = []
    for strip, (low, high) in spans.items():
        n = int((high - low) * length * 4)
        x, y = rng.uniform(low, high, n).round(3), rng.uniform(0, length, n).round(3)
        slant = np.arctan2(x - (low + high) / 2.0, 600.0)
        distance = 600.0 / np.cos(slant)
        sigma = 4.0 * ground(x, y) * np.pi / 4.0 * (distance * 0.5e-3) ** 2 * np.cos(slant)
        energy = gains[strip] * sigma / (CONSTANT * distance**4) * np.exp(rng.normal(0.0, 0.08, n))
        several = rng.random(n) < 0.1
        energy[several] *= 0.3
        faulty = rng.random(n) < 0.05
        energy[faulty] *= 2.0
        rows.append(
            {
                "strip": np.full(n, strip),
                "x": LEFT + x,
                "y": BOTTOM + y,
                "z": np.zeros(n),
                "gps_time": np.zeros(n),
                "beam_x": np.sin(slant),
                "beam_y": np.zeros(n),
                "beam_z": -np.cos(slant),
                "energy": energy,
                "number_of_echoes": 1 + several,
                "fit_flags": np.where(faulty, 1, 0),
                "beam_range": np.full(n, np.nan),
                "normal_x": np.zeros(n),
                "normal_y": np.zeros(n),
                "normal_z": np.ones(n),
            }
        )
    return Table({name: np.concatenate([r[name] for r in rows]) for name in rows[0]})


def whole(table: Table, params: RadiometryParams) -> Overlap:
    return overlap(Chunk(table, np.arange(table.rows), Tile(0, 0, 1e8)), None, params)


def by_tiles(table: Table, size: float, params: RadiometryParams) -> list[Overlap]:
    parts = []
    box = Box(LEFT - 1.0, BOTTOM - 1.0, LEFT + 201.0, BOTTOM + 61.0)
    for tile in TileGrid(size).touching(box):
        near = np.flatnonzero(tile.box.grown(OVERLAP.halo(params)).contains(table["x"], table["y"]))
        core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
        if len(core):  # a tile without echoes does not exist
            parts.append(overlap(Chunk(table.take(near), core, tile), None, params))
    return parts


SPANS = {0: (0.0, 60.0), 1: (40.0, 100.0), 2: (80.0, 140.0), 3: (30.0, 120.0)}
GAINS = {0: 1.3, 1: 0.9, 2: 1.0, 3: 1.1}
FIELD = [[LEFT + x, BOTTOM + y] for x, y in ((19.0, 2.0), (31.0, 2.0), (27.0, 18.0), (15.0, 18.0))]
TARGET = {"polygon": FIELD, "reflectance": 0.5}


@pytest.fixture(scope="module")
def table() -> Table:
    return survey(GAINS, SPANS, seed=1)


def test_gains_come_back(table: Table) -> None:
    got = calibrate([whole(table, params_of())], params_of())
    true = np.log(list(GAINS.values()))
    true -= true.mean()
    found = np.log([s.gain for s in got.strips])
    assert [s.strip for s in got.strips] == [0, 1, 2, 3]
    assert abs(found.mean()) < 1e-12
    errors = np.array([s.error for s in got.strips])
    assert (errors < 0.004).all()
    np.testing.assert_array_less(np.abs(found - true), 4.0 * errors)
    assert {(p.first, p.second) for p in got.pairs} == {(0, 1), (0, 3), (1, 2), (1, 3), (2, 3)}
    for pair in got.pairs:
        assert pair.log_ratio == pytest.approx(math.log(GAINS[pair.first] / GAINS[pair.second]), abs=4 * pair.error)
        assert 0.0 < pair.error < 0.005


@pytest.mark.slow
def test_standard_errors_are_those_of_many_surveys() -> None:
    """Standardised errors have unit spread; 40 surveys of 3 free gains: 1 / sqrt(2 x 120) = 0.065 of it."""
    true = np.log(list(GAINS.values()))
    true -= true.mean()
    scores = []
    for seed in range(40):
        got = calibrate([whole(survey(GAINS, SPANS, seed=100 + seed), params_of())], params_of())
        scores.append([(math.log(s.gain) - t) / (s.error or math.nan) for s, t in zip(got.strips, true, strict=True)])
    spread = float(np.sqrt(np.mean(np.square(scores))))
    assert 0.75 < spread < 1.25
    assert abs(np.mean(scores)) < 0.3


@pytest.mark.statistics
@pytest.mark.parametrize("size", [100.0, 33.0, 7.3])
def test_tiles_and_their_order_do_not_change_a_bit(table: Table, size: float) -> None:
    params = params_of(target=TARGET)
    one = calibrate([whole(table, params)], params)
    parts = by_tiles(table, size, params)
    assert len(parts) > 1
    for order in (parts, parts[::-1], [merge(parts[1:]), parts[0]]):
        assert calibrate(order, params).to_json() == one.to_json()


def test_without_the_halo_cells_are_torn(table: Table) -> None:
    """The test above can fail."""
    tile = Tile(int(LEFT // 7.3) + 6, int(BOTTOM // 7.3) + 2, 7.3)
    core = np.flatnonzero(tile.box.contains(table["x"], table["y"]))
    near = np.flatnonzero(tile.box.grown(2.0).contains(table["x"], table["y"]))
    at = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
    full = overlap(Chunk(table.take(near), at, tile), None, params_of())
    torn = overlap(Chunk(table.take(core), np.arange(len(core)), tile), None, params_of())
    assert full.cells.sum() > 0
    assert full.cells.sum() != torn.cells.sum()


def test_names_of_strips_do_not_matter(table: Table) -> None:
    """Strips numbered the other way round: the same gains, to the width of a histogram's bin."""
    turned = table.with_columns({"strip": 3 - table["strip"].astype(int)})
    one = [s.gain for s in calibrate([whole(table, params_of())], params_of()).strips]
    other = [s.gain for s in calibrate([whole(turned, params_of())], params_of()).strips]
    np.testing.assert_allclose(np.log(other[::-1]), np.log(one), atol=2 * STEP)


def test_order_of_rows_in_a_tile_does_not_matter_for_the_gains(table: Table) -> None:
    mixed = table.take(np.random.default_rng(4).permutation(table.rows))
    assert calibrate([whole(mixed, params_of())], params_of()) == calibrate([whole(table, params_of())], params_of())


def test_a_louder_strip_has_its_gain_raised_and_its_backscatter_kept(table: Table) -> None:
    louder = table.with_columns({"energy": np.where(table["strip"] == 1, 2.0, 1.0) * table["energy"]})
    before, after = (calibrate([whole(t, params_of())], params_of()) for t in (table, louder))
    change = np.log([b.gain / a.gain for a, b in zip(before.strips, after.strips, strict=True)])
    np.testing.assert_allclose(change, math.log(2.0) * (np.arange(4) == 1) - math.log(2.0) / 4.0, atol=2 * STEP)
    gamma = [columns(t, c)["backscatter"] for t, c in ((table, before), (louder, after))]
    np.testing.assert_allclose(gamma[1] / gamma[0], gamma[1][0] / gamma[0][0], rtol=3 * STEP)


def columns(table: Table, calibration: Calibration, **change: Any) -> Table:
    chunk = Chunk(table, np.arange(table.rows), Tile(0, 0, 1e8))
    return radiometry(chunk, None, calibration, params_of(**change))


def test_target_gives_the_constant(table: Table) -> None:
    inside = within(TARGET["polygon"], table["x"], table["y"])
    reflectance = ground(table["x"] - LEFT, table["y"] - BOTTOM)
    params = params_of(target={**TARGET, "reflectance": float(np.median(reflectance[inside]))})
    got = calibrate([whole(table, params)], params)
    assert got.source == "target"
    assert got.target_echoes > 300
    assert got.error is not None
    found = columns(table, got)
    clean = (table["fit_flags"] == 0) & (table["number_of_echoes"] == 1)
    assert set(found["radiometry_flags"][clean]) == {0}
    rho = found["backscatter"][inside & clean] / 4.0
    assert np.median(rho) == pytest.approx(params.target.reflectance, rel=got.error)
    # everywhere, also in the strips that do not see the target: the error of the constant, and of the gains
    bias = np.log(found["backscatter"][clean] / 4.0 / reflectance[clean])
    for strip in range(4):
        assert abs(np.median(bias[table["strip"][clean] == strip])) < 4.0 * got.error + 0.005
    np.testing.assert_allclose(
        found["reflectance"],
        10 * np.log10(found["cross_section"] / (np.pi * (found["range"] * 0.5e-3) ** 2)),
        atol=1e-4,
    )


def test_strips_that_nothing_ties_to_the_target_stay_uncalibrated() -> None:
    spans = {0: (0.0, 60.0), 1: (40.0, 100.0), 2: (140.0, 200.0)}
    table = survey({0: 1.2, 1: 1.0, 2: 5.0}, spans, seed=2)
    params = params_of(target=TARGET)
    got = calibrate([whole(table, params)], params)
    assert [s.tied for s in got.strips] == [True, True, False]
    assert [s.group for s in got.strips] == [0, 0, 1]
    assert got.strips[2].gain == 1.0
    assert got.strips[2].error is None
    found = columns(table, got)
    assert ((found["radiometry_flags"] & 32 > 0) == (table["strip"] == 2)).all()
    assert (np.isnan(found["reflectance"]) == (table["strip"] == 2)).all()
    # without balance the strips are taken to be of one gain
    alone = params_of(target=TARGET, balance=False)
    flat = calibrate([whole(table, alone)], alone)
    assert [s.gain for s in flat.strips] == [1.0, 1.0, 1.0]
    assert all(s.tied for s in flat.strips)
    # so C_cal holds for a strip without any usable echo, too; not so where gains may differ
    assert flat.calibrated(np.array([9])).all()
    assert not got.calibrated(np.array([9])).any()


def test_two_groups_that_both_see_the_target_get_one_constant() -> None:
    """Strips 0 and 1 overlap each other, 2 only the target (too few common cells to be compared)."""
    spans = {0: (0.0, 60.0), 1: (40.0, 100.0), 2: (4.0, 36.0)}
    table = survey({0: 1.2, 1: 1.0, 2: 3.0}, spans, seed=3)
    keep = (table["strip"] != 2) | (np.random.default_rng(1).random(table.rows) < 0.1)
    params = params_of(target=TARGET, overlap={**SECTION["overlap"], "least_cells": 100})
    got = calibrate([whole(table.take(keep), params)], params)
    assert [s.group for s in got.strips] == [0, 0, 1]
    assert all(s.tied for s in got.strips)
    assert got.strips[2].gain / got.strips[0].gain == pytest.approx(3.0 / 1.2, rel=0.2)


def test_a_target_that_no_echo_meets_is_refused(table: Table) -> None:
    far = {"polygon": [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]], "reflectance": 0.5}
    params = params_of(target=far)
    with pytest.raises(InputError, match="target"):
        calibrate([whole(table, params)], params)


def test_nothing_to_compare() -> None:
    for parts in ([], [whole(survey(GAINS, SPANS, seed=1), params_of(platform_altitude=None))]):
        got = calibrate(parts, params_of())
        assert got == Calibration()
    given = calibrate([], params_of(calibration=2.5))
    assert given.source == "given"
    assert given.constant == 2.5
    assert given.calibrated(np.array([0, 7])).all()
    assert (given.gains(np.array([0, 7])) == 1.0).all()
    lone = calibrate([whole(survey({5: 1.0}, {5: (0.0, 60.0)}, seed=1), params_of())], params_of())
    assert [(s.strip, s.gain, s.error) for s in lone.strips] == [(5, 1.0, None)]


def test_missing_values_take_no_part(table: Table) -> None:
    dirty = table.take(np.concatenate([np.arange(table.rows)] * 2))
    extra, clean = np.arange(dirty.rows) >= table.rows, calibrate([whole(table, params_of())], params_of())
    for name, value in (("energy", np.nan), ("normal_z", np.nan), ("beam_z", np.nan), ("energy", 0.0), ("z", np.nan)):
        spoilt = dirty.with_columns({name: np.where(extra, value, dirty[name])})
        assert calibrate([whole(spoilt, params_of())], params_of()) == clean


def test_long_chains_of_strips_of_very_different_precision() -> None:
    """Two chains of 40 strips; overlaps of 20 to 2e6 cells, their spread from one bin to a tenth."""
    rng = np.random.default_rng(6)
    true = rng.normal(0.0, 0.5, 80)
    for chain in (slice(0, 40), slice(40, 80)):
        true[chain] -= true[chain].mean()
    rows = []
    for a in (*range(39), *range(40, 79)):
        n = int(np.exp(rng.uniform(np.log(20), np.log(2e6))))
        middle, half = round((true[a] - true[a + 1]) / STEP), int(rng.choice([0, 20, 400]))
        rows += [(a, a + 1, middle + k, PARTS * (n // (2 * half + 1) + 1)) for k in range(-half, half + 1)]
    first, second, difference, cells = np.array(rows).T
    none = np.empty(0, np.int64)
    got = calibrate([Overlap(first, second, difference, cells, none, none, none, none, none)], params_of())
    found = np.log([s.gain for s in got.strips])
    assert {s.group for s in got.strips} == {0, 1}
    # each link is rounded to a bin; 39 of them in a row
    np.testing.assert_allclose(found, true, atol=40 * STEP / 2)
    assert abs(found[:40].mean()) < 1e-10
    assert abs(found[40:].mean()) < 1e-10
    assert all(s.error is not None and 0.0 < s.error < 0.2 for s in got.strips)


def test_json_there_and_back(table: Table) -> None:
    params = params_of(target=TARGET)
    got = calibrate([whole(table, params)], params)
    assert Calibration.from_json(json.loads(json.dumps(got.to_json(), allow_nan=False))) == got
    assert got.to_json()["source"] == "target"
    assert Calibration.from_json(Calibration().to_json()) == Calibration()
    for text in ("", "[]", "{}", '{"strips": 3, "pairs": []}', '{"strips": [], "pairs": [], "colour": 1}', "null"):
        with pytest.raises(InputError, match="calibration"):
            Calibration.from_json(json.loads(text or '""'))


def test_statistics_there_and_back(table: Table) -> None:
    got = whole(table, params_of(target=TARGET))
    again = Overlap.from_arrays(got.arrays())
    for name, values in got.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], values)
    assert sum(len(v) for v in got.arrays().values()) < table.rows  # compact


def test_within_a_polygon_that_is_not_convex() -> None:
    ell = [(0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0)]
    x, y = np.array([0.5, 3.5, 3.5, 0.5, 2.0, -0.1, 5.0]), np.array([0.5, 0.5, 2.0, 3.5, 2.0, 0.5, 0.5])
    np.testing.assert_array_equal(within(ell, x, y), [True, True, False, True, False, False, False])
    np.testing.assert_array_equal(within(ell[::-1], x, y), within(ell, x, y))
    # a point on a common edge of two polygons is in exactly one of them
    u, v = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], [(1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0)]
    on, up = np.ones(9), np.linspace(0.0, 0.9, 9)
    assert (within(u, on, up) ^ within(v, on, up)).all()
