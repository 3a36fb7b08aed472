"""Vectors of the simulated city, on the true echoes and classes, against what was built."""

from __future__ import annotations

from pathlib import Path

import pyogrio
import pytest
import shapely
from commandline import fwclass
from vectorscore import scored_run, true_buildings

from fwclass import conf
from fwclass.simulate.city import build_scene
from fwclass.simulate.flight import plan_strips
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.stage import simulate_strip
from fwclass.simulate.truth import parts_of_buildings, trees_of, write_truth

CONFIG = """survey:
  name: truth
  directory: .
  sources: ["reference/*.las"]
  reference: {kind: source}
  features: [zc]
  classes:
    - {name: ground, code: 2}
    - {name: low vegetation, code: 3}
    - {name: medium vegetation, code: 4}
    - {name: high vegetation, code: 5}
    - {name: building, code: 6}
    - {name: artificial, code: 64}
areas: {train: [[512000.0, 5403000.0, 512080.0, 5403160.0]], gap: 1}
ground: {max_building_size: 50.0, block: 64}
terrain: {block: 64}
classify: {keep: [2, 3, 4, 5, 6, 64]}
train: {trees: 2}
publish: {figure_pixels: 200}
vectors: {write: true}
"""


def simulation(**changed) -> SimulateParams:
    return conf.load("demo", tuple(f"simulate.{k}={v}" for k, v in changed.items())).simulate


def test_the_truth_is_what_stands_in_the_scene(tmp_path: Path):
    params = simulation(size=120, seed=4)
    scene = build_scene(params)
    corners, building, top = parts_of_buildings(scene)
    plans = shapely.polygons(corners)
    assert plans.tolist() and all(p.is_valid and p.exterior.is_ccw for p in plans)
    assert len(top) == (scene.solid_class == 6).sum()
    outlines, whole = true_buildings(write_truth(params, tmp_path))
    pairs = shapely.STRtree(outlines).query(outlines, predicate="overlaps")
    assert not len(pairs[0]) and len(outlines) == len(set(building.tolist())) and whole.any()
    trees, overtopped = trees_of(scene)
    assert len(trees) == (scene.solid_class == 5).sum() and (trees[:, 3] > 2).all() and not overtopped.all()


def test_the_same_town_has_the_same_bytes(tmp_path: Path):
    params = simulation(size=60, seed=5)
    one, other = (write_truth(params, tmp_path / name).read_bytes() for name in ("a", "b"))
    assert one == other


@pytest.mark.slow
def test_footprints_and_trees_of_the_city(tmp_path: Path):
    params = simulation(size=160, strips=2, seed=4)
    for strip in plan_strips(params):
        simulate_strip(params, strip, tmp_path)
    truth = write_truth(params, tmp_path)
    (tmp_path / "s.yaml").write_text(CONFIG)
    ended = fwclass("run", "s.yaml", "--out", "r", "--workers", 0, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    buildings, trees = scored_run(tmp_path / "r", truth)
    assert buildings["found"] >= 0.95 and buildings["iou"] >= 0.82 and buildings["joint_iou"] >= 0.9
    assert buildings["doubled"] == buildings["invalid"] == buildings["false"] == 0
    assert trees["found_open"] >= 0.85 and trees["false"] <= 0.2
    crowns = pyogrio.read_dataframe(tmp_path / "r/vectors.gpkg", layer="crowns")
    assert crowns.is_valid.all()
