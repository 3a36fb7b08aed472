"""Polygon files that name their coordinate system twice, one that is not known, or by words and the code of another.

GDAL goes by codes and by names: polygons lay in the next zone, in silence.
"""

from __future__ import annotations

import json
import re
import sqlite3
from contextlib import closing
from pathlib import Path

import geopandas
import pyarrow.parquet as pq
import pytest
import shapely
from pyproj import CRS

from fwclass.errors import InputError
from fwclass.formats import polygon_systems
from fwclass.read.info import info
from fwclass.read.polygons import open_polygons, source_crs

HERE, OTHER = 25832, 25833
WORDS = CRS.from_epsg(HERE).to_wkt("WKT1_GDAL")
NO_CODES = re.sub(r',AUTHORITY\["EPSG","\d+"\]', "", WORDS)
PRJ = CRS.from_epsg(HERE).to_wkt("WKT1_ESRI")
TWO = "names two coordinate systems"


def square(path: Path) -> Path:
    frame = geopandas.GeoDataFrame({"k": ["a"]}, geometry=[shapely.box(5e5, 5.4e6, 5e5 + 9, 5.4e6 + 9)], crs=HERE)
    frame.to_parquet(path) if path.suffix == ".parquet" else frame.to_file(path)
    return path


def gpkg(path: Path, change: str, *values: object) -> Path:
    with closing(sqlite3.connect(square(path))) as opened, opened:
        opened.execute(f"UPDATE gpkg_spatial_ref_sys SET {change} WHERE srs_id = {HERE}", values)  # noqa: S608 (own)
    return path


def layers_system(path: Path, srs: int, tables: tuple[str, ...]) -> Path:
    with closing(sqlite3.connect(square(path))) as opened, opened:
        row = (srs, "EPSG", srs, CRS.from_epsg(OTHER).to_wkt("WKT1_GDAL"))
        if srs == OTHER:
            opened.execute("INSERT INTO gpkg_spatial_ref_sys VALUES ('x', ?, ?, ?, ?, '')", row)
        for table in tables:
            opened.execute(f"UPDATE {table} SET srs_id = ?", (srs,))  # noqa: S608 (own)
    return path


def shapefile(path: Path, prj: str) -> Path:
    square(path).with_suffix(".prj").write_text(prj)
    return path


def geojson(path: Path, *named: str) -> Path:
    members = ", ".join(f'"crs": {{"type": "name", "properties": {{"name": "{name}"}}}}' for name in named)
    ring = "[[[9, 48], [9.001, 48], [9, 48.001], [9, 48]]]"
    feature = f'{{"type": "Feature", "properties": {{}}, "geometry": {{"type": "Polygon", "coordinates": {ring}}}}}'
    path.write_text(f'{{"type": "FeatureCollection", {members}, "features": [{feature}]}}')
    return path


def geoparquet(path: Path, **changes: object) -> Path:
    table = pq.read_table(square(path))
    geo = json.loads(table.schema.metadata[b"geo"])
    geo["columns"]["geometry"]["crs"] |= changes
    pq.write_table(table.replace_schema_metadata(table.schema.metadata | {b"geo": json.dumps(geo).encode()}), path)
    return path


TABLES = ("gpkg_contents", "gpkg_geometry_columns")
BOTH = (
    (".gpkg", lambda p: gpkg(p, "organization_coordsys_id = ?", OTHER)),
    (".gpkg", lambda p: gpkg(p, "organization = 'epsg', organization_coordsys_id = ?, definition = ?", OTHER, WORDS)),
    (".gpkg", lambda p: gpkg(p, "organization_coordsys_id = ?, definition = ?", OTHER, NO_CODES)),
    (".gpkg", lambda p: layers_system(p, OTHER, TABLES[:1])),
    (".shp", lambda p: shapefile(p, f'{NO_CODES[:-1]},AUTHORITY["EPSG","{OTHER}"]]')),
    (".shp", lambda p: shapefile(p, f'{PRJ[:-1]},AUTHORITY["EPSG","{OTHER}"]]')),
    (".shp", lambda p: shapefile(p, CRS.from_epsg(HERE).to_wkt().replace(str(HERE), str(OTHER)))),
    (".parquet", lambda p: geoparquet(p, id={"authority": "EPSG", "code": OTHER})),
    (".geojson", lambda p: geojson(p, f"EPSG:{OTHER}", f"EPSG:{HERE}")),
)


