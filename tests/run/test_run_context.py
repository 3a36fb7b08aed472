"""A layer that decides in context in a run: tiles, workers and a restart change nothing; its model travels."""

import contextlib
import html
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from commandline import fwclass
from runmaker import SETTINGS, delivered, delivered_echoes, looked, walk

import fwclass as fwclass_package
from fwclass import conf
from fwclass.delivery.viewed_echo import BehindEchoes
from fwclass.errors import ConfigError, InputError
from fwclass.graph import context_training
from fwclass.graph.context_folds import _folds_at, _squares_around, squares_of
from fwclass.graph.context_layer import context_layer, tries
from fwclass.graph.context_trial import Weighing, verdict
from fwclass.operate.seams.walk import SeamRequest, seams
from fwclass.operate.status.walk import Silent
from fwclass.report.summary import summary
from fwclass.run.cluster import Cluster
from fwclass.run.inputs import PartInputs
from fwclass.run.part import execute
from fwclass.schema import IDENTITY
from fwclass.store.models import load_model
from fwclass.store.run_store import Store
from fwclass.train.sample import Sample
from fwclass.walk.steps import plan_with_features

LAYER = (
    "classify.context.cells=[0.5, 1, 2.5]",
    "classify.context.folds=3",
    "select.block=20",
    "train.samples_per_class=800",
    "train.importance_repeats=0",
)


@pytest.fixture(scope="module")
def in_context(survey, tmp_path_factory):
    root = tmp_path_factory.mktemp("context")
    runner, report = walk(survey, root, *LAYER)
    assert not runner.failures, runner.failures
    return root, report


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["tile.size=37.5", "tile.size=150", "tile.size=1000"])
def test_tiles_change_no_answer(setting, survey, in_context, tmp_path):
    runner, _ = walk(survey, tmp_path, setting, *LAYER)
    assert not runner.failures
    before, after = delivered_echoes(in_context[0]), delivered_echoes(tmp_path)
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)


@pytest.mark.slow
def test_workers_give_the_same_bytes_and_a_restart_computes_nothing(survey, in_context, tmp_path):
    runner, _ = walk(survey, tmp_path, *LAYER, executor=Cluster(None, 2, 4.0, 1000))
    assert not runner.failures
    assert delivered(tmp_path) == delivered(in_context[0])
    again, _ = walk(survey, tmp_path, *LAYER)
    assert not [n for n, one in again.outcomes.items() if one.status == "computed" and n[0] != "report"]
    assert looked(survey, tmp_path, *LAYER).all_done


@pytest.mark.slow
def test_seams_are_none_and_the_stages_are_compared(survey, in_context):
    settings = (*SETTINGS, f"survey.directory={survey}", "seams.width=4", "seams.share=1", *LAYER)
    config = conf.load("demo", settings)
    compared = seams(config, in_context[0], SeamRequest((50.0, 50.0), config.seams.share, None, None), Silent())
    assert {"first-shares", "classify"} <= {s.stage for s in compared.bounded}
    assert all(s.differ == 0 for s in compared.bounded)


@pytest.mark.slow
def test_its_model_classifies_another_run_and_a_file(survey, in_context, tmp_path):
    model = in_context[0] / "model"
    card = load_model(model).card
    judged = card["context"]["judged"]
    assert judged["rows"] > 500 and 0.5 < judged["first"] / judged["rows"] <= 1
    assert any("squares of the training areas" in note for note in card["notes"]), "what the layer gains is said"
    runner, _ = walk(survey, tmp_path / "run", f"survey.model={model}", "survey.reference.kind=none")
    assert not runner.failures
    before, after = delivered_echoes(in_context[0]), delivered_echoes(tmp_path / "run")
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    strip = sorted((survey / "strips").glob("*.las"))[0]
    words = ("--set", "ground.block=64", "--set", "ground.max_building_size=50")
    files = []
    for size in ("30", "500"):
        out = tmp_path / f"{size}.laz"
        line = ("classify", strip, out, "--model", model, "--json", *words, "--set", f"tile.size={size}")
        described = json.loads(fwclass(*line).stdout)
        assert described["kind"] == "contextual" and len(described["classes"]) > 2
        files.append(out.read_bytes())
    assert files[0] == files[1]


