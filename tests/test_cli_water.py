"""Water in a run: a lake is flat, a river is told and left, tiles change nothing, bad files are refused in words."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import numpy as np
import pyproj
import pytest
import rasterio
from commandline import fwclass

X, Y = 500_000, 5_400_000
WORDS = ("--workflow", "ground", "--workers", "0", "--set", "water.file=water.geojson")
LAKE = [(20, 15), (45, 15), (45, 40), (20, 40), (20, 15)]
RIVER = [(60, 0.5), (66, 0.5), (66, 59.5), (60, 59.5), (60, 0.5)]


def features(crs: str, *several: list) -> str:
    """GeoJSON of polygons given in the survey's metres, in `crs`."""
    move = pyproj.Transformer.from_crs("EPSG:25832", crs, always_xy=True)
    rings = [[list(move.transform(X + x, Y + y)) for x, y in ring] for ring in several]
    shapes = [{"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [r]}} for r in rings]
    system = {"type": "name", "properties": {"name": "urn:ogc:def:crs:" + crs.replace(":", "::")}}
    return json.dumps({"type": "FeatureCollection", "crs": system, "features": shapes})


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain of 90 m × 60 m that falls by 3 m to the north, with a pond whose echoes are noisy, and a ditch."""
    place = tmp_path_factory.mktemp("water")
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 1, (2, 24_000)) * [[90], [60]]
    z = np.where((x > 60) & (x < 66), 0.05 * (60 - y) + 198.5, 201.0)
    z = np.where((x > 20) & (x < 45) & (y > 15) & (y < 40), 199.0 + rng.normal(0, 0.15, len(x)), z)
    z = np.where((z == 201.0) & (x > 18) & (x < 47) & (y > 13) & (y < 42), 199.3, z)
    lasmaker.write_las(place / "a.las", np.c_[X + x, Y + y, z.round(3)], point_format=6, intensity=np.ones(len(x), int))
    (place / "water.geojson").write_text(features("EPSG:25832", LAKE, RIVER))
    path = place / "s.yaml"
    path.write_text('survey: {name: water, sources: [a.las], crs: "EPSG:25832"}\n')
    return path


@pytest.fixture(scope="module")
def run(survey: Path) -> Path:
    out = survey.parent / "run"
    told = fwclass("run", survey, "--out", out, *WORDS, "--set", "tile.size=40")
    assert told.returncode == 0, told.stderr
    assert all(words in told.stderr for words in ("1 of 2 polygons flattened", "feature 2", "river"))
    return out


def raster(run: Path, name: str) -> np.ndarray:
    with rasterio.open(run / f"rasters/{name}.tif") as file:
        return file.read(1)[::-1]


def test_the_lake_is_level_and_the_river_is_as_it_was(survey: Path, run: Path) -> None:
    lake, river = json.loads((run / "report.json").read_text())["water"]
    assert lake["level_enough"] and 198.6 < lake["level"] < 199.1
    assert not river["level_enough"] and river["highest"] - river["lowest"] > 0.5
    dtm, mask = raster(run, "dtm"), raster(run, "dtm_mask")
    wet = np.zeros(dtm.shape, bool)
    wet[15:40, 20:45] = True
    assert (mask[wet] == 4).all() and (mask[~wet] != 4).all()
    assert np.ptp(dtm[wet]) == 0 and abs(dtm[wet][0] - lake["level"]) <= 2**-11 + 1e-5  # half a step of the raster
    assert raster(run, "slope")[16:39, 21:44].max() == 0
    without = survey.parent / "without"
    assert fwclass("run", survey, "--out", without, *WORDS[:4]).returncode == 0
    before = raster(without, "dtm")
    assert np.ptp(before[wet]) > 0.1 and (before[:, 55:] == dtm[:, 55:]).all()


@pytest.mark.parametrize("setting", ["tile.size=25", pytest.param("tile.size=200", marks=pytest.mark.slow)])
def test_tiles_change_no_byte(survey: Path, run: Path, setting: str, tmp_path: Path) -> None:
    assert fwclass("run", survey, "--out", tmp_path / "r", *WORDS, "--set", setting).returncode == 0
    for name in ("rasters/dtm.tif", "rasters/dtm_mask.tif", "contours.gpkg"):
        assert (tmp_path / "r" / name).read_bytes() == (run / name).read_bytes(), name


def test_polygons_in_degrees_are_brought_over(survey: Path, run: Path, tmp_path: Path) -> None:
    (survey.parent / "degrees.geojson").write_text(features("EPSG:4258", LAKE, RIVER))
    words = (*WORDS[:4], "--set", "water.file=degrees.geojson")
    assert fwclass("run", survey, "--out", tmp_path / "r", *words).returncode == 0
    assert (raster(tmp_path / "r", "dtm_mask") == raster(run, "dtm_mask")).all()


def test_commands_know_the_stages(survey: Path, run: Path) -> None:
    assert "parts are done" in fwclass("status", run).stdout
    assert fwclass("seams", run, "--share", "1").returncode == 0
    seams = json.loads((run / "report.json").read_text())["ground"]["seams"]
    assert seams["cells_off"] == seams["cells_one_sided"] == 0 and seams["cells"] > 5000
    told = fwclass("plan", survey, *WORDS, "--json", "--out", survey.parent / "plan")
    assert {"water", "shore", "water-levels"} <= {s["name"] for s in json.loads(told.stdout)["stages"]}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (features("EPSG:25832", [(x + 5000, y) for x, y in LAKE]), "no water lies in the survey"),
        ('{"type": "FeatureCollection", "features": []}', "no water lies in the survey"),
        (features("EPSG:25832", LAKE).replace("Polygon", "MultiLineString"), "is no polygon"),
        ("not json", "not what its name says"),
        (None, "no file matches"),
    ],
    ids=["elsewhere", "empty", "lines", "garbage", "missing"],
)
def test_a_file_without_water_is_refused_before_anything_is_made(survey, text, words, tmp_path) -> None:
    name = survey.parent / "bad.geojson"
    name.unlink(missing_ok=True)
    if text is not None:
        name.write_text(text)
    told = fwclass("run", survey, "--out", tmp_path / "r", *WORDS[:4], "--set", "water.file=bad.geojson")
    assert told.returncode in (1, 2) and words in told.stderr and "Traceback" not in told.stderr
    assert not (tmp_path / "r" / "store").exists()


def test_a_polygon_over_a_house_is_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 1, (2, 9_000)) * [[60], [40]]
    house = (x > 20) & (x < 36) & (y > 12) & (y < 28)
    z = np.where(house, 207.0, 200.0) + rng.normal(0, 0.02, len(x))
    lasmaker.write_las(tmp_path / "a.las", np.c_[X + x, Y + y, z.round(3)], point_format=6)
    (tmp_path / "s.yaml").write_text('survey: {name: house, sources: [a.las], crs: "EPSG:25832"}\n')
    for west, told in ((20, True), (40, False)):
        ring = [(west, 12), (west + 16, 12), (west + 16, 28), (west, 28), (west, 12)]
        (tmp_path / "water.geojson").write_text(features("EPSG:25832", ring))
        ended = fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "run", *WORDS)
        assert ended.returncode == 0, ended.stderr
        assert ("in 1 of 1 polygons of water most echoes lie 2 m and more above the level" in ended.stderr) == told
