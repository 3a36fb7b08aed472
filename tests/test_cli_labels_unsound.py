"""Labels whose polygons lie elsewhere, and plants and roofs that are exchanged: told, and exit code 4."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas
import laspy
import numpy as np
import pytest
import shapely
from commandline import fwclass

EDGE = 120.0
CONFIG = """
survey:
  name: town
  sources: [a.las]
  crs: EPSG:25832
  reference: {kind: REFERENCE}
  features: [height_above_ground]
  classes:
  - {name: ground, code: 2}
  - {name: vegetation, code: PLANTS, codes: [5]}
  - {name: building, code: ROOFS, codes: [6]}
areas: {train: [[500000, 5400000, 500070, 5400120]], gap: 5}
features: {also: []}
train: {trees: 3}
classify: {context: {cells: []}}
plausibility: {max_label_offset: 1.5}
"""
POLYGONS = "polygons, files: [labels.gpkg], field: code"


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[int, shapely.Polygon]]]:
    """Flat ground with roofs, which pulses do not pass through, and crowns, which they do; and what stands where."""
    place, r = tmp_path_factory.mktemp("town"), np.random.default_rng(7)
    x, y = r.uniform(0, EDGE, (2, 20_000))
    height, code = np.zeros(len(x)), np.full(len(x), 2)
    shapes = []
    for west in range(6, 120, 20):
        for south in range(6, 120, 20):
            kind = 6 if (west + south) % 40 == 12 else 5
            within = (x >= west) & (x < west + 9) & (y >= south) & (y < south + 9)
            height[within] = 6.0 if kind == 6 else r.uniform(3, 10, within.sum())
            code[within] = kind
            shapes.append((kind, shapely.box(west, south, west + 9, south + 9)))
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales, las.header.offsets = [0.001] * 3, [500_000, 5_400_000, 0]
    las.x, las.y, las.z = x + 500_000, y + 5_400_000, height + 100 + r.normal(0, 0.03, len(x))
    las.classification = code
    las.gps_time = np.arange(len(x), dtype=float)
    las.return_number = np.ones(len(x), int)
    las.number_of_returns = np.where((code == 5) & (r.random(len(x)) < 0.6), 2, 1)
    las.write(place / "a.las")
    everywhere = shapely.box(0, 0, EDGE, EDGE).difference(shapely.union_all([s for _, s in shapes]))
    return place, [(2, everywhere), *shapes]


def configured(place: Path, reference: str, plants: int = 5, roofs: int = 6) -> Path:
    path = place / f"{reference[:3]}-{plants}.yaml"
    path.write_text(
        CONFIG.replace("REFERENCE", reference).replace("PLANTS", str(plants)).replace("ROOFS", str(roofs)),
        encoding="utf-8",
    )
    return path


def draw(town: tuple[Path, list[tuple[int, shapely.Polygon]]], east: float) -> Path:
    place, shapes = town
    moved = [shapely.affinity.translate(s, 500_000 + east, 5_400_000) for _, s in shapes]
    geopandas.GeoDataFrame({"code": [c for c, _ in shapes]}, geometry=moved, crs=25832).to_file(place / "labels.gpkg")
    return configured(place, POLYGONS)


def run(config: Path, out: Path, *more: str):
    return fwclass("run", config, "--out", out, "--workers", "0", *more)


@pytest.mark.slow
def test_polygons_that_lie_elsewhere_end_with_4(town, tmp_path: Path) -> None:
    ended = run(draw(town, 4.0), tmp_path / "run")
    assert ended.returncode == 4, ended.stderr
    assert "fit the echoes best when they are moved by 4 m to the west" in ended.stderr
    assert "plausibility.max_label_offset" in ended.stderr and "survey.reference.crs" in ended.stderr
    told = json.loads((tmp_path / "run" / "report.json").read_text())
    assert told["labels"]["elsewhere"] in told["remarks"]
    assert "moved by 4 m" in (tmp_path / "run" / "report.html").read_text()
    trained = fwclass("train", draw(town, 4.0), "--out", tmp_path / "run", "--model", tmp_path / "model", "--no-assess")
    assert trained.returncode == 4 and "remark      the labels' polygons fit" in trained.stderr, trained.stderr
    assert run(draw(town, 4.0), tmp_path / "run", "--accept-implausible").returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("east", [0.0, 5.0])
def test_polygons_that_only_test_are_asked_too(town, tmp_path: Path, east: float) -> None:
    right = configured(town[0], "source")
    ended = fwclass("train", right, "--out", tmp_path / "right", "--model", tmp_path / "model", "--no-assess")
    assert ended.returncode == 0, ended.stderr
    given = ("--set", f"survey.model={tmp_path / 'model'}", "--set", "areas.train=[]")
    for size in ("50", "1000"):
        ended = run(draw(town, east), tmp_path / size, *given, "--set", f"tile.size={size}")
        assert ended.returncode == (4 if east else 0), ended.stderr
        assert ("moved by 5 m to the west" in ended.stderr) == bool(east)
    one, other = (json.loads((tmp_path / size / "report.json").read_text())["labels"] for size in ("50", "1000"))
    assert one == other


@pytest.mark.slow
@pytest.mark.parametrize("up", [0.0, 0.5])
def test_a_cloud_of_other_heights_is_told(town, tmp_path: Path, up: float) -> None:
    las = laspy.read(town[0] / "a.las")
    las.z, las.gps_time = np.asarray(las.z) + up, np.asarray(las.gps_time) + 1e6
    las.write(town[0] / "cloud.laz")
    ended = run(configured(town[0], "cloud, files: [cloud.laz]"), tmp_path / "run")
    assert ended.returncode == 0, ended.stderr
    assert ("points of the reference cloud lie 0.50 m above" in ended.stderr) == bool(up)


@pytest.mark.slow
def test_polygons_where_they_are_are_nothing_to_tell(town, tmp_path: Path) -> None:
    ended = run(draw(town, 0.0), tmp_path / "run")
    assert ended.returncode == 0 and "fit the echoes best" not in ended.stderr, ended.stderr


def test_plants_that_are_called_buildings_end_with_4(town, tmp_path: Path) -> None:
    ended = run(configured(town[0], "source", plants=6, roofs=5), tmp_path / "run")
    assert ended.returncode == 4 and "classes are exchanged" in ended.stderr, ended.stderr
    assert "pulses pass through plants, not through roofs" in ended.stderr
    assert run(configured(town[0], "source"), tmp_path / "right").returncode == 0
    for name, code in (("run", 4), ("right", 0)):
        model = ("--model", tmp_path / name / "model")
        ended = fwclass("classify", town[0] / "a.las", tmp_path / f"{name}.laz", *model)
        assert ended.returncode == code and ("classes are exchanged" in ended.stderr) == (code == 4), ended.stderr
