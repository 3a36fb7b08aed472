"""Training and test areas by files and by polygons: what boxes would do, from shapes drawn in a GIS."""

from __future__ import annotations

import json
import time
from pathlib import Path

import laspy
import numpy as np
import pyogrio.raw
import pytest
import shapely
from commandline import fwclass
from smallsurvey import small_survey

from fwclass.survey import area_files
from fwclass.survey.area_files import boxes_of
from fwclass.survey.area_of_interest import edges

WEST = shapely.box(500_000, 5_400_000, 500_030, 5_400_040)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small survey as two files, cut at x = 500 030, and polygons."""
    place = tmp_path_factory.mktemp("areas")
    small_survey(place)
    whole = laspy.read(place / "a.las")
    for name, rows in (("west", whole.x < 500_030), ("east", whole.x >= 500_030)):
        part = laspy.LasData(whole.header)
        part.points = whole.points[rows]
        part.write(place / f"{name}.las")
    (place / "a.las").unlink()
    text = (place / "s.yaml").read_text().replace("[a.las]", '["*.las"]')
    (place / "s.yaml").write_text(text)
    for name, shape in (
        ("west", WEST),
        ("far", shapely.box(0, 0, 10, 10)),
        ("dot", shapely.Point(500_000.2, 5_400_000.2).buffer(0.1)),
    ):
        data = np.array([shape.wkb], object)
        fields = {"geometry_type": "Polygon", "crs": "EPSG:32633"}
        pyogrio.raw.write(place / f"{name}.gpkg", data, [], [], layer="areas", driver="GPKG", **fields)
    return place


def report(place: Path, out: str, train: str) -> dict:
    words = ("--out", place / out, "--workers", "0", "--set", f"areas.train={train}")
    told = fwclass("run", place / "s.yaml", *words)
    assert told.returncode == 0, told.stderr
    return json.loads((place / out / "report.json").read_text())


def test_files_and_polygons_train_where_boxes_would(place: Path) -> None:
    by_box = report(place, "box", "[[500000, 5400000, 500030, 5400040]]")
    by_polygon = report(place, "polygon", "{polygons: west.gpkg}")
    by_file = report(place, "file", "{files: [w*.las]}")
    assert by_polygon["accuracy"] == by_box["accuracy"] and by_polygon["areas"] == by_box["areas"]
    assert by_polygon["training"]["samples"] == by_box["training"]["samples"] == by_file["training"]["samples"]
    ((xmin, _, xmax, _),) = by_file["areas"]["train"]
    assert 500_000 <= xmin < 500_000.5 and 500_029.5 < xmax <= 500_030.01
    for words in (("status", place / "polygon"), ("status", place / "file")):
        assert "parts are done" in fwclass(*words).stdout
    # what reads a delivery takes areas of every kind
    for out in ("polygon", "file"):
        run = place / out
        for words in (
            ("diff", run, place / "box"),
            ("suggest", run, place / f"{out}-places.gpkg"),
            ("label", "checkout", run, place / f"{out}-mend", "--least-sure", "1"),
        ):
            ended = fwclass(*words)
            assert ended.returncode == 0, ended.stderr
    again = fwclass(
        "run", place / "s.yaml", "--out", place / "file", "--workers", "0", "--set", "areas.train={files: [w*.las]}"
    )
    assert again.returncode == 0 and " computed" not in again.stderr
    assert (
        fwclass("plan", place / "s.yaml", "--out", place / "plan", "--set", "areas.train={files: [w*.las]}").returncode
        == 0
    )


@pytest.mark.parametrize(
    ("train", "words"),
    [
        ("{files: [nothing*.las]}", "areas.train.files"),
        ("{polygons: nothing.gpkg}", "nothing.gpkg"),
        ("{polygons: far.gpkg}", "no training area lies on the survey"),
        ("{polygons: dot.gpkg}", "too small"),
        ("{files: [w*.las], polygons: west.gpkg}", "either `files` or `polygons`"),
        ("{file: w.las}", "areas.train.file"),
        ("{files: [w*.las], crs: EPSG:32633}", "belong to `polygons`"),
        ("[[1, 2, 3]]", "areas.train"),
    ],
)
def test_what_names_no_area_is_refused_before_anything_runs(place: Path, train: str, words: str) -> None:
    out = place / "refused"
    told = fwclass("run", place / "s.yaml", "--out", out, "--workers", "0", "--set", f"areas.train={train}")
    assert told.returncode in (1, 2) and words in told.stderr and "Traceback" not in told.stderr, told.stderr
    assert not out.exists()


def test_boxes_are_the_squares_whose_middles_lie_inside() -> None:
    rng = np.random.default_rng(4)
    turned = np.sort(rng.uniform(0, 2 * np.pi, 9))
    outline = np.c_[np.cos(turned), np.sin(turned)] * rng.uniform(15, 40, (9, 1)) + 3.3
    shape = shapely.Polygon(outline).difference(shapely.Point(4, 4).buffer(6.1))
    rings = [np.array(r.coords) for r in (shape.exterior, *shape.interiors)]
    points, start = np.concatenate(rings), np.cumsum([0, *map(len, rings)])
    boxes = list(boxes_of(*edges(points[:, 0], points[:, 1], start), 1.0))
    column, row = np.meshgrid(np.arange(-50, 60), np.arange(-50, 60))
    middle_x, middle_y = column.ravel() + 0.5, row.ravel() + 0.5
    inside = shapely.contains_xy(shape, middle_x, middle_y)
    times = sum(b.contains(middle_x, middle_y).astype(int) for b in boxes)
    assert (times == inside).all() and inside.sum() > 500
    assert sum(b.area for b in boxes) == inside.sum()


def test_polygons_of_many_corners_take_no_time_for_every_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of 98,000 rows looked at all of 200,000 edges; a comb is taken by larger squares at once."""
    way = np.linspace(0, 2 * np.pi, 20_001)
    tall = np.c_[500_020 + 15 * np.cos(way), 5_400_000 + 49_000 * np.sin(way)]
    tall[-1] = tall[0]
    began = time.process_time()
    boxes = area_files._few_boxes(tall[:-1], tall[1:], 1.0)
    assert boxes is not None and sum((b.xmax - b.xmin) * (b.ymax - b.ymin) for b in boxes) == pytest.approx(
        np.pi * 15 * 49_000, rel=1e-2
    )
    comb = np.array([[500_000 + k / 2000, 5_400_000 + (k % 2) * 90_000] for k in range(100_001)])
    assert area_files._few_boxes(comb[:-1], comb[1:], 1.0) is None
    assert time.process_time() - began < 5  # s; two minutes were not enough


def test_a_corner_that_is_nowhere_is_told(place: Path) -> None:
    data = np.array([shapely.box(-1e300, -1e300, 1e300, 1e300).wkb], object)
    pyogrio.raw.write(
        place / "huge.gpkg", data, [], [], layer="a", driver="GPKG", geometry_type="Polygon", crs="EPSG:32633"
    )
    told = fwclass("plan", place / "s.yaml", "--set", "areas.train={polygons: huge.gpkg}")
    assert told.returncode == 1 and "nowhere on Earth" in told.stderr, told.stderr