@pytest.mark.slow
def test_weights_of_the_classes_are_learned_told_and_decide(survey, in_context, tmp_path, monkeypatch):
    heavy = (3.0, *(1.0 for _ in load_model(in_context[0] / "model").classes[1:]))
    monkeypatch.setattr(context_training, "weighing", lambda *_: Weighing(heavy, "ground weighs 3"))
    runner, report = walk(survey, tmp_path / "run", *LAYER, "classify.context.most_weight=3")
    assert not runner.failures
    assert load_model(tmp_path / "run" / "model").weights == heavy
    assert report["training"]["context_trial"].endswith("; ground weighs 3")
    assert "ground weighs 3" in report["training"]["notes"]
    before, after = delivered_echoes(in_context[0]), delivered_echoes(tmp_path / "run")
    ground = before["classification"] == 2
    assert (after["classification"][ground] == 2).all() and (after["classification"][~ground] == 2).any()
    assert after["confidence"].max() <= 1


@pytest.mark.slow
def test_an_explanation_gives_the_shares_that_decided(in_context, tmp_path):
    """At borders of tiles too, where neighbours in other tiles count."""
    run = fwclass_package.open(in_context[0])
    behind, every = BehindEchoes(run), run.echoes().to_arrow().to_pydict()
    border = [k for k, x in enumerate(every["x"]) if abs(x % 100 - 50) > 49.5][:3]
    for k in (0, 500, *border):
        row = {n: every[n][k] for n in IDENTITY}
        why = run.explain(row)
        assert max(why.shares.values()) == pytest.approx(every["confidence"][k], abs=1e-3)
        assert any(name.startswith("share_") for name, _, _ in why.features)
        who = PartInputs(Store(run.root)).table("tile", why.tile, IDENTITY)
        at = np.flatnonzero(np.logical_and.reduce([who[n] == row[n] for n in IDENTITY]))[0]
        assert behind.why(why.tile, int(at))["shares"] == pytest.approx(why.shares)
    shutil.copytree(in_context[0], tmp_path / "r", symlinks=True)
    shutil.rmtree(tmp_path / "r" / "store" / "first-shares")
    with pytest.raises(InputError, match="not kept any more"):
        fwclass_package.open(tmp_path / "r").explain(row)


class Pieces:
    """Every part as on a worker that runs short of memory."""

    address = ""

    def run(self, root, tasks):
        for task in tasks:
            yield execute(root, task, split=3)


def digests_of(root, stages):
    store = Store(root)
    return {(stage, r.part): r.digest for stage in stages for r in store.receipts(stage)}


@pytest.mark.slow
def test_short_memory_changes_no_byte(survey, in_context, tmp_path):
    """Parts once more, every tile in nine pieces."""
    shutil.copytree(in_context[0], tmp_path / "r", symlinks=True)
    again = ("fold-shares", "context-sample", "first-shares", "classify")
    before = digests_of(tmp_path / "r", again)
    for stage in again:
        shutil.rmtree(tmp_path / "r" / "store" / stage)
    walk(survey, tmp_path / "r", *LAYER, executor=contextlib.nullcontext(Pieces()))
    assert digests_of(tmp_path / "r", again) == before and len(before) > 8


@pytest.mark.slow
def test_another_training_row_changes_what_follows_and_features_stay(survey, in_context, tmp_path):
    shutil.copytree(in_context[0], tmp_path / "r", symlinks=True)
    runner, _ = walk(survey, tmp_path / "r", *LAYER, "train.seed=2")
    computed = {n[0] for n, one in runner.outcomes.items() if one.status == "computed"}
    assert {"fold-models", "fold-shares", "context-sample", "train", "first-shares", "classify"} <= computed
    assert not {"features", "ground-filter", "tile"} & computed


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (("classify.context.cells=[1, 0.5]",), "edges must rise"),
        (("classify.context.cells=[0.333]",), "whole centimetres"),
        (("classify.context.cells=[200]",), "classify.context.cells"),
        (("classify.context.cells=[0.01]",), "classify.context.cells"),
        (("classify.context.folds=1",), "classify.context.folds"),
        (("classify.context.cells=[1]", "thin.rate=0.1"), "thin.rate"),
        (("classify.context.cells=[1]", "classify.refine.between=[building, vegetation]"), "classify.refine"),
    ],
)
def test_a_layer_that_cannot_be_is_refused_before_anything_is_computed(settings, told):
    with pytest.raises(ConfigError, match=told):
        conf.load("demo", settings)


