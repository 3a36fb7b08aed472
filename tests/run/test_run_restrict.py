"""Runs of an area of interest: which tiles lie in it, and what is delivered of them."""

from __future__ import annotations

import shutil
from types import SimpleNamespace

import geopandas
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from runmaker import delivered, walk

from fwclass.errors import InputError
from fwclass.grid import Box, TileGrid
from fwclass.survey.area_of_interest import Area, edges, shares_area

CRS = "EPSG:25832"


def all_edges(shape):
    """Edges of a polygon of shapely, holes included."""
    rings = [np.array(r.coords) for r in (shape.exterior, *shape.interiors)]
    points = np.concatenate(rings)
    return edges(points[:, 0], points[:, 1], np.cumsum([0, *map(len, rings)]))


def layout(size=10.0, columns=5):
    tiles = tuple(TileGrid(size).tile(f"{i}_{j}") for i in range(columns) for j in range(columns))
    return SimpleNamespace(tiles=tiles, box=Box(0, 0, size * columns, size * columns))


@given(st.lists(st.tuples(st.integers(-5, 25), st.integers(-5, 25)), min_size=3, max_size=7), st.booleans())
@settings(max_examples=300, deadline=None)
def test_sharing_area_is_what_shapely_says(corners, hole):
    shape = shapely.convex_hull(shapely.Polygon(corners))
    if hole and shape.geom_type == "Polygon":
        shape = shape.difference(shapely.box(4, 4, 12, 12))
    for part in getattr(shape, "geoms", [shape]):
        if part.geom_type != "Polygon" or part.area == 0:
            continue
        a, b = all_edges(part)
        for tile in TileGrid(5.0).touching(Box(-5, -5, 25, 25)):
            square = shapely.box(*tile.box.grown(1e-6).bounds)
            smaller = shapely.box(*tile.box.grown(-1e-6).bounds)
            if part.intersection(smaller).area > 0 or not part.intersects(square):  # else it is for rounding to say
                assert shares_area(tile.box, a, b) == part.intersects(smaller), tile


def write(path, *shapes, crs=CRS):
    geopandas.GeoDataFrame({"name": ["a"] * len(shapes)}, geometry=list(shapes), crs=crs).to_file(path)
    return path


def test_an_area_on_the_borders_takes_no_neighbour(tmp_path):
    path = write(tmp_path / "a.gpkg", shapely.box(10, 10, 30, 20))
    assert Area(path).tiles(layout(), None) == {"1_1", "2_1"}


def test_polygons_outside_of_the_survey_are_told(tmp_path):
    far = shapely.box(5_000_000, 10, 5_000_010, 20)
    path = write(tmp_path / "a.gpkg", shapely.box(12, 12, 18, 18), far, shapely.union(shapely.box(22, 2, 28, 8), far))
    lines = []
    assert Area(path).tiles(layout(), None, lines.append) == {"1_1", "2_0"}
    assert len(lines) == 1 and "2 of 4 polygons" in lines[0] and "outside of the survey" in lines[0]
    Area(write(tmp_path / "b.gpkg", shapely.box(12, 12, 18, 18))).tiles(layout(), None, lines.append)
    assert len(lines) == 1


def test_an_area_may_be_in_degrees(tmp_path):
    tile = TileGrid(100.0).tile("5120_54030")
    inner = shapely.box(*tile.box.grown(-5.0).bounds)
    there = geopandas.GeoSeries([inner], crs=CRS).to_crs("EPSG:4326")
    path = write(tmp_path / "a.geojson", there.iloc[0], crs="EPSG:4326")
    tiles = tuple(TileGrid(100.0).touching(tile.box.grown(150.0)))
    found = Area(path).tiles(SimpleNamespace(tiles=tiles, box=tile.box), geopandas.GeoSeries([], crs=CRS).crs.to_wkt())
    assert found == {tile.key}


def test_an_area_elsewhere_is_refused(tmp_path):
    path = write(tmp_path / "a.gpkg", shapely.box(1000, 1000, 1010, 1010))
    with pytest.raises(InputError, match="no tile of the survey lies in the area"):
        Area(path).tiles(layout(), None)


def test_a_run_of_an_area_delivers_its_tiles_aside(survey, finished, tmp_path):
    """The whole delivery stays what readers see; the tiles come out as in the whole run."""
    root = tmp_path / "copy"
    shutil.copytree(finished[0], root, symlinks=True)
    whole = delivered(root)
    key = sorted(p.name.removesuffix(".copc.laz") for p in (root / "laz" / "tiles").glob("*.laz"))[0]
    size = 100.0
    inner = TileGrid(size).tile(key).box.grown(-1.0)
    area = Area(write(tmp_path / "a.gpkg", shapely.box(*inner.bounds)))
    road, _ = walk(survey, root, "classify.probabilities=true", tiles=area)
    assert {part for stage, part in road.outcomes if stage == "publish-tile"} == {key}
    assert delivered(root) == whole
    aside = root / "generations" / "0002"
    assert [p.name for p in (aside / "laz" / "tiles").iterdir()] == [f"{key}.copc.laz"] and not (
        aside / "rasters"
    ).exists()
    assert (root / "current").resolve().name == "0001"
