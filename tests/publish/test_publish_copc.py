"""COPC, read by four programs: each echo once, inside its node; the same bytes in any order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
from copcreader import nodes_of
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.formats.las_header import read_header
from fwclass.publish.copc import class_lookup, copc_columns, write_tile_copc
from fwclass.publish.octree import octree
from fwclass.publish.params import PublishParams
from fwclass.schema import Table, column

NAMES = {2: "ground", 5: "vegetation", 6: "building", 64: "car"}


@pytest.fixture
def town(echoes: Callable[..., Table]) -> Table:
    """Enough echoes for three levels of small nodes, some of them twice at one place."""
    table = echoes(6000, seed=3)
    x = table["x"].copy()
    x[:40], y = x[0], table["y"].copy()
    y[:40] = y[0]
    z = table["z"].copy()
    z[:40] = z[0]
    rng = np.random.default_rng(8)
    entropy = rng.random(6000).astype(np.float32)
    return table.with_columns({"x": x, "y": y, "z": z, "entropy": entropy, "width": rng.uniform(3, 9, 6000)})


@pytest.fixture
def small(params: PublishParams) -> PublishParams:
    return params.model_copy(update={"copc_leaf": 300})


def key_of(points: laspy.LasData | laspy.ScaleAwarePointRecord) -> np.ndarray:
    return np.asarray(points["pulse"]).astype(np.int64)


@pytest.mark.parametrize("backend", [laspy.LazBackend.Lazrs, laspy.LazBackend.Laszip])
def test_any_laz_reader_sees_every_echo_once(
    backend: laspy.LazBackend, town: Table, small: PublishParams, tmp_path: Path
) -> None:
    made = write_tile_copc(town, tmp_path / "t.copc.laz", pyproj.CRS(2154), small, NAMES)
    assert made["nodes"] > 4 and made["points"] == town.rows
    las = laspy.read(tmp_path / "t.copc.laz", laz_backend=backend)
    order = np.argsort(key_of(las))
    assert np.array_equal(key_of(las)[order], town["pulse"])
    assert np.array_equal(np.asarray(las.classification)[order], town["classification"])
    assert np.array_equal(np.asarray(las.point_source_id)[order], town["strip"])
    assert np.array_equal(np.asarray(las.gps_time)[order], np.nan_to_num(town["gps_time"]))
    for axis in "xyz":
        assert np.array_equal(np.rint(las[axis][order] * 1000), np.rint(town[axis] * 1000))
    for dim in las.point_format.extra_dimensions:
        name = next(n for n in copc_columns(town) if column(n).las == dim.name)
        assert dim.dtype is None or np.dtype(dim.dtype).kind in "iu", "whole numbers"
        known = np.isfinite(town[name])
        step = column(name).las_scale * (0.5001 if column(name).las_scale != 1 else 0)
        assert (np.abs(np.asarray(las[dim.name], float)[order][known] - town[name][known]) <= step).all(), name
    assert las.header.parse_crs().to_epsg() == 2154
    lookup = las.header.vlrs.get("ClassificationLookupVlr")[0]
    assert {k: lookup[k] for k in NAMES} == NAMES


def test_a_copc_reader_finds_each_echo_in_its_node(town: Table, small: PublishParams, tmp_path: Path) -> None:
    path = tmp_path / "t.copc.laz"
    write_tile_copc(town, path, None, small, NAMES)
    with laspy.CopcReader.open(path) as reader:
        everything = reader.query()
        assert sorted(key_of(everything)) == sorted(town["pulse"].astype(np.int64))
        few = reader.query(level=0)
        assert 0 < len(few) < town.rows
        box = laspy.copc.Bounds(np.array([770_020.0, 6_277_020.0]), np.array([770_050.0, 6_277_060.0]))
        inside = reader.query(bounds=box)
    x, y = town["x"], town["y"]
    wanted = town["pulse"][(x >= 770_020) & (x <= 770_050) & (y >= 6_277_020) & (y <= 6_277_060)]
    assert sorted(key_of(inside)) == sorted(wanted.astype(np.int64))


def test_copclib_agrees(town: Table, small: PublishParams, tmp_path: Path) -> None:
    """Every point lies inside its node of the cube that the info record tells. (What copclib itself reckons nodes from
    is the header's bounding box, which COPC does not say.)"""
    copclib = pytest.importorskip("copclib")
    path = tmp_path / "t.copc.laz"
    write_tile_copc(town, path, None, small, NAMES)
    reader = copclib.FileReader(str(path))
    info, seen = reader.copc_config.copc_info, []
    low = np.array([info.center_x, info.center_y, info.center_z]) - info.halfsize
    for node in reader.GetAllNodes():
        key, points = node.key, reader.GetPoints(node)
        edge = 2 * info.halfsize / 2**key.d
        corner = low + edge * np.array([key.x, key.y, key.z])
        xyz = np.array([[p.x, p.y, p.z] for p in points])
        assert ((xyz > corner) & (xyz < corner + edge)).all()
        seen += [tuple(row) for row in np.rint(xyz * 1000).astype(np.int64)]
    wanted = [tuple(row) for row in np.rint(np.stack([town[a] for a in "xyz"], axis=1) * 1000).astype(np.int64)]
    assert sorted(seen) == sorted(wanted)


def test_the_order_of_the_rows_does_not_count(town: Table, small: PublishParams, tmp_path: Path) -> None:
    shuffled = town.take(np.random.default_rng(1).permutation(town.rows))
    for name, table in (("a", town), ("b", shuffled)):
        write_tile_copc(table, tmp_path / f"{name}.copc.laz", None, small, NAMES)
    assert (tmp_path / "a.copc.laz").read_bytes() == (tmp_path / "b.copc.laz").read_bytes()


def test_our_own_reader_agrees_with_laspy(town: Table, small: PublishParams, tmp_path: Path) -> None:
    path = tmp_path / "t.copc.laz"
    made = write_tile_copc(town, path, None, small, NAMES)
    header = read_header(path)
    nodes = nodes_of(header)
    assert len(nodes) == made["nodes"]
    with laspy.CopcReader.open(path) as reader:
        page = reader.root_page.entries
    assert {(k.level, k.x, k.y, k.z): e.point_count for k, e in page.items()} == {n.key: n.points for n in nodes}


@pytest.mark.parametrize("rows", [0, 1])
def test_a_tile_of_one_echo_or_none_is_a_file(rows: int, town: Table, params: PublishParams, tmp_path: Path) -> None:
    path = tmp_path / "t.copc.laz"
    write_tile_copc(town.take(np.arange(rows)), path, None, params, {})
    for backend in (laspy.LazBackend.Lazrs, laspy.LazBackend.Laszip):
        assert len(laspy.read(path, laz_backend=backend).points) == rows
    assert sum(n.points for n in nodes_of(read_header(path))) == rows


def test_a_column_without_any_value_is_no_data_throughout(town: Table, params: PublishParams, tmp_path: Path) -> None:
    path = tmp_path / "t.copc.laz"
    table = town.with_columns({"width": np.full(town.rows, np.nan), "height_above_ground": np.full(town.rows, np.nan)})
    write_tile_copc(table, path, None, params, NAMES)
    raw = laspy.read(path).points.array
    assert (raw["echo width"] == 65535).all() and (raw["HeightAboveGround"] == -32768).all()


places = st.lists(st.tuples(*[st.integers(-(2**30), 2**30)] * 3), min_size=1, max_size=80)


@settings(max_examples=80, deadline=None)
@given(places=places, leaf=st.integers(1, 20), near=st.booleans())
def test_the_octree_holds_each_echo_once_inside_its_node(places: list, leaf: int, near: bool) -> None:
    units = np.array(places, np.int64) // (1 << 26 if near else 1)
    n = len(units)
    table = Table({"strip": np.ones(n), "pulse": np.arange(n), "echo_number": np.ones(n)})
    tree = octree(units, table, leaf)
    assert sorted(tree.order.tolist()) == list(range(n)) and tree.counts.sum() == n
    assert len({tuple(k) for k in tree.keys.tolist()}) == len(tree.keys)
    keys = {tuple(k) for k in tree.keys.tolist()}
    rows = np.split(tree.order, np.cumsum(tree.counts)[:-1])
    for key, inside in zip(tree.keys.tolist(), rows, strict=True):
        level, *place = key
        edge = 2.0**tree.bits / 2**level
        low = tree.low - 0.5 + np.array(place) * edge
        assert ((units[inside] > low) & (units[inside] < low + edge)).all()
        if level:
            assert (level - 1, *(p // 2 for p in place)) in keys, "a viewer comes by the parent"


def test_names_of_classes_are_cut_to_what_fits() -> None:
    names = {5: "ä" * 20, 6: "Gebäude", 7: "Straße", 8: "végétation", 9: "樹" * 20, 10: "", 255: 'a"<b>'}
    body = class_lookup(names)[54:]
    assert len(body) == 256 * 16
    written = {code: body[code * 16 + 1 : code * 16 + 16].rstrip(b"\0").decode() for code in names}
    wanted = {5: "a" * 15, 6: "Gebaude", 7: "Strasse", 8: "vegetation", 9: "樹" * 5, 10: "", 255: 'a"<b>'}
    assert written == wanted, "the record has ASCII, and what has none stays as it is"