def rows_at(x, y):
    n = len(x)
    place = np.stack([x, y], axis=1).astype(np.int64)
    key, one = np.arange(n, dtype=np.uint64), np.array([n], np.int64)
    return Sample(("zc",), np.zeros((n, 1), np.float32), np.zeros(n, np.uint8), key, key, one, one, place)


def test_squares_are_halved_where_training_areas_are_small():
    r = np.random.default_rng(1)
    division, edge = squares_of(rows_at(r.uniform(0, 12e3, 200), r.uniform(0, 12e3, 200)), 25.0, 3.0, 4)
    assert edge == 6.25 and set(division.fold.tolist()) == {0, 1, 2, 3}
    division, edge = squares_of(rows_at(np.array([0.0, 9e3, 9e3]), np.array([0.0, 0.0, 9e3])), 25.0, 3.0, 5)
    assert edge == 3.125 and len(division.near) == 3, "fewer folds where there are fewer squares"
    with pytest.raises(InputError, match="too small to learn the context"):
        squares_of(rows_at(np.full(9, 100.0), np.full(9, 100.0)), 25.0, 3.0, 4)
    division, _ = squares_of(rows_at(np.full(9, 100.0), np.full(9, 100.0)), 25.0, 3.0, 4, alone=True)
    assert len(division.near) == 1 and not division.trains(0).any(), "one layer is all that can be learned"


@pytest.mark.slow
@pytest.mark.parametrize("cells", ["[0.5, 1, 2.5]", "auto"])
def test_training_areas_of_a_few_metres_still_learn(cells, survey, tmp_path):
    """Classes stand in one fold alone, or there are fewer squares than folds."""
    settings = (*LAYER[1:], f"classify.context.cells={cells}")
    runner, _ = walk(survey, tmp_path, *settings, "areas.train=[[512000, 5403000, 512012, 5403012]]", "select.block=5")
    assert not runner.failures, runner.failures


