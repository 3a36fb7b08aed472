"""Neighbours that agree in a run: tiles, workers, memory and the command on one file change nothing."""

import contextlib
import json
import shutil

import laspy
import numpy as np
import pytest
from commandline import fwclass
from runmaker import SETTINGS, delivered, delivered_echoes, looked, walk

from fwclass import conf
from fwclass.conf.checks import refuse_regularized
from fwclass.errors import ConfigError
from fwclass.operate.seams.walk import SeamRequest, seams
from fwclass.operate.status.walk import Silent
from fwclass.run.cluster import Cluster
from fwclass.run.part import execute
from fwclass.store.run_store import Store

FIELD = ("classify.regularize.strength=0.3", "classify.regularize.reach=2", "train.importance_repeats=0")
LAYER = (
    "classify.context.cells=[1, 2.5]",
    "classify.context.folds=2",
    "select.block=20",
    "train.samples_per_class=800",
)


@pytest.fixture(scope="module")
def agreed(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("agreed")
    runner, _ = walk(survey, root, *FIELD)
    assert not runner.failures, runner.failures
    return root


@pytest.fixture(scope="module")
def alone(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("alone")
    runner, _ = walk(survey, root, "train.importance_repeats=0")
    assert not runner.failures
    return root


def look(root):
    return json.loads((root / "report.json").read_text())


def same(before, after):
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)


@pytest.mark.slow
def test_it_changes_some_answers_and_the_model_stays(agreed, alone):
    before, after = delivered_echoes(alone), delivered_echoes(agreed)
    changed = before["classification"] != after["classification"]
    assert 0 < changed.mean() < 0.2
    assert after["confidence"].mean() > before["confidence"].mean(), "neighbours that agree are surer"
    models = [{k: v for k, v in delivered(root).items() if k.startswith("model")} for root in (agreed, alone)]
    assert models[0] == models[1] and models[0]


@pytest.mark.slow
def test_the_report_says_that_neighbours_agree(agreed, alone):
    said = [any("mean field of strength 0.3" in line for line in look(root)["remarks"]) for root in (agreed, alone)]
    assert said == [True, False]


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["tile.size=37.5", "tile.size=1000"])
def test_tiles_change_no_answer(setting, survey, agreed, tmp_path):
    runner, _ = walk(survey, tmp_path, setting, *FIELD)
    assert not runner.failures
    same(delivered_echoes(agreed), delivered_echoes(tmp_path))


@pytest.mark.slow
def test_workers_give_the_same_bytes_and_a_restart_computes_nothing(survey, agreed, tmp_path):
    runner, _ = walk(survey, tmp_path, *FIELD, executor=Cluster(None, 2, 4.0, 1000))
    assert not runner.failures
    assert delivered(tmp_path) == delivered(agreed)
    assert looked(survey, tmp_path, *FIELD).all_done


@pytest.mark.slow
def test_seams_are_none_and_the_stages_are_compared(survey, agreed):
    settings = (*SETTINGS, f"survey.directory={survey}", "seams.width=4", "seams.share=1", *FIELD)
    config = conf.load("demo", settings)
    compared = seams(config, agreed, SeamRequest((50.0, 50.0), config.seams.share, None, None), Silent())
    assert {"model-shares", "classify"} <= {s.stage for s in compared.bounded}
    assert all(s.differ == 0 for s in compared.bounded)


class Pieces:
    """Every part as on a worker that runs short of memory."""

    address = ""

    def run(self, root, tasks):
        for task in tasks:
            yield execute(root, task, split=3)


@pytest.mark.slow
def test_short_memory_changes_no_byte(survey, agreed, tmp_path):
    shutil.copytree(agreed, tmp_path / "r", symlinks=True)
    again = ("model-shares", "classify")
    digests = [{(s, r.part): r.digest for s in again for r in Store(tmp_path / "r").receipts(s)}]
    for stage in again:
        shutil.rmtree(tmp_path / "r" / "store" / stage)
    walk(survey, tmp_path / "r", *FIELD, executor=contextlib.nullcontext(Pieces()))
    digests.append({(s, r.part): r.digest for s in again for r in Store(tmp_path / "r").receipts(s)})
    assert digests[0] == digests[1] and len(digests[0]) > 4


