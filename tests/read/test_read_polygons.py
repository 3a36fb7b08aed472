"""Files of polygons: four formats give the same, coordinate systems are brought together, faults are told."""

import json

import geopandas
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import shapely
from pyproj import CRS
from tolerances import COORDINATE

from fwclass.errors import ConfigError, InputError
from fwclass.read import polygons_info
from fwclass.read.info import describe, info
from fwclass.read.polygons import check_field, open_polygons, read_polygons, reproject, source_crs, values_of

FORMATS = ["gpkg", "geojson", "shp", "parquet"]
HOLED = shapely.Polygon(
    [(500020, 5400000), (500030, 5400000), (500030, 5400010), (500020, 5400010)],
    [[(500022, 5400002), (500022, 5400004), (500024, 5400004), (500024, 5400002)]],
)
TWO = shapely.MultiPolygon(
    [shapely.box(500040, 5400000, 500050, 5400010), shapely.box(500060, 5400000, 500070, 5400010)]
)


def frame(crs=25832, **columns):
    square = shapely.box(500000, 5400000, 500010, 5400010)
    columns = columns or {"klass": ["roof", "tree", None], "code": [6, 5, 2], "share": [0.5, 1.0, 2.0]}
    return geopandas.GeoDataFrame(columns, geometry=[square, HOLED, TWO], crs=crs)


def written(made, path):
    if path.suffix == ".parquet":
        made.to_parquet(path, write_covering_bbox=True)
    else:
        made.to_file(path)
    return path


def area(shapes, part):
    """Even-odd area by the shoelace formula: outline less holes."""
    total = 0.0
    for k, r in enumerate(range(shapes.part_start[part], shapes.part_start[part + 1])):
        at = slice(shapes.ring_start[r], shapes.ring_start[r + 1])
        x, y = shapes.x[at], shapes.y[at]
        own = abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
        total += own if k == 0 else -own
    return total


@pytest.mark.parametrize("ending", FORMATS)
def test_all_formats_give_the_same_polygons(ending, tmp_path):
    opened = open_polygons(written(frame(), tmp_path / f"labels.{ending}"))
    assert list(opened.fields) == ["klass", "code", "share"]
    assert opened.features == 3 and opened.crs.to_epsg() == 25832
    values, shapes = read_polygons(opened, "klass")
    assert values == values_of(opened, ["klass"])["klass"] == ["roof", "tree", None]
    assert read_polygons(opened, "code")[0] == [6, 5, 2]
    assert shapes.feature.tolist() == [0, 1, 2, 2]
    np.testing.assert_allclose([area(shapes, k) for k in range(4)], [100, 96, 100, 100], rtol=1e-5)


def test_several_layers_ask_for_one(tmp_path):
    path = tmp_path / "labels.gpkg"
    for layer in ("roofs", "trees"):
        frame().to_file(path, layer=layer)
    with pytest.raises(ConfigError, match="several layers") as fault:
        open_polygons(path)
    assert "roofs, trees" in str(fault.value) and "survey.reference.layer=roofs" in str(fault.value)
    with pytest.raises(ConfigError, match="did you mean 'trees'"):
        open_polygons(path, "tree")
    assert open_polygons(path, "trees").features == 3


def test_a_field_that_is_not_there(tmp_path):
    opened = open_polygons(written(frame(), tmp_path / "a.gpkg"))
    with pytest.raises(ConfigError, match="no such field") as fault:
        check_field(opened, "klas")
    assert "klass, code, share" in str(fault.value) and "did you mean 'klass'" in str(fault.value)


@pytest.mark.parametrize("ending", FORMATS)
def test_an_empty_file(ending, tmp_path):
    opened = open_polygons(written(frame().iloc[:0], tmp_path / f"a.{ending}"))
    with pytest.raises(InputError, match="empty") as fault:
        check_field(opened, "klass")
    assert f"a.{ending}" in str(fault.value)


@pytest.mark.parametrize("ending", ["gpkg", "geojson", "shp", "parquet"])
def test_bytes_that_are_no_polygons(ending, tmp_path):
    path = tmp_path / f"a.{ending}"
    path.write_bytes(b"nothing of that kind" * 20)
    with pytest.raises(InputError) as fault:
        open_polygons(path)
    assert str(path) in str(fault.value)


