"""`fwclass assess` of several files, and `areas.train: all`."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import numpy as np
import pyogrio
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
    words = ("--model", tmp_path / "m", "--no-assess", "--out", tmp_path / "t", "--json", "--overwrite")
    blocks = ("--set", "select.block=5", "--set", "select.gap=1")
    ended = fwclass("train", path, *words, *blocks)
    result = json.loads(ended.stdout)
    figures = result["cross_validation"]
    assert 0.7 < figures["accuracy"] < 1.0 and figures["squares"] == 48 and figures["folds"] == 5, figures
    assert "in folds" in ended.stderr and f"{100 * figures['accuracy']:.2f}" in ended.stderr
    one = fwclass("train", path, *words, "--set", "select.block=500")
    assert one.returncode == 0 and "cannot be cross-validated" in one.stderr, one.stderr
    assert json.loads(one.stdout)["cross_validation"] is None
    tested = fwclass("train", path, "--model", tmp_path / "n", "--out", tmp_path / "t", "--json")
    assert json.loads(tested.stdout)["cross_validation"] is None and "in folds" not in tested.stderr


def test_a_figure_of_a_given_model_is_told_as_that(tmp_path: Path) -> None:
    """Where it learned is not known here: of its own training places it would be far too good."""
    path = small_survey(tmp_path)
    trained = fwclass("train", path, "--model", tmp_path / "new/place", "--no-assess", "--out", tmp_path / "t")
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
