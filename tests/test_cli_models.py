"""Models that have a name, and how good they are on sources that were left out."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import laspy
import pytest
from commandline import fwclass
from modelmaker import models
from smallsurvey import small_survey

import fwclass as package
from fwclass.store.installed_models import VARIABLE, installed_models, model_location
from fwclass.store.models import load_model, save_model
from fwclass.study.installed import describe, facts_of_models


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small survey as three files side by side, and a model that each of them has judged."""
    place = tmp_path_factory.mktemp("named")
    small_survey(place)
    whole = laspy.read(place / "a.las")
    for k in range(3):
        part = laspy.LasData(whole.header)
        part.points = whole.points[(whole.x >= 500_000 + 20 * k) & (whole.x < 500_020 + 20 * k)]
        part.write(place / f"p{k}.las")
    (place / "a.las").unlink()
    text = (place / "s.yaml").read_text().replace("[a.las]", "[p0.las, p1.las, p2.las]")
    (place / "s.yaml").write_text(text)
    line = ("train", place / "s.yaml", "--model", place / "shelf" / "town", "--out", place / "run", "--workers", "0")
    told = fwclass(*line, "--leave-out", "--json", "--set", "areas.train=all")
    assert told.returncode == 0, told.stderr
    (place / "told.json").write_text(told.stdout)
    return place


def test_every_source_is_judged_by_a_model_of_the_others(place: Path) -> None:
    told = json.loads((place / "told.json").read_text())
    assert [one["source"] for one in told["left_out"]] == ["p0.las", "p1.las", "p2.las"]
    judged = sum(one["echoes"] for one in told["left_out"])
    total = sum(laspy.read(place / f"p{k}.las").header.point_count for k in range(3))
    assert 0.9 * total < judged < total, "neighbours of what trained, within areas.gap, are not judged"
    card = load_model(place / "shelf" / "town").card
    assert card["measured"]["left_out"] == told["left_out"]
    assert sum(card["eligible"]) == total, "the model itself is trained on all"
    alone = ("run", place / "s.yaml", "--out", place / "alone", "--workers", "0")
    ended = fwclass(*alone, "--set", "areas.train={files: [p1.las, p2.las]}", "--set", "areas.test={files: [p0.las]}")
    assert ended.returncode in (0, 4), ended.stderr
    same = json.loads((place / "alone" / "report.json").read_text())["accuracy"]
    assert same["confusion"] == told["left_out"][0]["confusion"], "as a run that trains on the others says"
    answers = package.open(place / "alone").echoes(columns=["x", "confidence"]).to_pandas()
    unsure = (answers.confidence[answers.x < 500_020] < 0.6 - 1e-6).mean()
    assert abs(told["left_out"][0]["unsure"] - unsure) < 1e-12


