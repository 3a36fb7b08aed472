"""Closed loop on the simulator: files of a matt slope are read and decomposed, to the reflectance it was made with.

The truth is the definition of a cross-section and the numbers the slope was made with; no formula of the room.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fwclass import conf
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.stage import decompose
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import features
from fwclass.grid import Tile
from fwclass.radiometry.calibration import Calibration, calibrate
from fwclass.radiometry.overlap import overlap
from fwclass.radiometry.params import RadiometryParams
from fwclass.radiometry.ranges import pointing_error
from fwclass.radiometry.stage import radiometry
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span
from fwclass.read.trajectory import in_survey_time, read_trajectory
from fwclass.schema import Table
from fwclass.simulate import stage as simulator
from fwclass.simulate.city import build_scene
from fwclass.simulate.flight import plan_strips
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.scene import Scene
from fwclass.simulate.stage import simulate_strip, write_trajectory
from fwclass.stage import Chunk

SECTION: dict[str, Any] = {
    "platform_altitude": None,
    "max_time_gap": 0.1,
    "max_incidence": 80.0,
    "grazing": 85.0,
    "calibration": None,
    "extinction": 0.0,
    "divergence": 0.5,
    "balance": True,
    "target": None,
    "overlap": {"cell": 2.0, "least_echoes": 4, "max_spread": 0.3, "max_incidence": 65.0, "least_cells": 20},
    "sound": conf.section("radiometry").sound.model_dump(),
}
SIZE, RHO = 60.0, 0.8


def slope_scene(params: SimulateParams, slope: float) -> Scene:
    """The simulator's scene with nothing on it but a smooth matt slope [deg] that rises to the north."""
    scene = build_scene(params)
    north = np.arange(len(scene.height)) * scene.step - scene.margin - params.size / 2.0
    height = np.repeat(math.tan(math.radians(slope)) * north[:, None], scene.height.shape[1], axis=1)
    return scene._replace(
        height=height.astype(np.float32),
        cover=np.zeros_like(scene.cover),
        albedo=np.full_like(scene.albedo, RHO),
        herbs=np.zeros_like(scene.herbs),
        roughness=np.zeros(4),
        ceiling=np.full_like(scene.ceiling, -np.inf),
        gap=np.array([-1e3, -1e3, 1.0, 0.0, 0.1, 0.1]),
    )


