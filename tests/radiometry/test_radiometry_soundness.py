"""Trajectories, altitudes and calibrations that cannot be those of the echoes are told and end with exit code 4."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from commandline import fwclass
from rawmaker import scene, write_parquet

from fwclass import conf
from fwclass.radiometry.calibration import Calibration, PairRatio
from fwclass.radiometry.soundness import COUNTS, by_strip, displacement, faults, strip_sums
from fwclass.report.radiometry import radiometry_facts
from fwclass.schema import Table

PARAMS = conf.section("radiometry")


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory):
    root = tmp_path_factory.mktemp("flight")
    truth = scene(pulses=600, n=80)
    write_parquet(root / "a.parquet", truth.columns(), {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    return root, truth


def decompose(flight, moved=(0.0, 0.0, 0.0), late=0.0, rows=slice(None), *words):
    root, truth = flight
    way = np.c_[truth.time + late, truth.origin + moved][::5][rows]
    (root / "way.csv").write_text("time,x,y,z\n" + "\n".join(",".join(f"{v:.6f}" for v in row) for row in way) + "\n")
    ended = fwclass(
        *("decompose", root / "a.parquet", root / "a.laz", "--overwrite", "--trajectory", root / "way.csv"),
        *("--set", "radiometry.calibration=1e-15", "--set", "radiometry.sound.darkest=-300"),
        *("--set", "radiometry.sound.brightest=300", *words),
    )
    return ended.returncode, ended.stderr


def test_a_sound_flight_is_not_told(flight) -> None:
    code, words = decompose(flight)
    assert code == 0 and "fault" not in words, words
    truth, las = flight[1], laspy.read(flight[0] / "a.laz")
    order = np.argsort(np.asarray(las.gps_time), kind="stable")
    away = np.linalg.norm(truth.place - truth.origin, axis=1)
    np.testing.assert_allclose(np.median(np.asarray(las["range"])[order] - away), 0.0, atol=0.02)


@pytest.mark.parametrize(
    "moved", [(0.0, 0.0, 40.0), pytest.param((0.0, 0.0, -40.0), marks=pytest.mark.slow), (12.0, -7.0, 0.0)]
)
def test_a_trajectory_that_lies_elsewhere(flight, moved) -> None:
    code, words = decompose(flight, moved)
    assert code == 4 and "trajectory or calibration are not those of the echoes" in words, words
    said = words.split("the trajectory lies ")[1].split(" m (x, y, z)")[0]
    np.testing.assert_allclose([float(v) for v in said.split(", ")], moved, atol=0.2)
    assert decompose(flight, moved, 0.0, slice(None), "--accept-implausible")[0] == 0


def test_half_of_a_flight(flight) -> None:
    code, words = decompose(flight, rows=slice(0, 60))
    assert code == 4 and "echoes have no range: no fix of the trajectory is at their times" in words, words


@pytest.mark.parametrize(
    ("altitude", "code"),
    [
        (720.0, 0),
        pytest.param(650.0, 0, marks=pytest.mark.slow),
        pytest.param(400.0, 4, marks=pytest.mark.slow),
        (2362.0, 4),
    ],
)
def test_an_altitude_is_held_against_the_beams(flight, altitude: float, code: int) -> None:
    """The sensor flew at 720 m over ground at 120 m; 2362 are its feet."""
    root = flight[0]
    line = ("decompose", root / "a.parquet", root / "a.laz", "--overwrite", "--set", "radiometry.calibration=1e-15")
    line += ("--set", "radiometry.sound.darkest=-300", "--set", "radiometry.sound.brightest=300")
    ended = fwclass(*line, "--set", f"radiometry.platform_altitude={altitude}")
    assert ended.returncode == code, ended.stderr
    assert ("meet at 720 m" in ended.stderr) == (code == 4), ended.stderr


@pytest.mark.parametrize(("altitude", "count"), [(700.0, 0), (300.0, 1)])
def test_an_altitude_in_a_run(altitude: float, count: int) -> None:
    params = conf.section("radiometry", (f"radiometry.platform_altitude={altitude}",))
    sums = {"sums": {"0": [0.0] * (len(COUNTS) + 9)}}
    facts = radiometry_facts([sums], None, [], params, True, {"a.las": (720.0, 120.0)})
    assert facts is not None and len(facts["implausible"]) == count
    assert radiometry_facts([sums], None, [], params, True, {}) == {"implausible": []}


@pytest.mark.parametrize(
    ("constant", "said"), [("1e-9", "above 3 dB"), pytest.param("1e-24", "below -30 dB", marks=pytest.mark.slow)]
)
def test_reflectances_of_no_surface(flight, constant: str, said: str) -> None:
    root = flight[0]
    decompose(flight)
    line = ("decompose", root / "a.parquet", root / "a.laz", "--overwrite", "--trajectory", root / "way.csv")
    ended = fwclass(*line, "--set", f"radiometry.calibration={constant}")
    assert ended.returncode == 4 and f"reflectances are {said}" in ended.stderr, ended.stderr


def test_points_alone_know_a_trajectory_of_another_place(flight) -> None:
    """As of LAS points: no beams, but nobody sees the ground from 100 km beside it, or from below."""
    truth = flight[1]
    n, nan = len(truth.time), np.full(len(truth.time), np.nan)
    x, y, z = truth.place.T
    echoes = Table(
        {"strip": np.zeros(n), "x": x, "y": y, "z": z, "gps_time": truth.time}
        | dict.fromkeys(("beam_x", "beam_y", "beam_z"), nan)
    )
    columns = Table({"range": nan, "reflectance": nan, "radiometry_flags": np.zeros(n)})
    for moved, astray in (((0, 0, 0), 0), ((1e5, 0, 0), n), ((0, 0, -2000), n)):
        way = Table({"gps_time": truth.time} | dict(zip("xyz", (truth.origin + moved).T, strict=True)))
        sums = by_strip([strip_sums(echoes, way, columns, np.zeros(n, bool), PARAMS)])[0]
        assert sums[COUNTS.index("astray")] == astray and displacement(sums) is None


def test_sums_do_not_depend_on_tiles(flight) -> None:
    truth = flight[1]
    n = len(truth.time)
    x, y, z = truth.place.T
    echoes = Table(
        {"strip": np.zeros(n), "x": x, "y": y, "z": z, "gps_time": truth.time}
        | dict(zip(("beam_x", "beam_y", "beam_z"), truth.away.T, strict=True))
    )
    columns = Table({"range": np.full(n, 600.0), "reflectance": np.zeros(n), "radiometry_flags": np.zeros(n)})
    way = Table({"gps_time": truth.time} | dict(zip("xyz", (truth.origin + np.array([3, 0, 9])).T, strict=True)))
    parts = [np.arange(n) % 3 == k for k in range(3)]
    whole = by_strip([strip_sums(echoes, way, columns, np.ones(n, bool), PARAMS)])[0]
    added = by_strip(
        strip_sums(echoes.take(p), way, columns.take(p), np.ones(int(p.sum()), bool), PARAMS) for p in parts
    )[0]
    np.testing.assert_allclose(whole, added, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(displacement(whole), (3, 0, 9), atol=1e-3)


def test_strips_and_targets_that_contradict_themselves() -> None:
    names = {1: "a.las", 2: "b.las"}
    pair = PairRatio(1, 2, 100, 0.1, 0.01, 0.69)
    changed = Calibration(pairs=(pair,), target_spread=0.5, target_levels=((1, 0.0), (2, -0.6)))
    first, second, third = faults({}, changed, names, PARAMS.sound, True)
    assert "a.las and b.las differ by a factor 1.99" in first
    assert "scatter by a factor 1.65" in second and "1.82 times as bright in a.las as in b.las" in third
    assert Calibration.from_json(changed.to_json()) == changed
    assert faults({}, Calibration(), names, PARAMS.sound, True) == []
