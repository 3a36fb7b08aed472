"""A run that learns from a base model's rows beside its own labels; corrections alone as a reference."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

import fwclass as package
from fwclass import conf
from fwclass.graph import context_training
from fwclass.graph.context_trial import verdict
from fwclass.model import Contextual
from fwclass.run.inputs import PartInputs
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.store.corrections import add_corrections, read_corrections
from fwclass.store.model_rows import load_rows
from fwclass.store.models import load_model
from fwclass.store.run_store import Store
from fwclass.study.training import kept_rows, training

ALONE = ("--set", "survey.reference.kind=corrections", "--set", "areas.train=[]", "--set", "train.base_rows=50")


def sample(root, part):
    return PartInputs(Store(root, read_only=True)).arrays(*part, "sample")[0]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A survey, a model of it that keeps rows, and a run by that model with its best places confirmed."""
    place = tmp_path_factory.mktemp("base")
    survey = small_survey(place)
    ended = fwclass(
        "train", survey, "--model", place / "model", "--keep-rows", 300, "--out", place / "t", "--workers", 0
    )
    assert ended.returncode == 0, ended.stderr
    given = ("--set", f"survey.model={place / 'model'}", "--set", "survey.classes=[]", "--set", "areas.train=[]")
    ended = fwclass("run", survey, "--out", place / "run", "--workers", 0, *given)
    assert ended.returncode == 0, ended.stderr
    words = (place / "run", place / "places.gpkg")
    assert fwclass("suggest", *words, "--size", 5, "--places", 3).returncode == 0
    assert fwclass("label", "confirm", *words).returncode == 0
    return survey, place / "run", place / "model"


def learn(made, root, *settings, workers=0):
    words = ("--set", f"survey.base_model={made[2]}", "--set", "survey.classes=[]", *ALONE)
    more = [w for s in settings for w in ("--set", s)]
    return fwclass("run", made[0], "--out", root, "--workers", workers, *words, *more)


@pytest.fixture(scope="module")
def learned(made, tmp_path_factory):
    root = tmp_path_factory.mktemp("learned") / "run"
    shutil.copytree(made[1], root, symlinks=True)
    ended = learn(made, root)
    assert ended.returncode == 0, ended.stderr
    return root, ended


def test_a_model_keeps_rows_of_every_class(made):
    model, rows = load_rows(made[2])
    assert dict(zip(*np.unique(rows.codes, return_counts=True), strict=True)) == {2: 300, 5: 300}
    assert (
        rows.X.shape == (600, len(model.features))
        and rows.context.shape == (600, 0)
        and model.card["rows"] == {"2": 300, "5": 300}
    )


def test_the_model_learns_from_the_confirmed_echoes_and_base_rows(made, learned):
    root = learned[0]
    own, base = sample(root, ("training", "all")), sample(root, ("base-rows", "all"))
    stands = read_corrections(root).standing()
    assert len(own["y"]) == stands.rows
    counts = np.bincount(own["y"], minlength=2)
    assert np.bincount(base["y"], minlength=2).tolist() == [min(300, max(int(n), 50)) for n in counts]
    kept = load_rows(made[2])[1]
    there = {(*row.tolist(), int(code)) for row, code in zip(kept.X, kept.codes, strict=True)}
    assert {(*row.tolist(), (2, 5)[y]) for row, y in zip(base["X"], base["y"], strict=True)} <= there
    card = load_model(root / "current" / "model").card if (root / "current").exists() else {}
    assert card["samples"] == (counts + np.bincount(base["y"], minlength=2)).tolist()
    report = package.open(root).report
    assert report["model"]["base"] == str(made[2]) and [c["code"] for c in report["model"]["classes"]] == [2, 5]


def test_a_model_that_learned_further_can_be_learned_from_again(made, learned, tmp_path):
    words = ("--set", f"survey.base_model={made[2]}", "--set", "survey.classes=[]", *ALONE, "--no-assess")
    ended = fwclass("train", made[0], "--model", tmp_path / "m", "--keep-rows", 20, "--out", learned[0], *words)
    assert ended.returncode == 0 and "the base model's" in ended.stderr, ended.stderr
    kept = load_rows(tmp_path / "m")[1]
    assert set(kept.codes.tolist()) <= {2, 5} and len(kept.codes) <= 40
    own = sample(learned[0], ("training", "all"))
    there = {(*row.tolist(), (2, 5)[y]) for row, y in zip(own["X"], own["y"], strict=True)}
    assert {(*row.tolist(), int(code)) for row, code in zip(kept.X, kept.codes, strict=True)} <= there