@dataclass(frozen=True)
class Flown:
    """Echoes with normals in canonical order, and what the slope and the sensor really were."""

    echoes: Table
    trajectory: Table
    settings: SimulateParams
    slope: float

    @property
    def constant(self) -> float:
        """C_cal by which a white level surface below the aircraft, `bright` DN high and `pulse_width` wide, has the
        cross-section 4 A: pi (R beta)^2 over R^4 times the area of that echo."""
        sensor, height = self.settings.sensor, self.settings.flight.height
        energy = sensor.bright * sensor.pulse_width * math.sqrt(math.pi / math.log(2.0)) / 2.0
        return math.pi * (height * sensor.divergence * 1e-3) ** 2 / (height**4 * energy)

    def truth(self, range_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosine of incidence and cross-section 4 rho A cos."""
        tilt = math.radians(self.slope)
        cosine = self.echoes["beam_y"] * math.sin(tilt) - self.echoes["beam_z"] * math.cos(tilt)
        radius = range_ * self.settings.sensor.divergence * 1e-3 / 2.0
        return cosine, 4.0 * RHO * math.pi * radius**2 * cosine


def fly(folder: Path, base: dict[str, Any], slope: float, sensor: dict[str, Any], flight: dict[str, Any]) -> Flown:
    """Simulate, read, decompose and give normals."""
    section = base["simulate"]
    settings = SimulateParams(
        **{**section, "size": SIZE, "strips": 2, "pulse_density": 4.0, "sensor": {**section["sensor"], **sensor}}
        | {"flight": {**section["flight"], **flight}, "recordings": [section["recordings"][2]]}
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulator, "build_scene", lambda params: slope_scene(params, slope))
        for strip in plan_strips(settings):
            simulate_strip(settings, strip, folder)
    reading, fitting = ReadParams(**base["read"]), DecomposeParams(**{**base["decompose"], "register_within": 0.0})
    pulse = SystemPulse.gaussian(settings.sensor.pulse_width)
    tables = []
    for number, path in enumerate(sorted((folder / "strips").glob("*.las"))):
        source = open_source(path)
        for span in index_source(source, reading):
            tables.append(decompose(read_span(source, span, reading), number, fitting, pulse)[0])
    table = Table.concat(tables)
    everything = np.arange(table.rows)
    tile = Tile(0, 0, 1e8)
    around = FeaturesParams(**{**base["features"], "normal_radius": 2.0, "noise_counts": True})
    shape = features(Chunk(table, everything, tile), (), around)
    table = table.with_columns({name: shape[name] for name in ("normal_x", "normal_y", "normal_z")})
    trajectory = read_trajectory(write_trajectory(settings, folder))
    trajectory = in_survey_time(trajectory, table["gps_time"].min(), table["gps_time"].max(), folder)
    return Flown(table, trajectory, settings, slope)


def columns(flown: Flown, calibration: Calibration, **change: Any) -> Table:
    params = RadiometryParams(**{**SECTION, "divergence": flown.settings.sensor.divergence, **change})
    chunk = Chunk(flown.echoes, np.arange(flown.echoes.rows), Tile(0, 0, 1e8))
    return radiometry(chunk, flown.trajectory, calibration, params)


def errors(flown: Flown, inner: np.ndarray, got: Table) -> dict[str, tuple[float, float]]:
    """Bias and root mean square of the relative errors of sigma and gamma."""
    _, sigma = flown.truth(got["range"].astype(float))
    found = {"sigma": got["cross_section"] / sigma - 1.0, "gamma": got["backscatter"] / (4.0 * RHO) - 1.0}
    return {name: (float(v[inner].mean()), float(np.sqrt((v[inner] ** 2).mean()))) for name, v in found.items()}


def inside(flown: Flown) -> np.ndarray:
    """Echoes whose whole neighbourhood is on the slope."""
    x, y = flown.echoes["x"] - flown.settings.origin_x, flown.echoes["y"] - flown.settings.origin_y
    return np.asarray((np.minimum(x, y) > 2.0) & (np.maximum(x, y) < SIZE - 2.0))


QUIET = {"energy_jitter": 0.0}


@pytest.mark.parametrize("slope", [0.0, pytest.param(40.0, marks=pytest.mark.slow), 60.0])
def test_cross_section_and_reflectance_of_a_slope(slope: float, base: dict[str, Any], tmp_path: Path) -> None:
    """Bias at most 0.5 %, root mean square at most 3 %, to 60 deg (62 with the scan angle)."""
    flown = fly(tmp_path, base, slope, QUIET, {})
    got = columns(flown, Calibration(flown.constant, source="given", others=True))
    inner = inside(flown)
    assert inner.sum() > 10000
    assert (got["radiometry_flags"][inner] == 0).mean() > 0.985  # some false splits, and normals of ragged neighbours
    single = inner & (got["radiometry_flags"] == 0)
    found = errors(flown, single, got)
    assert abs(found["sigma"][0]) < 0.005
    assert found["sigma"][1] < 0.03
    assert abs(found["gamma"][0]) < 0.005
    assert found["gamma"][1] < 0.03  # the normals, too, are measured
    cosine, _ = flown.truth(got["range"].astype(float))
    off = np.abs(got["incidence"][single] - np.degrees(np.arccos(cosine[single])))
    assert np.quantile(off, 0.99) < 2.0
    decibels = got["reflectance"][single] - 10.0 * np.log10(RHO * cosine[single])
    assert abs(np.mean(decibels)) < 0.03
    assert pointing_error(flown.echoes, flown.trajectory, RadiometryParams(**SECTION)) < 0.02


@pytest.mark.slow
def test_a_wide_beam_on_a_slope_keeps_its_energy(base: dict[str, Any], tmp_path: Path) -> None:
    """The echo is a third wider and as much lower: a sigma from its peak alone would lose a quarter."""
    sensor = QUIET | {"divergence": 1.3, "rings": [1, 8, 16, 24, 32]}
    flown = fly(tmp_path, base, 60.0, sensor, {})
    got = columns(flown, Calibration(flown.constant, source="given", others=True))
    single = inside(flown) & (got["radiometry_flags"] == 0)
    width = np.median(flown.echoes["width"][single]) / flown.settings.sensor.pulse_width
    assert width > 1.2
    found = errors(flown, single, got)
    assert abs(found["sigma"][0]) < 0.005
    assert found["sigma"][1] < 0.03
    peak = flown.echoes["amplitude"] * flown.settings.sensor.pulse_width * math.sqrt(math.pi / math.log(2.0)) / 2.0
    lost = np.median((peak / flown.echoes["energy"])[single])
    assert lost == pytest.approx(1.0 / width, rel=0.02)


def test_a_reference_target_and_the_overlap_find_the_sensors_numbers(base: dict[str, Any], tmp_path: Path) -> None:
    """C_cal of the sensor from a piece of the slope; a strip recorded at half the gain is found and undone."""
    flown = fly(tmp_path, base, 20.0, QUIET, {})
    half = np.where(flown.echoes["strip"] == 1, 0.5, 1.0)
    flown = Flown(
        flown.echoes.with_columns({"energy": flown.echoes["energy"] * half}), flown.trajectory, flown.settings, 20.0
    )
    x, y = flown.settings.origin_x, flown.settings.origin_y
    corners = ((10.0, 20.0), (50.0, 20.0), (50.0, 45.0), (10.0, 45.0))
    target = {"polygon": [[x + a, y + b] for a, b in corners], "reflectance": RHO}
    params = RadiometryParams(**{**SECTION, "target": target})
    chunk = Chunk(flown.echoes, np.arange(flown.echoes.rows), Tile(0, 0, 1e8))
    calibration = calibrate([overlap(chunk, flown.trajectory, params)], params)
    assert calibration.strips[0].gain / calibration.strips[1].gain == pytest.approx(2.0, rel=0.004)
    # gains are relative to the mean of the two strips, half a gain of 2 in logarithms
    assert calibration.constant == pytest.approx(flown.constant * math.sqrt(2.0), rel=0.005)
    got = columns(flown, calibration, target=target)
    found = errors(flown, inside(flown) & (got["radiometry_flags"] == 0), got)
    assert abs(found["sigma"][0]) < 0.005
    assert found["sigma"][1] < 0.03
