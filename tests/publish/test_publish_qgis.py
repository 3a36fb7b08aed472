"""The QGIS project and styles: hostile names are text, the same layers the same bytes, QGIS draws what is meant."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from pystac.validation.local_validator import LocalValidator

from fwclass.formats.wkb import box_wkb
from fwclass.grid import Box, Window
from fwclass.publish.cog import write_cog
from fwclass.publish.copc import write_tile_copc
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.publish.palette import colours, css
from fwclass.publish.params import PublishParams
from fwclass.publish.qgis import MapLayer, write_project
from fwclass.publish.qgis_layers import layer_groups
from fwclass.publish.qgis_style import HEIGHTS, SURE, class_cloud_style, class_raster_style, style_file
from fwclass.publish.raster_styles import MASK, STYLED, Spread, raster_style
from fwclass.publish.tile_facts import point_schema, tile_facts
from fwclass.publish.vpc import write_vpc
from fwclass.schema import Table

EVIL = "a\"'<b>&amp;\u202e\u0007]]>"
NAMES = {2: "ground", 5: EVIL, 64: "car", 255: "other"}
FACTS = {
    "points": 3,
    "bounds": [512000.0, 5403000.0, 1.0, 512100.0, 5403100.0, 9.0],
    "classes": {"2": 2, "64": 1},
    "confidence": 0.5,
    "times": [3e8, 3.1e8],
    "figures": {},
}


def test_hostile_names_are_only_text(tmp_path: Path) -> None:
    groups = layer_groups(
        NAMES, ("confidence",), {"all": dict.fromkeys(STYLED, (0.0, 1.0))}, ("tiles",), "all", contours=True
    )
    write_project(EVIL, groups, (0, 0, 1, 1), tmp_path / "p.qgz", None)
    with zipfile.ZipFile(tmp_path / "p.qgz") as archive:
        root = Xml.fromstring(archive.read("p.qgs"))  # noqa: S314 - our own
    plain = "a\"'<b>&amp;]]>"
    assert root.findtext("title") == plain
    labels = [e.get("label") for e in root.iter("paletteEntry")]
    labels = [label for label in labels if label not in {f"{k} {v}" for k, v in MASK.items()}]
    assert labels == ["2 ground", f"5 {plain}", "64 car", "255 other"]
    for style, kind in ((class_raster_style(NAMES), "raster"), (class_cloud_style(NAMES), "pointcloud")):
        Xml.fromstring(style_file(style, kind))  # noqa: S314
    made = write_vpc({f"tiles/{EVIL}.copc.laz": FACTS}, tmp_path / "v.vpc", None, point_schema(("confidence",)))
    item = json.loads((tmp_path / "v.vpc").read_text())["features"][0]
    assert made["items"] == 1 and item["assets"]["data"]["href"] == f"./tiles/{EVIL}.copc.laz"
    stac = LocalValidator().item_validator("1.1.0")
    assert not list(stac.iter_errors(item | {"stac_version": "1.1.0"})), "without a coordinate system too"
    assert list(stac.iter_errors(item | {"stac_version": "1.1.0", "bbox": [1, 2]}))


def test_voids_gaps_and_check_points_lie_above_the_rasters_of_the_quality() -> None:
    ranges = {"all": dict.fromkeys(STYLED, (0.0, 1.0))}
    for asked, expected in (((), []), (("voids",), ["voids"]), (("gaps", "check_points"), ["check_points", "gaps"])):
        layers = layer_groups(NAMES, (), ranges, ("tiles",), "all", quality=asked)["Quality"]
        assert [one.source for one in layers[:-2]] == [f"quality.gpkg|layername={name}" for name in expected]
        assert all(one.shown for one in layers[:-2]) and [one.kind for one in layers[-2:]] == ["raster", "raster"]
    assert "Quality" not in layer_groups(NAMES, (), ranges, ("tiles",), "all")


def test_the_same_layers_give_the_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        directory = tmp_path / name
        directory.mkdir()
        layer = Layer("tiles", box_wkb([Box(0, 0, 1, 1)]), {"tile": ["x"], "confidence": np.array([np.nan])})
        write_gpkg([layer, layer.__class__("areas", layer.geometry, {"kind": ["train"]})], directory / "t.gpkg", None)
        write_project("t", {"g": [MapLayer("n", "vector", "t.gpkg", [])]}, (0, 0, 1, 1), directory / "s.qgz", None)
        write_vpc({"tiles/1_1.copc.laz": FACTS}, directory / "s.vpc", pyproj.CRS(25832), point_schema(()))
    for file in ("t.gpkg", "s.qgz", "s.vpc"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


def test_a_list_of_tiles_has_two_kilobytes_a_tile(tmp_path: Path) -> None:
    """Ten thousand of them make 20 MB."""
    figures = {"count": 50_000.0, "minimum": 300.123, "maximum": 312.456, "mean": 305.789, "stddev": 2.345}
    facts = FACTS | {"figures": dict.fromkeys(("Z", "HeightAboveGround", "confidence"), figures)}
    columns = ("pulse", "amplitude", "amplitude_db", "width", "fit_flags", "height_above_ground", "confidence")
    schema = point_schema((*columns, "entropy", "range", "incidence", "reflectance", "radiometry_flags"))
    tiles = {f"tiles/{5120 + k // 100}_{54030 + k % 100}.copc.laz": facts for k in range(2_000)}
    seen = dict.fromkeys(tiles, ("overviews/256_2701.copc.laz",))
    made = write_vpc(
        tiles, tmp_path / "s.vpc", pyproj.CRS(25832), schema, seen, "overview.copc.laz", standard_time=True
    )
    assert made["items"] == 2_000 and made["bytes"] <= 4_000_000


def test_a_grid_that_is_tied_to_no_place_is_listed_in_its_own_coordinates(tmp_path: Path) -> None:
    plant = pyproj.CRS('LOCAL_CS["plant grid",UNIT["metre",1]]')
    write_vpc({"tiles/1_1.copc.laz": FACTS}, tmp_path / "s.vpc", plant, point_schema(()))
    write_vpc({"tiles/1_1.copc.laz": FACTS}, tmp_path / "none.vpc", None, point_schema(()))
    item, without = (json.loads((tmp_path / n).read_text())["features"][0] for n in ("s.vpc", "none.vpc"))
    assert item["geometry"] == without["geometry"] and "plant grid" in item["properties"]["proj:wkt2"]


@pytest.mark.parametrize("code", [32760, 3031])
def test_a_tile_on_the_date_line_lies_there_and_not_around_the_globe(tmp_path: Path, code: int) -> None:
    crs = pyproj.CRS(code)
    x, y = pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(180, -76)
    tile = FACTS | {"bounds": [x - 50, y - 30, 1.0, x + 50, y + 30, 9.0]}
    write_vpc({"tiles/1_1.copc.laz": tile}, tmp_path / "s.vpc", crs, point_schema(()))
    item = json.loads((tmp_path / "s.vpc").read_text())["features"][0]
    west, south, east, north = item["bbox"]
    assert 179.99 < west < 180 and -180 < east < -179.99 and -76.001 < south < -76 < north < -75.999
    pieces = [shapely.Polygon(piece[0]) for piece in item["geometry"]["coordinates"]]
    assert [piece.bounds[::2] for piece in pieces] == [(west, 180.0), (-180.0, east)]
    size = pyproj.Geod(ellps="WGS84")
    assert sum(abs(size.geometry_area_perimeter(p)[0]) for p in pieces) == pytest.approx(6000, rel=0.05)
    assert not list(LocalValidator().item_validator("1.1.0").iter_errors(item | {"stac_version": "1.1.0"}))


@pytest.mark.parametrize(("code", "pole"), [(3031, -90), (3995, 90)])
def test_a_tile_around_a_pole_holds_it(tmp_path: Path, code: int, pole: int) -> None:
    tile = FACTS | {"bounds": [-60.0, -30.0, 1.0, 40.0, 70.0, 9.0]}
    write_vpc({"tiles/1_1.copc.laz": tile}, tmp_path / "s.vpc", pyproj.CRS(code), point_schema(()))
    item = json.loads((tmp_path / "s.vpc").read_text())["features"][0]
    assert shapely.geometry.shape(item["geometry"]).bounds == tuple(item["bbox"])
    assert item["bbox"][::2] == [-180, 180] and pole in item["bbox"] and abs(sum(item["bbox"][1::2])) > 179.99


def test_colours_spread_over_what_is_common() -> None:
    spread = Spread()
    assert spread.shown() == [0.0, 1.0]
    rng = np.random.default_rng(0)
    for _ in range(5):
        spread.add(np.append(rng.normal(100, 2, 1000), [np.nan, 500.0]).astype(np.float32))
    low, high = spread.shown()
    assert 60 < low < 100 < high < 200


QGIS = """
import json, sys
from qgis.core import (QgsApplication, QgsCoordinateTransform, QgsMapRendererParallelJob, QgsMapSettings, QgsProject)
from qgis.PyQt.QtCore import QSize
QgsApplication.setPrefixPath('/usr', True)
app = QgsApplication([], False); app.initQgis()
project = QgsProject.instance()
out = {'read': project.read(sys.argv[1]), 'crs': project.crs().authid()}
layers = [n.layer() for n in project.layerTreeRoot().findLayers()]
out['layers'] = {l.name(): l.isValid() for l in layers}
classes = next(l for l in layers if l.name() == 'classes')
s = QgsMapSettings(); s.setLayers([classes]); s.setDestinationCrs(classes.crs()); s.setExtent(classes.extent())
s.setOutputSize(QSize(classes.width() * 8, classes.height() * 8))
job = QgsMapRendererParallelJob(s); job.start(); job.waitForFinished()
image = job.renderedImage()
places = range(classes.width())
out['pixels'] = [[image.pixelColor(8 * c + 4, 8 * r + 4).name() for c in places] for r in range(classes.height())]
print(json.dumps(out)); sys.stdout.flush()
import os; os._exit(0)
"""


def qgis(least: int = 0) -> str:
    """A Python that has QGIS of a version of `least` (32200 is 3.22) or later, `FWCLASS_QGIS` or the system's; skips
    where there is none."""
    for name in (os.environ.get("FWCLASS_QGIS"), "/usr/bin/python3", "python3"):
        path = shutil.which(name or "")
        code = "from qgis.core import Qgis; print(Qgis.QGIS_VERSION_INT)"
        told = subprocess.run([path, "-c", code], capture_output=True, text=True) if path else None
        if path and told and told.returncode == 0 and int(told.stdout) >= least:
            return path
    pytest.skip(f"no QGIS {least or ''} here: apt-get install python3-qgis")


def ask_qgis(python: str, script: str, project: Path) -> Any:
    """What `script` prints last, of a project; nothing is left in its directory."""
    before = sorted(p.name for p in project.parent.rglob("*"))
    with tempfile.TemporaryDirectory() as home:
        told = subprocess.run(
            [python, "-c", script, str(project)],
            env={**os.environ, "QT_QPA_PLATFORM": "offscreen", "HOME": home, "PYTHONPATH": ""},
            capture_output=True,
            text=True,
            timeout=120,
        )
    assert told.returncode == 0, told.stderr[-2000:]
    assert sorted(p.name for p in project.parent.rglob("*")) == before, "QGIS leaves no file in a delivery"
    return json.loads(told.stdout.splitlines()[-1])


@pytest.mark.slow
def test_qgis_opens_the_project_and_draws_the_classes(params: PublishParams, tmp_path: Path) -> None:
    python = qgis()
    crs, window = pyproj.CRS(25832), Window(1.0, 512_000, 5_403_000, 8, 6)
    codes = np.random.default_rng(1).choice(np.array([2, 64], np.uint8), window.shape)
    shown, names = {2: "ground", 64: "car"}, {2: "ground", 64: "car"}
    target = tmp_path / "rasters"
    ranges = dict.fromkeys(STYLED, (0.0, 9.0))
    for name in STYLED:
        raster = codes if name in ("classes", "confidence", "hillshade") else codes.astype(np.float32)
        nodata = 0 if raster.dtype == np.uint8 else np.nan
        write_cog(
            raster, window, target / f"{name}.tif", crs, params, nodata, names=shown if name == "classes" else None
        )
        (target / f"{name}.qml").write_bytes(style_file(raster_style(name, ranges, names), "raster"))
    box = Box(512_000, 5_403_000, 512_008, 5_403_006)
    fields = {"tile": ["5120_54030"], "confidence": np.array([0.8]), "rank": np.array([1], np.int32)}
    write_gpkg([Layer("tiles", box_wkb([box]), fields)], tmp_path / "tiles.gpkg", crs)
    groups = layer_groups(names, ("confidence",), {"all": ranges}, ("tiles",), "all")
    write_project("t", groups, box.bounds, tmp_path / "survey.qgz", crs)
    made = ask_qgis(python, QGIS, tmp_path / "survey.qgz")
    assert made["read"] and made["crs"] == "EPSG:25832"
    clouds = {"by class", "by confidence", "by height above ground"}  # no such file here, and 3.22 knows none
    assert all(valid for name, valid in made["layers"].items() if name not in clouds), made["layers"]
    palette = {
        code: css(colour) for code, colour in colours([{"name": n, "code": c} for c, n in names.items()]).items()
    }
    assert made["pixels"] == [[palette[c] for c in row] for row in codes[::-1].tolist()]


CLOUDS = """
import json, os, sys
from qgis.core import QgsApplication, QgsMapRendererParallelJob, QgsMapSettings, QgsProject, QgsRectangle
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor
QgsApplication.setPrefixPath('/usr', True)
app = QgsApplication([], False); app.initQgis()
project = QgsProject.instance(); project.read(sys.argv[1])
out = {}
for layer in (n.layer() for n in project.layerTreeRoot().findGroup('Echoes').findLayers()):
    s = QgsMapSettings(); s.setLayers([layer]); s.setDestinationCrs(project.crs())
    s.setExtent(QgsRectangle(512000, 5403000, 512060, 5403060)); s.setOutputSize(QSize(600, 600))
    s.setBackgroundColor(QColor('white'))
    job = QgsMapRendererParallelJob(s); job.start(); job.waitForFinished(); image = job.renderedImage()
    out[layer.name()] = [image.pixelColor(100 * k + 50, 300).name() for k in range(6)]
