"""`run --workflow ground`: ground, terrain and heights of a survey, without labels, classes or a model."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
import shapely
from commandline import fwclass
from smallsurvey import small_survey

LEAST = "survey: {name: bare, sources: [a.las]}\n"
"""All that a survey's file must say."""
WORDS = ("--workflow", "ground", "--workers", "0")


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("bare")
    small_survey(place)
    points = laspy.read(place / "a.las")
    points.z[-40:] -= 30.0  # echoes of a beam that went astray
    points.z[-60:-50] += 200.0  # birds
    points.X[:4], points.Y[:4] = 80_000, 40_000  # cut with both edges
    points.write(place / "a.las")
    path = place / "bare.yaml"
    path.write_text(LEAST)
    return path


@pytest.fixture(scope="module")
def run(bare: Path) -> Path:
    out = bare.parent / "run"
    told = fwclass("run", bare, "--out", out, *WORDS, "--set", "tile.size=25")
    assert told.returncode == 0, told.stderr
    return out


def digests(run: Path, kind: str) -> dict[str, str]:
    files = sorted((run / kind).resolve().rglob("*.laz"), key=lambda p: p.name)
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_every_point_has_the_class_that_the_filter_gives_it(run: Path) -> None:
    tables = [pq.read_table(p).to_pydict() for p in (run / "parquet").glob("*.parquet")]
    ground, noise, height, codes = (
        np.concatenate([np.array(t[n], float) for t in tables])
        for n in ("ground", "noise", "height_above_ground", "classification")
    )
    expected = np.where(noise > 0, np.where(height > 0, 18, 7), np.where(ground > 0, 2, 1))
    assert len(codes) == 6000 and (codes == expected).all()
    assert (codes == 7).sum() >= 35 and (codes == 18).sum() >= 8
    assert all(np.isnan(np.array(t["confidence"], float)).all() for t in tables)  # nobody was asked how sure it is
    strip = laspy.read(run / "laz" / "strips" / "a.laz")
    assert np.unique(strip.classification, return_counts=True)[1].tolist() == [
        int((codes == c).sum()) for c in (1, 2, 7, 18)
    ]


def test_what_is_delivered_has_no_classifier_in_it(run: Path) -> None:
    report = json.loads((run / "report.json").read_text())
    assert report["accuracy"] is None and report["training"] is None and not report["outputs"]["model"]
    assert [c["code"] for c in report["classes"]] == [1, 2, 7, 18]
    names = {Path(n).name for n in report["outputs"]["rasters"]}
    assert "confidence.tif" not in names, "it had no value"
    with zipfile.ZipFile(run / "survey.qgz") as project:
        shown = project.read("survey.qgs").decode()
    assert "hillshade" in shown and "confidence" not in shown and "least sure" not in shown
    assert {"dtm.tif", "dsm.tif", "ndsm.tif", "hillshade.tif", "slope.tif", "roughness.tif", "classes.tif"} <= names
    page = (run / "report.html").read_text()
    assert "least sure" not in page and "training areas" not in page and 'id="layer-confidence"' not in page


@pytest.mark.parametrize("setting", ["tile.size=40", "tile.size=200"])
def test_tiles_change_no_byte_of_a_strip(bare: Path, run: Path, setting: str, tmp_path: Path) -> None:
    told = fwclass("run", bare, "--out", tmp_path / "run", *WORDS, "--set", setting)
    assert told.returncode == 0, told.stderr
    assert digests(tmp_path / "run", "laz/strips") == digests(run, "laz/strips")
    for name in ("rasters/dtm.tif", "rasters/slope.tif", "rasters/roughness.tif", "contours.gpkg"):
        assert (tmp_path / "run" / name).read_bytes() == (run / name).read_bytes(), name


