"""A survey with everything odd: no CRS, class codes 255 and without a name, a tile with one echo, hostile names."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from xml.etree import ElementTree as Xml

import lasmaker
import laspy
import numpy as np
import pyogrio
import pytest
from commandline import fwclass
from pyproj import CRS
from pystac.validation.local_validator import LocalValidator
from smallsurvey import small_survey

import fwclass as package
from fwclass import conf
from fwclass.delivery.viewed import ViewedRun
from fwclass.formats.geoparquet import header
from fwclass.view.scene import ECHOES

EVIL = "<b onclick='x'>\"&evil"
SURVEY = """survey:
  name: odd
  directory: .
  sources: [a.las]
  crs: none
  reference: {{kind: source}}
  features: [zc, height_range_c100]
  classes: [{{name: {name}, code: 2, codes: [2]}}, {{name: high, code: 255, codes: [5]}}]
classify: {{keep: [77]}}
areas: {{train: [[500000, 5400000, 500030, 5400040]], gap: 1}}
tile: {{size: 25}}
train: {{trees: 3}}
publish: {{figure_pixels: 200}}
assess: {{block: 5}}
"""
ALONE = (500_130.0, 5_400_020.0)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("odd")
    rng = np.random.default_rng(0)
    x, y, high = *rng.uniform(0, 1, (2, 6000)) * [[80], [40]], rng.random(6000) < 0.3
    xyz = np.c_[500_000 + x, 5_400_000 + y, 200 + 0.05 * x + high * rng.uniform(0.5, 6, 6000)]
    xyz = np.vstack([xyz, [*ALONE, 700.0]])
    classes = np.append(np.where(high, 5, 2), 2)
    classes[:300] = 77
    lasmaker.write_las(place / "a.las", xyz, point_format=6, classification=classes, intensity=rng.integers(1, 9, 6001))
    (place / "s.yaml").write_text(SURVEY.format(name=json.dumps(EVIL)), encoding="utf-8")
    made = fwclass("run", place / "s.yaml", "--out", place / "run", "--workers", "0")
    assert made.returncode in (0, 4), made.stderr
    return place / "run"


def test_marks_of_direction_are_no_part_of_a_name(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(SURVEY.format(name=json.dumps("a\u202eb")), encoding="utf-8")
    told = fwclass("run", tmp_path / "s.yaml", "--workers", "0", cwd=tmp_path)
    assert told.returncode == 2 and "characters that cannot be seen" in told.stderr and "\u202e" not in told.stderr


@pytest.mark.slow
def test_tiles_have_their_codes_and_names(root: Path) -> None:
    seen: dict[int, int] = {}
    for path in sorted((root / "laz" / "tiles").iterdir()):
        las = laspy.read(path)
        codes, counts = np.unique(np.asarray(las.classification), return_counts=True)
        for code, count in zip(codes.tolist(), counts.tolist(), strict=True):
            seen[code] = seen.get(code, 0) + count
        assert (
            las.header.parse_crs() is None
            and header(root / "parquet" / f"{path.name.split('.')[0]}.parquet")["crs"] is None
        )
    assert set(seen) == {2, 77, 255} and seen[77] == 300 and sum(seen.values()) == 6001
    alone = laspy.read(root / "laz" / "tiles" / f"{int(ALONE[0] // 25)}_{int(ALONE[1] // 25)}.copc.laz")
    assert len(alone.points) == 1


@pytest.mark.slow
def test_lists_project_and_styles_are_sound(root: Path) -> None:
    items = json.loads((root / "laz" / "survey.vpc").read_text())["features"]
    stac = LocalValidator().item_validator("1.1.0")
    assert not [e for i in items for e in stac.iter_errors(i | {"stac_version": "1.1.0"})]
    with zipfile.ZipFile(root / "survey.qgz") as archive:
        project = Xml.fromstring(archive.read("survey.qgs"))  # noqa: S314 - our own
    labels = {e.get("label") for e in project.iter("category")}
    assert labels == {"2 <b onclick='x'>\"&evil", "77 class 77", "255 high"}
    for path in (root / "rasters").glob("*.qml"):
        Xml.parse(path)  # noqa: S314
    fields = pyogrio.read_info(root / "tiles.gpkg", layer="tiles")["fields"]
    assert {"class_2", "class_77", "class_255"} <= set(fields)


@pytest.mark.slow
def test_the_page_escapes_what_it_shows(root: Path) -> None:
    text = (root / "report.html").read_text(encoding="utf-8")
    assert "<b onclick" not in text and "in no known system" in text


@pytest.mark.slow
def test_python_and_the_viewer_open_it(root: Path) -> None:
    run = package.open(root)
    assert run.crs is None and len(run.echoes()) == 6001
    scene = ViewedRun(run, conf.section("view", ()))
    assert sum(len(scene.level(ECHOES, k)) for k in scene.pyramid.levels()) > 6001
    x0, y0, x1, y1 = scene.index()["bounds"]
    assert 199 < scene.index()["height"] < 210, "one echo 500 m up draws no view away"
    assert 499_999 < x0 < 500_001 and 5_399_999 < y0 < 5_400_001 and x1 == ALONE[0] and y1 < 5_400_040.1
    assert {c["code"] for c in scene.index()["classes"]} >= {2, 255}
    for name in ("amplitude_sigma", "width"):  # discrete returns: no value anywhere
        if name in {c["name"] for c in scene.index()["columns"]}:
            assert scene.scale(name)["low"] is scene.scale(name)["high"] is None


def test_one_system_under_two_names_is_one(tmp_path):
    """Software spells a system in its own way; what it is decides, not what it is called."""
    survey = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    text = CRS.from_epsg(25832).to_wkt("WKT1_GDAL").replace("ETRS89 / UTM zone 32N", "ETRS_1989_UTM_Zone_32N")
    for name, system in (("a.las", CRS.from_epsg(25832)), ("b.las", CRS.from_wkt(text))):
        part = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        part.header.offsets, part.header.scales = whole.header.offsets, whole.header.scales
        part.points = whole.points[(whole.x < 500_040) == (name == "a.las")]
        part.header.add_crs(system)
        part.write(tmp_path / name)
    survey.write_text(survey.read_text().replace("sources: [a.las]", "sources: [a.las, b.las]"))
    ended = fwclass("run", survey, "--workflow", "ground", "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode in (0, 4), ended.stderr
    other = laspy.read(tmp_path / "b.las")
    other.header.vlrs.clear()
    other.header.add_crs(CRS.from_epsg(25833))
    other.write(tmp_path / "b.las")
    ended = fwclass("run", survey, "--workflow", "ground", "--out", tmp_path / "s", "--workers", 0)
    assert ended.returncode == 1 and "survey.crs" in ended.stderr, ended.stderr


def test_sources_in_all_directories_are_not_those_of_runs_below(tmp_path: Path) -> None:
    """The deliveries of the first run were taken for two files of one name by the second one."""
    conf = small_survey(tmp_path)
    line = ("run", conf, "--out", tmp_path / "runs" / "r", "--workers", 0, "--workflow", "ground")
    line += ("--set", "survey.sources=['**/*.la?']")
    assert fwclass(*line).returncode == 0
    assert list((tmp_path / "runs").glob("r/laz/strips/a.laz"))
    ended = fwclass(*line)
    assert ended.returncode == 0 and "computed" not in ended.stderr, ended.stderr
