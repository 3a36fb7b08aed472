"""A file of polygons is read by the driver of its own format: it reaches no host, no other file and no other driver."""

from __future__ import annotations

import contextlib
import http.server
import json
import os
import re
import shutil
import sqlite3
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio.raw
import pytest
import shapely
from commandline import fwclass

from fwclass.errors import FwclassError, InputError
from fwclass.formats.gdal import DRIVERS, vector_gdal
from fwclass.read.polygons import open_polygons, read_polygons
from fwclass.read.polygons_info import polygon_info
from fwclass.survey.area_of_interest import Area

SQUARE = [[[0, 0], [10, 0], [10, 10], [0, 0]]]


class Hosts(http.server.ThreadingHTTPServer):
    """Counts what is asked of it."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        super().__init__(("127.0.0.1", 0), _Answer)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class _Answer(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.server.asked.append(f"{self.command} {self.path}")  # type: ignore[attr-defined]
        self.send_response(200)
        self.end_headers()
        self.wfile.write(json.dumps(collection()).encode())

    do_HEAD = do_POST = do_GET

    def log_message(self, *words: object) -> None:
        pass


def collection(crs: object = None, key: str = "crs") -> dict[str, Any]:
    shape = {"type": "Polygon", "coordinates": SQUARE}
    features = [{"type": "Feature", "properties": {"class": "a"}, "geometry": shape}]
    return {"type": "FeatureCollection", "features": features} | ({key: crs} if crs else {})


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[Hosts]:
    """A host that no proxy stands before."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    server = Hosts()
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture
def sound(tmp_path: Path) -> Path:
    """A directory with a sound file of each format, named ``good``."""
    shape = np.array([struct.pack("<BIII8d", 1, 3, 1, 4, 0, 0, 10, 0, 10, 10, 0, 0)], object)
    for driver, ending in (("GPKG", "gpkg"), ("ESRI Shapefile", "shp")):
        vector_gdal().raw.write(
            str(tmp_path / f"good.{ending}"),
            shape,
            [np.array(["a"], object)],
            np.array(["class"], object),
            layer="good",
            driver=driver,
            geometry_type="Polygon",
            crs="EPSG:25832",
        )
    (tmp_path / "good.geojson").write_text(json.dumps(collection()))
    return tmp_path


def vrt(url: str) -> str:
    return (
        "<OGRVRTDataSource><OGRVRTLayer name='x'><SrcDataSource>/vsicurl/"
        f"{url}/evil.geojson</SrcDataSource><SrcLayer>evil</SrcLayer></OGRVRTLayer></OGRVRTDataSource>"
    )


CONTENTS: dict[str, Callable[[str], str]] = {
    "virtual layer": vrt,
    "web feature service": lambda url: f"<OGRWFSDataSource><URL>{url}/wfs</URL></OGRWFSDataSource>",
    "pipeline": lambda url: json.dumps(
        {"type": "gdal_streamed_alg", "command_line": f"gdal vector pipeline ! read {url}/a.geojson ! filter"}
    ),
    "topology": lambda url: json.dumps({"type": "Topology", "objects": {}, "arcs": [], "url": url}),
    "Esri": lambda url: json.dumps({"geometryType": "esriGeometryPoint", "features": [], "fields": [], "url": url})[:9],
    "service": lambda url: json.dumps({"stac_version": "1.0.0", "href": url, "links": [{"href": url}]}),
    "mbtiles": lambda url: json.dumps({"tilejson": "2.0", "tiles": [f"{url}/{{z}}"]}),
    "map service": lambda url: f"<GDAL_WMS><Service name='TMS'><ServerUrl>{url}</ServerUrl></Service></GDAL_WMS>",
    "table": lambda url: f'WKT,url\n"POINT (0 0)",{url}\n',
    "text of a database": lambda url: f"PG:host=127.0.0.1 port={url.rsplit(':', 1)[1]}",
}


@pytest.mark.parametrize("ending", ["gpkg", "geojson", "json", "shp"])
@pytest.mark.parametrize("content", CONTENTS)
def test_another_formats_text_under_the_name_of_polygons_is_refused(
    content: str, ending: str, tmp_path: Path, host: Hosts
) -> None:
    path = tmp_path / f"a.{ending}"
    path.write_text(CONTENTS[content](host.url))
    ended = fwclass("info", path)
    assert ended.returncode == 1 and "not what its name says" in ended.stderr and not host.asked
    with pytest.raises(InputError, match="not what its name says"):
        Area(path).check()
    assert not host.asked


