"""A model that learns from what it is sure of: whatever the tiles, without labels, and not where it is unsure."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

from fwclass import conf
from fwclass.classify.shares import answer
from fwclass.errors import InputError
from fwclass.hashing import hash_keys
from fwclass.model import ClassDef
from fwclass.store.model_rows import load_rows
from fwclass.store.models import load_model
from fwclass.study.adapted import ADAPTED, SeenEchoes, adapt, draw_seen
from fwclass.train.sample import Sample, kept_sample
from fwclass.train.stage import grow_trees, train

CLASSES = (ClassDef(name="low", code=2, codes=(2,)), ClassDef(name="high", code=5, codes=(5,)))
TRAINING = conf.section("train", ("train.trees=20",))
PARAMS = conf.section("adapt")


def two_clouds(rng: np.random.Generator, n: int, shift: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Two classes that three features tell apart, the first of them `shift` further than at home."""
    y = rng.integers(0, 2, n)
    X = rng.normal(0, 1, (n, 3)) * noise * [0.5, 1.0, 1.0] + np.where(y[:, None] == 1, 1, -1) + [shift, 0, 0]
    return X.astype(np.float32), y.astype(np.uint8)


def learned(X: np.ndarray, y: np.ndarray):
    """A forest of rows, and these as a base."""
    base = kept_sample(("a", "b", "c"), X, np.array([2, 5], np.uint8)[y], CLASSES, CLASSES, 1)
    return train(base, grow_trees(base, CLASSES, 0, TRAINING.trees, TRAINING), TRAINING, CLASSES), base


@pytest.fixture(scope="module")
def moved():
    """A model, its rows, and a survey whose classes lie elsewhere."""
    rng = np.random.default_rng(0)
    model, base = learned(*two_clouds(rng, 4000, 0.0, 0.7))
    return model, base, SeenEchoes(np.arange(9000, dtype=np.uint64), two_clouds(rng, 9000, 0.3, 0.7)[0])


def test_a_round_learns_from_the_base_and_from_what_is_sure(moved):
    """Chosen by other means; tests/bench/bench_adapt.py shows what it is worth."""
    model, base, seen = moved
    adapted = adapt(model, base, seen, PARAMS.model_copy(update={"rounds": 1}), TRAINING)
    winner, shares = answer(seen.X, model)
    share = shares[np.arange(len(winner)), winner]
    chosen = []
    for k in range(2):
        rows = np.flatnonzero((winner == k) & (share >= PARAMS.sure))
        most = int(np.bincount(base.y).max())
        chosen.append(rows[np.argsort(hash_keys(TRAINING.seed, seen.key[rows]), kind="stable")[:most]])
    rows = np.sort(np.concatenate(chosen))
    X, y = np.concatenate([seen.X[rows], base.X]), np.concatenate([winner[rows], base.y]).astype(np.uint8)
    key = np.concatenate([seen.key[rows], base.key])
    assert adapted.card["samples"] == np.bincount(y).tolist()
    digest = Sample(base.features, X, y, key, key, base.eligible).digest
    assert adapted.card["training"] == digest
    facts = adapted.card[ADAPTED]
    assert [len(facts["rounds"]), facts["changed"]] == [2, float((answer(seen.X, adapted)[0] != winner).mean())]
    assert facts["rounds"][0] == {"confidence": share.mean(), "unsure": (share < PARAMS.unsure).mean()}


def test_tiles_and_their_order_change_nothing(moved):
    seen = moved[2]
    whole = draw_seen([seen], 500, 1)
    order = np.random.default_rng(1).permutation(len(seen.key))
    parts = draw_seen((SeenEchoes(seen.key[p], seen.X[p]) for p in np.array_split(order, 9)), 500, 1)
    assert (whole.key == parts.key).all() and (whole.X == parts.X).all() and len(whole.key) == 500


def test_of_a_survey_that_it_is_unsure_of_nothing_is_learned():
    rng = np.random.default_rng(3)
    model, base = learned(*two_clouds(rng, 4000, 0.0, 3.0))
    seen = SeenEchoes(np.arange(4000, dtype=np.uint64), two_clouds(rng, 4000, 0.0, 3.0)[0])
    with pytest.raises(InputError, match="unsure of too many"):
        adapt(model, base, seen, PARAMS, TRAINING)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("adapted")
    survey = small_survey(place)
    words = ("--workers", 0, "--out", place / "t")
    assert fwclass("train", survey, "--model", place / "m", "--keep-rows", 200, *words).returncode == 0
    given = ("--set", f"survey.model={place / 'm'}", "--set", "survey.classes=[]")
    for size in (25, 40):
        ended = fwclass(
            "run", survey, "--out", place / f"r{size}", "--workers", 0, *given, "--set", f"tile.size={size}"
        )
        assert ended.returncode == 0, ended.stderr
    return place


ALL = ("--set", "adapt.most_unsure=1", "--set", "train.trees=5")


def test_the_command_writes_a_model_that_a_run_takes(place: Path) -> None:
    ended = fwclass("adapt", place / "r25", place / "m", place / "a", *ALL)
    assert ended.returncode == 0 and "not right more often" in ended.stderr, ended.stderr
    card = load_model(place / "a").card
    assert "measured" not in card and card["computed"] == load_model(place / "m").card["computed"]
    before, after = load_rows(place / "m")[1], load_rows(place / "a")[1]
    assert (before.X == after.X).all() and (before.codes == after.codes).all()
    again = fwclass(
        "run", place / "s.yaml", "--out", place / "r", "--set", f"survey.model={place / 'a'}", "--workers", 0
    )
    assert again.returncode in (0, 4), again.stderr
    refused = fwclass("adapt", place / "r25", place / "m", place / "a", *ALL)
    assert refused.returncode == 2 and "--overwrite" in refused.stderr


def test_tiles_of_the_run_do_not_matter(place: Path) -> None:
    for size in (25, 40):
        ended = fwclass("adapt", place / f"r{size}", place / "m", place / f"a{size}", *ALL, "--overwrite")
        assert ended.returncode == 0, ended.stderr
    digests = {json.loads((place / f"a{size}" / "card.json").read_text())["digest"] for size in (25, 40)}
    assert len(digests) == 1


def test_what_does_not_fit_is_refused(place: Path, tmp_path: Path) -> None:
    survey = place / "s.yaml"
    other = fwclass(
        "train",
        survey,
        "--model",
        tmp_path / "o",
        "--keep-rows",
        9,
        "--out",
        tmp_path / "t",
        "--workers",
        0,
        "--set",
        "survey.features=[zc]",
        "--no-assess",
    )
    assert other.returncode == 0, other.stderr
    ended = fwclass("adapt", place / "r25", tmp_path / "o", tmp_path / "a")
    assert ended.returncode == 1 and "features of this model" in ended.stderr and not (tmp_path / "a").exists()
    none = fwclass("adapt", place / "r25", place / "t" / "model", tmp_path / "a")
    assert none.returncode == 1 and "Traceback" not in none.stderr
    assert fwclass("adapt", tmp_path, place / "m", tmp_path / "a").returncode == 1
    wrong = fwclass("adapt", place / "r25", place / "m", tmp_path / "a", "--set", "ground.method=csf")
    assert wrong.returncode == 2 and "no effect" in wrong.stderr