def test_only_what_learns_is_made_anew(made, learned, tmp_path):
    made_anew = {s["name"] for s in package.open(learned[0]).report["stages"] if s["computed"]}
    assert not made_anew & {"read", "split", "tile", "ground-filter", "terrain", "height", "features"}
    again = learn(made, learned[0])
    assert again.returncode == 0 and "base-rows" not in again.stderr.replace("base-rows        1 skipped", "")


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_tiles_and_workers_change_nothing(made, learned, tmp_path, workers):
    shutil.copytree(made[1] / "labels", tmp_path / "run" / "labels")
    ended = learn(made, tmp_path / "run", "tile.size=40", workers=workers)
    assert ended.returncode == 0, ended.stderr
    tables = [
        package.open(r).echoes(columns=["strip", "pulse", "echo_number", "classification", "confidence"]).to_pandas()
        for r in (learned[0], tmp_path / "run")
    ]
    a, b = (t.sort_values(["strip", "pulse", "echo_number"]).reset_index(drop=True) for t in tables)
    assert a.equals(b)


def test_classes_of_a_ready_model_can_be_corrected(made, tmp_path):
    tile = package.open(made[1]).tiles[0]["tile"]
    assert fwclass("label", "checkout", made[1], tmp_path / "out", "--tiles", tile).returncode == 0
    ended = fwclass("label", "collect", tmp_path / "out")
    assert ended.returncode == 0 and "nothing new" in ended.stdout + ended.stderr, ended.stderr


# ------------------------------------------------------------------ in context

CELLS = "classify.context.cells=[1,3]"


@pytest.fixture(scope="module")
def contextual(made, tmp_path_factory):
    """A model of both layers that keeps rows."""
    place = tmp_path_factory.mktemp("contextual")
    ended = fwclass(
        *("train", made[0], "--model", place / "model", "--keep-rows", 200, "--out", place / "t", "--workers", 0),
        *("--set", CELLS),
    )
    assert ended.returncode == 0, ended.stderr
    return made[0], made[1], place / "model"


def only(run, root, code):
    """A run with corrections of one class alone."""
    shutil.copytree(run / "labels", root / "labels")
    path = root / "labels" / "corrections.parquet"
    rows = read_corrections(root)
    path.unlink()
    kept = rows.take(rows.code == code)
    assert 0 < kept.rows < rows.rows
    add_corrections(root, lambda earlier: kept)


def test_both_layers_learn_from_base_rows_though_a_class_has_no_label(contextual, tmp_path):
    model, rows = load_rows(contextual[2])
    assert isinstance(model, Contextual) and rows.X.shape == (400, len(model.features))
    assert rows.context.shape == (400, 2 + 2 * 2 * 2) and model.card["rows"] == {"2": 200, "5": 200}
    assert (rows.context[:, :2].sum(axis=1, dtype=int) - 255 <= 1).all(), "shares of two classes, rounded"
    only(contextual[1], tmp_path / "run", 2)
    ended = learn(contextual, tmp_path / "run")
    assert ended.returncode == 0, ended.stderr
    root = tmp_path / "run"
    base, own = sample(root, ("base-rows", "all")), sample(root, ("training", "all"))
    near = sample(root, ("context-training", "all"))
    assert set(near) == {"context"} and len(near["context"]) == len(own["y"]), "the rows themselves are kept once"
    assert set(own["y"].tolist()) == {0} and own["X"].shape[1] + near["context"].shape[1] == len(model.deciding)
    assert base["X"].shape[1] == len(model.deciding)
    learned = load_model(Store(root, read_only=True).path("train", "model", "model"))
    assert isinstance(learned, Contextual) and learned.cells == model.cells
    rows = len(own["y"]) + len(base["y"])
    assert sum(learned.coarse.card["samples"]) == sum(learned.fine.card["samples"]) == rows
    written = np.unique(package.open(root).echoes(columns=["classification"]).to_pandas()["classification"])
    assert {2, 5} <= set(written.tolist()), "a class without a label is not forgotten"


@pytest.mark.slow
def test_rows_in_context_change_with_neither_tiles_nor_workers(contextual, tmp_path):
    for name, words in (("a", ()), ("b", ("tile.size=40",))):
        shutil.copytree(contextual[1] / "labels", tmp_path / name / "labels")
        ended = learn(contextual, tmp_path / name, *words, workers=2 if words else 0)
        assert ended.returncode == 0, ended.stderr
    keys = ["strip", "pulse", "echo_number"]
    tables = [
        package.open(tmp_path / name).echoes(columns=[*keys, "classification", "confidence"]).to_pandas()
        for name in "ab"
    ]
    a, b = (t.sort_values(keys).reset_index(drop=True) for t in tables)
    assert a.equals(b)