@pytest.mark.parametrize("kind", ["link", "url"])
@pytest.mark.parametrize("key", ["crs", "\\u0063rs", "c\\u0072\\u0073"])
@pytest.mark.parametrize("before", ["", '"a": {"b": {}}, "c": "}{", '])
def test_a_coordinate_system_is_not_fetched(kind: str, key: str, before: str, tmp_path: Path, host: Hosts) -> None:
    """Nor with its name in escapes, or behind other members."""
    member = {"link": "href", "url": "url"}[kind]
    where = f'{{{before}"{member}": "{host.url}/crs.wkt", "type": "ogcwkt"}}'
    text = json.dumps(collection("SYSTEM", "KEY")).replace("KEY", key)
    (tmp_path / "a.geojson").write_text(
        text.replace('"SYSTEM"', f'{{{before}"type": "{kind}", "properties": {where}}}')
    )
    with pytest.raises(InputError, match="not what its name says"):
        open_polygons(tmp_path / "a.geojson")
    assert not host.asked


@pytest.mark.parametrize(
    "name",
    [
        "/vsicurl/{}/a.geojson",
        "/vsizip//vsicurl/{}/a.zip/a.gpkg",
        "{}/a.geojson",
        "PG:host=127.0.0.1 dbname=a.gpkg",
        "WFS:{}/a.gpkg",
        "/vsimem/a.gpkg",
        "GPKG:{}.gpkg",
        "zip://{}/a.geojson",
        "/vsistdin/a.json",
    ],
)
def test_a_name_that_gdal_would_understand_is_the_name_of_a_file(name: str, host: Hosts) -> None:
    for path in (Path(name.format(host.url)), Path(name.format(f"/vsicurl/{host.url}"))):
        with pytest.raises(InputError):
            Area(path).check()
    assert not host.asked


def changed(sound: Path, *statements: str) -> Path:
    path = sound / "changed.gpkg"
    shutil.copy(sound / "good.gpkg", path)
    database = sqlite3.connect(path)
    for statement in statements:
        database.execute(statement)
    database.commit()
    database.close()
    return path


LISTED = "insert into gpkg_contents(table_name, data_type, identifier, srs_id) values('v', 'features', 'v', 25832)"
GEOMETRY = "insert into gpkg_geometry_columns values('v', '{}', 'POLYGON', 25832, 0, 0)"


@pytest.mark.parametrize(
    "expression",
    [
        "load_extension('/tmp/none.so')",
        "ogr_geocode('x', 'y')",
        "ogr_datasource_load_layers('{}/a.geojson')",
        "readfile('/etc/passwd')",
    ],
)
def test_a_view_of_a_geopackage_calls_nothing(expression: str, sound: Path, host: Hosts) -> None:
    view = f"create view v as select fid, geom, {expression.format(host.url)} as class from good"  # noqa: S608 - made here
    path = changed(sound, view, LISTED, GEOMETRY.format("geom"))
    with pytest.raises(InputError, match="not what its name says"):
        read_polygons(open_polygons(path, "v"), "class")
    assert not host.asked


ENDLESS = "with t(n) as (select 1 union all select n + 1 from t) select n as fid, x'00' as geom from t"


@pytest.mark.parametrize(
    ("statements", "words"),
    [
        ((f"create view v as {ENDLESS}", LISTED, GEOMETRY.format("geom")), "a view, v"),
        (("create view V as select * from good", LISTED, GEOMETRY.format("geom")), "a view, V"),
        (("alter table gpkg_contents rename to c", f"create view gpkg_contents as {ENDLESS}"), "a view, gpkg_contents"),
        (("alter table good add column g as (hex(zeroblob(500000000)))",), "generated columns in good"),
    ],
)
def test_a_layer_that_is_computed_when_it_is_read_is_refused(statements, words, sound: Path) -> None:
    """An endless query, or one that takes all memory, cannot be told from a harmless one before it runs."""
    path = changed(sound, *statements)
    with pytest.raises(InputError, match="not what its name says") as fault:
        read_polygons(open_polygons(path, None), "class")
    assert words in str(fault.value)


