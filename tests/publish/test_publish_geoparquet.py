"""GeoParquet, read by geopandas and by DuckDB."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.errors import InputError
from fwclass.publish.geoparquet import about_delivery, round_floats, wkb_points, write_geoparquet
from fwclass.publish.params import PublishParams
from fwclass.schema import Table

CRS = pyproj.CRS(2154)


def geo(path: Path) -> dict:
    return json.loads(pq.read_schema(path).metadata[b"geo"])


def test_geopandas_reads_points_columns_and_crs(
    echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    geopandas = pytest.importorskip("geopandas")
    table = echoes()
    write_geoparquet(table, tmp_path / "t.parquet", CRS, params)
    frame = geopandas.read_parquet(tmp_path / "t.parquet")
    assert frame.crs == CRS and frame.geometry.has_z.all()
    for axis in "xyz":
        assert np.array_equal(getattr(frame.geometry, axis), table[axis])
    for name in table:
        assert frame[name].dtype == table[name].dtype
        assert np.array_equal(frame[name], table[name], equal_nan=table[name].dtype.kind == "f")
    box = (770_010, 6_277_020, 770_040, 6_277_070)
    part = geopandas.read_parquet(tmp_path / "t.parquet", bbox=box)
    x, y = table["x"], table["y"]
    inside = (x >= box[0]) & (y >= box[1]) & (x <= box[2]) & (y <= box[3])
    assert 0 < inside.sum() <= len(part) < len(frame) / 2, "the covering box filters rows, a little wide of it"
    assert set(table["pulse"][inside]) <= set(part["pulse"])


def test_duckdb_reads_box_and_wkb(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    table = echoes()
    path = tmp_path / "t.parquet"
    write_geoparquet(table, path, None, params)
    query = f"select x, bbox.xmin, bbox.ymax, ST_AsWKB(geometry) from read_parquet('{path}')"  # noqa: S608
    rows = duckdb.connect(config={"autoinstall_known_extensions": False}).execute(query).fetchall()
    assert len(rows) == table.rows
    for i in (0, 77, table.rows - 1):
        x, xmin, ymax, wkb = rows[i]
        assert x == table["x"][i] and 0 <= x - xmin <= 0.0625 and 0 <= ymax - table["y"][i] <= 0.5, "rounded outwards"
        found = wkb_xyz(bytes(wkb))
        assert found[:2] == (table["x"][i], table["y"][i])


def test_duckdb_reads_whole_numbers_and_heights(
    echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    duckdb = pytest.importorskip("duckdb")
    table, path = echoes(), tmp_path / "t.parquet"
    write_geoparquet(table, path, None, params)
    rows = duckdb.sql(f"select z, pulse from read_parquet('{path}')").fetchnumpy()  # noqa: S608
    assert np.array_equal(rows["z"], table["z"]) and np.array_equal(rows["pulse"], table["pulse"])


def test_centimetres_take_two_bytes_a_coordinate(params: PublishParams, tmp_path: Path) -> None:
    """A file of 50 m in centimetres has some 12 bits a coordinate; planes of the doubles' bytes took up to 40."""
    rng = np.random.default_rng(0)
    x, y = np.sort(rng.integers(0, 5_000, (2, 40_000)), axis=1) / 100.0
    z = 300.0 + np.rint(100.0 * (np.sin(x) + rng.uniform(0, 8, len(x)))) / 100.0
    pulse = np.arange(len(x), dtype=np.uint32) * 3
    path = tmp_path / "t.parquet"
    write_geoparquet(Table({"x": x + 770_000.0, "y": y + 6_277_000.0, "z": z, "pulse": pulse}), path, None, params)
    about = pq.read_metadata(path)
    size = {about.row_group(0).column(k).path_in_schema: 0 for k in range(about.num_columns)}
    for group in range(about.num_row_groups):
        for k in range(about.num_columns):
            one = about.row_group(group).column(k)
            size[one.path_in_schema] += one.total_compressed_size
    assert size["z"] < 2.2 * len(x) and size["pulse"] < 0.5 * len(x)


def wkb_xyz(wkb: bytes) -> tuple[float, ...]:
    """Coordinates of a little-endian WKB point, ISO with height or plain."""
    order, kind = struct.unpack_from("<BI", wkb)
    assert order == 1 and kind in (1, 1001, 0x80000001)
    return struct.unpack_from("<2d" if kind == 1 else "<3d", wkb, 5)


def test_wkb_is_the_standard_s(echoes: Callable[..., Table]) -> None:
    shapely = pytest.importorskip("shapely")
    table = echoes(20)
    made = wkb_points(table["x"], table["y"], table["z"]).to_pylist()
    assert {len(w) for w in made} == {29}
    points = shapely.points(np.column_stack([table["x"], table["y"], table["z"]]))
    assert made == list(shapely.to_wkb(points, flavor="iso"))