def test_the_context_of_a_base_model_may_be_left_out_or_be_another(contextual, tmp_path):
    shutil.copytree(contextual[1] / "labels", tmp_path / "run" / "labels")
    ended = learn(contextual, tmp_path / "run", "classify.context.cells=[]")
    assert ended.returncode == 0 and "context-training" not in ended.stderr, ended.stderr
    only(contextual[1], tmp_path / "other", 2)
    ended = learn(contextual, tmp_path / "other", "classify.context.cells=[2]")
    assert ended.returncode == 2 and "do not suffice" in ended.stderr, "no row of plants has such a context"
    assert "features" not in ended.stderr.split("do not suffice")[0], "before anything dear is computed"


@pytest.mark.slow
def test_where_it_pays_a_base_model_in_context_brings_its_own_and_one_without_keeps_its_classes(
    contextual, made, tmp_path
):
    only(contextual[1], tmp_path / "run", 2)
    ended = learn(contextual, tmp_path / "run", "classify.context.cells=auto")
    assert ended.returncode == 0 and "context-training" in ended.stderr, ended.stderr
    learned = load_model(Store(tmp_path / "run", read_only=True).path("train", "model", "model"))
    assert isinstance(learned, Contextual) and learned.cells == (1.0, 3.0)
    only(made[1], tmp_path / "other", 2)
    ended = learn(made, tmp_path / "other", "classify.context.cells=auto")
    assert ended.returncode == 0 and "it is not used" in ended.stderr, ended.stderr
    written = np.unique(
        package.open(tmp_path / "other").echoes(columns=["classification"]).to_pandas()["classification"]
    )
    assert {2, 5} <= set(written.tolist())


@pytest.mark.parametrize("why", [(), ("mean IoU does not rise",)])
def test_rows_are_kept_with_their_context_where_it_pays(why, made, tmp_path, monkeypatch):
    monkeypatch.setattr(context_training, "verdict", lambda *tried: replace(verdict(*tried), why=why))
    cells = ("classify.context.cells=auto", "classify.context.auto_cells=[1, 3]", "survey.reference.kind=source")
    config = conf.load(made[0], (*cells, "train.trees=5"))
    with Display() as display:
        runner = Runner(tmp_path / "t", Loop(), display)
        result = training(config, runner, False)
    rows = kept_rows(config, runner.store, 20)
    assert rows.context.shape == (40, 0 if why else 2 + 2 * 2 * 2)
    asked = any("cross-validated" in remark for remark in result["remarks"])
    assert asked == bool(why), "one layer alone is cross-validated, where there are blocks enough"


RENAMED = "survey.classes=[{name: Boden, code: 20, codes: [2]}, {name: Busch, code: 5, codes: [1, 5]}]"


@pytest.mark.slow
def test_rows_are_matched_by_what_codes_mean(contextual, tmp_path):
    """The same model, whatever the classes are called and written as."""
    roots = {}
    for name, settings in (("own", ()), ("renamed", (RENAMED,))):
        shutil.copytree(contextual[1] / "labels", tmp_path / name / "labels")
        ended = learn(contextual, tmp_path / name, *settings)
        assert ended.returncode == 0, ended.stderr
        roots[name] = tmp_path / name
        said = "note: the base model's rows are learned by the codes that they count: ground (2) as Boden (20), bush"
        assert (said in ended.stderr) == (name == "renamed")
    nears = [sample(roots[name], ("context-training", "all"))["context"] for name in roots]
    assert np.array_equal(*nears)
    for part in (("base-rows", "all"), ("training", "all")):
        own, renamed = sample(roots["own"], part), sample(roots["renamed"], part)
        assert all((own[n] == renamed[n]).all() for n in ("y", "key")) and np.array_equal(
            own["X"], renamed["X"], equal_nan=True
        )
    keys = ["strip", "pulse", "echo_number", "classification", "confidence"]
    a, b = (package.open(r).echoes(columns=keys).to_pandas().sort_values(keys[:3]) for r in roots.values())
    assert (np.where(a.classification == 2, 20, a.classification) == b.classification.to_numpy()).all()
    assert (a.confidence.to_numpy() == b.confidence.to_numpy()).all()
    assert any("Boden (20)" in n for n in package.open(roots["renamed"]).report["training"]["notes"])


def test_a_class_that_is_several_here_teaches_nothing_and_is_told(contextual, tmp_path):
    shutil.copytree(contextual[1] / "labels", tmp_path / "run" / "labels")
    several = "survey.classes=[{name: a, code: 2, codes: [2]}, {name: b, code: 5, codes: [4]}, {name: c, code: 6}]"
    ended = learn(contextual, tmp_path / "run", several)
    assert ended.returncode == 2 and "No labelled echo of 'c'" in ended.stderr, ended.stderr
    assert "the base model has no rows of c (6): learned from this survey's labels alone" in ended.stderr
    assert "decides in context, but its classes are others: this run does without" in ended.stderr
    assert "correct or confirm echoes of it" in ended.stderr, "labels are by hand"
    assert "features" not in ended.stderr.split("do not suffice")[0], "before anything dear is computed"