def walked_over_and_over(path: Path, table: str, depth: int = 6, each: int = 50) -> None:
    """Put a tree of pages in the place of a table's leaf: each has the next one as all of its children."""
    with sqlite3.connect(path) as opened:
        root = opened.execute("select rootpage from sqlite_master where name = ?", (table,)).fetchone()[0]
        size = opened.execute("pragma page_size").fetchone()[0]
    content = bytearray(path.read_bytes())
    count = len(content) // size
    leaf = content[(root - 1) * size : root * size]
    assert leaf[0] == 0x0D

    def page(child: int) -> bytes:
        made, cells = bytearray(size), size - 5 * each
        made[:12] = struct.pack(">BHHHBI", 5, 0, each, cells, 0, child)
        for k in range(each):
            struct.pack_into(">H", made, 12 + 2 * k, cells + 5 * k)
            struct.pack_into(">IB", made, cells + 5 * k, child, 1)
        return bytes(made)

    content += leaf + b"".join(page(count + k) for k in range(1, depth))
    content[(root - 1) * size : root * size] = page(count + depth)
    struct.pack_into(">I", content, 28, len(content) // size)
    path.write_bytes(content)


@pytest.mark.parametrize("table", ["good", "gpkg_contents", "gpkg_spatial_ref_sys"])
def test_pages_that_are_there_many_times_are_refused(table: str, sound: Path) -> None:
    """50^6 rows of 100 kB: SQLite, and GDAL with it, would walk for a year."""
    path = sound / "good.gpkg"
    walked_over_and_over(path, table)
    with pytest.raises(InputError, match="not what its name says") as told:
        open_polygons(path)
    assert "damaged database" in str(told.value)


def test_a_layer_of_thousands_of_fields_is_read_a_hundred_times_at_most(tmp_path: Path) -> None:
    about = collection()
    about["features"][0]["properties"] = {f"f{k}": k for k in range(3000)}
    (tmp_path / "a.geojson").write_text(json.dumps(about))
    told = polygon_info(tmp_path / "a.geojson")["layers"][0]
    assert len(told["fields"]) == 3000 and len(told["values"]) == 100


def test_a_layer_of_more_fields_than_any_has_is_refused(tmp_path: Path) -> None:
    """One of 60 000 fields in 600 kB took a minute: GDAL looks every one up that is not read, one after the other."""
    about = collection()
    about["features"][0]["properties"] = {f"f{k}": k for k in range(5000)}
    (tmp_path / "a.geojson").write_text(json.dumps(about))
    with pytest.raises(InputError, match="more fields than any has"):
        open_polygons(tmp_path / "a.geojson")


def test_a_layer_that_says_it_has_more_rows_is_refused(sound: Path) -> None:
    with sqlite3.connect(sound / "good.gpkg") as opened:
        opened.execute("update gpkg_ogr_contents set feature_count = 2000000000")
    with pytest.raises(InputError, match="says it has 2000000000 rows, and has"):
        open_polygons(sound / "good.gpkg")


@pytest.mark.parametrize(
    "change",
    [
        {"primary_column": ["geometry"]},
        {"primary_column": {}},
        {"columns": {"geometry": {"encoding": "WKB", "geometry_types": 5}}},
        {"columns": {"geometry": {"encoding": "WKB", "covering": ["x"]}}},
        {"columns": {"geometry": {"encoding": "WKB", "covering": {"bbox": [1]}}}},
        "[" * 100_000,
    ],
)
def test_metadata_of_another_shape_is_refused(change: Any, tmp_path: Path) -> None:
    about = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": {"encoding": "WKB"}}}
    text = change if isinstance(change, str) else json.dumps(about | change)
    table = pa.table({"geometry": pa.array([b"x"])}).replace_schema_metadata({"geo": text})
    pq.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(InputError, match="no GeoParquet"):
        open_polygons(tmp_path / "a.parquet")


def test_columns_that_are_there_twice_or_nested_are_refused(tmp_path: Path) -> None:
    about = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": {"encoding": "WKB"}}}
    shape = pa.array([shapely.to_wkb(shapely.box(0, 0, 9, 9))])
    for name, columns in {
        "twice": [pa.array([1]), pa.array([2]), shape],
        "nested": [pa.array([[1]]), pa.array([{"a": 1}]), shape],
    }.items():
        table = pa.Table.from_arrays(columns, ["code", "code" if name == "twice" else "b", "geometry"])
        pq.write_table(table.replace_schema_metadata({"geo": json.dumps(about)}), tmp_path / f"{name}.parquet")
        with pytest.raises(InputError, match="no GeoParquet"):
            read_polygons(open_polygons(tmp_path / f"{name}.parquet"), "code")


@pytest.mark.parametrize("lengths", ["true", "small"])
def test_an_index_that_leads_to_one_record_over_and_over_is_refused(lengths: str, sound: Path) -> None:
    """Eight bytes each, of 480 kB: of 900 kB came 4 GB."""
    index = sound / "good.shx"
    data, n = bytearray(index.read_bytes()), 5000
    entry = bytes(data[100:108]) if lengths == "true" else bytes(data[100:104]) + struct.pack(">i", 2)
    made = data[:100] + entry * n
    struct.pack_into(">i", made, 24, len(made) // 2)
    index.write_bytes(made)
    with pytest.raises(InputError, match="not what its name says") as told:
        read_polygons(open_polygons(sound / "good.shp"), None)
    assert "an index of" in str(told.value)


@pytest.mark.parametrize("part", ["shx", "dbf"])
def test_a_shapefile_whose_parts_count_fewer_records_is_refused(part: str, tmp_path: Path) -> None:
    """The index or the attributes of an older state: the other polygons would be left out without a word."""
    square, path = shapely.to_wkb(shapely.box(500000, 5400000, 500010, 5400010)), tmp_path / "six.shp"
    about: dict[str, Any] = {"geometry_type": "Polygon", "crs": "EPSG:32633", "driver": "ESRI Shapefile"}
    pyogrio.raw.write(path, np.array([square] * 6, object), [np.arange(6)], ["code"], **about)
    assert open_polygons(path).features == 6
    raw = bytearray(path.with_suffix(f".{part}").read_bytes())
    if part == "shx":
        raw = raw[: 100 + 4 * 8]
        struct.pack_into(">i", raw, 24, len(raw) // 2)
    else:
        struct.pack_into("<I", raw, 4, 4)
    path.with_suffix(f".{part}").write_bytes(raw)
    with pytest.raises(InputError, match="do not belong together"):
        open_polygons(path)


@pytest.mark.parametrize(
    "entries", [b"", b"\xff" * 16, b"\x7f" * 16, b"\0" * 7], ids=["none", "minus", "beyond", "cut"]
)
def test_an_index_that_leads_nowhere_ends_in_words(entries: bytes, sound: Path) -> None:
    whole = len(read_polygons(open_polygons(sound / "good.shp"), None)[1].x)
    index = sound / "good.shx"
    index.write_bytes(index.read_bytes()[:100] + entries)
    with contextlib.suppress(InputError):
        assert len(read_polygons(open_polygons(sound / "good.shp"), None)[1].x) <= whole


COUNTED = "select count(*) as fid from (with t(n) as (select 1 union all select n + 1 from t) select n from t)"


def renamed(table: str, name: str = "x'67'") -> str:
    return (
        f"insert into {table} select {name}, "
        + {
            "gpkg_contents": "'features', 'g', '', '2000-01-01T00:00:00Z', 0, 0, 1, 1, 25832",
            "gpkg_geometry_columns": "'geom', 'POLYGON', 25832, 0, 0",
        }[table]
    )


@pytest.mark.parametrize(
    ("statements", "words"),
    [
        ((f"create view v as {COUNTED}",), "a view, v"),
        (
            (
                "create table g(fid integer primary key, geom polygon, class as (hex(zeroblob(500000000))))",
                renamed("gpkg_contents"),
                renamed("gpkg_geometry_columns"),
            ),
            "generated columns in g",
        ),
        (("create table g(fid integer primary key, geom polygon)", renamed("gpkg_contents")), "whose name is blob"),
        (("update gpkg_ogr_contents set table_name = x'676f6f64', feature_count = 2000000000",), "whose name is blob"),
        (("update gpkg_ogr_contents set table_name = 'GOOD', feature_count = 2000000000",), "says it has 2000000000"),
        ((f"alter table good add column more text default '{'x' * 100_000}'",), "for silent rows of good"),
    ],
)
def test_what_gdal_sees_and_a_layer_is_not_is_refused_too(statements, words, sound: Path) -> None:
    """GDAL counts a view that is no layer, takes a name that is no text for one, and gives every row the default."""
    with pytest.raises(InputError, match="not what its name says") as told:
        open_polygons(changed(sound, *statements), "good")
    assert words in str(told.value)


@pytest.mark.parametrize(
    "table", ["VirtualOGR('{}/a.geojson')", "VirtualShape('{}', 'UTF-8', 25832)", "VirtualText('{}', 'UTF-8')"]
)
def test_a_geopackage_opens_no_other_file(table: str, sound: Path, host: Hosts) -> None:
    text = f"CREATE VIRTUAL TABLE v USING {table.format(sound / 'good')}".replace("'", "''")
    path = changed(
        sound,
        "pragma writable_schema = 1",
        LISTED,
        GEOMETRY.format("geometry"),
        f"insert into sqlite_master(type, name, tbl_name, rootpage, sql) values('table', 'v', 'v', 0, '{text}')",
    )
    with pytest.raises(InputError, match="not what its name says") as fault:
        open_polygons(path, "v")
    assert "reads other files" in str(fault.value)


@pytest.mark.parametrize("name", ["good.prj", "good.sbn", "good.CPG", "good.gpkg-wal", "good.shp.xml"])
def test_a_pipe_beside_keeps_nobody_waiting(name: str, sound: Path) -> None:
    (sound / name).unlink(missing_ok=True)
    os.mkfifo(sound / name)
    for ending in ("gpkg", "shp", "geojson"):
        with pytest.raises(InputError, match="not what its name says"):
            open_polygons(sound / f"good.{ending}")


def test_three_drivers_are_left_and_sound_files_are_read(sound: Path) -> None:
    assert set(vector_gdal().list_drivers()) <= DRIVERS
    for ending in ("gpkg", "shp", "geojson"):
        values, shapes = read_polygons(open_polygons(sound / f"good.{ending}"), "class")
        assert values == ["a"] and shapes.parts == 1
    late = {"name": "x" * 100, "features": collection()["features"], "type": "FeatureCollection"}
    bare = {"coordinates": SQUARE, "type": "Polygon"}
    for content in (late, bare, collection({"type": "name", "properties": {"name": "EPSG:25832"}})):
        (sound / "a.json").write_text("\ufeff\n" + json.dumps(content, indent=1), encoding="utf-8")
        assert read_polygons(open_polygons(sound / "a.json"), None)[1].parts == 1


def test_foreign_files_reach_gdal_through_one_door() -> None:
    """pyogrio is imported where it is restricted, and rasterio opens what the program itself has written."""
    root = Path(__file__).parents[2] / "fwclass"
    texts = {p.relative_to(root).as_posix(): p.read_text(encoding="utf-8") for p in root.rglob("*.py")}
    imports = re.compile(r"^\s*(import pyogrio|from pyogrio)", re.MULTILINE)
    assert {name for name, text in texts.items() if imports.search(text)} == {"formats/gdal.py"}
    assert {name for name, text in texts.items() if "rasterio.open(" in text} == {
        "publish/cog.py",
        "publish/delivered_raster.py",
    }
    reads = texts["publish/delivered_raster.py"]
    assert 'driver="GTiff"' in reads and reads.count("rasterio.open(") == 1
    writes = texts["publish/cog.py"]
    assert 'rasterio.open(raw, "w"' in writes and 'rasterio.open(written, driver="GTiff")' in writes
    assert writes.count("rasterio.open(") == 2


def test_gdal_that_cannot_be_restricted_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    from pyogrio import _ogr

    from fwclass.formats import gdal

    monkeypatch.setattr(gdal, "DRIVERS", {"GPKG"})
    monkeypatch.setattr(_ogr, "_register_drivers", lambda: None)
    with pytest.raises(FwclassError, match="cannot be kept from opening"):
        gdal.vector_gdal.__wrapped__()