@pytest.mark.parametrize("ending", FORMATS)
def test_a_file_cut_short(ending, tmp_path):
    path = written(frame(), tmp_path / f"a.{ending}")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError) as fault:
        open_polygons(path)
    assert str(path) in str(fault.value)


def test_a_shapefile_without_its_table(tmp_path):
    path = written(frame(), tmp_path / "a.shp")
    assert {p.suffix for p in open_polygons(path).files} == {".shp", ".shx", ".dbf", ".prj", ".cpg"}
    (tmp_path / "a.dbf").unlink()
    with pytest.raises(ConfigError, match="no such field"):
        check_field(open_polygons(path), "klass")


def test_another_ending_and_plain_parquet(tmp_path):
    with pytest.raises(InputError, match="no file of polygons or lines"):
        open_polygons(tmp_path / "a.kml")
    with pytest.raises(InputError, match=r"OGR_GEOMETRY='LINESTRING'.* a\.gpkg a\.dxf"):  # a drawing has texts beside
        open_polygons(tmp_path / "a.dxf")
    pq.write_table(pa.table({"klass": ["a"], "geometry": [b"x"]}), tmp_path / "a.parquet")
    with pytest.raises(InputError, match="without geographic metadata"):
        open_polygons(tmp_path / "a.parquet")


def test_native_encoding_is_told(tmp_path):
    frame().to_parquet(tmp_path / "a.parquet", geometry_encoding="geoarrow")
    with pytest.raises(InputError, match="encoding WKB"):
        open_polygons(tmp_path / "a.parquet")


def test_points_in_a_file_are_named_by_their_feature(tmp_path):
    made = frame()
    made.loc[1, "geometry"] = shapely.Point(500000, 5400000)
    for ending in ("geojson", "parquet"):
        with pytest.raises(InputError, match="feature 2") as fault:
            read_polygons(open_polygons(written(made, tmp_path / f"a.{ending}")), "klass")
        assert "Point" in str(fault.value)


@pytest.mark.parametrize("ending", ["gpkg", "parquet"])
def test_without_a_coordinate_system_one_is_asked_for(ending, tmp_path):
    opened = open_polygons(written(frame(crs=None), tmp_path / f"a.{ending}"))
    utm = CRS.from_epsg(25832)
    with pytest.raises(InputError, match=r"survey\.reference\.crs=EPSG"):
        source_crs(opened, None, utm)
    assert source_crs(opened, utm, utm) is utm
    assert source_crs(opened, None, None) is None


def test_geoparquet_that_does_not_speak_of_its_system_is_in_degrees(tmp_path):
    path = written(frame(), tmp_path / "a.parquet")
    table = pq.read_table(path)
    about = json.loads(table.schema.metadata[b"geo"])
    del about["columns"]["geometry"]["crs"]
    pq.write_table(table.replace_schema_metadata({b"geo": json.dumps(about).encode()}), path)
    opened = open_polygons(path)
    assert opened.crs.is_geographic
    _, shapes = read_polygons(opened, None)
    with pytest.raises(InputError, match="not the degrees") as fault:
        reproject(shapes, opened.crs, CRS.from_epsg(25832), path)
    assert "5400010" in str(fault.value)


@pytest.mark.parametrize("crs", [4326, 3857, 32632, 2056])
def test_corners_are_reprojected_as_geopandas_does(crs, tmp_path):
    made = frame().to_crs(crs)
    opened = open_polygons(written(made, tmp_path / "a.gpkg"))
    _, shapes = read_polygons(opened, None)
    target = CRS.from_user_input("EPSG:25832+5783")  # with heights, as surveys name it
    moved, told = reproject(shapes, source_crs(opened, None, target), target, opened.path)
    expected = made.to_crs(25832).get_coordinates().to_numpy()
    np.testing.assert_allclose(np.column_stack([moved.x, moved.y]), expected, atol=COORDINATE)
    assert "from" in told and "25832" not in told
    same, nothing = reproject(shapes, opened.crs, opened.crs, opened.path)
    assert same is shapes and nothing == ""


