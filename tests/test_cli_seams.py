"""`fwclass seams` as a user meets it: exit codes, JSON, polygons."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import laspy
import numpy as np
import pyogrio
import pytest
from commandline import fwclass
from runmaker import rewrite_table

CONFIG = """
survey:
  name: small
  directory: .
  sources: [a.las]
  reference: {kind: source}
  crs: EPSG:25832
  features: [zc, height_range_c100]
  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]
areas: {train: [[0, 0, 5, 10]], gap: 0.5}
tile: {size: 5.0}
train: {trees: 5}
seams: {width: 0.75, share: 1.0}
plausibility: {accept: true}  # made-up places lie nowhere in a UTM zone
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A survey of four tiles, run into `r`."""
    root = tmp_path_factory.mktemp("seams")
    r = np.random.default_rng(0)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = [0.001] * 3
    las.x, las.y, las.z = r.uniform(0, 9.99, (3, 4000))
    las.classification = r.choice([2, 6], 4000)
    las.write(root / "a.las")
    (root / "c.yaml").write_text(CONFIG)
    ended = fwclass("run", root / "c.yaml", "--out", root / "r", "--workers", 0)
    assert ended.returncode == 0, ended.stderr
    return root


def test_a_run_without_seams_is_told_so(whole, tmp_path):
    ended = fwclass("seams", whole / "r", "--json", "--gpkg", tmp_path / "s.gpkg")
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["equal"] and found["shift"] == [2.5, 2.5] and found["borders"]["all"] == pytest.approx(20.0)
    assert found["borders"]["share"] == 1.0
    rows = {s["stage"]: s["rows"] for s in found["bounded"]}
    assert set(rows) == {"features", "label", "classify", "ground", "height", "terrain"}
    assert rows["classify"] == rows["features"] == pytest.approx(4000 * (1 - 0.85**2), rel=0.1)
    assert rows["ground"] == 4000
    assert all(s["share"] == 0.0 for s in found["bounded"]) and "no value differs" in ended.stderr
    strips = pyogrio.read_dataframe(tmp_path / "s.gpkg", layer="strips")
    assert strips.crs.to_epsg() == 25832 and (strips["differ"] == 0).all()
    assert strips.union_all().area == pytest.approx(100 - 8.5**2)
    again = fwclass("seams", whole / "r", "--gpkg", tmp_path / "s.gpkg")
    assert again.returncode == 2 and "--overwrite" in again.stderr


def test_a_seam_is_exit_code_4_and_shown_on_the_map(whole, tmp_path):
    shutil.copytree(whole / "r", tmp_path / "r")
    rewrite_table(
        tmp_path / "r" / "store" / "classify" / "0_0",
        lambda columns: columns.with_columns({"confidence": np.nextafter(columns["confidence"], np.float32(2))}),
    )
    ended = fwclass("seams", tmp_path / "r", "--gpkg", tmp_path / "s.gpkg", "--length", 20)
    assert ended.returncode == 4
    assert "classify: " in ended.stderr and "values differ" in ended.stdout and "confidence" in ended.stdout
    points = pyogrio.read_dataframe(tmp_path / "s.gpkg", layer="echoes")
    assert len(points) == 20 and set(points["stage"]) == {"classify"} and set(points["column"]) == {"confidence"}
    assert (
        (points.geometry.x < 5).all() and (points.geometry.y < 5).all() and (points["run"] != points["shifted"]).all()
    )
    assert pyogrio.read_dataframe(tmp_path / "s.gpkg", layer="strips")["differ"].max() > 20


def test_what_cannot_be_is_refused(whole, tmp_path):
    for words, told in (
        (("--share", 0.1, "--length", 5), "give one of them"),
        (("--shift", "5,0"), "not a shift"),
        (("--set", "seams.width=-1"), "seams.width"),
    ):
        ended = fwclass("seams", whole / "r", *words)
        assert ended.returncode == 2 and told in ended.stderr, ended.stderr
    stale = fwclass("seams", whole / "r", "--set", "features.cell_x=3")
    assert stale.returncode == 1 and "not finished" in stale.stderr
    nothing = fwclass("seams", tmp_path)
    assert nothing.returncode == 2 and "no such run directory" in nothing.stderr
