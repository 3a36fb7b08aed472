"""A coordinate system that names a file by its path: PROJ and GDAL would open it, whatever it is."""

from __future__ import annotations

import json
import os
import sqlite3
import struct
import subprocess
import sys
from pathlib import Path

import lasmaker
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pyproj
import pytest
import shapely
from commandline import fwclass
from pyproj.exceptions import CRSError

from fwclass.errors import InputError
from fwclass.formats.grid_files import is_path, names_file, paths_named, without_paths
from fwclass.read.raw_columns import Settings

GRID = "/tmp/x/fifo"  # noqa: S108 (only a name)
PROJ4 = "+proj=utm +zone=33 +ellps=bessel +nadgrids={} +type=crs"
FORMS = {
    "WKT 1": lambda grid: pyproj.CRS(PROJ4.format(grid)).to_wkt("WKT1_GDAL"),
    "WKT 2": lambda grid: pyproj.CRS(PROJ4.format(grid)).to_wkt(),
    "PROJJSON": lambda grid: pyproj.CRS(PROJ4.format(grid)).to_json(),
    "PROJ": PROJ4.format,
    "vertical": lambda grid: (
        'COMPD_CS["a",PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984",'
        'SPHEROID["WGS 84",6378137,298.257]],'
        'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
        'PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",15],PARAMETER["scale_factor",0.9996],'
        'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]],VERT_CS["h",'
        f'VERT_DATUM["d",2005,EXTENSION["PROJ4_GRIDS","{grid}"]],UNIT["metre",1],AXIS["Up",UP]]]'
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_path_is_seen_in_every_form(form: str):
    text = FORMS[form]
    assert paths_named(text(GRID)) == [GRID] * text(GRID).count(GRID)
    assert paths_named(text("us_noaa_conus.tif")) == [] and paths_named(text("@null")) == []
    bound = pyproj.CRS(text(GRID))
    plain, paths = without_paths(bound)
    assert set(paths) == {GRID} and not plain.is_bound and "PARAMETERFILE" not in plain.to_wkt().upper()
    assert plain.to_epsg() == bound.to_epsg() and plain.is_compound == bound.is_compound
    kept = pyproj.CRS(text("us_noaa_conus.tif"))
    assert without_paths(kept) == (kept, [])


@pytest.mark.parametrize("code", [25832, 32633, 2056, 31370, 3857, 4326, 7423, 27700, 5514])
def test_systems_of_the_registry_are_left_alone(code: int):
    crs = pyproj.CRS.from_epsg(code)
    assert without_paths(crs) == (crs, [])
    assert paths_named(crs.to_wkt()) == paths_named(crs.to_wkt("WKT1_GDAL")) == paths_named(crs.to_json()) == []


def of_method(words: str) -> dict:
    """PROJJSON of a projected system whose conversion is made by PROJ's own words."""
    system = pyproj.CRS.from_epsg(2154).to_json_dict()
    method = {"name": f"PROJ-based operation method: {words}"}
    return {**system, "id": {"authority": "X", "code": 1}, "conversion": {"name": "x", "method": method}}


@pytest.mark.parametrize(
    "words",
    [
        f"+proj=tinshift +file={GRID}",
        f"+proj=pipeline +step +proj=hgridshift +grids='{GRID}'",
        "proj=defmodel model=~/grid",
        "+proj=tinshift +file=pyproject.toml",
    ],
)
def test_a_file_in_a_method_s_name_is_refused(words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.chdir(tmp_path)
    crs = pyproj.CRS.from_json_dict(of_method(words))
    with pytest.raises(CRSError, match="made by the file"):
        without_paths(crs)
    las(tmp_path / "a.las", crs.to_wkt())
    told = fwclass("info", tmp_path / "a.las", cwd=tmp_path)
    assert told.returncode == 0 and "the CRS record is not used: a coordinate system made by the file" in told.stdout
    geoparquet(tmp_path / "a.parquet", json.dumps(of_method(words)))
    refused = fwclass("info", tmp_path / "a.parquet", cwd=tmp_path)
    assert refused.returncode == 1 and "coordinate system" in refused.stderr, refused.stderr


def test_a_method_of_words_without_a_file_is_none_of_these():
    crs = pyproj.CRS("+proj=ob_tran +o_proj=utm +o_lon_p=10 +o_lat_p=80 +zone=33 +ellps=bessel +type=crs")
    assert without_paths(crs) == (crs, [])


def test_what_a_path_is():
    assert all(map(is_path, ["/a", "a/b", "./a", "~/a", "..\\a", "C:\\a", "@/a", "http://h/a", ".a"]))
    assert not any(map(is_path, ["a.gsb", "@null", "us_noaa_conus.tif", ""]))


def las(path: Path, wkt: str) -> Path:
    """A LAS file of a slope with that WKT record."""
    r = np.random.default_rng(0)
    x, y = r.uniform(0, 20, (2, 400))
    lasmaker.write_las(path, np.c_[500_000 + x, 5_400_000 + y, 100 + 0.1 * x], point_format=6)
    data, body = bytearray(path.read_bytes()), wkt.encode() + b"\0"
    record = struct.pack("<H16sHH32s", 0, b"LASF_Projection", 2112, len(body), b"") + body
    start, records = struct.unpack_from("<II", data, 96)
    struct.pack_into("<II", data, 96, start + len(record), records + 1)
    struct.pack_into("<H", data, 6, struct.unpack_from("<H", data, 6)[0] | 16)
    path.write_bytes(data[:375] + record + data[375:])
    return path


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
@pytest.mark.parametrize("form", [pytest.param("WKT 1", marks=pytest.mark.slow), "WKT 2", "vertical"])
def test_a_pipe_holds_no_command_up(tmp_path: Path, form: str):
    os.mkfifo(tmp_path / "pipe")
    las(tmp_path / "a.las", FORMS[form](str(tmp_path / "pipe")))
    code = "from fwclass.cli import main; main()"
    words = ["ground", "a.las", "o.laz", "--dtm", "dtm.tif", "--method", "slope"]
    ended = subprocess.run([sys.executable, "-c", code, *words], cwd=tmp_path, capture_output=True, timeout=120)
    assert ended.returncode == 0, ended.stderr.decode()
    assert "names files" in fwclass("info", "a.las", cwd=tmp_path).stdout


def square(path: Path) -> None:
    """A file of one polygon, as its ending says."""
    shapes = shapely.to_wkb([shapely.box(0, 0, 9, 9)])
    pyogrio.raw.write(path, shapes, [np.array([2])], ["code"], geometry_type="Polygon", crs="EPSG:32633")


def geopackage(path: Path, text: str) -> None:
    square(path)
    with sqlite3.connect(path) as opened:
        opened.execute("UPDATE gpkg_spatial_ref_sys SET definition = ?", (text,))


def shapefile(path: Path, text: str) -> None:
    square(path)
    path.with_suffix(".prj").write_text(text)


def geojson(path: Path, text: str) -> None:
    crs = {"type": "name", "properties": {"name": text}}
    path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": []}))


def geoparquet(path: Path, text: str) -> None:
    column = {"encoding": "WKB", "geometry_types": ["Polygon"], "crs": json.loads(text)}
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    table = pa.table({"geometry": pa.array([shapely.to_wkb(shapely.box(0, 0, 9, 9))]), "code": [2]})
    pq.write_table(table.replace_schema_metadata({"geo": json.dumps(geo)}), path)


@pytest.mark.parametrize(
    ("name", "write", "form"),
    [
        ("a.gpkg", geopackage, "WKT 1"),
        ("b.gpkg", geopackage, "WKT 2"),
        ("a.shp", shapefile, "WKT 1"),
        ("b.shp", shapefile, "WKT 2"),
        ("a.geojson", geojson, "PROJ"),
        ("a.parquet", geoparquet, "PROJJSON"),
    ],
)
def test_polygons_with_such_a_system_are_refused(tmp_path: Path, name: str, write, form: str):
    write(tmp_path / name, FORMS[form](GRID))
    ended = fwclass("info", name, cwd=tmp_path)
    assert ended.returncode == 1 and "names" in ended.stderr and "file" in ended.stderr, ended.stderr


def test_a_path_behind_a_long_beginning_or_a_wrong_escape_is_refused_too(tmp_path: Path):
    shapefile(tmp_path / "a.shp", " " * 70_000 + FORMS["WKT 1"](GRID))
    ended = fwclass("info", "a.shp", cwd=tmp_path)
    assert ended.returncode == 1 and "more than 65536 bytes" in ended.stderr
    geojson(tmp_path / "a.geojson", "QQ" + FORMS["PROJ"](GRID))
    broken = tmp_path / "a.geojson"
    broken.write_text(broken.read_text().replace("QQ", "\\q"))
    ended = fwclass("info", "a.geojson", cwd=tmp_path)
    assert ended.returncode == 1 and "no JSON object" in ended.stderr


@pytest.mark.parametrize("key", ['"crs"', '"\\u0063rs"', '"a": "}", "crs"'])
def test_a_path_among_other_members_is_refused_too(tmp_path: Path, key: str):
    system = {"a": {"b": [{}]}, "type": "name", "properties": {"c": {}, "name": FORMS["PROJ"](GRID)}}
    text = f'{{"type": "FeatureCollection", {key}: {json.dumps(system)}, "features": []}}'
    (tmp_path / "a.geojson").write_text(text)
    ended = fwclass("info", "a.geojson", cwd=tmp_path)
    assert ended.returncode == 1 and GRID in ended.stderr


def test_so_is_a_configuration(tmp_path: Path):
    las(tmp_path / "a.las", pyproj.CRS.from_epsg(32633).to_wkt())
    (tmp_path / "c.yaml").write_text(
        f"survey: {{name: a, directory: ., sources: [a.las], crs: '{PROJ4.format(GRID)}'}}\n"
    )
    ended = fwclass("run", "c.yaml", "--workflow", "ground", "--out", "r", "--workers", "0", cwd=tmp_path)
    assert ended.returncode == 2 and "not a coordinate system" in ended.stderr


@pytest.mark.parametrize(
    "name",
    ["dict:../secret.csv,7", "dict:secret.csv,7", "+init=/etc/x:1", "+init=secret:1", "+proj=defmodel +model=./s.csv"],
)
def test_a_system_that_is_looked_up_in_a_file_is_refused(tmp_path: Path, name: str):
    """GDAL would take the system of the line that begins so."""
    (tmp_path / "secret.csv").write_text(f"7,{pyproj.CRS.from_epsg(32633).to_wkt('WKT1_GDAL')}\n")
    geojson(tmp_path / "a.geojson", name)
    ended = fwclass("info", "a.geojson", cwd=tmp_path)
    assert ended.returncode == 1 and "names the file" in ended.stderr, ended.stderr
    assert names_file(name)


def test_a_file_that_another_member_names_is_refused(tmp_path: Path):
    system = {"type": FORMS["PROJ"](GRID), "properties": {"name": "EPSG:25832"}}
    (tmp_path / "a.geojson").write_text(json.dumps({"type": "FeatureCollection", "crs": system, "features": []}))
    ended = fwclass("info", "a.geojson", cwd=tmp_path)
    assert ended.returncode == 1 and GRID in ended.stderr, ended.stderr


def info(name: str, place: Path) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, as it may wait for a pipe."""
    code = "from fwclass.cli import main; main()"
    line = [sys.executable, "-c", code, "info", name]
    return subprocess.run(line, cwd=place, capture_output=True, text=True, timeout=60)


POLYGON = '"geometry": {"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9], [0, 0]]]}'


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
@pytest.mark.parametrize(
    "system",
    [
        "'crs': {'type': 'name', 'properties': {'name': 'NAME'}}",
        '"crs" /**/ : {"type": "name", "properties": {"name": "NAME"}}',
        '"crs": /**/ {"type": "name", "properties": {"name": "NAME"}}',
        '"crs\\u0000": {"type": "name", "properties": {"name": "NAME"}}',
    ],
)
def test_a_system_in_what_gdal_takes_for_json_is_refused(tmp_path: Path, system: str):
    """GDAL reads comments and single quotes in a file of one feature, and takes a name up to its zero."""
    os.mkfifo(tmp_path / "pipe")
    text = '{"type": "Feature", "properties": {"a/b": "it\'s //"}, ' + POLYGON
    (tmp_path / "a.geojson").write_text(f"{text}}}")
    assert fwclass("info", "a.geojson", cwd=tmp_path).returncode == 0
    named = system.replace("NAME", PROJ4.format(tmp_path / "pipe"))
    (tmp_path / "a.geojson").write_text(f"{text}, {named}}}")
    ended = info("a.geojson", tmp_path)
    assert ended.returncode == 1 and "not what its name says" in ended.stderr, ended.stderr


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
@pytest.mark.parametrize(
    ("name", "write", "text"),
    [
        ("a.shp", shapefile, FORMS["WKT 1"]("grid.gsb")),
        ("a.geojson", geojson, FORMS["PROJ"]("grid.gsb")),
        ("b.geojson", geojson, "+init=epsg:32633"),
    ],
)
def test_a_grid_is_not_taken_from_the_current_directory(tmp_path: Path, name: str, write, text: str):
    """Which may be a stranger's: GDAL looks there for what PROJ does not have."""
    write(tmp_path / name, text)
    assert fwclass("info", name, cwd=tmp_path).returncode == 0
    for pipe in ("grid.gsb", "epsg"):
        os.mkfifo(tmp_path / pipe)
    ended = info(name, tmp_path)
    assert ended.returncode == 1 and "names the file" in ended.stderr, ended.stderr


@pytest.mark.parametrize(
    "name",
    [
        "EPSG:25832",
        "EPSG:25832+7837",
        "urn:ogc:def:crs:EPSG::25832",
        "urn:ogc:def:crs:EPSG:9.8:25832",
        "urn:ogc:def:crs:OGC:1.3:CRS84",
        "urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::7837",
        "http://www.opengis.net/def/crs/EPSG/0/25832",
        "http://www.opengis.net/gml/srs/epsg.xml#25832",
        "WGS 84 / UTM zone 33N",
        "WGS84",
        "+proj=utm +zone=32 +datum=WGS84",
        "+init=epsg:25832",
        pyproj.CRS.from_epsg(25832).to_wkt(),
        pyproj.CRS.from_epsg(25832).to_wkt("WKT1_ESRI"),
        pyproj.CRS.from_epsg(25832).to_json(),
    ],
)
def test_what_a_system_is_usually_called_names_no_file(name: str):
    assert names_file(name) == ""


@pytest.mark.parametrize("crs", ["+init=/etc/passwd:1", "+proj=defmodel +model=/etc/passwd", "dict:x,1"])
def test_so_is_that_of_raw_waveforms(tmp_path: Path, crs: str):
    settings = Settings(1.0, None, None, False, crs)
    with pytest.raises(InputError, match="not a coordinate system"):
        settings.system(tmp_path / "a.parquet", [])