def test_contours_are_lines_of_the_terrain(bare: Path, run: Path) -> None:
    meta, _, shapes, fields = pyogrio.raw.read(run / "contours.gpkg", layer="contours")
    elevation, index, _ = fields
    assert (
        list(meta["fields"]) == ["elevation", "index_contour", "depression"] and meta["geometry_type"] == "LineString"
    )
    assert (
        set(elevation) == {201.0, 202.0, 203.0} and not index.any()
    )  # a slope from 200 to 204 m, and no multiple of 5
    for line, height in zip(shapely.from_wkb(shapes), elevation, strict=True):
        x, y = shapely.get_coordinates(line).T
        assert np.abs(200 + 0.05 * (x - 500_000) - height).max() < 0.25 + 0.1  # a share of the interval, and bushes
        assert y.min() >= 5_400_000 and y.max() <= 5_400_040  # whole cells
    with zipfile.ZipFile(run / "survey.qgz") as project:
        shown = project.read("survey.qgs").decode()
    assert "contours.gpkg|layername=contours" in shown
    assert ("quality.gpkg|layername=voids" in shown) == (run / "quality.gpkg").exists()
    other = ("--set", "contours.enabled=false", "--set", "quality.cell=0.5", "--set", "quality.void_spacings=1.5")
    told = fwclass("run", bare, "--out", bare.parent / "none", *WORDS, *other)
    assert told.returncode == 0 and not (bare.parent / "none" / "contours.gpkg").exists()
    with zipfile.ZipFile(bare.parent / "none" / "survey.qgz") as project:
        shown = project.read("survey.qgs").decode()
    assert "contours" not in shown
    assert "quality.gpkg|layername=voids" in shown and (bare.parent / "none" / "quality.gpkg").exists()
    told = fwclass("run", bare, "--out", bare.parent / "bad", *WORDS, "--set", "contours.interval=0")
    assert told.returncode == 2 and "contours.interval" in told.stderr and not (bare.parent / "bad").exists()


def test_points_on_the_upper_edge_open_no_cells(run: Path) -> None:
    """The file reaches from 0 to 80 m and from 0 to 40 m, both included."""
    for path in sorted((run / "rasters").resolve().glob("*.tif")):
        with rasterio.open(path) as raster:
            assert raster.bounds == (500_000, 5_400_000, 500_080, 5_400_040), path.name
    assert json.loads((run / "quality.json").read_text())["pulses"] == 6000 - 50, "those in no cell are counted"


def test_commands_know_the_run(bare: Path, run: Path) -> None:
    assert "parts are done" in fwclass("status", run).stdout
    again = fwclass("run", bare, "--out", run, *WORDS, "--set", "tile.size=25")
    assert again.returncode == 0 and "computed" not in again.stdout + again.stderr
    assert fwclass("seams", run, "--share", "1").returncode == 0
    graph = fwclass("plan", bare, "--workflow", "ground", "--graph").stdout
    assert "terrain" in graph and "train" not in graph
    assert "ground, --set tile.size=25" in fwclass("history", run).stdout


def test_a_plan_reckons_with_its_stages_alone(bare: Path, tmp_path: Path) -> None:
    told = fwclass("plan", bare, "--workflow", "ground", "--out", tmp_path, "--json")
    assert told.returncode == 0, told.stderr
    stages = {s["name"] for s in json.loads(told.stdout)["stages"]}
    assert {"terrain", "publish-rasters"} <= stages and not stages & {"features", "trees", "confusion"}
    assert fwclass("plan", bare, "--workflow", "ground", "--dry-run", "1", "--out", tmp_path / "b").returncode == 2


def test_the_classification_says_all_that_the_file_lacks(bare: Path) -> None:
    told = fwclass("run", bare, "--out", bare.parent / "other")
    assert told.returncode == 2 and not (bare.parent / "other").exists()
    for words in ("two classes", "nothing to train on", "no training area", "fwclass init", "--workflow ground"):
        assert words in told.stderr


@pytest.mark.slow
def test_stray_points_over_a_wide_land_cost_the_check_of_seams_no_wide_raster(bare: Path, tmp_path: Path) -> None:
    """An echo in each of 20 x 20 blocks that touch: the rasters of their box would hold 4 000 cells for each."""
    points = laspy.read(bare.parent / "a.las")
    places = np.arange(400)
    points.points = points.points[:400]
    points.x, points.y = 500_010 + 64 * (places % 20), 5_400_010 + 64 * (places // 20)
    points.z = np.full(400, 100.0)
    points.write(tmp_path / "a.las")
    (tmp_path / "s.yaml").write_text(LEAST)
    settings = ("tile.size=512", "ground.block=64", "terrain.block=64")
    words = [word for text in settings for word in ("--set", text)]
    ended = fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "run", *WORDS, *words)
    assert ended.returncode in (0, 4), ended.stderr
    seams = json.loads((tmp_path / "run" / "report.json").read_text())["ground"]["seams"]
    assert seams["echoes"] == 400 and seams["left_out"] == 0 and seams["cells"] < 4 * 400
