"""Selection over a survey: what it reads, that workers change nothing, and that a run takes what it writes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from runmaker import SETTINGS, walk

from fwclass import conf
from fwclass.conf.sets import feature_set
from fwclass.errors import ConfigError, InputError
from fwclass.graph.areas import within
from fwclass.grid import Box
from fwclass.run.cluster import Cluster
from fwclass.run.inputs import PartInputs
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.schema import Table, canonical_key
from fwclass.store.run_store import Store
from fwclass.study.select import output
from fwclass.study.select.sample import TRAINING, training_of
from fwclass.study.select.thinning import thinning
from fwclass.study.selection import selection

CANDIDATES = ("zc", "echo_number", "amplitude", "inclination_r100", "width")
SMALL = ("select.block=15", "select.trees=5", "select.samples_per_class=500", "select.timing_repeats=1")


def _chosen(survey: Path, root: Path, method: str, *settings: str, executor=None, names=CANDIDATES, **asked):
    config = conf.load("demo", (*SETTINGS, *SMALL, f"survey.directory={survey}", *settings))
    with Display() as display:
        runner = Runner(root, executor or Loop(), display)
        return (
            thinning(config, runner, names)
            if method == "thinning"
            else selection(config, runner, names, method, **asked)
        )


@pytest.fixture(scope="module")
def root(finished, tmp_path_factory) -> Path:
    """A run directory of its own, in which echoes and features are there."""
    place = tmp_path_factory.mktemp("select") / "run"
    shutil.copytree(finished[0], place, symlinks=True)
    return place


@pytest.fixture(scope="module")
def forwards(survey, root):
    return _chosen(survey, root, "forward")


def test_forward_tells_curve_cost_and_set(forwards):
    made = forwards
    assert [len(s["features"]) for s in made["steps"]] == list(range(1, len(made["steps"]) + 1))
    assert made["best"]["score"] == max(s["score"] for s in made["steps"]) > 0.7
    assert made["chosen"] == made["best"]["features"]
    assert len(made["smallest"]["features"]) <= len(made["best"]["features"])
    assert all(s["microseconds"] > 0 for s in made["steps"])
    assert "sphere of radius 1 m" in made["cost"]["scales"] or "inclination_r100" not in made["chosen"]
    assert json.loads(json.dumps(made)) == made
    assert "us/echo" in output.describe(made, Path("x.yaml"))


def test_only_training_areas_are_read(survey, root, forwards):
    config = conf.load("demo", (*SETTINGS, *SMALL))
    placed, folds = training_of(PartInputs(Store(root)), CANDIDATES)
    boxes = config.areas.boxes("train")
    n = placed.sample.rows
    table = Table({"x": placed.x, "y": placed.y})
    assert within(table, boxes).all() and n == forwards["sample"]["rows"]
    assert not Box(512060.0, 5403000.0, 513000.0, 5404000.0).contains(placed.x, placed.y).any()
    assert set(np.unique(folds.fold)) == {0, 1, 2, 3, 4}
    assert Store(root).receipt(TRAINING, "all").meta["counts"] == placed.sample.counts.tolist()


def test_the_file_is_a_feature_set_of_the_same_bytes(survey, root, forwards, tmp_path):
    path = tmp_path / "found.yaml"
    output.write(forwards, path)
    assert feature_set(str(path)).features == tuple(forwards["chosen"])
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(path.with_suffix(".json").read_text())["chosen"] == forwards["chosen"]
    for stage in ("select-trial", "select-sample", "select-training", "select-cost"):
        shutil.rmtree(root / "store" / stage)
    again = _chosen(survey, root, "forward", "tile.size=100")
    selection = feature_set(str(path)).selection
    assert [s.size for s in selection.steps] == [len(s["features"]) for s in forwards["steps"]]
    output.write(again, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == path.read_bytes()
    config = conf.load("demo", (f"survey.features={path}",))
    assert config.features_asked == tuple(forwards["chosen"])


def test_backward_and_fscore_agree_on_what_is_best_alone(survey, root):
    back = _chosen(survey, root, "rffs", "select.drop=0.4")
    assert [len(s["features"]) for s in back["steps"]] == [5, 3, 2, 1]
    assert len(back["ranks"]) == 5 and back["ranks"][0][1] > 0
    score = _chosen(survey, root, "fscore")
    assert [len(s["features"]) for s in score["steps"]] == [1, 2, 3, 4, 5]
    assert score["ranks"] == sorted(score["ranks"], key=lambda r: -r[1])


@pytest.mark.slow
def test_two_workers_give_the_same_bytes(survey, root, forwards, tmp_path):
    shutil.rmtree(root / "store" / "select-trial")
    with Cluster(None, 2, 2.0, 1000) as cluster:
        made = _chosen(survey, root, "forward", executor=cluster)
    output.write(made, tmp_path / "two.yaml")
    output.write(forwards, tmp_path / "one.yaml")
    assert (tmp_path / "two.yaml").read_bytes() == (tmp_path / "one.yaml").read_bytes()


def test_what_cannot_be_chosen_is_said(survey, root, tmp_path):
    with pytest.raises(ConfigError, match="is not a feature"):
        _chosen(survey, root, "forward", names=("zc", "flatness_r100"))
    with pytest.raises(ConfigError, match="named twice"):
        _chosen(survey, root, "forward", names=("zc", "zc"))
    with pytest.raises(ConfigError, match="no candidate"):
        _chosen(survey, root, "forward", order=("zc", "amplitude_db"))
    with pytest.raises(ConfigError, match="needs the range"):
        _chosen(survey, root, "forward", "survey.trajectory.files=[]", names=("zc", "backscatter"))
    with pytest.raises(InputError, match="too few blocks"):
        _chosen(survey, root, "forward", "select.block=200", "select.gap=0")
    (tmp_path / "there.yaml").write_text("x")
    with pytest.raises(ConfigError, match="exists"):
        output.check_target(tmp_path / "there.yaml", root, "forward", False)


def test_candidates_without_information_are_left_out_and_told(survey, root):
    """`beam_range` has no value where the source does not know the sensor's place."""
    made = _chosen(survey, root, "fscore", names=("zc", "amplitude", "beam_range"))
    assert made["left_out"] == {"beam_range": "no value in any training row"}
    assert "left out: beam_range" in output.describe(made, Path("x.yaml"))
    assert all("beam_range" not in s["features"] for s in made["steps"])
    with pytest.raises(InputError, match="has a value of any candidate"):
        _chosen(survey, root, "fscore", names=("beam_range",))


