"""Runs that deliver footprints: the same bytes whatever the tiles, none without buildings, few echoes."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import geopandas
import lasmaker
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from commandline import fwclass

CONFIG = """survey:
  name: houses
  directory: .
  crs: EPSG:25833
  sources: [a.las]
  reference: {kind: source}
  features: [zc, height_range_c100]
  classes: [{name: ground, code: 2}, {name: CLASS, code: CODE}]
areas: {train: [[500000, 5400000, 500060, 5400080]], gap: 1}
classify: {keep: [2, CODE]}
train: {trees: 5}
publish: {figure_pixels: 200}
assess: {block: 5}
ground: {block: 64}
terrain: {block: 64}
vectors: {write: true}
"""
HOUSES = [
    shapely.affinity.rotate(shapely.box(8, 8, 20, 18), 15),
    shapely.affinity.rotate(shapely.box(55, 20, 95, 32), 10),  # crosses a border of blocks and of tiles
    shapely.box(60, 55, 72, 70),
]


def survey(place: Path, density: float = 5.0, code: int = 6, name: str = "building", birds: bool = False) -> Path:
    """``a.las``, 120 m × 80 m of flat land with houses, and of the same class `birds`; and ``s.yaml``."""
    rng = np.random.default_rng(3)
    number = int(density * 120 * 80)
    x, y = rng.uniform(0, 1, (2, number)) * [[120], [80]]
    on = shapely.contains_xy(shapely.MultiPolygon(HOUSES), x, y)
    z = 200 + 0.02 * x + 7.0 * on
    xyz = np.c_[500_000 + x, 5_400_000 + y, z]
    if birds:
        xyz, on = np.r_[xyz, BIRDS + np.array([500_000, 5_400_000, 0])], np.append(on, np.ones(len(BIRDS), bool))
    place.mkdir(parents=True, exist_ok=True)
    lasmaker.write_las(place / "a.las", xyz, point_format=6, classification=np.where(on, code, 2))
    (place / "s.yaml").write_text(CONFIG.replace("CODE", str(code)).replace("CLASS", name))
    return place


BIRDS = np.array([[66.5, 62.5, 270.0], [30.5, 40.5, 270.0], [90.5, 70.5, 275.0], [10.5, 70.5, 280.0]])
"""The first over a house, the others over open land."""


def run(place: Path, out: str, *words: object):
    ended = fwclass("run", "s.yaml", "--out", out, "--workers", 0, *words, cwd=place)
    assert ended.returncode == 0, ended.stderr
    return ended


def digests(run: Path) -> list[str]:
    paths = [run / "vectors.gpkg", *sorted((run / "vectors").iterdir())]
    return [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = survey(tmp_path_factory.mktemp("vectors"))
    run(place, "r")
    return place


def test_each_house_is_one_polygon_with_its_height(place: Path):
    made = pyogrio.read_dataframe(place / "r/vectors.gpkg", layer="buildings")
    assert len(made) == 3 and made.crs.to_epsg() == 25833 and made.is_valid.all() and made.id.is_unique
    for house in HOUSES:
        true = shapely.affinity.translate(house, 500_000, 5_400_000)
        (best,) = [p for p in made.geometry if p.intersects(true)]
        assert best.intersection(true).area / best.union(true).area > 0.9
    assert made.height.between(6.5, 7.5).all() and made.confidence.isna().all() and (made.echoes > 300).all()
    same = geopandas.read_parquet(place / "r/vectors/buildings.parquet")
    assert same.drop(columns="bbox", errors="ignore").equals(made[same.columns.drop("bbox", errors="ignore")])


@pytest.mark.slow
@pytest.mark.parametrize("words", [("--set", "tile.size=30"), ("--set", "tile.size=200"), ("--workers", 2)])
def test_tiles_and_workers_change_no_byte(place: Path, words):
    name = "_".join(map(str, words))
    run(place, name, *words)
    assert digests(place / name) == digests(place / "r")


def test_the_delivery_knows_them(place: Path):
    report = json.loads((place / "r/report.json").read_text())
    names = ["buildings"]  # a survey without vegetation
    assert report["vectors"] == {"buildings": 3}
    assert "vectors     3 buildings: r/vectors.gpkg, r/vectors" in run(place, "r").stderr
    assert report["outputs"]["vectors"] == ["vectors.gpkg", *(f"vectors/{n}.parquet" for n in names)]
    status = fwclass("status", "r", cwd=place)
    assert status.returncode == 0 and "publish-vectors" in status.stdout + status.stderr
    plan = fwclass("plan", "s.yaml", "--json", cwd=place)
    assert {"buildings", "publish-vectors"} <= {s["name"] for s in json.loads(plan.stdout)["stages"]}
    ended = fwclass("status", "r", "--verify", cwd=place)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
def test_what_the_classes_do_not_give_is_told(tmp_path: Path):
    ended = run(survey(tmp_path / "bushes", code=5, name="bush"), "r")
    assert "vectors have no buildings: no class has code 6" in ended.stderr
    layers = pyogrio.list_layers(tmp_path / "bushes/r/vectors.gpkg")[:, 0]
    assert sorted(layers) == ["crowns", "trees"]
    ended = run(survey(tmp_path / "cars", code=64, name="car"), "r")
    assert "no buildings" in ended.stderr and "vectors have no trees: no class has code 3, 4, 5" in ended.stderr
    assert not (tmp_path / "cars/r/vectors.gpkg").exists()


def test_sparse_echoes_are_told(tmp_path: Path):
    ended = run(survey(tmp_path / "s", density=0.5), "r")
    assert "0.5 pulses per m²" in ended.stderr and "rough" in ended.stderr
    made = pyogrio.read_dataframe(tmp_path / "s/r/vectors.gpkg", layer="buildings")
    assert len(made) <= 4 and made.is_valid.all()


def test_a_survey_whose_buildings_are_none_has_an_empty_layer(place: Path, tmp_path: Path):
    shutil.copytree(place, tmp_path / "s", symlinks=True)
    run(tmp_path / "s", "r", "--set", "vectors.buildings.least_height=50")
    assert len(pyogrio.read_dataframe(tmp_path / "s/r/vectors.gpkg", layer="buildings")) == 0
    assert len(geopandas.read_parquet(tmp_path / "s/r/vectors/buildings.parquet")) == 0


def test_birds_are_no_trees_and_hide_no_class(tmp_path: Path):
    place = survey(tmp_path, 1.5, code=5, name="tree", birds=True)
    run(place, "r")
    crowns = pyogrio.read_dataframe(place / "r/vectors.gpkg", layer="crowns")
    assert len(crowns) and crowns.height.max() < 8
    with rasterio.open(place / "r/rasters/classes.tif") as classes, rasterio.open(place / "r/rasters/dsm.tif") as dsm:
        x, y = BIRDS[1:, :2].T + np.array([[500_000], [5_400_000]])
        where = rasterio.transform.rowcol(classes.transform, x, y)
        assert (classes.read(1)[where] == 2).all() and (dsm.read(1)[where] < 205).all()