def test_corners_without_a_place_are_told(tmp_path):
    made = geopandas.GeoDataFrame(
        {"k": [1, 2]}, geometry=[shapely.box(9, 48, 10, 49), shapely.box(9, 90, 10, 95)], crs=4326
    )
    opened = open_polygons(written(made, tmp_path / "a.gpkg"))
    _, shapes = read_polygons(opened, None)
    with pytest.raises(InputError, match="feature 2"):
        reproject(shapes, opened.crs, CRS.from_epsg(25832), opened.path)


@pytest.mark.parametrize("ending", FORMATS)
def test_info_lists_layers_fields_and_values(ending, tmp_path):
    path = written(frame(), tmp_path / f"a.{ending}")
    found = info(path)
    assert found["layers"][0]["values"]["klass"] == {"no value": 1, "roof": 1, "tree": 1}
    assert found["layers"][0]["crs"]["epsg"] == 25832
    json.dumps(found, allow_nan=False)
    told = describe(found)
    assert "klass" in told and "roof: 1" in told and "EPSG:25832" in told and "500000 to 500070" in told


@pytest.mark.parametrize("ending", ["geojson", "parquet"])
def test_many_fields_are_read_at_once_and_the_first_ones_counted(ending, tmp_path, monkeypatch):
    """Each field was another reading of the file, and a reading takes longer the more fields there are."""
    made = frame().assign(**{f"k{i}": i for i in range(200)})
    path, calls, of = written(made, tmp_path / f"a.{ending}"), [], polygons_info.values_of
    monkeypatch.setattr(polygons_info, "values_of", lambda opened, fields: calls.append(1) or of(opened, fields))
    found = info(path)
    told, layer = describe(found), found["layers"][0]
    assert layer["uncounted"] == list(layer["fields"])[100:] and not set(layer["uncounted"]) & set(layer["values"])
    monkeypatch.setattr(polygons_info, "MAX_TABLE", 2)
    many = info(path)
    assert many["layers"][0]["uncounted"] == list(layer["fields"]) and "values not counted" in describe(many)
    assert len(calls) == 1 and "k90 (int64)  90: 3" in told.replace("int32", "int64")
    assert "more, whose values are not counted" in told and "more than 40 values" not in told and "k150" not in told


def test_info_tells_what_is_wrong(tmp_path):
    made = frame(crs=None)
    made.loc[1, "geometry"] = None
    found = info(written(made, tmp_path / "a.gpkg"))
    assert any("survey.reference.crs" in f for f in found["faults"])
    assert any("1 features without a polygon" in f for f in found["faults"])


@pytest.mark.parametrize(
    ("crs", "by", "told"), [(4326, 1.0, "are not the degrees"), (25832, 1e-5, "look like degrees")]
)
def test_info_tells_corners_that_are_not_of_their_system(crs, by, told, tmp_path):
    made = frame(crs=crs)
    made["geometry"] = made.geometry.scale(by, by, origin=(0, 0))
    faults = info(written(made, tmp_path / "a.gpkg"))["faults"]
    assert len(faults) == 1 and told in faults[0]


@pytest.mark.statistics
@pytest.mark.parametrize("dictionary", [False, True])
def test_geoparquet_unpacks_to_no_more_than_its_bytes_allow(dictionary, tmp_path):
    """A page of 100 MB in some kilobytes, and one shape of 2 MB that a thousand features have."""
    shape = bytes(2 << 20 if dictionary else 100 << 20)
    about = {"version": "1.1.0", "primary_column": "g", "columns": {"g": {"encoding": "WKB", "crs": "EPSG:25832"}}}
    shapes = pa.DictionaryArray.from_arrays(np.zeros(1000 if dictionary else 1, np.int32), pa.array([shape]))
    table = pa.table({"g": shapes if dictionary else pa.array([shape])})
    words = {"compression": "zstd", "use_dictionary": dictionary, "store_schema": False, "write_statistics": False}
    with pq.ParquetWriter(tmp_path / "a.parquet", table.schema, **words) as file:
        file.write_table(table)
        file.add_key_value_metadata({"geo": json.dumps(about)})
    assert (tmp_path / "a.parquet").stat().st_size < 20_000
    with pytest.raises(InputError, match=r"unpack to more|take more than"):
        read_polygons(open_polygons(tmp_path / "a.parquet"), None)