def test_the_fold_of_an_echo_is_that_of_its_square():
    r = np.random.default_rng(2)
    squares = np.unique(r.integers(-9, 9, (60, 2)), axis=0)
    fold = r.integers(0, 4, len(squares))
    x, y = r.integers(-12, 12, (2, 900))
    of = {tuple(s): f for s, f in zip(squares.tolist(), fold.tolist(), strict=True)}
    expected = [of.get((a, b), -1) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    np.testing.assert_array_equal(_folds_at(x, y, squares, fold), expected)


def test_shares_are_asked_of_all_that_a_row_of_the_sample_reaches_and_of_no_more_than_two_squares_around():
    """What lies within the context's reach of a row is asked, or the row would see noughts; what lies two squares away
    is not, which is most of a large tile with a small training area."""
    r = np.random.default_rng(4)
    place, halo = r.integers(-9_000, 9_000, (40, 2)), 1_500
    around = _squares_around(place, halo)
    asked = r.integers(-14_000, 14_000, (4_000, 2))
    away = np.abs(asked[:, None] - place).max(axis=2).min(axis=1)
    near = _folds_at(asked[:, 0] // halo, asked[:, 1] // halo, around, np.zeros(len(around), np.int64)) == 0
    assert near[away <= halo].all() and not near[away >= 2 * halo].any() and 0.1 < near.mean() < 0.9


AUTO = ("classify.context.cells=auto", "classify.context.auto_cells=[0.5, 1, 2.5]", *LAYER[1:])


def answers(root):
    """What is delivered of the echoes, byte by byte: all but the model, whose card says what was tried."""
    return {name: digest for name, digest in delivered(root).items() if not name.startswith("model/")}


@pytest.fixture(scope="module")
def one_layer(survey, begun):
    root = begun("one")
    runner, _ = walk(survey, root, *LAYER, "classify.context.cells=[]")
    assert not runner.failures
    return root


def said(why):
    """`verdict`, with other reasons."""

    def judge(*arguments):
        return replace(verdict(*arguments), why=why)

    return judge


@pytest.fixture(scope="module")
def given_up(survey, begun):
    """A run whose second layer does not pay."""
    root = begun("given-up")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(context_training, "verdict", said(("mean IoU does not rise",)))
        runner, report = walk(survey, root, *AUTO)
    assert not runner.failures, runner.failures
    return root, report


@pytest.mark.slow
def test_where_a_second_layer_does_not_pay_a_run_answers_as_with_one(given_up, one_layer):
    root, report = given_up
    assert answers(root) == answers(one_layer)
    trial = report["training"]["context_trial"]
    assert trial.endswith("it is not used, as mean IoU does not rise") and "squares of the training areas" in trial
    assert report["training"]["in_context"] is None and trial in report["training"]["notes"]
    assert trial in summary(report, root) and trial in load_model(root / "model").card["notes"]
    assert trial.removeprefix("t") in html.unescape((root / "report.html").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["tile.size=37.5", "tile.size=1000"])
def test_whether_it_pays_does_not_depend_on_tiles(setting, survey, tmp_path):
    told, before = [], []
    for name, more in (("one", ()), ("other", (setting,))):
        runner, report = walk(survey, tmp_path / name, *more, *AUTO)
        assert not runner.failures
        told.append(report["training"]["context_trial"])
        before.append(delivered_echoes(tmp_path / name))
    assert told[0] == told[1]
    for column in before[0]:
        np.testing.assert_array_equal(before[0][column], before[1][column], err_msg=column)


@pytest.mark.slow
def test_workers_try_it_likewise_and_a_restart_computes_nothing(survey, tmp_path):
    first, _ = walk(survey, tmp_path / "one", *AUTO)
    runner, _ = walk(survey, tmp_path / "two", *AUTO, executor=Cluster(None, 2, 4.0, 1000))
    assert not first.failures and not runner.failures
    assert delivered(tmp_path / "one") == delivered(tmp_path / "two")
    assert looked(survey, tmp_path / "two", *AUTO).all_done


@pytest.mark.slow
def test_a_run_without_the_layer_that_it_tried_is_seamless_explained_and_its_model_travels(survey, given_up, tmp_path):
    root = given_up[0]
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", "seams.width=4", "seams.share=1", *AUTO))
    compared = seams(config, root, SeamRequest((50.0, 50.0), config.seams.share, None, None), Silent())
    assert {"first-shares", "classify"} <= {s.stage for s in compared.bounded}
    assert all(s.differ == 0 for s in compared.bounded)
    run = fwclass_package.open(root)
    every = run.echoes().to_arrow().to_pydict()
    why = run.explain({n: every[n][500] for n in IDENTITY})
    assert max(why.shares.values()) == pytest.approx(every["confidence"][500], abs=1e-3)
    assert BehindEchoes(run).why(why.tile, 0)["shares"]
    model = ("survey.reference.kind=none", "classify.context.cells=auto", f"survey.model={root / 'model'}")
    runner, _ = walk(survey, tmp_path / "run", *model)
    assert not runner.failures
    before, after = delivered_echoes(root), delivered_echoes(tmp_path / "run")
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)


@pytest.mark.parametrize(
    "other", ["train.method=boosting", "thin.rate=0.5", "classify.refine.between=[building, vegetation]"]
)
def test_what_a_second_layer_cannot_stand_behind_is_run_without(other):
    plan = plan_with_features(conf.load("demo", ("classify.context.cells=auto", other)))
    assert context_layer(plan) is None and not tries(plan)


@pytest.mark.slow
def test_where_a_second_layer_pays_it_is_that_of_the_same_cells(survey, in_context, tmp_path, monkeypatch):
    monkeypatch.setattr(context_training, "verdict", said(()))
    runner, report = walk(survey, tmp_path, *AUTO)
    assert not runner.failures
    assert answers(tmp_path) == answers(in_context[0])
    assert report["training"]["in_context"] == [0.5, 1, 2.5]
