"""`run --workflow quality`: density and strips of a survey, without labels, classes or a model."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import rasterio
from commandline import fwclass
from smallsurvey import small_survey
from stripmaker import ground, line, write_lines

WORDS = ("--workflow", "quality", "--workers", "0")
LIFTS = [(0.0, 0.0, 0.0), (0.09, 0.0, 0.0), (0.0, 0.0, 0.0)]
"""m; a lift of one outer line is in part a tilt of all, which no overlap sees."""
BLOCKS = ("--set", "terrain.block=128", "--set", "ground.block=128", "--set", "terrain.block_halo=40")


def run(place: Path, out: Path, *settings: str, expect: int = 0) -> dict[str, Any]:
    told = fwclass("run", place / "s.yaml", "--out", out, *WORDS, *BLOCKS, *settings)
    assert told.returncode == expect, told.stdout + told.stderr
    return json.loads((out / "quality.json").read_text())


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("lines")
    for k, lift in enumerate(LIFTS):
        one = line(k, lift)
        lake = (np.abs(one["x"] - 500_080) < 10) & (np.abs(one["y"] - 5_400_120) < 20)
        write_lines(place / f"l{k}.las", [one], ~lake)
    (place / "s.yaml").write_text("survey: {name: lines, sources: ['l*.las']}\n")
    return place


@pytest.fixture(scope="module")
def made(survey: Path) -> tuple[Path, dict[str, Any]]:
    out = survey / "run"
    return out, run(survey, out, "--set", "tile.size=100")


def test_the_last_lines_have_the_figures(survey: Path, made: tuple[Path, dict[str, Any]]) -> None:
    out, facts = made
    ended = fwclass("run", survey / "s.yaml", "--out", out, *WORDS, *BLOCKS, "--set", "tile.size=100").stderr
    strips, density = facts["strips"], facts["density"]
    for words in (
        f"density     {density['pulses']:.2f} pulses per m², {density['echoes']:.2f} echoes",
        f"voids       1 from {facts['voids']['least']:.3g} m² on, 1.5 % of the area; the largest 800 m²",
        f"strips      3 by files, {100 * strips['rms']:.1f} cm apart in height (root",
        "noise       0 % of the echoes (0)",
    ):
        assert words in ended, (words, ended)
    assert "threshold" not in ended
    report = json.loads((out / "report.json").read_text())
    path = (out / "report.json").resolve()
    path.chmod(0o644)
    path.write_text(json.dumps({n: v for n, v in report.items() if n != "thresholds"}))
    again = fwclass("run", survey / "s.yaml", "--out", out, *WORDS, *BLOCKS, "--set", "tile.size=100")
    assert again.returncode == 0 and "thresholds" in json.loads((out / "report.json").read_text()), "of before it was"


def test_lifts_of_lines_come_out(made: tuple[Path, dict[str, Any]]) -> None:
    strips = made[1]["strips"]
    assert strips["by"] == "files" and [s["name"] for s in strips["strips"]] == ["l0", "l1", "l2"]
    heights = np.array([s["height"] for s in strips["strips"]])
    errors = np.array([s["height_error"] for s in strips["strips"]])
    off = heights - heights.mean() - (np.array(LIFTS)[:, 0] - np.mean(LIFTS, axis=0)[0])
    assert (np.abs(off) < 3 * errors + 0.001).all() and (errors < 0.002).all()
    assert max(abs(s[n]) for s in strips["strips"] for n in ("roll", "pitch") if s[n] is not None) < 0.003
    between = {(b["first"], b["second"]): b for b in strips["between"]}
    assert set(between) == {(0, 1), (1, 2)} and sum(b["pairs"] for b in between.values()) == strips["pairs"] > 500
    assert between[0, 1]["mean"] == pytest.approx(-0.09, abs=0.003)
    assert between[1, 2]["mean"] == pytest.approx(0.09, abs=0.003)
    assert 0.08 < strips["rms"] < 0.1 and strips["left"] < 0.02
    assert [round(s["azimuth"]) % 360 for s in strips["strips"]] == [0, 180, 0]


def test_density_is_what_was_flown(made: tuple[Path, dict[str, Any]]) -> None:
    facts = made[1]
    assert facts["echoes"] == facts["pulses"] == pytest.approx(281_600, rel=0.01) and facts["noise"] == 0
    assert facts["density"]["area"] == pytest.approx(220 * 240 - 800, rel=0.01)
    assert facts["density"]["pulses"] == pytest.approx(281_600 / (220 * 240 - 800), rel=0.01)
    with rasterio.open(made[0] / "rasters/pulse_density.tif") as raster:
        values = raster.read(1)
        left = values[10:110, 2:18]  # of one line alone
        assert raster.res == (2.0, 2.0) and np.nanmean(left) == pytest.approx(4.0, rel=0.05)
        assert 0 <= facts["pulses"] - np.nansum(values) * 4 <= 3  # those exactly on the upper edges lie in no cell


def test_a_lake_is_a_void(made: tuple[Path, dict[str, Any]]) -> None:
    voids = made[1]["voids"]
    assert voids["count"] == 1 and voids["largest"] == [
        {"area": 800.0, "bounds": [500_070.0, 5_400_100.0, 500_090.0, 5_400_140.0]}
    ]
    info = pyogrio.read_info(made[0] / "quality.gpkg", layer="voids")
    assert info["features"] == 1 and info["total_bounds"] == (500_070.0, 5_400_100.0, 500_090.0, 5_400_140.0)
    assert "32633" in str(info["crs"])


def test_the_map_of_differences_shows_the_lifts(made: tuple[Path, dict[str, Any]]) -> None:
    with rasterio.open(made[0] / "rasters/strip_dz.tif") as raster:
        values, rows, cols = raster.read(1), *raster.shape
        x = raster.transform.c + 4 * (np.arange(cols) + 0.5) - 500_000
    assert rows == 60 and np.isnan(values[:, (x < 58) | (x > 162)]).all()
    assert np.nanmedian(values[:, (x > 60) & (x < 100)]) == pytest.approx(0.09, abs=0.004)
    assert np.nanmedian(values[:, (x > 120) & (x < 160)]) == pytest.approx(0.09, abs=0.004)


@pytest.mark.parametrize("setting", ["tile.size=64", pytest.param("tile.size=1000", marks=pytest.mark.slow)])
def test_tiles_change_no_byte(survey: Path, made: tuple[Path, dict[str, Any]], setting: str, tmp_path: Path) -> None:
    run(survey, tmp_path / "run", "--set", setting)
    for name in ("quality.json", "quality.gpkg", "rasters/pulse_density.tif", "rasters/strip_dz.tif"):
        assert (tmp_path / "run" / name).read_bytes() == (made[0] / name).read_bytes(), name


@pytest.mark.slow
def test_workers_change_no_byte(survey: Path, made: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    run(survey, tmp_path / "run", "--set", "tile.size=100", "--workers", "2")
    for name in ("quality.json", "quality.gpkg", "rasters/pulse_density.tif", "rasters/strip_dz.tif"):
        assert (tmp_path / "run" / name).read_bytes() == (made[0] / name).read_bytes(), name


def test_lines_inside_files_are_told_apart_by_time(tmp_path: Path) -> None:
    lines = [line(k, lift) for k, lift in enumerate(LIFTS)]
    north = np.concatenate([one["y"] for one in lines]) > 5_400_120  # delivered as tiles, each with all lines
    write_lines(tmp_path / "n.las", lines, north)
    write_lines(tmp_path / "s.las", lines, ~north)
    (tmp_path / "s.yaml").write_text("survey: {name: tiles, sources: ['*.las']}\n")
    strips = run(tmp_path, tmp_path / "run", "--set", "quality.line_gap=1")["strips"]
    assert strips["by"] == "times" and [s["files"] for s in strips["strips"]] == [["n", "s"]] * 3
    heights = np.array([s["height"] for s in strips["strips"]])
    assert heights[1] - heights[0] == pytest.approx(0.09, abs=0.005) and heights[2] - heights[0] == pytest.approx(
        0.0, abs=0.005
    )


def test_what_cannot_be_told_is_said(tmp_path: Path) -> None:
    small_survey(tmp_path)
    (tmp_path / "s.yaml").write_text("survey: {name: one, sources: [a.las]}\n")
    facts = run(tmp_path, tmp_path / "run")
    assert any("there is one strip" in text for text in facts["remarks"]) and facts["strips"]["rms"] is None
    report = json.loads((tmp_path / "run/report.json").read_text())
    assert report["quality"] == facts and not any("classes" in text for text in report["remarks"])
    again = fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "run", *WORDS, *BLOCKS).stderr
    assert "strips      1 by files, nowhere compared" in again and "remark      there is one strip" in again, again
    told = fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "run", *WORDS, *BLOCKS, "--tiles", "5000_54000")
    assert told.returncode == 2 and "delivers no tiles" in told.stderr and "Traceback" not in told.stderr


def test_cells_divide_a_block(survey: Path, tmp_path: Path) -> None:
    for setting in ("quality.cell=3", "quality.planes.cell=2.5"):
        told = fwclass("run", survey / "s.yaml", "--out", tmp_path / "run", *WORDS, *BLOCKS, "--set", setting)
        assert told.returncode == 2 and setting.split("=")[0] in told.stderr and not (tmp_path / "run").exists()


def test_the_terrain_of_the_maker_is_smooth() -> None:
    x, y = np.meshgrid(np.arange(500_000.0, 500_220), np.arange(5_400_000.0, 5_400_240))
    assert np.abs(np.gradient(ground(x, y))).max() < np.tan(np.radians(9))


def test_the_page_says_what_the_figures_say(made: tuple[Path, dict[str, Any]]) -> None:
    out, facts = made
    page = (out / "quality.html").read_text()
    assert page.count("data:image/png;base64,") == 2 and "http" not in page.replace("http-equiv", "")
    for words in (
        f"{facts['density']['pulses']:.2f}",
        "the largest 800 m²",
        "l0 – l1",
        "-9.0",
        f"{100 * facts['strips']['rms']:.1f} cm",
        "a tilt that all strips share",
    ):
        assert words in page, words
    report = (out / "report.html").read_text()
    assert 'id="quality"' in report and "./quality.html" in report and "l0 – l1" in report
    assert "classified as" not in report


@pytest.mark.parametrize(
    "setting", ["min_density=6", "min_pulse_density=6", "max_dz=0.08", "max_void=700", "max_noise=0"]
)
def test_thresholds_are_told_and_end_with_exit_code_4(
    survey: Path, made: tuple[Path, dict[str, Any]], setting: str
) -> None:
    name = setting.split("=")[0]
    told = fwclass(
        "run",
        survey / "s.yaml",
        "--out",
        made[0],
        *WORDS,
        *BLOCKS,
        "--set",
        "tile.size=100",
        "--set",
        f"quality.{setting}",
    )
    missed = name != "max_noise"
    asked = json.loads((made[0] / "report.json").read_text())["thresholds"]
    assert [(one["setting"], one["met"]) for one in asked] == [(name, not missed)]
    assert f": {'missed' if missed else 'met'}\n" in told.stderr.partition("threshold   ")[2], told.stderr
    page = html.unescape((made[0] / "report.html").read_text())
    assert ("The survey's quality misses 1 of 1 threshold: " if missed else "quality meets 1 threshold of 1.") in page
    assert f"asked for: {'missed' if missed else 'met'}</td>" in page
    assert told.returncode == (4 if missed else 0) and (f"quality.{name}" in told.stderr) == missed
    assert "computed" not in told.stderr and "Traceback" not in told.stderr  # they change no part


def write_area(path: Path, *boxes: tuple[float, float, float, float]) -> None:
    """GeoJSON in the survey's own system."""
    features = [
        {
            "type": "Feature",
            "properties": {},
            "geometry": {"type": "Polygon", "coordinates": [[[a, b], [c, b], [c, d], [a, d], [a, b]]]},
        }
        for a, b, c, d in boxes
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


AREA = ("--set", "quality.area.file=area.geojson", "--set", "quality.area.crs=EPSG:32633")


@pytest.mark.slow
def test_an_area_that_was_to_be_flown_has_its_gaps(survey: Path, made: tuple[Path, dict[str, Any]]) -> None:
    """40 m x 20 m of it lie west of all lines, and a lake of 800 m² in it; its halves overlap."""
    west = (499_960.0, 5_400_100.0, 500_060.0, 5_400_120.0)
    east = (500_050.0, 5_400_090.0, 500_100.0, 5_400_150.0)
    write_area(survey / "area.geojson", west, east)
    outs = [survey / "area", survey / "area_again"]
    facts = [run(survey, out, *AREA, *more) for out, more in zip(outs, ((), ("--set", "tile.size=64")), strict=True)]
    covered = facts[0]["coverage"]
    assert covered["area"] == pytest.approx(100 * 20 + 50 * 60 - 10 * 20, abs=60)
    assert covered["gaps"] == 2 and [g["area"] for g in covered["largest"]] == pytest.approx([800, 800], abs=50)
    assert covered["share"] == pytest.approx(1 - 1600 / 4800, abs=0.02)
    assert pyogrio.read_info(outs[0] / "quality.gpkg", layer="gaps")["features"] == 2
    assert "coverage" in (outs[0] / "quality.html").read_text()
    assert {**facts[0], "coverage": None} == made[1], "nothing else is another"
    for name in ("quality.json", "quality.gpkg", "quality.html"):
        assert (outs[0] / name).read_bytes() == (outs[1] / name).read_bytes(), name
    run(survey, outs[0], *AREA, "--set", "quality.min_coverage=0.6")
    run(survey, outs[0], *AREA, "--set", "quality.min_coverage=0.7", expect=4)


def test_an_area_elsewhere_is_refused(survey: Path, tmp_path: Path) -> None:
    write_area(survey / "area.geojson", (600_000.0, 5_400_100.0, 600_060.0, 5_400_120.0))
    ended = fwclass("run", survey / "s.yaml", "--out", tmp_path / "run", *WORDS, *AREA)
    assert ended.returncode == 1 and "no area that was to be flown lies in the survey" in ended.stderr, ended.stderr
    ended = fwclass("run", survey / "s.yaml", "--out", tmp_path / "run", *WORDS, *AREA[:2])  # metres for degrees
    assert "--set quality.area.crs=EPSG:" in ended.stderr and "reference" not in ended.stderr, ended.stderr


def test_files_that_meet_at_a_step_are_told_and_end_with_4(tmp_path: Path) -> None:
    """Heights of one of two tiles are those above the ellipsoid: nothing overlapped, and nothing was said."""
    whole = line(1, (0.0, 0.0, 0.0))
    middle = np.median(whole["y"])
    for name, part, lift in (("a", whole["y"] < middle, 0.0), ("b", whole["y"] >= middle, 46.3)):
        write_lines(tmp_path / f"{name}.las", [{**whole, "z": whole["z"] + lift}], part)
    (tmp_path / "s.yaml").write_text("survey: {name: tiles, sources: ['?.las']}\n")
    facts = run(tmp_path, tmp_path / "run", expect=4)
    (step,) = facts["strips"]["borders"]["stepped"]
    assert (step["first"], step["second"]) == ("a", "b") and step["step"] == pytest.approx(-46.3, abs=0.1)
    for size in ("40", "1000"):
        other = run(tmp_path, tmp_path / size, "--set", f"tile.size={size}", expect=4)
        assert other["strips"] == facts["strips"]
    run(tmp_path, tmp_path / "run", "--accept-implausible")


@pytest.mark.slow
def test_a_line_in_feet_is_told_and_ends_with_4(tmp_path: Path) -> None:
    """Its planes are rougher than planes may be, so that none was compared: 47 m were less told than 5."""
    for k, unit in enumerate((1.0, 0.3048, 1.0)):
        one = line(k, noise=0.03)
        write_lines(tmp_path / f"l{k}.las", [{**one, "z": one["z"] / unit}])
    (tmp_path / "s.yaml").write_text("survey: {name: feet, sources: ['l?.las']}\n")
    facts = run(tmp_path, tmp_path / "run", expect=4)
    assert facts["strips"]["apart"] == 0
    assert {(s["first"], s["second"]) for s in facts["strips"]["lifted"]} == {(0, 1), (1, 2)}
    assert any("lowest echoes of two" in text for text in facts["remarks"])
    for size in ("40", "1000"):
        assert run(tmp_path, tmp_path / size, "--set", f"tile.size={size}", expect=4)["strips"] == facts["strips"]
    run(tmp_path, tmp_path / "run", "--accept-implausible")