print(json.dumps(out)); sys.stdout.flush(); os._exit(0)
"""


@pytest.mark.slow
def test_qgis_draws_echoes_by_class_confidence_and_height(params: PublishParams, echoes: Any, tmp_path: Path) -> None:
    """Six echoes 10 m apart, each with its own class, confidence and height; two more far out, as QGIS draws boxes of
    tiles that are smaller than the window."""
    python, crs = qgis(33200), pyproj.CRS(25832)
    table, codes, share = dict(echoes(8)), np.array([2, 64] * 4, np.uint8), np.linspace(0, 1, 6)
    table |= {"x": np.append(512_005.0 + 10 * np.arange(6), [511_500, 512_500]), "z": 300 + np.arange(8.0)}
    table |= {"y": np.append(np.full(6, 5_403_030.0), [5_402_500, 5_403_500]), "classification": codes}
    table |= {"confidence": np.append(share, [1, 1]).astype(np.float32)}
    table |= {"height_above_ground": np.append(25 * share, [0, 0]).astype(np.float32)}
    made, names = Table(table), {2: "ground", 64: "car"}
    for path in ("laz/tiles/5120_54030.copc.laz", "laz/overview.copc.laz"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        write_tile_copc(made, tmp_path / path, crs, params, names)
    tiles, schema = {"tiles/5120_54030.copc.laz": tile_facts(made)}, point_schema(tuple(table))
    write_vpc(tiles, tmp_path / "laz" / "survey.vpc", crs, schema, overview="overview.copc.laz")
    groups = layer_groups(names, tuple(table), {}, (), "all")
    write_project("t", groups, (512_000, 5_403_000, 512_060, 5_403_060), tmp_path / "survey.qgz", crs)
    drawn = ask_qgis(python, CLOUDS, tmp_path / "survey.qgz")
    palette = {c: css(rgb) for c, rgb in colours([{"name": n, "code": c} for c, n in names.items()]).items()}
    assert drawn["by class"] == [palette[c] for c in codes[:6].tolist()]
    for layer, ramp in (("by confidence", SURE), ("by height above ground", HEIGHTS)):
        shares, rgbs = zip(*ramp, strict=True)
        wanted = np.stack([np.interp(share, shares, [c[k] for c in rgbs]) for k in range(3)], axis=1)
        got = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in drawn[layer]])
        assert np.abs(got - wanted).max() <= 2, (layer, got, wanted)


COMPOUND = pyproj.CRS("EPSG:25832+5773")
LOCAL = pyproj.CRS.from_proj4("+proj=tmerc +lat_0=48 +lon_0=9 +k=1 +x_0=5e5 +ellps=GRS80 +units=m")
ONLY_WKT2 = pyproj.CRS.from_wkt(
    "BOUNDCRS[SOURCECRS["
    + pyproj.CRS(25832).to_wkt("WKT2_2019")
    + "],TARGETCRS["
    + pyproj.CRS(4326).to_wkt("WKT2_2019")
    + '],ABRIDGEDTRANSFORMATION["none",METHOD["Geocentric translations (geog2D domain)",ID["EPSG",9603]],'
    'PARAMETER["X-axis translation",0],PARAMETER["Y-axis translation",0],PARAMETER["Z-axis translation",0]]]'
)


@pytest.mark.parametrize("crs", [None, COMPOUND, LOCAL, ONLY_WKT2], ids=["none", "compound", "local", "bound"])
def test_any_system_or_none_makes_files(crs: pyproj.CRS | None, tmp_path: Path) -> None:
    box = Box(512_000, 5_403_000, 512_100, 5_403_100)
    write_gpkg([Layer("tiles", box_wkb([box]), {"tile": ["1_1"]})], tmp_path / "t.gpkg", crs)
    write_project("t", {"g": [MapLayer("n", "vector", "t.gpkg", [])]}, box.bounds, tmp_path / "s.qgz", crs)
    write_vpc({"tiles/1_1.copc.laz": FACTS}, tmp_path / "s.vpc", crs, point_schema(()))
    item = json.loads((tmp_path / "s.vpc").read_text())["features"][0]
    assert ("proj:wkt2" in item["properties"]) == (crs is not None)
    assert len(pyogrio.raw.read(tmp_path / "t.gpkg")[2]) == 1
