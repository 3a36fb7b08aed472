"""Figures that a reference, a correction or a missing value flatters say so."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
from commandline import fwclass
from smallsurvey import small_survey

WORDS = "The reference is what a run of fwclass delivered"


def test_a_runs_own_answers_are_no_reference(tmp_path: Path) -> None:
    path = small_survey(tmp_path)
    assert WORDS not in fwclass("run", path, "--out", tmp_path / "r", "--workers", 0).stderr
    reference = '{kind: echoes, files: ["r/parquet/*.parquet"], field: classification}'
    path.write_text(path.read_text().replace("{kind: source}", reference))
    ended = fwclass("run", path, "--out", tmp_path / "self", "--workers", 0)
    assert ended.returncode == 0 and WORDS in ended.stderr, ended.stderr
    assert WORDS in json.loads((tmp_path / "self" / "report.json").read_text())["accuracy"]["remarks"][0]


def test_a_value_that_one_class_lacks_is_told(tmp_path: Path) -> None:
    path = small_survey(tmp_path)
    las = laspy.read(tmp_path / "a.las")
    las.add_extra_dim(laspy.ExtraBytesParams("Pulse width", "f4"))
    width = np.random.default_rng(0).normal(4.0, 0.3, len(las.points))
    las["Pulse width"] = np.where(np.asarray(las.classification) == 5, np.nan, width)
    las.write(tmp_path / "a.las")
    path.write_text(path.read_text().replace("[zc, height_range_c100]", "[intensity, width]"))
    ended = fwclass("train", path, "--model", tmp_path / "m", "--out", tmp_path / "r", "--workers", 0)
    assert "feature 'width' has no value in 100 % of the rows of bush" in ended.stderr, ended.stderr
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0)
    assert "its absence tells them apart" in (tmp_path / "r" / "report.html").read_text()


def test_a_table_of_classifiers_has_the_remarks_of_each(tmp_path: Path) -> None:
    line = ("train", small_survey(tmp_path), "--out", tmp_path / "r", "--workers", 0, "--compare", "forest,linear-svm")
    ended = fwclass(*line)
    assert ended.returncode == 0 and "remark: The accuracy may be too good: it was tested" in ended.stdout, ended.stdout
    assert "errors hang together over the 12 m that what decides reaches" in ended.stdout