def test_thinning_curve(survey, root, tmp_path):
    made = _chosen(survey, root, "thinning", "select.rates=[1.0, 0.2]")
    one, fifth = made["steps"]
    assert one["kept"] == one["rows"] and fifth["kept"] == pytest.approx(0.2 * one["rows"], rel=0.05)
    assert 0.5 < fifth["accuracy"] <= one["accuracy"] + 0.02
    assert fifth["microseconds"]["vote"] > 0 and one["microseconds"]["vote"] > 0
    output.write(made, tmp_path / "thinning.yaml")
    assert "thin:" in (tmp_path / "thinning.yaml").read_text()
    assert "lowest rate" in output.describe(made, tmp_path / "thinning.yaml")


def _classes(root: Path) -> dict[int, tuple[int, bool]]:
    """(class code, sampled) of every echo by its key."""
    inputs, found = PartInputs(Store(root)), {}
    identity = dict.fromkeys(("strip", "pulse", "echo_number"), "tile")
    for receipt in Store(root).receipts("classify"):
        table = inputs.rows(receipt.part, {**identity, "classification": "classify", "sampled": "thin"})
        values = zip(table["classification"].tolist(), table["sampled"].tolist(), strict=True)
        found |= dict(zip(canonical_key(table).tolist(), values, strict=True))
    return found


@pytest.mark.slow
def test_a_thinned_run_is_the_same_for_any_tiles(survey, finished, tmp_path):
    shutil.copytree(finished[0], tmp_path / "a", symlinks=True)
    runner, report = walk(survey, tmp_path / "a", "thin.rate=0.2")
    assert not runner.failures, runner.failures
    other, _ = walk(survey, tmp_path / "b", "thin.rate=0.2", "tile.size=35")
    assert not other.failures, other.failures
    one, two = _classes(tmp_path / "a"), _classes(tmp_path / "b")
    assert one == two
    share = np.mean([sampled for _, sampled in one.values()])
    assert 0.15 < share < 0.25
    assert report["accuracy"]["overall_accuracy"] > finished[1]["accuracy"]["overall_accuracy"] - 0.1
