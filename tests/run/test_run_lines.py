"""Lines of a class in a run: tiles, workers and the command on one file change nothing; who goes without."""

import json

import numpy as np
import pytest
from commandline import fwclass
from runmaker import SETTINGS, delivered, delivered_echoes, looked, walk

from fwclass import conf
from fwclass.graph.areas import within
from fwclass.run.cluster import Cluster
from fwclass.run.inputs import PartInputs
from fwclass.schema import IDENTITY, Table
from fwclass.store.run_store import Store

CODE = 64
"""Cars, fences and poles of the simulated survey; no wires, but a class like any other."""

LINES = (f"classify.lines.codes=[{CODE}]", "classify.lines.reach=15", "train.importance_repeats=0")
AWAY = ("classify.lines.codes=[]", "train.importance_repeats=0")


@pytest.fixture(scope="module")
def lined(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("lined")
    runner, _ = walk(survey, root, *LINES)
    assert not runner.failures, runner.failures
    return root


def same(before, after):
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)


def echoes_that_trained(root):
    """Of all echoes, ordered as `delivered_echoes`, those in training areas that have a label."""
    store, columns = Store(root), {**dict.fromkeys((*IDENTITY, "x", "y"), "tile"), "reference": "label"}
    echoes = Table.concat([PartInputs(store).rows(part, columns) for stage, part in store.parts() if stage == "tile"])
    order = np.lexsort((echoes["echo_number"], echoes["pulse"], echoes["strip"]))
    areas = conf.load("demo", SETTINGS).areas.boxes("train")
    return (within(echoes, areas) & (echoes["reference"] > 0))[order]


@pytest.mark.slow
def test_classes_change_and_it_is_said(survey, lined, tmp_path):
    runner, _ = walk(survey, tmp_path / "without", *AWAY)
    assert not runner.failures
    before, after = (delivered_echoes(root)["classification"] for root in (tmp_path / "without", lined))
    assert 0 < (before != after).mean() < 0.1
    joined, left = np.sum([r.meta["lines"] for r in Store(lined).receipts("classify")], axis=0)
    assert (
        joined == ((before != CODE) & (after == CODE)).sum() and left == ((before == CODE) & (after != CODE)).sum() > 0
    )
    (line,) = [t for t in json.loads((lined / "report.json").read_text())["remarks"] if "classify.lines" in t]
    assert line.startswith(f"{joined:,} echoes have got a wire's class") and f"and {left:,} have lost it" in line
    trained = echoes_that_trained(lined)
    assert (before == after)[trained].all() and trained.sum() > 10_000
    assert not list(Store(tmp_path / "without").receipts("model-shares"))
    assert "classify.lines" not in (tmp_path / "without" / "report.json").read_text().split('"remarks"')[1]


@pytest.mark.slow
def test_tiles_change_no_answer(survey, lined, tmp_path):
    runner, _ = walk(survey, tmp_path, "tile.size=37.5", *LINES)
    assert not runner.failures
    same(delivered_echoes(lined), delivered_echoes(tmp_path))


@pytest.mark.slow
def test_workers_give_the_same_bytes_and_a_restart_computes_nothing(survey, lined, tmp_path):
    runner, _ = walk(survey, tmp_path, *LINES, executor=Cluster(None, 2, 4.0, 1000))
    assert not runner.failures
    assert delivered(tmp_path) == delivered(lined)
    assert looked(survey, tmp_path, *LINES).all_done


@pytest.mark.slow
@pytest.mark.parametrize(
    "more", [("classify.context.cells=[1, 2.5]", "classify.context.folds=2"), ("classify.regularize.strength=0.1",)]
)
def test_behind_other_layers_a_file_is_answered_for_alike_in_tiles_of_any_size(survey, tmp_path, more):
    runner, _ = walk(survey, tmp_path / "r", *LINES, *more, "select.block=20", "train.samples_per_class=800")
    assert not runner.failures
    strip = sorted((survey / "strips").glob("*.las"))[0]
    words = ("ground.block=64", "ground.max_building_size=50", *LINES[:2], *(m for m in more if "regularize" in m))
    files = []
    for size in (30, 500):
        out = tmp_path / f"{size}.laz"
        line = [part for word in (*words, f"tile.size={size}") for part in ("--set", word)]
        told = json.loads(fwclass("classify", strip, out, "--model", tmp_path / "r" / "model", "--json", *line).stdout)
        assert any("classify.lines" in note for note in told["notes"])
        files.append(out.read_bytes())
    assert files[0] == files[1]


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["thin.rate=0.5", "classify.refine.between=[building, vegetation]"])
def test_runs_that_ask_the_model_of_some_echoes_have_no_lines_and_say_so(survey, tmp_path, setting):
    runner, report = walk(survey, tmp_path, setting, *LINES)
    assert not runner.failures
    assert not list(Store(tmp_path).receipts("model-shares"))
    assert any("not looked for along lines" in line for line in report["remarks"])


@pytest.mark.slow
def test_echoes_that_are_kept_are_not_counted(survey, tmp_path):
    both = []
    for name, more in (("without", AWAY), ("lined", LINES)):
        runner, _ = walk(survey, tmp_path / name, *more, "classify.keep=[2]")
        assert not runner.failures
        both.append(delivered_echoes(tmp_path / name)["classification"])
    before, after = both
    counted = np.sum([r.meta["lines"] for r in Store(tmp_path / "lined").receipts("classify")], axis=0)
    assert counted.tolist() == [((before != after) & (v == CODE)).sum() for v in (after, before)]


@pytest.mark.slow
def test_a_class_that_the_source_keeps_has_no_lines(survey, tmp_path):
    runner, report = walk(survey, tmp_path, *LINES, f"classify.keep=[{CODE}]")
    assert not runner.failures
    assert not list(Store(tmp_path).receipts("model-shares"))
    assert any("not looked for along lines" in line for line in report["remarks"])


@pytest.mark.slow
def test_a_classifier_of_ones_own_has_no_lines(survey, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\nfrom fwclass.graph.own_stage import classifier_stage\n"
        "from fwclass.workflows.classification import classification\n\n\n"
        "def g(table):\n"
        "    n = table.rows\n"
        "    return {'classification': np.full(n, 2), 'confidence': np.ones(n), 'entropy': np.zeros(n)}\n\n\n"
        "workflow = classification.without_training().with_stage_instead(classifier_stage(g, ('z',)))\n"
    )
    runner, _ = walk(survey, tmp_path / "r", *LINES[:2], "plausibility.accept=true", workflow=str(path))
    assert not runner.failures, runner.failures
    assert not list(Store(tmp_path / "r").receipts("model-shares"))
