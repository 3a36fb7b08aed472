"""Radiometry of echoes: formulas by hand, laws of a matt surface, what is missing, where the range comes from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from tolerances import FLOAT32_CHAIN_RTOL, FLOAT32_RTOL

from fwclass import conf
from fwclass.decompose.fitted_echoes import SATURATED as of_the_fit
from fwclass.errors import InputError
from fwclass.features.params import NORMAL, FeaturesParams
from fwclass.features.stage import features
from fwclass.grid import Tile
from fwclass.radiometry.calibration import Calibration
from fwclass.radiometry.params import RadiometryParams
from fwclass.radiometry.ranges import pointing_error, ranges
from fwclass.radiometry.stage import RADIOMETRY, radiometry
from fwclass.schema import Table, column
from fwclass.stage import Chunk
from fwclass.units import AREA_PER_FWHM
from fwclass.waveforms import SATURATED as fit_saturated

SECTION: dict[str, Any] = {
    "platform_altitude": 660.0,
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
ONE = {
    "strip": 0,
    "x": 0.0,
    "y": 0.0,
    "z": 60.0,
    "gps_time": 100.0,
    "beam_x": 0.0,
    "beam_y": 0.0,
    "beam_z": -1.0,
    "energy": 40.0,
    "number_of_echoes": 1,
    "fit_flags": 0,
    "beam_range": np.nan,
    "normal_x": 0.0,
    "normal_y": 0.0,
    "normal_z": 1.0,
}
GIVEN = Calibration(constant=1e-15, source="given", others=True)


def params_of(**change: Any) -> RadiometryParams:
    return RadiometryParams(**{**SECTION, **change})


def echoes(**change: Any) -> Table:
    columns = np.broadcast_arrays(*{**ONE, **change}.values())
    return Table(dict(zip(ONE, (np.atleast_1d(c) for c in columns), strict=True)))


def run(table: Table, calibration: Calibration = GIVEN, trajectory: Table | None = None, **change: Any) -> Table:
    return radiometry(
        Chunk(table, np.arange(table.rows), Tile(0, 0, 100.0)), trajectory, calibration, params_of(**change)
    )


def test_numbers_by_hand() -> None:
    got = run(echoes())
    area = math.pi * (600.0 * 0.25e-3) ** 2  # radius of the beam: half the divergence times the range
    sigma = 1e-15 * 600.0**4 * 40.0
    assert got["range"][0] == 600.0
    assert got["incidence"][0] == 0.0
    assert got["cross_section"][0] == pytest.approx(sigma, rel=FLOAT32_RTOL)
    assert got["backscatter"][0] == pytest.approx(sigma / area, rel=FLOAT32_RTOL)
    assert got["reflectance"][0] == pytest.approx(10.0 * math.log10(sigma / (4.0 * area)), abs=1e-5)
    assert got["radiometry_flags"][0] == 0
    assert tuple(got) == RADIOMETRY.writes
    # 0.2 dB/km over 600 m there and 600 m back
    thick = run(echoes(), extinction=0.2)
    assert thick["reflectance"][0] - got["reflectance"][0] == pytest.approx(0.24, abs=1e-5)


def test_matt_surface_has_the_cross_section_of_the_light_it_sends_back() -> None:
    """From the definition of a cross-section, 4 pi times the intensity towards the sensor over the irradiance."""
    rho, theta, distance, divergence = 0.35, math.radians(50.0), 740.0, 0.7
    area = math.pi / 4.0 * (distance * divergence * 1e-3) ** 2
    lit = area / math.cos(theta)
    irradiance = math.cos(theta)  # per unit of the beam's
    radiance = rho * irradiance / math.pi
    back = radiance * lit * math.cos(theta)  # per steradian, towards the sensor
    sigma = 4.0 * math.pi * back
    energy = sigma / (GIVEN.constant * distance**4)
    tilted = {"normal_x": math.sin(theta), "normal_z": math.cos(theta)}
    got = run(echoes(energy=energy, beam_range=distance, **tilted), divergence=divergence)
    assert got["cross_section"][0] == pytest.approx(sigma, rel=FLOAT32_CHAIN_RTOL)
    assert got["backscatter"][0] == pytest.approx(4.0 * rho, rel=FLOAT32_CHAIN_RTOL)
    assert got["incidence"][0] == pytest.approx(50.0, abs=1e-3)
    assert got["reflectance"][0] == pytest.approx(10.0 * math.log10(rho * math.cos(theta)), abs=1e-4)


def test_matt_surface_has_one_backscatter_at_every_range_and_slope() -> None:
    rng = np.random.default_rng(5)
    n = 2000
    distance, theta, turn = rng.uniform(100, 3000, n), np.radians(rng.uniform(0, 79, n)), rng.uniform(0, 2 * np.pi, n)
    tilt = np.radians(rng.uniform(-30, 30, n))
    beam = np.stack([np.sin(tilt), np.zeros(n), -np.cos(tilt)])
    across = np.stack([np.cos(tilt), np.zeros(n), np.sin(tilt)])
    side = across * np.cos(turn) + np.array([[0.0], [1.0], [0.0]]) * np.sin(turn)
    normal = -beam * np.cos(theta) + side * np.sin(theta)
    normal *= np.sign(normal[2])  # upward, as the features stage gives it
    names = ("beam_x", "beam_y", "beam_z", "normal_x", "normal_y", "normal_z")
    place = dict(zip(names, [*beam, *normal], strict=True))
    got = run(echoes(energy=1e9 * np.cos(theta) / distance**2, beam_range=distance, **place))
    # beam, normal and energy are stored with 24 bits; the cosine is worst at grazing incidence
    np.testing.assert_allclose(got["backscatter"], np.median(got["backscatter"]), rtol=5e-6)
    np.testing.assert_allclose(got["incidence"], np.degrees(theta), atol=0.03)
    ratio = got["cross_section"] / (distance**2 * np.cos(theta))
    np.testing.assert_allclose(ratio, ratio[0], rtol=5e-6)


def test_old_factor_of_the_simulated_city_is_reproduced() -> None:
    """gamma = 8.743e-9 R^2 peak FWHM / cos: a white surface of 240 DN and 3.5 ns from 369 m has 1; 4 in true units."""
    factor, peak, fwhm, theta = 8.743e-9, 57.0, 4.1, math.radians(20.0)
    energy = peak * fwhm * math.sqrt(math.pi) / (2.0 * math.sqrt(math.log(2.0)))
    tilted = {"normal_x": math.sin(theta), "normal_z": math.cos(theta)}
    constant = factor * np.pi / 4.0 * 0.5e-3**2 / AREA_PER_FWHM
    got = run(echoes(energy=energy, beam_range=369.0, **tilted), Calibration(constant, source="given", others=True))
    assert got["backscatter"][0] == pytest.approx(factor * 369.0**2 * peak * fwhm / math.cos(theta), rel=FLOAT32_RTOL)
    white = 240.0 * 3.5 * math.sqrt(math.pi) / (2.0 * math.sqrt(math.log(2.0)))
    true = run(echoes(energy=white, beam_range=369.0), Calibration(4.0 * constant, source="given", others=True))
    assert true["backscatter"][0] == pytest.approx(4.0, rel=1e-4)
    assert true["reflectance"][0] == pytest.approx(0.0, abs=1e-3)
    assert true["cross_section"][0] == pytest.approx(math.pi * (369.0 * 0.5e-3) ** 2, rel=1e-4)


def test_divergence_cancels_out_of_gamma_and_reflectance_once_calibrated() -> None:
    narrow = run(echoes(), Calibration(1e-15, source="given", others=True), divergence=0.3)
    wide = run(echoes(), Calibration(9e-15, source="given", others=True), divergence=0.9)
    np.testing.assert_allclose(wide["backscatter"], narrow["backscatter"], rtol=FLOAT32_RTOL)
    np.testing.assert_allclose(wide["reflectance"], narrow["reflectance"], atol=1e-5)


@pytest.mark.parametrize(
    ("change", "flag", "known"),
    [
        ({}, 0, ("cross_section", "backscatter", "reflectance")),
        ({"number_of_echoes": 3}, 1, ("cross_section", "backscatter", "reflectance")),
        ({"z": 700.0}, 2, ()),
        ({"z": np.nan}, 2, ()),
        ({"beam_z": 0.2}, 2, ()),
        ({"beam_z": np.nan}, 2 | 4, ()),
        ({"beam_range": 0.0, "z": 660.0}, 2, ()),
        ({"normal_z": np.nan}, 4, ("cross_section", "reflectance")),
        ({"normal_z": 0.0}, 4, ("cross_section", "reflectance")),
        ({"normal_x": 1.0, "normal_z": 0.0}, 4, ("cross_section", "reflectance")),
        ({"normal_x": 1.0, "normal_z": 0.12}, 8, ("cross_section", "backscatter", "reflectance")),
        ({"fit_flags": 3}, 16, ("cross_section", "backscatter", "reflectance")),
        ({"energy": np.nan}, 0, ()),
        ({"energy": np.inf}, 0, ()),
        ({"energy": -1.0}, 0, ()),
        ({"beam_range": np.inf, "z": 660.0}, 2, ()),
        ({"energy": 0.0}, 0, ("cross_section", "backscatter")),
    ],
)
def test_what_is_missing_is_missing_and_flagged(change: dict[str, float], flag: int, known: tuple[str, ...]) -> None:
    got = run(echoes(**change))
    assert got["radiometry_flags"][0] == flag
    for name in ("cross_section", "backscatter", "reflectance"):
        assert np.isnan(got[name][0]) == (name not in known), name


def test_uncalibrated_is_relative_and_has_no_reflectance() -> None:
    got = run(echoes(), Calibration())
    assert got["radiometry_flags"][0] == 32
    assert np.isnan(got["reflectance"][0])
    assert got["cross_section"][0] == pytest.approx(600.0**4 * 40.0, rel=FLOAT32_RTOL)


def test_grazing_incidence_stays_finite_and_tells_its_angle() -> None:
    wall = {"normal_x": math.cos(math.radians(6.0)), "normal_z": math.sin(math.radians(6.0))}
    got, facing = run(echoes(**wall)), run(echoes())
    assert got["incidence"][0] == pytest.approx(84.0, abs=1e-3)
    assert got["backscatter"][0] == pytest.approx(
        facing["backscatter"][0] / math.cos(math.radians(80.0)), rel=FLOAT32_RTOL
    )
    assert got["cross_section"][0] == facing["cross_section"][0]


def test_a_single_scan_line_has_no_normals() -> None:
    """Neighbours of one line lie in one plane with the beam: over noisy flat ground, and over what stands up."""
    rng = np.random.default_rng(8)
    params = FeaturesParams(**{**conf.section("features").model_dump(), "normal_radius": 1.5, "noise_counts": True})
    tilt = np.repeat(np.linspace(-0.3, 0.3, 700), 2)
    n = len(tilt)
    for rough in (0.02, 4.0):
        away = (600.0 + np.where(np.arange(n) % 2 == 0, 0.0, rng.uniform(0.0, rough, n))) / np.cos(tilt)
        place = {"x": (away * np.sin(tilt)).round(3), "y": rng.normal(0.0, 0.02, n).round(3)}
        place["z"] = (660.0 - away * np.cos(tilt)).round(3)
        beam = {"beam_x": np.sin(tilt), "beam_y": np.zeros(n), "beam_z": -np.cos(tilt)}
        table = echoes(**place, **beam).with_columns(
            {"pulse": np.arange(n), "echo_number": np.ones(n), "amplitude": np.ones(n), "width": np.ones(n)}
        )
        chunk = Chunk(table, np.arange(n), Tile(0, 0, 1e6))
        got = run(table.with_columns(features(chunk, (), params).select(NORMAL)))
        without = got["radiometry_flags"] & 4 > 0
        assert without.mean() > 0.9 and np.isnan(got["incidence"][without]).all()
        assert np.isnan(got["backscatter"][without]).all() and np.isfinite(got["cross_section"]).all()


def flight() -> Table:
    """A fix each second at 60 m/s east, 600 m above the echo; none from 110 to 120."""
    time = np.concatenate([np.arange(90.0, 111.0), np.arange(120.0, 131.0)])
    return Table({"gps_time": time, "x": 60.0 * (time - 100.0), "y": 0.0 * time, "z": 660.0 + 0.0 * time})


def test_range_comes_from_the_source_then_the_trajectory_then_the_altitude() -> None:
    table = echoes(gps_time=[100.5, 100.5, 115.0, 80.0, np.nan, 130.0], beam_range=[500.0] + 5 * [np.nan], beam_z=-0.8)
    got = ranges(table, flight(), params_of())
    there = math.hypot(30.0, 600.0)
    np.testing.assert_allclose(got, [500.0, there, 750.0, 750.0, 750.0, math.hypot(1800.0, 600.0)], rtol=1e-7)
    got = ranges(table, flight(), params_of(platform_altitude=None))
    np.testing.assert_array_equal(np.isnan(got), [False, False, True, True, True, False])
    assert np.isnan(ranges(table, None, params_of(platform_altitude=None))[1:]).all()
    # a gap is one of more than max_time_gap
    assert np.isfinite(ranges(table, flight(), params_of(platform_altitude=None, max_time_gap=11.0))[2])


def test_range_does_not_depend_on_the_other_rows() -> None:
    rng = np.random.default_rng(3)
    table = echoes(gps_time=rng.uniform(85, 135, 500), z=rng.uniform(0, 100, 500))
    whole = ranges(table, flight(), params_of())
    for rows in (np.arange(3, 9), np.array([77]), np.arange(500)[::-1]):
        np.testing.assert_array_equal(ranges(table.take(rows), flight(), params_of()), whole[rows])


def test_pointing_error_tells_a_wrong_clock() -> None:
    time = np.linspace(90.5, 109.5, 40)
    table = echoes(gps_time=time, x=60.0 * (time - 100.0))
    assert pointing_error(table, flight(), params_of()) == pytest.approx(0.0, abs=1e-4)
    late = flight().with_columns({"gps_time": flight()["gps_time"] - 3.0})
    assert pointing_error(table, late, params_of()) == pytest.approx(math.degrees(math.atan2(180, 600)), abs=0.5)
    assert math.isnan(pointing_error(echoes(gps_time=np.nan), flight(), params_of()))


def test_only_core_rows_in_their_order_and_declared_ranges() -> None:
    rng = np.random.default_rng(8)
    n = 300
    vectors = rng.normal(size=(2, 3, n))
    vectors /= np.sqrt((vectors**2).sum(axis=1, keepdims=True))
    names = ("beam_x", "beam_y", "beam_z", "normal_x", "normal_y", "normal_z")
    table = echoes(energy=rng.uniform(0, 1e4, n), **dict(zip(names, vectors.reshape(6, n), strict=True)))
    core = rng.permutation(n)[:120]
    part = radiometry(Chunk(table, core, Tile(0, 0, 100.0)), None, GIVEN, params_of())
    whole = run(table)
    for name, values in part.items():
        np.testing.assert_array_equal(values, whole[name][core])
        seen = values[np.isfinite(values)]
        record = column(name)
        assert record.low is None or seen.min() >= record.low
        assert record.high is None or seen.max() <= record.high
    empty = radiometry(Chunk(table, np.empty(0, np.int64), Tile(0, 0, 1.0)), flight(), GIVEN, params_of())
    assert empty.rows == 0


def test_a_missing_column_is_named() -> None:
    table = echoes().select([n for n in ONE if n != "energy"])
    with pytest.raises(InputError, match="energy"):
        run(table)


@pytest.mark.parametrize(
    "change",
    [
        {"divergence": 0.0},
        {"max_incidence": 90.0},
        {"max_time_gap": 0.0},
        {"calibration": -1.0},
        {"extinction": -0.1},
        {"target": {"polygon": [[0, 0], [1, 1]], "reflectance": 0.5}},
        {"target": {"polygon": [[0, 0], [1, 1], [2, 2]], "reflectance": 0.5}},
        {"target": {"polygon": [[0, 0], [1, 1], [2, 0]], "reflectance": 50.0}},
        {"target": {"polygon": [[0, 0], [1, 1], [2, 0]], "reflectance": 0.5}, "calibration": 1.0},
        {"altitude": 1.0},
    ],
)
def test_params_that_do_not_fit_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        params_of(**change)


def test_a_saturated_echo_is_one_that_the_fit_calls_so() -> None:
    assert fit_saturated == of_the_fit