@pytest.mark.slow
def test_another_strength_computes_no_share_again(survey, agreed, tmp_path):
    shutil.copytree(agreed, tmp_path / "r", symlinks=True)
    runner, _ = walk(survey, tmp_path / "r", *FIELD, "classify.regularize.strength=0.1")
    computed = {n[0] for n, one in runner.outcomes.items() if one.status == "computed"}
    assert "classify" in computed and not {"model-shares", "train", "features"} & computed


@pytest.mark.slow
def test_behind_the_context_by_a_given_model_and_on_a_file(survey, tmp_path):
    """The model is used as it is elsewhere; a file is answered for alike in tiles of any size."""
    runner, _ = walk(survey, tmp_path / "r", *FIELD, *LAYER)
    assert not runner.failures
    model = tmp_path / "r" / "model"
    small = (f"survey.model={model}", "survey.reference.kind=none", "tile.size=40")
    runner, _ = walk(survey, tmp_path / "s", *FIELD, *small)
    assert not runner.failures
    same(delivered_echoes(tmp_path / "r"), delivered_echoes(tmp_path / "s"))
    strip = sorted((survey / "strips").glob("*.las"))[0]
    words = ("--set", "ground.block=64", "--set", "ground.max_building_size=50", "--set", FIELD[1])
    files = []
    for size, strength in ((30, 0.3), (500, 0.3), (500, 0)):
        out = tmp_path / f"{size}-{strength}.laz"
        more = ("--set", f"tile.size={size}", "--set", f"classify.regularize.strength={strength}")
        described = json.loads(fwclass("classify", strip, out, "--model", model, "--json", *words, *more).stdout)
        assert described["kind"] == "contextual" and len(described["classes"]) > 2
        files.append(out.read_bytes())
    assert files[0] == files[1] != files[2]


@pytest.mark.slow
def test_one_strip_is_answered_for_as_in_a_run_of_it(survey, agreed, tmp_path):
    strip = sorted((survey / "strips").glob("*.las"))[0]
    given = (f"survey.sources=[strips/{strip.name}]", f"survey.model={agreed / 'model'}", "survey.reference.kind=none")
    runner, _ = walk(survey, tmp_path / "r", *FIELD, *given)
    assert not runner.failures
    words = ("ground.block=64", "terrain.block=64", "ground.max_building_size=50", "pulse.sample=3000", *FIELD[:2])
    line = [part for word in words for part in ("--set", word)]
    fwclass("classify", strip, tmp_path / "o.laz", "--model", agreed / "model", *line)
    (of_run,) = sorted((tmp_path / "r" / "laz" / "strips").glob("*.laz"))
    one, other = laspy.read(tmp_path / "o.laz"), laspy.read(of_run)
    np.testing.assert_array_equal(one["classification"], other["classification"])


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (("classify.regularize.strength=-1",), "classify.regularize.strength"),
        (("classify.regularize.strength=11",), "classify.regularize.strength"),
        (("classify.regularize.reach=100",), "classify.regularize.reach"),
        (("classify.regularize.neighbours=0",), "classify.regularize.neighbours"),
        (("classify.regularize.rounds=99",), "classify.regularize.rounds"),
        (("classify.regularize.strength=0.1", "thin.rate=0.1"), "thin.rate"),
        (("classify.regularize.strength=0.1", "classify.refine.between=[building, vegetation]"), "classify.refine"),
    ],
)
def test_a_mean_field_that_cannot_be_is_refused_before_anything_is_computed(settings, said):
    with pytest.raises(ConfigError, match=said):
        conf.load("demo", settings)


def test_a_model_with_a_layer_of_a_pair_is_refused_in_words():
    with pytest.raises(ConfigError, match="strength=0"):
        refuse_regularized("model")


@pytest.mark.slow
def test_without_strength_nothing_of_it_is_part_of_a_run(alone):
    assert not list(Store(alone).receipts("model-shares"))
