"""The work list: what a place is, whatever the tiles; and the file that GIS opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyogrio
import pytest
from commandline import fwclass
from scipy.ndimage import label

from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.errors import InputError
from fwclass.view.worklist import UnsureEchoes, WorkList


def listed(
    x: np.ndarray, y: np.ndarray, parts: np.ndarray, cell: float = 1.0, most: int = 10, place: float = 7e5
) -> WorkList:
    """Echoes added in so many parts; confidence and class follow from the place."""
    unsure = UnsureEchoes(cell, place)
    for part in np.unique(parts):
        rows = parts == part
        a, b = x[rows], y[rows]
        sure = (np.abs(np.sin(a)) / 2).astype(np.float32)
        unsure.add(a, b, a + b, sure, (np.floor(b) % 3).astype(np.uint8))
    return unsure.work_list(most)


def test_places_join_squares_that_touch() -> None:
    x = np.array([0.5, 1.5, 2.5, 9.5, 9.6, -7.0])
    y = np.array([0.5, 1.5, 0.5, 0.5, 0.5, 3.0])
    work = listed(x, y, np.zeros(6))
    assert [p.echoes for p in work.places] == [3, 2, 1]
    assert work.places[0].box == (0.0, 0.0, 3.0, 2.0) and work.places[0].classes == ((0, 2), (1, 1))
    assert work.places[1].x == pytest.approx(9.55) and work.places[1].z == pytest.approx(10.05)
    assert work.of(x, y).tolist() == [0, 0, 0, 1, 1, 2]
    assert work.of(np.array([0.5]), np.array([1.5])).tolist() == [-1]
    none = listed(x[:0], y[:0], np.zeros(0))
    assert none.places == () and none.of(x, y).tolist() == [-1] * 6


def test_no_place_is_wider_than_one_look_judges() -> None:
    """A plain of unsure echoes is cut by a global grid, in whatever parts it comes."""
    rng = np.random.default_rng(3)
    x, y = np.round(rng.uniform(-50, 50, (2, 40_000)), 3)
    work = listed(x, y, np.zeros(len(x)), 1.0, 1000, 20.0)
    assert len(work.places) == 36 and sum(p.echoes for p in work.places) == len(x)
    for place in work.places:
        x0, y0, x1, y1 = place.box
        assert x1 - x0 <= 20 and y1 - y0 <= 20 and x0 // 20 == (x1 - 0.5) // 20 and place.size < 29
    other = listed(x, y, rng.integers(0, 9, len(x)), 1.0, 1000, 20.0)
    assert other.places == work.places


def test_neither_tiles_nor_their_order_change_a_place() -> None:
    """Against another program's labelling of the squares; to the last bit in whatever parts echoes come."""
    rng = np.random.default_rng(5)
    centre = rng.integers(-30, 30, (40, 2)) + 0.0
    at = np.round(centre[rng.integers(0, 40, 4000)] + rng.normal(0, 1.5, (4000, 2)), 3)
    x, y = at[:, 0] + 500_000, at[:, 1] + 5_400_000
    work = listed(x, y, np.zeros(4000), 1.3, 7)
    for parts in (rng.integers(0, 9, 4000), np.floor(-x / 7)):
        other = listed(x, y, parts, 1.3, 7)
        assert other.places == work.places and (other.squares == work.squares).all()
    i, j = np.floor(x / 1.3).astype(int), np.floor(y / 1.3).astype(int)
    grid = np.zeros((np.ptp(i) + 1, np.ptp(j) + 1))
    grid[i - i.min(), j - j.min()] = 1
    own = label(grid, np.ones((3, 3)))[0][i - i.min(), j - j.min()]
    assert [p.echoes for p in work.places] == sorted(np.bincount(own)[1:].tolist(), reverse=True)[:7]
    mine = work.of(x, y)
    for k, place in enumerate(work.places):
        rows = mine == k
        assert rows.sum() == place.echoes and len(set(own[rows])) == 1
        assert place.confidence == pytest.approx(np.mean(np.abs(np.sin(x[rows])) / 2), abs=1e-6)
        box = np.array(place.box)
        assert ((x[rows] >= box[0]) & (y[rows] >= box[1]) & (x[rows] < box[2]) & (y[rows] < box[3])).all()
        assert abs(place.x - np.median(x[rows])) < 1.3 and abs(place.y - np.median(y[rows])) < 1.3