def test_what_compares_on_labels_alone_refuses_a_base_model(made, tmp_path):
    words = ("--set", f"survey.base_model={made[2]}", "--set", "survey.classes=[]")
    for command in (("train", made[0], "--compare", "forest,boosting"), ("select", made[0], "--method", "rffs")):
        ended = fwclass(*command, "--out", tmp_path / "r", *words)
        assert ended.returncode == 2 and "survey.base_model=null" in ended.stderr, ended.stderr


# ------------------------------------------------------------------ what is refused


def refused(made, root, *settings, code=2):
    ended = learn(made, root, *settings)
    assert ended.returncode == code and "Traceback" not in ended.stderr, ended.stderr
    return ended.stderr


def test_without_corrections_it_says_where_they_come_from(made, tmp_path):
    said = refused(made, tmp_path / "none")
    assert "no corrections to learn from" in said and "docs/corrections.md" in said


def test_model_and_base_model_are_one_too_many(made, tmp_path):
    assert "one of them" in refused(made, tmp_path / "r", f"survey.model={made[2]}")


def test_only_a_forest_learns_from_them(made, tmp_path):
    assert "train.method" in refused(made, tmp_path / "r", "train.method=rbf-svm")


def test_other_classes_are_told(made, tmp_path):
    classes = "survey.classes=[{name: wall, code: 20, codes: [20]}, {name: roof, code: 21, codes: [21]}]"
    assert "ground (2)" in refused(made, tmp_path / "r", classes)


@pytest.fixture
def model(made, tmp_path):
    shutil.copytree(made[2], tmp_path / "model")
    return tmp_path / "model"


def damage(model, how):
    rows = model / "rows"
    if how == "none":
        shutil.rmtree(rows)
        card = json.loads((model / "card.json").read_text())
        del card["rows"]
        (model / "card.json").write_text(json.dumps(card))
    elif how == "gone":
        (rows / "X.npy").unlink()
    elif how == "cut":
        (rows / "X.npy").write_bytes((rows / "X.npy").read_bytes()[:500])
    elif how == "others":
        np.save(rows / "codes.npy", np.full(600, 2, np.uint8))
    elif how == "infinite":
        X = np.load(rows / "X.npy")
        X[3] = np.inf
        np.save(rows / "X.npy", X)
    elif how == "reversed":
        np.save(rows / "X.npy", np.load(rows / "X.npy")[::-1])
    elif how == "objects":
        np.save(rows / "codes.npy", np.array([{}] * 600, object), allow_pickle=True)


def test_rows_of_a_model_in_context_have_theirs(contextual, tmp_path):
    for how in ("gone", "others"):
        shutil.copytree(contextual[2], tmp_path / how)
        path = tmp_path / how / "rows" / "context.npy"
        path.unlink() if how == "gone" else np.save(path, np.load(path)[:, 1:])
        shutil.copytree(contextual[1] / "labels", tmp_path / f"r-{how}" / "labels")
        ended = learn((contextual[0], None, tmp_path / how), tmp_path / f"r-{how}")
        assert ended.returncode == 1 and "Traceback" not in ended.stderr, ended.stderr
        assert ("are not there" if how == "gone" else "do not fit its card") in ended.stderr, ended.stderr


@pytest.mark.parametrize("how", ["none", "gone", "cut", "others", "infinite", "reversed", "objects"])
def test_rows_that_are_not_whole_are_refused(how, made, model, tmp_path):
    damage(model, how)
    shutil.copytree(made[1] / "labels", tmp_path / "run" / "labels")
    ended = fwclass(
        "run", made[0], "--out", tmp_path / "run", "--workers", 0, "--set", f"survey.base_model={model}", *ALONE
    )
    assert ended.returncode == 1 and "Traceback" not in ended.stderr, ended.stderr
    assert str(model) in ended.stderr and "rows" in ended.stderr


def test_context_that_a_ready_model_does_not_have_is_refused(made, tmp_path):
    words = ("--set", f"survey.model={made[2]}", "--set", "survey.classes=[]", "--set", "classify.context.cells=[1]")
    ended = fwclass("run", made[0], "--out", tmp_path / "r", *words)
    assert (
        ended.returncode == 2 and "no layer that decides in context" in ended.stderr and not (tmp_path / "r").exists()
    )
