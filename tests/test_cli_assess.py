"""`fwclass assess` of several files, and `areas.train: all`."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pyogrio
import pyproj
import pytest
from commandline import fwclass
from smallsurvey import CONFIG, small_survey


@pytest.fixture
def tiles(tmp_path: Path) -> Path:
    """``ref/a.las`` and ``ref/b.las`` with predictions that err on a tenth and a half of the points."""
    rng = np.random.default_rng(0)
    for name, wrong in (("a", 0.1), ("b", 0.5)):
        xyz = np.c_[500_000 + rng.uniform(0, 20, (1000, 2)) + 100 * (name == "b"), np.full(1000, 5.0)]
        truth = rng.choice([2, 5], 1000)
        answer = np.where(np.arange(1000) < 1000 * wrong, 7 - truth, truth)
        for place, classes in (("ref", truth), ("out", answer)):
            (tmp_path / place).mkdir(exist_ok=True)
            lasmaker.write_las(tmp_path / place / f"{name}.las", xyz, point_format=6, classification=classes)
    return tmp_path


def test_files_of_one_name_are_counted_together(tiles: Path) -> None:
    one = json.loads(fwclass("assess", tiles / "ref/a.las", tiles / "out/a.las", "--json").stdout)
    both = json.loads(fwclass("assess", tiles / "ref/*.las", tiles / "out/*.las", "--json").stdout)
    assert one["overall_accuracy"] == pytest.approx(0.9) and both["overall_accuracy"] == pytest.approx(0.7)
    assert both["matched"] == 2000 and both["unmatched"] == 0


@pytest.mark.parametrize(
    ("reference", "prediction", "words"),
    [("ref/*.las", "out/a.las", "no partner"), ("ref/*.laz", "out/*.las", "no file matches"), ("x.las", "y", "x.las")],
)
def test_what_does_not_fit_is_said(tiles: Path, reference: str, prediction: str, words: str) -> None:
    ended = fwclass("assess", tiles / reference, tiles / prediction)
    assert ended.returncode == 1 and words in ended.stderr and "Traceback" not in ended.stderr, ended.stderr


def test_all_may_train(tmp_path: Path) -> None:
    path = small_survey(tmp_path)
    path.write_text(CONFIG.replace("[[500000, 5400000, 500030, 5400040]]", "all"))
    ended = fwclass("run", path, "--out", tmp_path / "run", "--workers", "0")
    assert ended.returncode == 0 and "with areas.train: all none is left" in ended.stderr, ended.stdout + ended.stderr
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert sum(report["training"]["samples"].values()) == 6000 and not report["accuracy"]
    bounds = pyogrio.read_info(tmp_path / "run" / "tiles.gpkg", layer="areas")["total_bounds"]
    assert bounds[0] > 499_999 and bounds[2] < 500_081, "the survey, not the world"
    plan = fwclass("plan", path, "--out", tmp_path / "plan", "--json")
    assert plan.returncode == 0, plan.stderr
    path.write_text(path.read_text().replace("train: all", "train: all, test: [[500040, 5400000, 500060, 5400040]]"))
    ended = fwclass("run", path, "--out", tmp_path / "other", "--workers", "0")
    assert ended.returncode == 2 and "nothing is left to test on" in ended.stderr


def test_a_model_that_nobody_tests_is_cross_validated(tmp_path: Path) -> None:
    """Out of bag every row has neighbours that trained: never the only figure."""
    path = small_survey(tmp_path)
    loop = ("--out", tmp_path / "t", "--json", "--workers", "0")
    words = ("--model", tmp_path / "m", "--no-assess", "--overwrite", *loop)
    blocks = ("--set", "select.block=5", "--set", "select.gap=1")
    ended = fwclass("train", path, *words, *blocks)
    result = json.loads(ended.stdout)
    figures = result["cross_validation"]
    assert 0.7 < figures["accuracy"] < 1.0 and figures["squares"] == 48 and figures["folds"] == 5, figures
    assert "in folds" in ended.stderr and f"{100 * figures['accuracy']:.2f}" in ended.stderr
    assert ended.returncode == 0, ended.stderr
    blind = fwclass("train", path, *words, *blocks, "--set", "survey.features=[echo_number]")
    assert blind.returncode == 4 and "no better than chance" in blind.stderr, blind.stderr
    one = fwclass("train", path, *words, "--set", "select.block=500")
    assert one.returncode == 0 and "cannot be cross-validated: select-training of part all failed (" in one.stderr
    assert json.loads(one.stdout)["cross_validation"] is None
    tested = fwclass("train", path, "--model", tmp_path / "n", *loop)
    assert json.loads(tested.stdout)["cross_validation"] is None and "in folds" not in tested.stderr


def test_a_figure_of_a_given_model_is_told_as_that(tmp_path: Path) -> None:
    """Where it learned is not known here: of its own training places it would be far too good."""
    path = small_survey(tmp_path)
    words = ("--model", tmp_path / "new/place", "--no-assess", "--out", tmp_path / "t", "--workers", "0")
    trained = fwclass("train", path, *words)
    assert trained.returncode == 0, trained.stderr
    given = ("--set", f"survey.model={tmp_path / 'new/place'}", "--workers", "0")
    whole = fwclass("run", path, "--out", tmp_path / "a", *given, "--set", "areas.train=[]")
    assert "on all echoes, by a model that was given" in whole.stderr and "every training area" not in whole.stderr
    assert "The model, or its base, was given, and nothing here tells where it learned" in whole.stderr
    assert "test on 20 squares or more" not in whole.stderr, "there are 128"
    few = fwclass("run", path, "--out", tmp_path / "b", *given, "--set", "areas.train=[]", "--set", "assess.block=40")
    assert "test on 20 squares or more" in few.stderr, "as of a model that is trained here"
    known = fwclass("run", path, "--out", tmp_path / "c", *given)
    assert "further than 1 m from every training area" in known.stderr and "nothing here tells" not in known.stderr


def cloud(path, shift=(0.0, 0.0, 0.0), codes=None, rows=slice(None), epsg=None):
    rng = np.random.default_rng(5)
    xyz = np.c_[rng.uniform(0, 60, (4000, 2)), rng.uniform(200, 210, 4000)] + [500_000, 5_400_000, 0]
    classes = np.where(xyz[:, 2] < 204, 2, 6) if codes is None else codes
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales, las.header.offsets = [0.001] * 3, [500_000, 5_400_000, 0]
    if epsg:
        las.header.add_crs(pyproj.CRS.from_epsg(epsg))
    las.x, las.y, las.z = (xyz + shift)[rows].T
    las.classification = np.broadcast_to(classes, len(xyz))[rows]
    las.write(path)
    return path


def test_the_same_points_are_not_told(tmp_path):
    a, order = cloud(tmp_path / "a.las"), np.random.default_rng(1).permutation(4000)
    for b in (cloud(tmp_path / "b.las"), cloud(tmp_path / "c.las", rows=order, shift=(0.005, 0, 0))):
        ended = fwclass("assess", a, b)
        assert ended.returncode == 0 and "remark" not in ended.stderr, ended.stderr


def test_a_shift_is_told_and_ends_with_4(tmp_path):
    a, b = cloud(tmp_path / "a.las"), cloud(tmp_path / "b.las", shift=(0.0, 0.5, 0.0))
    ended = fwclass("assess", a, b)
    assert ended.returncode == 4 and "the prediction lies +0.00, +0.50, +0.00 m" in ended.stderr, ended.stderr
    assert "kappa" in ended.stdout and fwclass("assess", a, b, "--accept-implausible").returncode == 0


def test_other_systems_and_ambiguous_points(tmp_path):
    a, b = cloud(tmp_path / "a.las", epsg=25832), cloud(tmp_path / "b.las", epsg=2154)
    ended = fwclass("assess", a, b)
    assert ended.returncode == 4 and "are in different systems" in ended.stderr, ended.stderr
    both = np.r_[np.arange(4000), np.arange(400)]
    codes = laspy.read(a).classification
    las = laspy.read(cloud(tmp_path / "c.las", rows=both, epsg=25832))
    las.classification = np.r_[codes, np.where(codes[:400] == 2, 6, 2)]
    las.write(tmp_path / "c.las")
    ended = fwclass("assess", a, tmp_path / "c.las")
    assert ended.returncode == 4 and "400 predicted points lie at the place of another" in ended.stderr, ended.stderr


def test_neighbours_unknown_codes_and_files_of_another_place(tmp_path):
    a, half = cloud(tmp_path / "a.las"), cloud(tmp_path / "b.las", rows=slice(0, 2000))
    ended = fwclass("assess", a, half, "--json")
    said = json.loads(ended.stdout)["remarks"]
    assert ended.returncode == 0 and any("figures are those of neighbours" in text for text in said), said
    ended = fwclass("assess", a, cloud(tmp_path / "c.las", codes=26))
    assert "4,000 predicted points have codes that no class has (26: 4,000)" in ended.stderr, ended.stderr
    assert "compared with itself" in fwclass("assess", a, a).stderr
    for name, far in (("r", 0.0), ("p", 59.0)):
        (tmp_path / name).mkdir()
        cloud(tmp_path / name / "one.las")
        cloud(tmp_path / name / "two.las", shift=(far, 0, 0) if name == "p" else (0, 0, 0))
        cloud(tmp_path / name / "three.las")
    ended = fwclass("assess", tmp_path / "r" / "*.las", tmp_path / "p" / "*.las")
    assert "few points of some files have a predicted one (two.las:" in ended.stderr, ended.stderr
    assert "references are counted twice: one.las and three.las and two.las" in ended.stderr


def test_houses_are_counted_whole_whatever_the_files(tmp_path: Path) -> None:
    """Three houses, of which one is missing and one lies in two files."""
    x, y = (v.ravel() + 0.25 for v in np.meshgrid(np.arange(0, 80, 0.5), np.arange(0, 40, 0.5)))
    houses = [(5, 15), (35, 50), (60, 70)]
    truth, answer = (
        np.where((y > 5) & (y < 20) & np.any([(x > a) & (x < b) for a, b in some], axis=0), 6, 2)
        for some in (houses, houses[:2])
    )
    xyz = np.c_[500_000 + x, 5_400_000 + y, np.where(truth == 6, 8.0, 3.0)]
    for place, classes in (("ref", truth), ("out", answer)):
        (tmp_path / place).mkdir()
        for name, rows in (("all", x > -1), ("one", x < 40), ("two", x >= 40)):
            lasmaker.write_las(
                tmp_path / place / f"{name}.las", xyz[rows], point_format=6, classification=classes[rows]
            )
    words = ("assess", tmp_path / "ref/all.las", tmp_path / "out/all.las")
    whole = json.loads(fwclass(*words, "--json").stdout)["objects"]
    assert (
        whole
        == json.loads(fwclass("assess", *(tmp_path / f"{p}/[ot]*.las" for p in ("ref", "out")), "--json").stdout)[
            "objects"
        ]
    )
    (one,) = whole["classes"]
    assert (one["name"], one["reference"], one["found"], one["predicted"], one["correct"]) == ("6", 3, 2, 2, 2)
    assert one["completeness"] == pytest.approx(2 / 3) and one["correctness"] == 1.0 and one["split"] == 0
    assert "completeness %" in fwclass(*words).stdout
    assert "completeness" not in fwclass(*words, "--ground").stdout
    land = json.loads(fwclass(*words, "--map", "land=2;house=6", "--objects", "land, house", "--json").stdout)[
        "objects"
    ]
    assert [c["name"] for c in land["classes"]] == ["land", "house"]
    ended = fwclass(*words, "--map", "land=2;house=6", "--objects", "hose")
    assert ended.returncode == 2 and "'hose'" in ended.stderr and "house" in ended.stderr