def test_the_file_has_the_places_of_the_page_in_their_order(scene: ViewedRun, run: Path, tmp_path: Path) -> None:
    path = tmp_path / "worklist.gpkg"
    ended = fwclass("view", run, "--worklist", path)
    assert ended.returncode == 0, ended.stderr
    assert scene.work()["total"] == len(scene.work()["places"]) and "largest" not in ended.stderr + ended.stdout
    layers = pyogrio.list_layers(path)
    assert layers.tolist() == [["places", "Polygon"]]
    table = pyogrio.read_dataframe(path)
    assert table.crs.to_epsg() == 25832
    places = scene.work()["places"]
    assert len(places) > 3 and table["rank"].tolist() == list(range(1, len(places) + 1))
    for name in ("echoes", "x", "y", "z", "size", "confidence"):
        assert table[name].tolist() == [p[name] for p in places]
    assert table.geometry.bounds.to_numpy().tolist() == [list(p["box"]) for p in places]
    few = fwclass("view", run, "--worklist", tmp_path / "few.gpkg", "--set", "view.places=2")
    assert f", the largest of {len(places)}" in few.stderr + few.stdout, few.stderr
    names = {c["code"]: c["name"] for c in scene.index()["classes"]}
    assert table["classes"][0] == ", ".join(f"{names[c]} {n}" for c, n in places[0]["classes"])
    first = path.read_bytes()
    refused = fwclass("view", run, "--worklist", path)
    assert refused.returncode == 2 and "--overwrite" in refused.stderr and path.read_bytes() == first
    assert fwclass("view", run, "--worklist", path, "--overwrite").returncode == 0 and path.read_bytes() == first


def test_a_work_list_may_be_empty_and_serves_nothing(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "none.gpkg"
    ended = fwclass("view", run, "--worklist", path, "--set", "view.unsure=0")
    assert ended.returncode == 0 and "empty" in ended.stderr
    assert pyogrio.read_info(path)["features"] == 0
    assert fwclass("view", run, "--worklist", tmp_path / "a.gpkg", "--port", 8080).returncode == 2
    assert fwclass("view", run, "--overwrite").returncode == 2
    nowhere = fwclass("view", tmp_path / "none", "--worklist", tmp_path / "a.gpkg")
    assert nowhere.returncode == 1 and "no such run" in nowhere.stderr
    for name in (".", "places.txt"):
        other = fwclass("view", run, "--worklist", tmp_path / name, "--overwrite")
        assert other.returncode == 2 and "GeoPackage" in other.stderr


def test_the_page_goes_through_the_places_of_a_file(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "places.gpkg"
    ended = fwclass("suggest", run, path, "--places", 7)
    assert ended.returncode == 0, ended.stderr
    scene = ViewedRun(open_run(run), conf.section("view"))
    scene.list_places(path)
    work, table = scene.work(), pyogrio.read_dataframe(path)
    assert scene.index()["goes_through"] == "places.gpkg" and len(work["places"]) == len(table) == 7
    for place, (_, row) in zip(work["places"], table.iterrows(), strict=True):
        assert place["echoes"] == row["echoes"] and tuple(place["box"]) == row.geometry.bounds
        assert place["x"] == pytest.approx((row.geometry.bounds[0] + row.geometry.bounds[2]) / 2)
    assert scene.reopened().work() == work
    far = table.set_geometry(table.geometry.translate(1e5, 0))
    far.to_file(tmp_path / "far.gpkg", layer="places")
    with pytest.raises(InputError, match="any of these places"):
        ViewedRun(open_run(run), conf.section("view")).list_places(tmp_path / "far.gpkg")
    both = fwclass("view", run, "--places", path, "--worklist", tmp_path / "w.gpkg")
    assert both.returncode == 2
