"""`run --workflow ground`: ground, terrain and heights of a survey, without labels, classes or a model."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from smallsurvey import small_survey

LEAST = "survey: {name: bare, sources: [a.las]}\n"
"""All that a survey's file must say."""
WORDS = ("--workflow", "ground", "--workers", "0")


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("bare")
    small_survey(place)
    points = laspy.read(place / "a.las")
    points.z[-40:] -= 30.0  # echoes of a beam that went astray
    points.z[-60:-50] += 200.0  # birds
    points.write(place / "a.las")
    path = place / "bare.yaml"
    path.write_text(LEAST)
    return path


@pytest.fixture(scope="module")
def run(bare: Path) -> Path:
    out = bare.parent / "run"
    told = fwclass("run", bare, "--out", out, *WORDS, "--set", "tile.size=25")
    assert told.returncode == 0, told.stderr
    return out


def digests(run: Path, kind: str) -> dict[str, str]:
    files = sorted((run / kind).resolve().rglob("*.laz"), key=lambda p: p.name)
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_every_point_has_the_class_that_the_filter_gives_it(run: Path) -> None:
    tables = [pq.read_table(p).to_pydict() for p in (run / "parquet").glob("*.parquet")]
    ground, noise, height, codes = (
        np.concatenate([np.array(t[n], float) for t in tables])
        for n in ("ground", "noise", "height_above_ground", "classification")
    )
    expected = np.where(noise > 0, np.where(height > 0, 18, 7), np.where(ground > 0, 2, 1))
    assert len(codes) == 6000 and (codes == expected).all()
    assert (codes == 7).sum() >= 35 and (codes == 18).sum() >= 8
    assert all(np.isnan(np.array(t["confidence"], float)).all() for t in tables)  # nobody was asked how sure it is
    strip = laspy.read(run / "laz" / "strips" / "a.laz")
    assert np.unique(strip.classification, return_counts=True)[1].tolist() == [
        int((codes == c).sum()) for c in (1, 2, 7, 18)
    ]


def test_what_is_delivered_has_no_classifier_in_it(run: Path) -> None:
    report = json.loads((run / "report.json").read_text())
    assert report["accuracy"] is None and report["training"] is None and not report["outputs"]["model"]
    assert [c["code"] for c in report["classes"]] == [1, 2, 7, 18]
    names = {Path(n).name for n in report["outputs"]["rasters"]}
    assert {"dtm.tif", "dsm.tif", "ndsm.tif", "hillshade.tif", "slope.tif", "roughness.tif", "classes.tif"} <= names
    page = (run / "report.html").read_text()
    assert "least sure" not in page and "training areas" not in page and 'id="layer-confidence"' not in page


@pytest.mark.parametrize("setting", ["tile.size=40", "tile.size=200"])
def test_tiles_change_no_byte_of_a_strip(bare: Path, run: Path, setting: str, tmp_path: Path) -> None:
    told = fwclass("run", bare, "--out", tmp_path / "run", *WORDS, "--set", setting)
    assert told.returncode == 0, told.stderr
    assert digests(tmp_path / "run", "laz/strips") == digests(run, "laz/strips")
    for name in ("dtm", "slope", "roughness"):
        made = (tmp_path / f"run/rasters/{name}.tif").read_bytes()
        assert made == (run / f"rasters/{name}.tif").read_bytes(), name


def test_commands_know_the_run(bare: Path, run: Path) -> None:
    assert "parts are done" in fwclass("status", run).stdout
    again = fwclass("run", bare, "--out", run, *WORDS, "--set", "tile.size=25")
    assert again.returncode == 0 and "computed" not in again.stdout + again.stderr
    assert fwclass("seams", run, "--share", "1").returncode == 0
    graph = fwclass("plan", bare, "--workflow", "ground", "--graph").stdout
    assert "terrain" in graph and "train" not in graph
    assert "ground, --set tile.size=25" in fwclass("history", run).stdout


def test_a_plan_reckons_with_its_stages_alone(bare: Path, tmp_path: Path) -> None:
    told = fwclass("plan", bare, "--workflow", "ground", "--out", tmp_path, "--json")
    assert told.returncode == 0, told.stderr
    stages = {s["name"] for s in json.loads(told.stdout)["stages"]}
    assert {"terrain", "publish-rasters"} <= stages and not stages & {"features", "trees", "confusion"}
    assert fwclass("plan", bare, "--workflow", "ground", "--dry-run", "1", "--out", tmp_path / "b").returncode == 2


def test_the_classification_says_all_that_the_file_lacks(bare: Path) -> None:
    told = fwclass("run", bare, "--out", bare.parent / "other")
    assert told.returncode == 2 and not (bare.parent / "other").exists()
    for words in ("two classes", "nothing to train on", "no training area", "fwclass init", "--workflow ground"):
        assert words in told.stderr
