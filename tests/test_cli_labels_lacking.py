"""What a survey's labels lack is said before anything is computed; what its file leaves out has an answer."""

from __future__ import annotations

import json
from pathlib import Path

from commandline import fwclass
from smallsurvey import CONFIG, small_survey


def test_a_training_area_without_a_label_is_a_fault(tmp_path: Path) -> None:
    survey = small_survey(tmp_path)
    away = "areas.train=[[500000,5400000,500030,5400040],[500070,5400000,500070.01,5400000.01]]"
    told = fwclass("run", survey, "--out", tmp_path / "run", "--workers", "0", "--set", away)
    assert told.returncode == 2 and "Training area [500070.0, 5400000.0" in told.stderr
    assert not (tmp_path / "run" / "store" / "features").exists()
    mended = fwclass("run", survey, "--out", tmp_path / "run", "--workers", "0")
    assert mended.returncode == 0, mended.stderr
    assert "skipped" in mended.stderr  # tiles are those that were made


def test_the_status_of_a_run_whose_labels_lack_a_class_can_be_asked_for(tmp_path: Path) -> None:
    survey = small_survey(tmp_path)
    survey.write_text(CONFIG.replace("codes: [5]}]", "codes: [5]}, {name: bridge, code: 17, codes: [17]}]"))
    told = fwclass("run", survey, "--out", tmp_path / "run", "--workers", "0")
    assert told.returncode == 2 and "No labelled echo of 'bridge'" in told.stderr
    assert "ground 1,6" in told.stderr  # how many of the others there are
    asked = fwclass("status", tmp_path / "run")
    assert asked.returncode == 3 and "Traceback" not in asked.stderr


def test_a_class_without_codes_counts_its_own(tmp_path: Path) -> None:
    survey = small_survey(tmp_path)
    with_codes = fwclass("run", survey, "--out", tmp_path / "a", "--workers", "0")
    survey.write_text(CONFIG.replace(", codes: [2]", "").replace(", codes: [5]", ""))
    without = fwclass("run", survey, "--out", tmp_path / "b", "--workers", "0")
    assert with_codes.returncode == without.returncode == 0, without.stderr
    first, second = ((tmp_path / run / "laz" / "strips" / "a.laz").read_bytes() for run in "ab")
    assert first == second


def test_a_model_gives_the_classes_that_a_file_leaves_out(tmp_path: Path) -> None:
    survey = small_survey(tmp_path)
    assert fwclass("train", survey, "--model", tmp_path / "m", "--workers", "0").returncode == 0
    bare = tmp_path / "bare.yaml"
    bare.write_text("survey: {name: bare, sources: [a.las], model: m}\n")
    told = fwclass("run", bare, "--out", tmp_path / "run", "--workers", "0")
    assert told.returncode == 0, told.stderr
    assert '"name": "bush"' in (tmp_path / "run" / "report.json").read_text()
    assert fwclass("plan", bare, "--out", tmp_path / "plan").returncode == 0


def test_points_that_a_map_leaves_out_are_counted(tmp_path: Path) -> None:
    cloud = small_survey(tmp_path).parent / "a.las"
    told = fwclass("assess", cloud, cloud, "--map", "ground=2", "--json")
    left_out = json.loads(told.stdout)["left_out"]
    assert list(left_out) == ["5"] and f"(5: {left_out['5']:,})" in told.stderr
    assert "not counted" not in fwclass("assess", cloud, cloud).stderr
