"""Places outside of where their coordinate system is used, heights without land, and times that are none are told."""

from __future__ import annotations

import json
import math
from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass
from pyproj import CRS
from smallsurvey import small_survey

from fwclass.formats.area_of_use import elsewhere, outside_of_area, place_faults, time_faults

STUTTGART = (513_000.0, 5_403_000.0)


def box(x: float, y: float, z: float = 300.0) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return (x, y, z), (x + 500.0, y + 500.0, z + 40.0)


@pytest.mark.parametrize(
    ("code", "x", "y"), [("EPSG:3857", 1e6, 6e6), ("EPSG:3395", 1e6, 6e6), ("EPSG:3857", 1e6, -5e6)]
)
def test_systems_whose_lengths_are_none_are_told(code: str, x: float, y: float) -> None:
    crs = CRS.from_user_input(code)
    [fault] = place_faults(crs, *box(x, y))
    lat = math.degrees(math.atan(math.sinh(y / 6_378_137.0)))
    told = float(fault.split("is one of ")[1].split()[0])
    assert told == pytest.approx(1 / math.cos(math.radians(lat)), rel=0.02) and elsewhere(crs, *box(x, y))
    low, high = box(x, y)
    assert not elsewhere(crs, (x, 0.0, low[2]), high)  # a stray point on the equator proves nothing


@pytest.mark.parametrize(
    ("code", "x", "y"),
    [
        ("EPSG:25832", *STUTTGART),
        ("EPSG:2263", 980_000.0, 200_000.0),  # feet
        ("EPSG:5070", 1.6e6, 5e5),  # Florida, in the system of a continent
        ("EPSG:3035", 4.3e6, 3.1e6),
        ("EPSG:25832+7837", *STUTTGART),  # a compound system names no area of its own
        ("EPSG:25832", 882_000.0, 6_116_000.0),  # Bornholm, half a zone beyond Denmark's
        ("EPSG:28992", 85_000.0, 446_000.0),  # Delft
        ("EPSG:2193", 1_570_000.0, 5_180_000.0),  # Christchurch
        ("EPSG:3832", 0.0, 0.0),  # over the antimeridian
        ("EPSG:3857", 1e6, 1e5),
        ("EPSG:32661", 2e6, 2e6),
    ],
)
def test_places_of_a_system_are_no_fault(code: str, x: float, y: float) -> None:
    crs = CRS.from_user_input(code)
    assert place_faults(crs, *box(x, y)) == [] and not elsewhere(crs, *box(x, y))
    assert outside_of_area(CRS.from_wkt(crs.to_wkt()), *box(x, y)) == ""


@pytest.mark.parametrize(
    ("code", "x", "y", "there"),
    [
        ("EPSG:25832", *STUTTGART[::-1], "3.5° N 49.3° E"),
        ("EPSG:25832", 0.0, 0.0, "0.0° N 4.5° E"),  # local coordinates
        ("EPSG:28992", 446_000.0, 85_000.0, "48.7° N 9.3° E"),
        ("EPSG:31467", *STUTTGART, "42.6° N 27.3° W"),  # a zone's number is missing
    ],
)
def test_places_elsewhere_are_told(code: str, x: float, y: float, there: str) -> None:
    crs = CRS.from_user_input(code)
    (fault,) = place_faults(crs, *box(x, y))
    assert there in fault and crs.name in fault and elsewhere(crs, *box(x, y)), fault
    assert there in outside_of_area(CRS.from_wkt(crs.to_wkt("WKT1_GDAL")), *box(x, y))


def test_stray_points_prove_nothing() -> None:
    crs = CRS.from_epsg(25832)
    low, high = (0.0, 0.0, -9999.0), (*STUTTGART, 400.0)
    (fault,) = place_faults(crs, low, high)
    assert "heights from -9,999.0 to 400.0 m" in fault and not elsewhere(crs, low, high)


