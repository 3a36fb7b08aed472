"""Well-known binary of polygons: what shapely writes is read back, and no bytes do harm."""

import struct

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.errors import InputError
from fwclass.formats.wkb import WkbError, parse, shapes

SQUARE = shapely.box(0, 0, 10, 10)
HOLED = shapely.Polygon([(20, 0), (30, 0), (30, 10), (20, 10)], [[(22, 2), (24, 2), (24, 4), (22, 4)]])
BOTH = shapely.MultiPolygon([SQUARE, HOLED])


def coordinates(polygons):
    return [[ring.tolist() for ring in rings] for rings in polygons]


def of_shapely(polygon):
    rings = [polygon.exterior, *polygon.interiors]
    return [[list(map(float, c[:2])) for c in ring.coords] for ring in rings]


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("flavor", ["iso", "extended"])
@pytest.mark.parametrize("z", [False, True])
@pytest.mark.parametrize("shape", [SQUARE, HOLED, BOTH])
def test_what_shapely_writes_is_read_back(shape, z, flavor, order):
    made = shapely.force_3d(shape, 7.0) if z else shape
    if flavor == "extended":
        made = shapely.set_srid(made, 25832)
    data = shapely.to_wkb(made, flavor=flavor, byte_order=order, include_srid=flavor == "extended", output_dimension=4)
    assert coordinates(parse(data)) == [of_shapely(p) for p in shapely.get_parts(shape)]


def test_measures_are_left_out():
    point = struct.pack("<4d", 1.0, 2.0, 3.0, 4.0)
    data = struct.pack("<BII", 1, 3003, 1) + struct.pack("<I", 4) + 4 * point
    assert coordinates(parse(data)) == [[[[1.0, 2.0]] * 4]]


@pytest.mark.parametrize("shape", ["POINT (1 2)", "LINESTRING (0 0, 1 1)", "GEOMETRYCOLLECTION (POINT (1 2))"])
def test_other_geometries_are_refused_by_the_number_of_their_feature(shape):
    data = [shapely.to_wkb(SQUARE), shapely.to_wkb(shapely.from_wkt(shape))]
    with pytest.raises(InputError, match="feature 2") as fault:
        shapes(data, "file.gpkg")
    assert shape.split()[0].lower() in str(fault.value).lower()
    assert "Convert geometry type" in str(fault.value)


@pytest.mark.parametrize("kind", [10, 12, 15, 16, 1010, 3015])
def test_curves_and_surfaces_are_named(kind):
    data = struct.pack("<BII", 1, kind, 0)
    with pytest.raises(WkbError, match=r"CurvePolygon|MultiSurface|PolyhedralSurface|TIN"):
        parse(data)


def test_promises_beyond_the_bytes_are_refused_before_anything_is_made():
    for data in (
        struct.pack("<BII", 1, 3, 2**32 - 1),
        struct.pack("<BIII", 1, 3, 1, 2**32 - 1) + bytes(64),
        struct.pack("<BII", 1, 6, 2**31),
    ):
        with pytest.raises(WkbError, match="promised"):
            parse(data)


def test_bytes_too_many_are_refused():
    with pytest.raises(WkbError, match="too many"):
        parse(shapely.to_wkb(SQUARE) + b"\0")


def ring(points):
    data = struct.pack("<BIII", 1, 3, 1, len(points))
    return data + np.array(points, "<f8").tobytes()


def test_unsound_rings_are_left_out_and_counted():
    bad = [
        [(0, 0), (1, 0), (1, 1), (0, 1)],
        [(0, 0), (1, 0), (0, 0)],
        [(0, 0), (1, 0), (1, np.nan), (0, 0)],
        [(0, 0), (np.inf, 0), (1, 1), (0, 0)],
        [],
    ]
    made = shapes([*(ring(b) for b in bad), None, shapely.to_wkb(SQUARE), shapely.to_wkb(shapely.Polygon())], "f")
    assert (made.parts, made.invalid, made.empty) == (1, 5, 2)
    assert made.feature.tolist() == [6]


def test_a_polygon_with_one_unsound_hole_is_left_out_whole():
    outline = np.array([(0, 0), (9, 0), (9, 9), (0, 0)], "<f8").tobytes()
    hole = np.array([(2, 2), (3, 3)], "<f8").tobytes()
    data = struct.pack("<BII", 1, 3, 2) + struct.pack("<I", 4) + outline + struct.pack("<I", 2) + hole
    made = shapes([data], "f")
    assert (made.parts, made.invalid) == (0, 1)


VALID = [shapely.to_wkb(g) for g in (SQUARE, HOLED, BOTH, shapely.force_3d(BOTH))]


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_polygons_or_an_error(data):
    _only_polygons_or_an_error(data)


@pytest.mark.statistics
@settings(max_examples=300, deadline=None)
@given(st.sampled_from(VALID), st.data())
def test_damaged_polygons_are_polygons_or_an_error(data, draw):
    changed = bytearray(data[: draw.draw(st.integers(0, len(data)))])
    for _ in range(draw.draw(st.integers(0, 4))):
        if changed:
            changed[draw.draw(st.integers(0, len(changed) - 1))] = draw.draw(st.integers(0, 255))
    _only_polygons_or_an_error(bytes(changed))


def _only_polygons_or_an_error(data):
    try:
        polygons = parse(data)
    except WkbError:
        return
    assert sum(r.size for rings in polygons for r in rings) * 8 <= len(data)
