"""`fwclass plan` as a user meets it: what it prints and writes, what it refuses, and that nothing runs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass

from fwclass.run import cluster

HEAD = "survey      t: 1 file,"


@pytest.fixture
def conf(tmp_path: Path) -> Path:
    """A survey of one file: a field of 60 m x 60 m with a house on it."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 60, (2, 12_000))
    house = (np.abs(x - 30) < 8) & (np.abs(y - 30) < 8)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales, las.header.offsets = [0.001] * 3, [0.0] * 3
    las.x, las.y, las.z = x, y, 100 + 6.0 * house + rng.normal(0, 0.02, x.size)
    las.classification = np.where(house, 6, 2)
    las.return_number = las.number_of_returns = np.ones(x.size, np.uint8)
    las.write(tmp_path / "a.las")
    path = tmp_path / "c.yaml"
    path.write_text(
        f"survey: {{name: t, directory: {tmp_path}, sources: [a.las], reference: {{kind: source}}, crs: 'EPSG:25832',\n"
        "  features: [height_above_ground, height_range_r100],\n"
        "  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]}\n"
        "areas: {train: [[0, 0, 35, 60]], gap: 1.0}\ntile: {size: 20.0}\ntrain: {trees: 5}\n"
    )
    return path


def test_a_plan_is_told_and_written_and_nothing_runs(conf: Path, tmp_path: Path) -> None:
    ended = fwclass("plan", conf, "--out", tmp_path / "r")
    assert ended.returncode == 0, ended.stderr
    for text in (HEAD, "12,000 points", "9 of 20 m", "proposed", "publish-tile", "fits", "sampled"):
        assert text in ended.stdout
    assert sorted(p.name for p in (tmp_path / "r").iterdir()) == ["plan"]
    assert sorted(p.name for p in (tmp_path / "r" / "plan").iterdir()) == ["plan.json", "plan.png", "tiles.gpkg"]