def test_metadata_follow_the_specification(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    table = echoes()
    write_geoparquet(table, tmp_path / "a.parquet", CRS, params)
    write_geoparquet(table, tmp_path / "b.parquet", None, params)
    about = geo(tmp_path / "a.parquet")
    column = about["columns"]["geometry"]
    assert about["version"] == "1.1.0" and about["primary_column"] == "geometry"
    assert column["encoding"] == "WKB" and column["geometry_types"] == ["Point Z"]
    assert pyproj.CRS.from_json_dict(column["crs"]) == CRS
    assert column["covering"]["bbox"]["xmax"] == ["bbox", "xmax"]
    assert column["bbox"] == [f(table[a]) for f in (np.min, np.max) for a in "xyz"]
    unknown = geo(tmp_path / "b.parquet")["columns"]["geometry"]
    assert "crs" in unknown and unknown["crs"] is None, "left out would mean longitude and latitude"


def test_fields_carry_unit_and_meaning(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    write_geoparquet(echoes(), tmp_path / "t.parquet", CRS, params)
    schema = pq.read_schema(tmp_path / "t.parquet")
    assert schema.field("amplitude").metadata[b"unit"] == b"DN"
    assert schema.field("amplitude").metadata[b"null"] == b"NaN"
    assert b"radius 1 m" in schema.field("echo_ratio_r100").metadata[b"meaning"]


def test_row_groups_keep_the_order(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    table = echoes(500)
    small = params.model_copy(update={"row_group": 128})
    made = write_geoparquet(table, tmp_path / "t.parquet", CRS, small)
    file = pq.ParquetFile(tmp_path / "t.parquet")
    assert made["row_groups"] == file.num_row_groups == 4
    assert [file.metadata.row_group(i).num_rows for i in range(4)] == [128, 128, 128, 116]
    assert file.metadata.row_group(0).column(0).compression == "ZSTD"
    assert np.array_equal(file.read(["pulse"])["pulse"], table["pulse"])
    paths = [file.metadata.row_group(0).column(i).path_in_schema for i in range(file.metadata.num_columns)]
    stats = file.metadata.row_group(0).column(paths.index("bbox.xmin")).statistics
    assert 0 <= table["x"][:128].min() - stats.min <= 0.0625, "readers skip row groups by the box's statistics"


def test_same_rows_give_same_bytes(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    for name in "ab":
        write_geoparquet(echoes(), tmp_path / f"{name}.parquet", CRS, params)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


@pytest.mark.parametrize("rows", [0, 1])
def test_tiny_tables(rows: int, echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    table = echoes(1).take(np.arange(rows))
    write_geoparquet(table, tmp_path / "t.parquet", CRS, params)
    assert len(geopandas.read_parquet(tmp_path / "t.parquet")) == rows
    assert ("bbox" in geo(tmp_path / "t.parquet")["columns"]["geometry"]) == bool(rows)


def test_a_missing_coordinate_is_said(echoes: Callable[..., Table], params: PublishParams, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'z' is missing"):
        write_geoparquet(echoes().select(["x", "y"]), tmp_path / "t.parquet", CRS, params)


def test_metadata_tell_classes_with_colours(
    echoes: Callable[..., Table], params: PublishParams, tmp_path: Path
) -> None:
    names = {2: 'a"<b>', 64: "car"}
    write_geoparquet(echoes(), tmp_path / "t.parquet", CRS, params, about_delivery(names, 10))
    told = json.loads(pq.read_schema(tmp_path / "t.parquet").metadata[b"fwclass"])
    assert [(c["code"], c["name"]) for c in told["classes"]] == list(names.items())
    assert all(c["color"].startswith("#") for c in told["classes"]) and told["relative_step"] == 2**-10


@pytest.mark.statistics
@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(width=32), min_size=1, max_size=20), st.integers(4, 23))
def test_rounding_stays_within_half_a_step(values: list[float], bits: int) -> None:
    table = Table({"width": np.array(values, np.float32)})
    got, want = round_floats(table, bits)["width"].astype(float), table["width"].astype(float)
    known = np.isfinite(want)
    assert np.array_equal(got[~known], want[~known], equal_nan=True)
    normal = known & (np.abs(want) >= np.finfo(np.float32).tiny)
    assert (np.abs(got - want)[normal] <= np.abs(want[normal]) * 2.0 ** -(bits + 1) * 1.0000001).all()
    assert round_floats(table, bits, ["width"])["width"] is table["width"]
