"""A second layer in a run: tiles, workers and a restart change nothing; elsewhere answers stay; its model travels."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest
from commandline import fwclass
from runmaker import ANSWER, SETTINGS, delivered, delivered_echoes, looked, walk

from fwclass import conf
from fwclass.errors import ConfigError
from fwclass.operate.seams.walk import SeamRequest, seams
from fwclass.operate.status.walk import Silent
from fwclass.run.cluster import Cluster
from fwclass.store.models import load_model

LAYER = (
    "classify.refine.between=[building, vegetation]",
    "classify.refine.scales=[0.6, 1.5, 3]",
    "classify.refine.samples_per_class=400",
    "classify.refine.method=forest",
    "train.importance_repeats=0",
)


@pytest.fixture(scope="module")
def refined(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("refined")
    runner, report = walk(survey, root, *LAYER)
    assert not runner.failures, runner.failures
    return root, report


def boundary(root):
    """Echoes at the boundary, and all."""
    receipts = [json.loads(p.read_text()) for p in sorted((root / "store" / "refine").glob("*/receipt.json"))]
    return sum(r["meta"]["boundary"] for r in receipts), sum(r["meta"]["rows"] for r in receipts)


@pytest.mark.slow
def test_weights_of_classes_that_the_second_layer_lacks_are_the_first_one_s(survey, tmp_path):
    """The training of the second layer failed, after hours."""
    runner, report = walk(survey, tmp_path, *LAYER, "train.class_weights={ground: 0.2}")
    assert not runner.failures, runner.failures
    assert report["accuracy"]["overall_accuracy"] > 0.5


@pytest.mark.slow
def test_answers_change_at_the_boundary_alone(survey, refined, finished):
    after, before = delivered_echoes(refined[0]), delivered_echoes(finished[0])
    changed = np.zeros(len(after["strip"]), bool)
    for name in ANSWER[3:]:
        changed |= after[name] != before[name]
    at, rows = boundary(refined[0])
    assert 0 < changed.sum() <= at < rows == len(changed)
    assert set(after["classification"][changed].tolist()) <= {5, 6}


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["tile.size=37.5", "tile.size=150", "tile.size=1000"])
def test_tiles_change_no_answer(setting, survey, refined, tmp_path):
    runner, _ = walk(survey, tmp_path, setting, *LAYER)
    assert not runner.failures
    before, after = delivered_echoes(refined[0]), delivered_echoes(tmp_path)
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    assert boundary(tmp_path) == boundary(refined[0])


@pytest.mark.slow
def test_workers_give_the_same_bytes_and_a_restart_makes_nothing(survey, refined, tmp_path):
    runner, _ = walk(survey, tmp_path, *LAYER, executor=Cluster(None, 2, 4.0, 1000))
    assert not runner.failures
    assert delivered(tmp_path) == delivered(refined[0])
    again, _ = walk(survey, tmp_path, *LAYER)
    made = [name for name, one in again.outcomes.items() if one.status == "computed" and name[0] != "report"]
    assert made == []
    assert looked(survey, tmp_path, *LAYER).all_done


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_bytes_with_one_worker(survey, refined, tmp_path):
    words = [w for text in (*SETTINGS, f"survey.directory={survey}", *LAYER) for w in ("--set", text)]
    line = [sys.executable, "-c", "from fwclass.cli import main; main()", "run", "demo", "--out", str(tmp_path / "r")]
    process = subprocess.Popen([*line, *words, "--workers", "0"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until = time.monotonic() + 240
        while not list((tmp_path / "r" / "store" / "refine").glob("*/receipt.json")):
            assert process.poll() is None and time.monotonic() < until, "it ended before its second layer"
            time.sleep(0.01)
    finally:
        process.kill()
        process.wait()
    assert not (tmp_path / "r" / "model").exists()
    runner, _ = walk(survey, tmp_path / "r", *LAYER, executor=Cluster(None, 1, 4.0, 1000))
    assert not runner.failures
    assert "skipped" in {o.status for o in runner.outcomes.values()}
    assert delivered(tmp_path / "r") == delivered(refined[0])


@pytest.mark.slow
def test_seams_are_none_and_the_stages_are_compared(survey, refined):
    settings = (*SETTINGS, f"survey.directory={survey}", "seams.width=4", "seams.share=1", *LAYER)
    config = conf.load("demo", settings)
    found = seams(config, refined[0], SeamRequest((50.0, 50.0), config.seams.share, None, None), Silent())
    stages = {s.stage: s for s in found.bounded}
    assert {"coarse", "refine", "classify"} <= set(stages)
    assert all(s.differ == 0 for s in found.bounded)


@pytest.mark.slow
def test_a_model_of_two_layers_classifies_another_run_and_a_file(survey, refined, tmp_path):
    model = refined[0] / "model"
    found = load_model(model)
    assert found.kind == "two-layer" and found.card["refine"]["between"] == ["building", "vegetation"]
    runner, _ = walk(survey, tmp_path / "run", f"survey.model={model}", "survey.reference.kind=none")
    assert not runner.failures
    before, after = delivered_echoes(refined[0]), delivered_echoes(tmp_path / "run")
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    strip = sorted((survey / "strips").glob("*.las"))[0]
    words = [
        "--set",
        "ground.block=64",
        "--set",
        "ground.max_building_size=50",
        "--set",
        "decompose.register_within=0.0",
    ]
    told = fwclass("classify", strip, tmp_path / "a.laz", "--model", model, "--json", *words)
    assert json.loads(told.stdout)["boundary"] > 0


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("classify.refine.between=[building]", "two different classes"),
        ("classify.refine.between=[building, building]", "two different classes"),
        ("classify.refine.between=[building, boat]", "no class is called 'boat'"),
        ("classify.refine.within=200", "classify.refine.within"),
        ("classify.refine.scales=[1, 0.5]", "radii must rise"),
        ("classify.refine.scales=[0.333]", "whole centimetres"),
        ("classify.refine.scales=[200]", "classify.refine.scales"),
        ("classify.refine.method=oracle", "classify.refine.method"),
    ],
)
def test_a_layer_that_cannot_be_is_refused_before_anything_is_computed(setting, told):
    with pytest.raises(ConfigError, match=told):
        conf.load("demo", (setting,))


def test_a_thinned_run_has_no_second_layer():
    with pytest.raises(ConfigError, match="no second layer"):
        conf.load("demo", ("classify.refine.between=[building, vegetation]", "thin.rate=0.1"))


@pytest.mark.slow
def test_classes_that_do_not_meet_in_the_training_areas_are_told(survey, tmp_path):
    runner, _ = walk(survey, tmp_path, *LAYER, "classify.refine.within=0.01")
    told = (
        " ".join(str(f) for f in runner.failures.values())
        if isinstance(runner.failures, dict)
        else str(runner.failures)
    )
    assert "near a boundary of building and vegetation" in told


@pytest.mark.slow
def test_scales_are_chosen_on_the_second_layer_s_rows(survey, tmp_path):
    words = [w for text in (*SETTINGS, f"survey.directory={survey}", *LAYER) for w in ("--set", text)]
    words += ["--set", "select.block=15", "--set", "select.folds=2", "--set", "select.trees=5", "--workers", "0"]
    words += ["--set", "classify.refine.rows=anywhere", "--set", "select.timing_echoes=500"]
    told = fwclass("select", "demo", "--method", "scales", "--out", tmp_path / "r", *words, "--json")
    made = json.loads(told.stdout)
    assert 1 <= len(made["scales"]) <= 3 and set(made["scales"]) <= {0.6, 1.5, 3.0}
    assert [len(s["features"]) for s in made["steps"]] == [1, 2, 3]
    judged = np.array([[s["accuracy"] for s in made["steps"]]])
    assert (judged > 0.5).all() and made["sample"]["blocks"] > 2
    assert "classify.refine.scales=" in told.stderr
    written = (tmp_path / "r" / "select" / "scales.yaml").read_text()
    assert "refine" in written and (tmp_path / "r" / "select" / "scales.png").is_file()
    again = json.loads(
        fwclass("select", "demo", "--method", "scales", "--out", tmp_path / "r", *words, "--json").stdout
    )
    assert again["scales"] == made["scales"]