def test_a_plan_reckons_with_the_workers_that_a_run_starts(
    conf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of the settings are this machine's; `--workers` may be another's, and what a run here starts is said."""
    monkeypatch.setattr(cluster, "CORES", 2)
    plans = {}
    for name, words in (("set", ("--set", "run.workers=9")), ("asked", ("--workers", 9)), ("two", ("--workers", 2))):
        ended = fwclass("plan", conf, "--out", tmp_path / name, *words, "--json")
        assert ended.returncode == 0, ended.stderr
        assert ("planned with 9 workers; here 2 started of 9" in ended.stderr) == (name == "asked"), ended.stderr
        plans[name] = json.loads(ended.stdout)
    assert [plans[name]["workers"] for name in plans] == [2, 9, 2]
    assert plans["set"]["wall_seconds"] == plans["two"]["wall_seconds"] > plans["asked"]["wall_seconds"]


def test_what_a_paper_compares_is_reckoned_with(conf: Path, tmp_path: Path) -> None:
    """A run of a paper was planned as the classification alone."""
    ended = fwclass("plan", conf, "--out", tmp_path / "r", "--workflow", "xiong2018", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    parts = {s["name"]: s["parts"] for s in told["stages"]}
    assert parts["paper-model"] == parts["paper-time"] == parts["paper-difference"] == 4
    assert parts["select-ranked"] == 2 * 5 and parts["paper-drops"] == 1 and told["without_cost"] == []


@pytest.mark.parametrize(("workflow", "survey"), [("he2023", "he2023-isprs"), ("li2018", "street-sim")])
def test_the_graph_of_a_study_without_a_survey(workflow: str, survey: str, tmp_path: Path) -> None:
    ended = fwclass("plan", survey, "--workflow", workflow, "--graph", "--json", cwd=tmp_path)
    assert ended.returncode == 0 and len(json.loads(ended.stdout)) == (2 if workflow == "he2023" else 3)
    refused = fwclass("plan", survey, "--workflow", workflow, cwd=tmp_path)
    assert refused.returncode == 2 and "--graph tells its stages" in refused.stderr


def test_json_goes_to_standard_output_alone(conf: Path, tmp_path: Path) -> None:
    ended = fwclass("plan", conf, "--out", tmp_path / "r", "--json")
    told = json.loads(ended.stdout)
    assert HEAD in ended.stderr and told["fits"] and told["points"] == told["pulses"] == told["echoes"] == 12_000
    assert told["tiles"]["number"] == 9 and told["tiles"]["halo"] >= 1.0
    assert told["seconds"] > 0 and told["disk_bytes"] > 0 and told["free_bytes"] > 0
    assert {s["source"] for s in told["stages"]} == {"conf"} and told["dry_run"] is None
    assert json.loads((tmp_path / "r" / "plan" / "plan.json").read_text()) == told


def test_every_file_of_the_reference_is_a_part_by_itself(conf: Path, tmp_path: Path) -> None:
    """They were planned as one, and four were made."""
    for name in "pqrs":
        shutil.copy(tmp_path / "a.las", tmp_path / f"{name}.las")
    (tmp_path / "c.yaml").write_text(conf.read_text().replace("{kind: source}", "{kind: cloud, files: ['[p-s].las']}"))
    ended = fwclass("plan", conf, "--out", tmp_path / "r", "--json")
    told = json.loads(ended.stdout)
    parts = {stage["name"]: stage["parts"] for stage in told["stages"]}
    assert parts["reference-split"] == 4 and told["reference_points"] == 48_000


def test_a_plan_is_not_overwritten_unasked(conf: Path, tmp_path: Path) -> None:
    args = ("plan", conf, "--out", tmp_path / "r")
    assert fwclass(*args).returncode == 0
    again = fwclass(*args)
    assert again.returncode == 2 and "there is a plan already" in again.stderr
    assert fwclass(*args, "--overwrite").returncode == 0


def test_too_little_memory_is_refused_with_the_numbers(conf: Path, tmp_path: Path) -> None:
    args = ("--out", tmp_path / "r", "--workers", 2, "--set", "run.worker_memory_gib=0.25", "--json")
    ended = fwclass("plan", conf, *args)
    assert ended.returncode == 2
    assert "does not fit" in ended.stderr and "MiB needed, 205 MiB allowed" in ended.stderr
    told = json.loads(ended.stdout)
    assert not told["fits"] and told["proposed"] is None and not all(limit["fits"] for limit in told["limits"])


def test_wrong_words_are_told(conf: Path, tmp_path: Path) -> None:
    assert fwclass("plan").returncode == 2
    gone = fwclass("plan", conf, "--set", "survey.sources=[b.las]", "--out", tmp_path / "r")
    assert gone.returncode == 1 and "no file matches" in gone.stderr and not (tmp_path / "r").exists()
    unknown = fwclass("plan", conf, "--set", "plan.stages.tile.eech=3")
    assert unknown.returncode == 2 and "unknown key plan.stages.tile.eech (did you mean 'each'?)" in unknown.stderr
    for words, told in (
        ("survey.features=[foo]", "'foo' is not a feature"),
        ("areas.train=[[900,900,910,910]]", "no training area lies on the survey"),
    ):
        refused = fwclass("plan", conf, "--set", words, "--out", tmp_path / "r")
        assert refused.returncode == 2 and told in refused.stderr and not (tmp_path / "r").exists()


@pytest.mark.parametrize("command", ["plan", "run", "status"])
def test_every_file_that_cannot_be_used_is_named(conf: Path, tmp_path: Path, command: str) -> None:
    whole = (tmp_path / "a.las").read_bytes()
    (tmp_path / "b.las").write_bytes(whole[:-30])
    (tmp_path / "c.las").write_bytes(b"PK\3\4")
    settings = ("--set", "survey.sources=['*.las']", "--out", tmp_path / "r")
    ended = fwclass(command, conf, *settings)
    assert ended.returncode == 1 and "2 of 3 source files cannot be used" in ended.stderr
    assert "b.las: the file is cut short" in ended.stderr and "c.las: " in ended.stderr


@pytest.mark.parametrize("command", ["plan", "run"])
def test_two_files_of_one_name_are_refused(conf: Path, tmp_path: Path, command: str) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "a.las").write_bytes((tmp_path / "a.las").read_bytes())
    settings = ("--set", "survey.sources=['a.las', 'more/*.las']", "--out", tmp_path / "r")
    ended = fwclass(command, conf, *settings)
    assert ended.returncode == 1 and "two files of the survey have the same name" in ended.stderr


def test_a_survey_still_to_be_simulated_is_planned_but_not_tried(tmp_path: Path) -> None:
    ended = fwclass("plan", "demo", "--out", tmp_path / "r", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["simulated"] and told["files"] == 4 and told["tiles"]["number"] == 9
    assert told["pulses"] == pytest.approx(3.3 * 300**2, rel=0.01) and told["stages"][0]["name"] == "simulate"
    tried = fwclass("plan", "demo", "--out", tmp_path / "s", "--dry-run", 1)
    assert tried.returncode == 2 and "fwclass simulate" in tried.stderr


@pytest.mark.slow
def test_a_dry_run_measures_and_leaves_nothing_behind(conf: Path, tmp_path: Path) -> None:
    ended = fwclass("plan", conf, "--out", tmp_path / "r", "--dry-run", 2, "--workers", 0, "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    real = {s["name"] for s in told["stages"] if s["source"] == "dry run"}
    assert real >= {"tile", "features", "classify", "publish-tile"} and "publish-rasters" not in real
    assert told["dry_run"]["parts"] > 10 and told["dry_run"]["peak_mib"] > 50
    keys = next(line for line in ended.stderr.splitlines() if line.startswith("dry run     tiles")).split()[3:5]
    assert len({k.strip(",") for k in keys}) == 2
    assert sorted(p.name for p in (tmp_path / "r").iterdir()) == ["plan"]
    assert sorted(p.name for p in (tmp_path / "r" / "plan").iterdir()) == ["plan.json", "plan.png", "tiles.gpkg"]


OWN = """
from dataclasses import replace
from fwclass.graph.own_stage import classifier_stage
from fwclass.workflows.classification import classification


def answer(X):
    return X[:, 0] > 0


workflow = classification.without_training().with_stage_instead(classifier_stage(answer, ("z",)))
"""
EARLY = """
from dataclasses import replace
from fwclass.graph.stages import TILE_ECHOES
from fwclass.workflows.classification import classification

workflow = classification.with_stage_instead(replace(TILE_ECHOES))
"""


def test_a_workflow_of_ones_own_is_planned_by_its_stages(tmp_path: Path) -> None:
    """What does not learn is not charged for learning; a cost that is set for a stage is reckoned with."""
    (tmp_path / "own.py").write_text(OWN)
    ended = fwclass("plan", "demo", "--workflow", tmp_path / "own.py", "--out", tmp_path / "r", "--json")
    assert ended.returncode == 0, ended.stderr
    stages = {s["name"] for s in json.loads(ended.stdout)["stages"]}
    assert {"tile", "classify"} <= stages and not stages & {"sample", "training", "trees", "train"}
    assert fwclass("plan", "demo", "--workflow", "he2023").returncode == 2
    page = Path(__file__).parents[1] / "docs" / "extending.md"
    own = page.read_text(encoding="utf-8").split("```python\n# uneven.py")[1].split("```")[0]
    (tmp_path / "uneven.py").write_text(own)
    words = ("--workflow", tmp_path / "uneven.py", "--set", "survey.features=[zc, unevenness]", "--out", tmp_path / "u")
    ended = fwclass("plan", "demo", *words)
    assert ended.returncode == 0 and "what unevenness of" in ended.stderr, ended.stderr
    assert fwclass("plan", "demo", *words, "--dry-run", 1, "--overwrite").returncode == 2


def test_a_stage_before_the_tiles_cannot_be_replaced(tmp_path: Path) -> None:
    (tmp_path / "early.py").write_text(EARLY)
    ended = fwclass("plan", "demo", "--workflow", tmp_path / "early.py", "--out", tmp_path / "r")
    assert ended.returncode == 2 and "before the tiles cannot be replaced" in ended.stderr
