"""Points that are no ground, or cannot be: withheld, noise that is kept, and returns without a last one."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pytest
import rasterio
from commandline import fwclass
from smallsurvey import small_survey

from fwclass import conf
from fwclass.report.ground import ground_remarks

WORDS = ("--workflow", "ground", "--workers", 0)
LOW = 0.45
"""m below the slope: too little for a filter to see."""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """The small survey, and every fourth point of its eastern half once more, `LOW` deeper, in ``low.las``."""
    small_survey(tmp_path)
    (tmp_path / "g.yaml").write_text('survey: {name: g, sources: [a.las], crs: "EPSG:25832"}\n')
    return tmp_path


def with_low_points(place: Path, **changes: int) -> np.ndarray:
    """Write ``a.las`` with such points changed; bool (points,) of them."""
    las = laspy.read(place / "a.las")
    low = np.zeros(len(las.x), bool)
    low[np.flatnonzero(np.asarray(las.x) > 500_040)[::4]] = True
    las.z[low] = 200 + 0.05 * (np.asarray(las.x)[low] - 500_000) - LOW
    for name, value in changes.items():
        las[name][low] = value
    las.write(place / "a.las")
    return low


def terrain_error(run: Path) -> float:
    """Mean of the terrain less the slope that the points were made on, in the eastern half [m]."""
    with rasterio.open(run / "rasters/dtm.tif") as file:
        dtm = file.read(1)
        x = file.transform.c + (np.arange(file.width) + 0.5) * file.transform.a - 500_000
    off = dtm - (200 + 0.05 * x)
    return float(np.nanmean(off[:, (x > 45) & (x < 75)]))


def run(place: Path, *words: object) -> tuple[str, float]:
    ended = fwclass("run", place / "g.yaml", "--out", place / "r", *WORDS, *words)
    assert ended.returncode == 0, ended.stderr
    return ended.stderr, terrain_error(place / "r")


@pytest.mark.parametrize("flag", ["withheld", pytest.param("synthetic", marks=pytest.mark.slow)])
def test_no_ground_is_made_of_withheld_points(place: Path, flag: str) -> None:
    low = with_low_points(place, **{flag: 1})
    assert f"flags        {flag} {low.sum():,}: no ground is made of them" in fwclass("info", place / "a.las").stdout
    said, off = run(place)
    assert f"flag {low.sum():,} returns as withheld or synthetic" in said and abs(off) < 0.03
    strip = laspy.read(place / "r/laz/strips/a.laz")
    assert (np.asarray(strip[flag], bool) == low).all() and (np.asarray(strip.classification)[low] != 2).all()
    tiles = [laspy.read(p) for p in (place / "r/laz/tiles").glob("*.laz")]
    assert sum(int(np.sum(t.withheld)) for t in tiles) == low.sum()
    said, off = run(place, "--set", "read.use_flagged=true")
    assert "withheld" not in said and off < -0.1, "they are ground like all others"


def test_a_survey_that_is_all_withheld_is_delivered_whole_and_ends_with_4(place: Path) -> None:
    las = laspy.read(place / "a.las")
    las.withheld[:] = 1
    las.write(place / "a.las")
    ended = fwclass("run", place / "g.yaml", "--out", place / "r", *WORDS)
    assert ended.returncode == 4 and "no echo is ground" in ended.stderr and "got: 0 of 6,000" in ended.stderr
    quality = json.loads((place / "r" / "quality.json").read_text())
    assert quality["density"]["echoes"] is None and "NaN" not in (place / "r" / "quality.html").read_text()


def test_they_neither_train_nor_are_tested(place: Path) -> None:
    low = with_low_points(place, withheld=1)
    words = ("--out", place / "c", "--workers", 0, "--set", "areas.gap=0")
    ended = fwclass("run", place / "s.yaml", *words)
    assert ended.returncode == 0, ended.stderr
    report = json.loads((place / "c" / "report.json").read_text())
    x = np.asarray(laspy.read(place / "a.las").x)
    assert sum(map(sum, report["accuracy"]["confusion"])) == int(((x >= 500_030) & ~low).sum())


def test_noise_that_is_kept_makes_no_ground(place: Path) -> None:
    low = with_low_points(place, classification=7)
    said, off = run(place)
    assert off < -0.1 and f"the sources call {low.sum():,} echoes noise (7 low noise: {low.sum():,})" in said
    said, off = run(place, "--set", "classify.keep=[7]")
    assert abs(off) < 0.03 and "may be ground" not in said
    assert (np.asarray(laspy.read(place / "r/laz/strips/a.laz").classification)[low] == 7).all()
    words = ("--set", "classify.keep=[7]", "--set", "tile.size=60", "--out", place / "t")
    assert fwclass("run", place / "g.yaml", *WORDS, *words).returncode == 0
    for name in ("rasters/dtm.tif", "laz/strips/a.laz"):
        assert (place / "r" / name).read_bytes() == (place / "t" / name).read_bytes()


def test_returns_without_a_last_one_are_told_and_refused(place: Path) -> None:
    las = laspy.read(place / "a.las")
    las.return_number[:], las.number_of_returns[:] = 1, 2
    las.write(place / "a.las")
    ended = fwclass("run", place / "g.yaml", "--out", place / "r", *WORDS)
    assert ended.returncode == 4 and "no echo is ground" in ended.stderr, ended.stderr
    assert "hardly one of 6,000 echoes (100.0 %), in 1 of 1 blocks of" in ended.stderr
    assert "last of its pulse" in (place / "r" / "report.html").read_text()
    said, off = run(place, "--set", "ground.last_returns=false")
    assert "last of its pulse" not in said and abs(off) < 0.1


def test_a_hall_that_became_ground_is_told(tmp_path: Path) -> None:
    """Wider than any window of the filter's; its sources know better."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 160, (2, 40_000))
    hall = (abs(x - 80) < 35) & (abs(y - 80) < 35)
    xyz = np.c_[500_000 + x, 5_400_000 + y, 100 + 9.0 * hall]
    lasmaker.write_las(tmp_path / "a.las", xyz, point_format=6, classification=np.where(hall, 6, 2))
    (tmp_path / "g.yaml").write_text('survey: {name: g, sources: [a.las], crs: "EPSG:25832"}\n')
    for words, wrong in (((), True), (("--set", "ground.max_building_size=90"), False)):
        ended = fwclass("run", tmp_path / "g.yaml", "--out", tmp_path / "r", *WORDS, *words)
        assert ended.returncode == (4 if wrong else 0), ended.stderr
        assert ("echoes that the sources call building became ground" in ended.stderr) == wrong, ended.stderr
    told = ground_remarks([], 0, conf.section("ground", ()), [{"2": [900, 700]}, {"2": [900, 800]}])
    assert told == ["only 1,500 of 1,800 echoes that the sources call ground became ground" + told[0][69:]]


def test_half_a_survey_without_last_returns_is_told(place: Path) -> None:
    las = laspy.read(place / "a.las")
    west = np.asarray(las.x) < 500_040
    las.number_of_returns[west] = 3
    las.write(place / "a.las")
    said, _ = run(place, "--set", "ground.block=40")
    assert "is the last of its pulse, so that no ground is there" in said and "in 1 of 3 blocks" in said