def test_a_model_is_used_by_its_name(place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("FWCLASS_MODELS", str(place / "shelf"))
    shutil.copytree(place / "shelf", tmp_path / "more")
    (tmp_path / "more" / "town" / "card.json").write_text("{}")
    listed = fwclass("models")
    assert listed.returncode == 0 and "p1.las" in listed.stdout and "% right" in listed.stdout
    assert listed.stdout.count("by all others, unsure of") == 3
    by_name = fwclass("classify", place / "p0.las", tmp_path / "a.laz", "--model", "town", "--accept-drift")
    by_path = fwclass(
        "classify", place / "p0.las", tmp_path / "b.laz", "--model", place / "shelf" / "town", "--accept-drift"
    )
    assert by_name.returncode == by_path.returncode == 0, by_name.stderr
    assert "on what it had not seen it was unsure of" in by_name.stderr and "% on p2.las" in by_name.stderr
    run = ("run", place / "s.yaml", "--out", tmp_path / "r", "--workers", "0", "--set", "survey.classes=[]")
    ended = fwclass(*run, "--set", "areas.train=[]", "--set", "survey.model=town", "--accept-drift")
    assert ended.returncode == 0 and "% on p2.las" in ended.stderr, ended.stderr
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
    planned = fwclass("plan", place / "s.yaml", "--out", tmp_path / "plan", "--set", "survey.model=town")
    assert planned.returncode == 0, planned.stderr
    unknown = fwclass("classify", place / "p0.las", tmp_path / "c.laz", "--model", "village")
    assert unknown.returncode != 0 and "`fwclass models`" in unknown.stderr
    monkeypatch.setenv("FWCLASS_MODELS", str(tmp_path / "more"))
    damaged = fwclass("models")
    assert damaged.returncode == 0 and "damaged" in damaged.stdout
    assert json.loads(fwclass("models", "--json").stdout)[0]["fault"]


def test_a_strangers_card_is_listed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Classes without a name, and figures that no float holds."""
    made, judged = models()["forest"], {"tested": {"overall_accuracy": 10**400, "kappa": 0, "mean_iou": 0, "echoes": 1}}
    classes = [{"code": c["code"], "codes": c["codes"]} for c in made.card["classes"]]
    save_model(tmp_path / "town", replace(made, card={**made.card, "classes": classes, "measured": judged}))
    monkeypatch.setenv("FWCLASS_MODELS", str(tmp_path))
    listed = fwclass("models")
    assert listed.returncode == 0 and "2 2, 3 3, 4 4" in listed.stdout, listed.stderr
    assert json.loads(fwclass("models", "--json").stdout)[0]["classes"][0] == {"name": "2", "code": 2}


def test_a_path_goes_before_a_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    save_model(tmp_path / "shelf" / "town", models()["forest"])
    monkeypatch.setenv("FWCLASS_MODELS", str(tmp_path / "shelf"))
    assert installed_models()["town"] == tmp_path / "shelf" / "town"
    assert model_location("town", tmp_path) == tmp_path / "shelf" / "town"
    assert model_location("./town", tmp_path) == tmp_path / "town"
    assert model_location("x/town", tmp_path) == tmp_path / "x" / "town"
    (tmp_path / "town").mkdir()
    assert model_location("town", tmp_path) == tmp_path / "town"


def test_no_model_has_a_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("FWCLASS_MODELS", raising=False)
    assert "no model has a name" in fwclass("models").stdout
    monkeypatch.setenv("FWCLASS_MODELS", str(tmp_path / "none"))
    told = fwclass("models").stdout
    assert "no model has a name" in told and "does not exist" in told and str(tmp_path / "none") in told


def test_the_variable_may_name_a_model_itself(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    save_model(tmp_path / "town", models()["forest"])
    monkeypatch.setenv("FWCLASS_MODELS", str(tmp_path / "town"))
    assert installed_models()["town"] == tmp_path / "town" and "fine" not in installed_models()


def test_what_a_model_had_right_on_its_test_areas_is_listed(
    place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    words = ("--workers", "0", "--set", "areas.train={files: [p0.las, p1.las]}", "--set", "areas.gap=0")
    told = fwclass(
        "train", place / "s.yaml", "--model", tmp_path / "m" / "t", "--out", tmp_path / "r", "--json", *words
    )
    assert told.returncode == 0, told.stderr
    accuracy = json.loads(told.stdout)["accuracy"]
    tested = load_model(tmp_path / "m" / "t").card["measured"]["tested"]
    assert tested["overall_accuracy"] == accuracy["overall_accuracy"]
    assert tested["echoes"] == sum(map(sum, accuracy["confusion"])) > 0
    monkeypatch.setenv("FWCLASS_MODELS", str(tmp_path / "m"))
    assert f"{100 * accuracy['overall_accuracy']:.1f} % right" in fwclass("models").stdout


@pytest.mark.parametrize("ranges", ["text", {}, {"zc": "a"}, {"zc": [1]}, {"zc": [2.0, 1.0]}, {"zc": [True, 2]}])
def test_usual_values_that_are_none_are_refused(ranges: object, place: Path, tmp_path: Path) -> None:
    """Without them nobody would be told that data are unlike the model's own."""
    shutil.copytree(place / "shelf" / "town", tmp_path / "m")
    card = json.loads((tmp_path / "m" / "card.json").read_text())
    card["ranges"] = ranges if not isinstance(ranges, dict) or not ranges else {**card["ranges"], **ranges}
    (tmp_path / "m" / "card.json").write_text(json.dumps(card))
    ended = fwclass("classify", place / "p0.las", tmp_path / "c.laz", "--model", tmp_path / "m")
    assert ended.returncode == 1 and "ranges" in ended.stderr and not (tmp_path / "c.laz").exists()


@pytest.mark.parametrize("setting", ["classify.context.cells=[2]", "classify.refine.between=[ground, bush]"])
def test_what_only_training_obeys_is_refused(setting: str, place: Path, tmp_path: Path) -> None:
    words = ("--model", place / "shelf" / "town", "--set", setting)
    ended = fwclass("classify", place / "p0.las", tmp_path / "c.laz", *words)
    assert ended.returncode == 2 and "no effect" in ended.stderr, ended.stderr


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (("--leave-out", "--set", "survey.sources=[p0.las]"), "one source cannot be left out"),
        (("--leave-out", "--compare", "all"), "--leave-out"),
    ],
)
def test_what_cannot_be_left_out_is_refused(place: Path, tmp_path: Path, more: tuple[str, ...], told: str) -> None:
    model = () if "--compare" in more else ("--model", tmp_path / "m")
    ended = fwclass("train", place / "s.yaml", "--out", tmp_path / "r", "--workers", "0", *model, *more)
    assert ended.returncode == 2 and told in ended.stderr, ended.stderr
    assert not (tmp_path / "m").exists()


def test_no_name_of_a_directory_reaches_the_terminal_raw(tmp_path, monkeypatch):
    (tmp_path / "a\x1b[31m\nb").mkdir()
    (tmp_path / "a\x1b[31m\nb" / "card.json").write_text("{}")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    told = describe(facts_of_models())
    assert "a\\x1b[31m\\nb" in told and "\x1b" not in told