@pytest.mark.parametrize(("ending", "write"), BOTH)
def test_words_count_more_than_codes_and_both_are_told(ending: str, write, tmp_path: Path) -> None:
    path = write(tmp_path / f"a{ending}")
    opened, survey = open_polygons(path), CRS.from_epsg(HERE)
    assert opened.crs.to_epsg() == HERE
    assert any(TWO in fault and "zone 32N" in fault and "33N" in fault for fault in info(path)["faults"])
    lines: list[str] = []
    assert source_crs(opened, None, survey, say=lines.append).to_epsg() == HERE
    assert len(lines) == 1 and TWO in lines[0] and path.name in lines[0]
    with pytest.raises(InputError, match=TWO):  # nobody would know of it
        source_crs(opened, None, survey)
    assert source_crs(opened, survey, survey).to_epsg() == HERE  # the user's word


@pytest.mark.parametrize(
    ("ending", "write"),
    [
        (".gpkg", lambda p: layers_system(p, -1, TABLES)),
        (".gpkg", lambda p: layers_system(p, 0, TABLES)),
        (".gpkg", lambda p: layers_system(p, 99999, TABLES)),
        (".geojson", lambda p: geojson(p, "urn:ogc:def:crs:EPSG::999999")),
        (".geojson", lambda p: geojson(p, "local grid")),
        (".shp", lambda p: shapefile(p, "")),
        (".shp", lambda p: shapefile(p, "no system")),
    ],
)
def test_a_system_that_is_none_is_none(ending: str, write, tmp_path: Path) -> None:
    """GDAL took degrees of WGS 84 for names that it does not know, and for systems that the file calls undefined."""
    path = write(tmp_path / f"a{ending}")
    assert open_polygons(path).crs is None and any("no coordinate system" in f for f in info(path)["faults"])
    with pytest.raises(InputError, match="is unknown"):
        source_crs(open_polygons(path), None, CRS.from_epsg(HERE))


@pytest.mark.parametrize(
    ("ending", "write", "code"),
    [
        (".gpkg", lambda p: gpkg(p, "definition = 'undefined'"), HERE),
        (".gpkg", lambda p: gpkg(p, "organization = 'NONE'"), HERE),
        (".shp", lambda p: shapefile(p, PRJ), HERE),
        (".shp", lambda p: shapefile(p, "\ufeff" + PRJ), HERE),
        (".shp", lambda p: shapefile(p, WORDS), HERE),
        (".shp", lambda p: shapefile(p, CRS.from_epsg(HERE).to_wkt()), HERE),
        (".geojson", lambda p: geojson(p, "urn:ogc:def:crs:OGC:1.3:CRS84"), 4326),
        (".geojson", lambda p: geojson(p, "ETRS89 / UTM zone 32N"), HERE),
        (".geojson", lambda p: geojson(p, f"urn:ogc:def:crs:EPSG::{HERE}"), HERE),
    ],
)
def test_one_system_is_no_fault(ending: str, write, code: int, tmp_path: Path) -> None:
    opened = open_polygons(write(tmp_path / f"a{ending}"))
    assert opened.crs.to_epsg() == code and not opened.faults


@pytest.mark.parametrize("column", ["organization", "organization_coordsys_id", "definition", "srs_id"])
def test_a_table_of_systems_without_a_column_is_no_traceback(column: str, tmp_path: Path) -> None:
    with closing(sqlite3.connect(square(tmp_path / "a.gpkg"))) as opened, opened:
        opened.execute(f"ALTER TABLE gpkg_spatial_ref_sys RENAME COLUMN {column} TO other")
    assert not open_polygons(tmp_path / "a.gpkg").faults


def test_rows_of_one_system_are_not_all_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each names a code that PROJ looks up: 100,000 of them took a minute."""
    with closing(sqlite3.connect(square(tmp_path / "a.gpkg"))) as opened, opened:
        opened.execute("ALTER TABLE gpkg_spatial_ref_sys RENAME TO before")
        opened.execute("CREATE TABLE gpkg_spatial_ref_sys AS SELECT * FROM before")
        rows = [("x", HERE, "EPSG", 2000 + k, WORDS, "") for k in range(3000)]
        opened.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", rows)
    asked: list[str | None] = []
    for name in ("_system", "_words"):
        plain = getattr(polygon_systems, name)
        monkeypatch.setattr(polygon_systems, name, lambda text, plain=plain: (asked.append(text), plain(text))[1])
    open_polygons(tmp_path / "a.gpkg")
    assert 0 < len(asked) <= 6 * polygon_systems.MOST_ROWS
