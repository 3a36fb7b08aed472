"""Files that lie where their coordinate system is not used, where another than their own puts them, or far from all."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lasmaker
import numpy as np
import pytest
import rasterio
from commandline import fwclass
from pyproj import CRS
from smallsurvey import small_survey

from fwclass import conf
from fwclass.errors import QualityError
from fwclass.report.places import file_places, judge_file_places
from fwclass.survey.layout import Strip, Survey

HERE = (500_000.0, 5_400_000.0)
UTM32, UTM33, LAMBERT = (CRS.from_epsg(code) for code in (25832, 25833, 2154))
BOUNDS = conf.section("plausibility")


def files(place: Path, corners: Sequence[tuple[float, float]], scales: Sequence[float] = (), **more: Any) -> Path:
    """A survey of files, each of a slope of 12 m x 12 m with this corner; its coordinates times its scale, if given."""
    more |= {"point_format": 6}
    for k, (x, y) in enumerate(corners):
        inside = np.random.default_rng(k).uniform(0, 12, (300, 2))
        xyz = np.c_[inside + np.array([x, y]), 200 + 0.1 * inside[:, 0]] * (scales[k] if scales else 1.0)
        lasmaker.write_las(place / f"f{k}.las", xyz, gps_time=4e8 + 10.0 * k + 1e-4 * np.arange(300), **more)
    (place / "s.yaml").write_text("survey: {name: s, sources: ['*.las']}\n")
    return place / "s.yaml"


def measured(path: Path, *words: str) -> tuple[Any, dict[str, Any]]:
    """How a run of the quality workflow ends, and its report."""
    root = path.parent / "r"
    ended = fwclass("run", path, "--out", root, "--workflow", "quality", "--workers", 0, *words)
    return ended, json.loads((root / "report.json").read_text())


@pytest.mark.parametrize("scale", [1 / 0.3048, pytest.param(100.0, marks=pytest.mark.slow)])
def test_one_file_of_three_in_another_unit_ends_with_4(tmp_path: Path, scale: float) -> None:
    path = files(tmp_path, [(HERE[0] + 12 * k, HERE[1]) for k in range(3)], [1.0, scale, 1.0])
    ended, report = measured(path)
    assert ended.returncode == 4 and "1 of 3 files (f1.las)" in ended.stderr, ended.stderr
    assert ended.stderr.count("is used from") == 2  # the remark and the reason
    assert report["input"]["places"]["elsewhere"] in report["remarks"]
    assert "1 of 3 files (f1.las)" in (tmp_path / "r" / "report.html").read_text()
    assert measured(path, "--accept-implausible")[0].returncode == 0


def test_a_part_of_one_file_in_feet_ends_with_4_and_strays_do_not(tmp_path: Path) -> None:
    inside = np.random.default_rng(0).uniform(0, 12, (2000, 2))
    xyz = np.c_[inside + HERE, 200 + 0.1 * inside[:, 0]]
    for part, code in ((30, 0), (200, 4)):
        mixed = np.r_[xyz[part:], xyz[:part] / 0.3048]
        times = 4e8 + 1e-4 * np.arange(2000)
        lasmaker.write_las(tmp_path / "f0.las", mixed, point_format=6, gps_time=times, scale=0.01)
        (tmp_path / "s.yaml").write_text("survey: {name: s, sources: ['*.las']}\n")
        for size in (25, 60):
            ended, report = measured(tmp_path / "s.yaml", "--set", f"tile.size={size}")
            assert ended.returncode == code, ended.stderr
            assert ("200 of 2,000 echoes" in report["input"]["places"]["elsewhere"]) == (code == 4)


def test_a_system_that_puts_files_further_outside_than_their_own_ends_with_4(tmp_path: Path) -> None:
    path = files(tmp_path, [(770_500.0, 6_277_500.0)], keys=lasmaker.UTM33 | {3072: 2154})
    for code, fault in ((2154, 0), (3035, 4), (25832, 4)):
        ended, report = measured(path, "--set", f"survey.crs=EPSG:{code}")
        assert ended.returncode == fault, (code, ended.stderr)
        assert bool(report["input"]["places"]["overruled"]) == (code == 25832)


@pytest.mark.parametrize("whole", [(0,), (1, 2)])
def test_files_that_say_nothing_of_heights_take_those_of_the_others(tmp_path: Path, whole: tuple[int, ...]) -> None:
    for k in range(3):
        keys = {3072: 25832} | ({4096: 7837} if k in whole else {})
        files(tmp_path, [(HERE[0] + 12 * k, HERE[1])], keys=keys)
        (tmp_path / "f0.las").rename(tmp_path / f"g{k}.las")
    drafted = fwclass("init", tmp_path)
    assert "heights of all are those" in drafted.stdout and "set survey.crs" not in drafted.stderr
    ended, report = measured(tmp_path / "s.yaml")
    assert ended.returncode == 0, ended.stderr
    (told,) = report["input"]["places"]["remarks"]
    flat = [k for k in range(3) if k not in whole]
    assert f"{len(flat)} file" in told and "DHHN2016 height" in told and all(f"g{k}.las" in told for k in flat)
    assert f"note: {told}" in ended.stderr and told in report["remarks"]
    with rasterio.open(tmp_path / "r" / "rasters" / "pulse_density.tif") as raster:
        assert CRS.from_wkt(raster.crs.to_wkt()).is_compound
    ended, report = measured(tmp_path / "s.yaml", "--set", "survey.crs=EPSG:25832")
    assert ended.returncode == 0 and not report["input"]["places"]["remarks"]


def test_a_file_of_another_survey_ends_with_4(tmp_path: Path) -> None:
    path = files(tmp_path, [*((HERE[0] + 12 * k, HERE[1]) for k in range(5)), (HERE[0] + 60_000, HERE[1])])
    ended, report = measured(path)
    assert ended.returncode == 4 and "files lie far from all others" in ended.stderr, ended.stderr
    assert "f5.las lies 60 km from the nearest of the other 5 files" in report["remarks"][0]
    ended, report = measured(path, "--set", "plausibility.max_apart=70000")
    assert ended.returncode == 0 and not report["input"]["places"]["remarks"]
    assert measured(path, "--accept-implausible")[0].returncode == 0


def places(boxes: Sequence[tuple[float, float]], crs: CRS = UTM32, own: CRS | None = None) -> dict[str, Any]:
    """What is said of files of 1 km x 1 km with these corners, all of which name `own` where it is given."""
    strips = tuple(Strip(k + 1, Path(f"f{k}.las"), (), 6) for k in range(len(boxes)))
    overruled = {s.path.name: own.to_wkt() for s in strips} if own else {}
    survey = Survey(strips, (), crs.to_wkt(), True, overruled=overruled)
    bounds = {k + 1: ([x, y, 0.0], [x + 1000.0, y + 1000.0, 50.0]) for k, (x, y) in enumerate(boxes)}
    return file_places(survey, bounds, BOUNDS)


def test_several_sites_are_told_and_taken() -> None:
    town = [(HERE[0] + 1000 * (k % 4), HERE[1] + 1000 * (k // 4)) for k in range(12)]
    second = [(HERE[0] + 80_000 + 1000 * k, HERE[1]) for k in range(4)]
    for boxes in (
        town[:2],
        [*town[:3], second[0]],
        [town[0], *((HERE[0], HERE[1] + 40_000.0 * k) for k in range(1, 6))],
    ):
        judge_file_places(places(boxes), BOUNDS, "s")  # few files, or each a site of its own
    both = places([*town, *second])
    assert not both["alone"] and "2 places" in both["remarks"][0] and "76 km" in both["remarks"][0]
    for foreign in (1, 2):
        assert (foreign == 1) == bool(places([*town, *second[:foreign]])["alone"])
    assert not places([*town[:6], second[0], (0.0, HERE[1]), (HERE[0], 0.0)])["alone"]  # four sites: a collection
    with pytest.raises(QualityError, match="far from all others"):
        judge_file_places(places([*town, second[0]]), BOUNDS, "s")
    judge_file_places(places([*town, second[0]]), BOUNDS.model_copy(update={"accept": True}), "s")


def test_a_chain_of_files_is_one_place() -> None:
    assert places([(HERE[0], HERE[1] + 29_000.0 * k) for k in range(8)])["remarks"] == []


def test_what_overrules_a_wrong_header_is_taken() -> None:
    town = [(770_500.0, 6_277_500.0)]
    assert "56.6° N 13.4° E" in places(town, UTM32, LAMBERT)["overruled"]
    assert not places(town, LAMBERT, UTM32)["remarks"]  # the header is the wrong one
    assert not places([HERE], UTM32, UTM33)["remarks"] and not places([HERE], UTM33, UTM32)["remarks"]
    assert not places([(891_000.0, 6_120_000.0)], UTM32, UTM32)["remarks"]  # Bornholm in Denmark's zone


def test_a_survey_all_of_which_lies_elsewhere_is_told_as_a_whole() -> None:
    assert not places([(x * 1000, y) for x, y in [HERE, HERE]])["elsewhere"]
    assert "1 of 2 files (f1.las)" in places([HERE, (HERE[0] * 1000, HERE[1])])["elsewhere"]


def test_commands_of_one_file_take_no_worse_system(tmp_path: Path) -> None:
    files(tmp_path, [(770_500.0, 6_277_500.0)], keys=lasmaker.UTM33 | {3072: 2154})
    for command, *more in (
        ("ground", "o.las"),
        ("features", "o.parquet", "--features", "amplitude"),
        ("decompose", "o.laz"),
    ):
        for code, fault in ((2154, 0), (25832, 4)):
            words = (
                command,
                tmp_path / "f0.las",
                tmp_path / more[0],
                *more[1:],
                "--crs",
                f"EPSG:{code}",
                "--overwrite",
            )
            ended = fwclass(*words)
            assert ended.returncode == fault, (command, code, ended.stderr)
            assert not fault or "outside of the area that" in ended.stderr


@pytest.mark.parametrize(
    ("at", "off"),
    [
        pytest.param(179, -20.0, marks=pytest.mark.slow),
        pytest.param(211, -2.0, marks=pytest.mark.slow),
        (187, 20.0),
        (179, -0.5),
    ],
)
def test_points_outside_of_the_bounds_that_a_header_states_are_told(tmp_path: Path, at: int, off: float) -> None:
    survey = small_survey(tmp_path)
    raw = bytearray((tmp_path / "a.las").read_bytes())
    struct.pack_into("<d", raw, at, struct.unpack_from("<d", raw, at)[0] + off)
    (tmp_path / "a.las").write_bytes(raw)
    ended = fwclass("run", survey, "--out", tmp_path / "r", "--workers", 0, "--workflow", "ground")
    assert ended.returncode == 0, ended.stderr
    told = "points of a.las lie outside of the bounds that the header states" in " ".join(ended.stderr.split())
    assert told == (abs(off) > 1)