def test_heights_in_feet_are_feet() -> None:
    colorado = CRS.from_epsg(2232)  # US survey feet
    assert place_faults(colorado, (3e6, 1.5e6, 9_000.0), (3e6, 1.5e6, 14_000.0)) == []
    assert place_faults(None, (0.0, 0.0, 9_000.0), (1.0, 1.0, 14_000.0)) != []
    assert place_faults(None, (math.nan,) * 3, (math.nan,) * 3) == []


def test_times_that_are_none() -> None:
    for sound in ((0.0, 604_800.0), (-9.9e8, 4.2e8), (1.3e9, 1.4e9), (math.nan, math.nan), (math.inf, -math.inf)):
        assert time_faults(*sound) == []
    assert "1e+11 s, 3,169 years" in time_faults(3e10, 1e11)[0]
    assert time_faults(1e300, 1.7e308) == ["GPS times reach 1.7e+308 s, 5.39e+300 years: they are not in seconds"]


def test_info_and_a_run_tell_it(tmp_path: Path) -> None:
    conf = small_survey(tmp_path)
    las = laspy.read(tmp_path / "a.las")
    times = np.array(las.gps_time)
    line = ("run", conf, "--out", tmp_path / "r", "--workers", 0, "--workflow", "ground")
    assert fwclass(*line).returncode == 0
    assert "is used from" not in fwclass("info", tmp_path / "a.las").stdout
    las.gps_time = times * 1e6 + 1e12
    las.write(tmp_path / "a.las")
    assert "they are not in seconds" in fwclass("info", tmp_path / "a.las").stdout
    ended = fwclass(*line)
    assert ended.returncode == 0 and "they are not in seconds" in ended.stderr, ended.stderr
    x, y = np.array(las.x), np.array(las.y)
    las.change_scaling(scales=(0.01, 0.01, 0.01), offsets=(0.0, 0.0, 0.0))
    las.x, las.y = y, x
    las.write(tmp_path / "a.las")
    assert "are x and y swapped" in fwclass("info", tmp_path / "a.las").stdout
    ended = fwclass(*line)
    assert ended.returncode == 4 and "the echoes do not lie where their coordinate system is" in ended.stderr
    place = json.loads((tmp_path / "r" / "report.json").read_text())["place"]
    assert place["elsewhere"] and len(place["remarks"]) == 2
    assert "are x and y swapped" in (tmp_path / "r" / "report.html").read_text()
    assert fwclass(*line, "--accept-implausible").returncode == 0


def test_commands_of_one_file_end_with_it_when_they_have_written(tmp_path: Path) -> None:
    small_survey(tmp_path)
    las = laspy.read(tmp_path / "a.las")
    sound = np.array(las.x), np.array(las.y), np.array(las.z)
    commands = {"ground": ("ground", "o.las"), "normalize": ("normalize", "o.las", "--method", "smrf")}
    commands["features"] = ("features", "o.parquet", "--features", "amplitude,height_above_ground")
    las.change_scaling(scales=(0.01, 0.01, 0.01), offsets=(0.0, 0.0, 0.0))
    for places, said in (
        (sound, ""),
        ((sound[1], sound[0], sound[2]), "are x and y swapped"),
        ((sound[0], sound[1], sound[2] - 5000.0), "reach where no land is"),
    ):
        las.x, las.y, las.z = places
        las.write(tmp_path / "a.las")
        for command, output, *more in commands.values():
            line = (command, tmp_path / "a.las", tmp_path / output, *more, "--overwrite")
            ended = fwclass(*line)
            assert ended.returncode == (4 if said else 0), ended.stderr
            assert (tmp_path / output).is_file() and said in ended.stderr
            assert ("do not lie where their coordinate system is" in ended.stderr) == bool(said)
            (tmp_path / output).unlink()
            if said:
                ended = fwclass(*line, "--accept-implausible")
                assert ended.returncode == 0 and said in ended.stderr, ended.stderr
