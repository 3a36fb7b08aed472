"""How much a model is unsure of: counted alike in any tiles, said and judged of models that were given."""

from __future__ import annotations

import json

import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

import fwclass as package
from fwclass import conf
from fwclass.classify.unsure import SAID_FROM, by_percent, judge_unsure, share_below, unlike_files, unsure_facts
from fwclass.errors import QualityError
from fwclass.graph.assess import automation

PARAMS = conf.section("classify", ())
CARD: dict = {}
"""Of a given model, of which nothing is known elsewhere."""


def facts(unsure, of=1000, given=CARD):
    counts = np.zeros(101, np.int64)
    counts[40], counts[99] = unsure, of - unsure
    return unsure_facts(counts, PARAMS, given)


def test_parts_add_up_and_the_bound_itself_is_sure():
    confidence = np.random.default_rng(1).integers(0, 301, 999).astype(np.float32) / np.float32(300)
    confidence[::7] = np.nan
    parts = np.array_split(confidence, 13)
    assert (np.sum([by_percent(p) for p in parts], axis=0) == by_percent(confidence)).all()
    known = confidence[np.isfinite(confidence)]
    share = unsure_facts(by_percent(confidence), PARAMS, CARD)["share"]
    assert share == (np.rint(known.astype(float) * 300) < 180).mean()
    assert unsure_facts(by_percent(np.full(3, np.nan, np.float32)), PARAMS, CARD) is None


def test_it_is_said_and_judged_of_given_models_alone():
    few, some, many = (round(1000 * s) for s in (SAID_FROM - 0.001, SAID_FROM + 0.001, PARAMS.max_unsure + 0.001))
    assert not facts(few)["remarks"] and "unsure of 5.6 %" in facts(some)["remarks"][0]
    judge_unsure(facts(some), PARAMS, "m")
    with pytest.raises(QualityError) as fault:
        judge_unsure(facts(many), PARAMS, "m")
    assert "9.1 %" in str(fault.value) and "suggest" in str(fault.value)
    judge_unsure(facts(many), PARAMS.model_copy(update={"accept_drift": True}), "m")
    judge_unsure(facts(many, given=None), PARAMS, "m")
    assert not facts(many, given=None)["remarks"]
    judge_unsure(None, PARAMS, "m")


def judged(unsure, right, source):
    return {"unsure": unsure, "overall_accuracy": right, "source": source}


def test_what_the_card_knows_of_other_surveys_stands_beside_it():
    card = {"measured": {"left_out": [judged(0.071, 0.911, "town_*.laz"), judged(0.02, 0.96, "hills.laz")]}}
    (remark,) = facts(10, given=card)["remarks"]
    assert "unsure of 1.0 %" in remark and "2.0 % on hills.laz (96.0 % right), 7.1 % on town_*.laz" in remark
    assert "4 to 27 %" not in remark and "4 to 27 %" in facts(80, given=card)["remarks"][0]
    for odd in ({"measured": 3}, {"measured": {"left_out": 7}}, {"measured": {"left_out": [{"source": "a"}]}}):
        assert not facts(10, given=odd)["remarks"]
    other = PARAMS.model_copy(update={"unsure": 0.5})
    assert not unsure_facts(by_percent(np.array([0.4] + 99 * [0.9], np.float32)), other, card)["remarks"]


def test_the_share_that_is_unsure_by_the_curve_that_is_kept():
    rng = np.random.default_rng(5)
    percent = rng.integers(30, 101, 500)
    counts = np.zeros((3, 101), np.int64)
    np.add.at(counts[1], percent, 1)
    for bound in (0.29, 0.6, 1.0):
        assert abs(share_below(automation(counts), bound) - (percent < round(100 * bound)).mean()) < 1e-12
    assert share_below([], 0.6) == 1.0


def test_the_commands_say_it_and_end_with_4(tmp_path):
    survey = small_survey(tmp_path)
    words = ("--model", tmp_path / "m", "--no-assess", "--out", tmp_path / "t", "--workers", 0)
    assert fwclass("train", survey, *words, "--set", "train.trees=5").returncode == 0
    given = ("--set", f"survey.model={tmp_path / 'm'}", "--set", "survey.classes=[]", "--set", "areas.train=[]")
    strict = ("--set", "classify.unsure=1", "--set", "classify.max_unsure=0")
    ended = fwclass("run", survey, "--out", tmp_path / "r", "--workers", 0, *given, *strict)
    assert ended.returncode == 4 and "unsure of too much" in ended.stderr, ended.stderr
    told = json.loads((tmp_path / "r" / "report.json").read_text())["unsure"]
    sure = package.open(tmp_path / "r").echoes(columns=["confidence"]).to_pandas()["confidence"].to_numpy()
    assert told["share"] == (sure < 0.9999).mean() > 0
    accepted = fwclass("run", survey, "--out", tmp_path / "r", "--workers", 0, *given, *strict, "--accept-drift")
    assert accepted.returncode == 0, accepted.stderr
    words = ("classify", tmp_path / "a.las", tmp_path / "o.las", "--model", tmp_path / "m", "--json")
    ended = fwclass(*words, *strict)
    assert ended.returncode == 4 and "unsure of too much" in ended.stderr, ended.stderr
    assert json.loads(ended.stdout)["unsure"]["share"] == told["share"], "the same features and answers as in the run"
    assert fwclass(*words, "--overwrite", "--accept-drift", *strict).returncode == 0


def of_files(**unsure):
    """What `unlike_files` says of files of 2,000 echoes with so many unsure ones each."""
    percent = np.zeros((len(unsure), 101), np.int64)
    percent[:, 30] = list(unsure.values())
    percent[:, 90] = 2000 - percent[:, 30]
    return unlike_files(dict(zip(unsure, percent, strict=True)), PARAMS)


def test_a_file_that_the_average_hides_is_named():
    told = of_files(a=60, b=20, c=250, d=500, e=10)
    assert told["files"] == [["d", 0.25], ["c", 0.125]] and "d 25.0 %, c 12.5 %" in told["remarks"][0]
    assert of_files(a=170, b=10)["files"] == [], "below the bound"
    assert of_files(a=300, b=200, c=250)["files"] == [], "all alike: the average hides nothing"
    assert of_files(a=500)["files"] == [], "there is no other"


def test_a_run_names_the_unlike_file_whatever_the_tiles(tmp_path):
    survey = small_survey(tmp_path)
    assert fwclass("run", survey, "--out", tmp_path / "t", "--workers", 0).returncode == 0
    las = laspy.read(tmp_path / "a.las")
    slope = 200 + 0.05 * (np.asarray(las.x) - 500_000)
    height = np.asarray(las.z) - slope
    las.z = slope + np.where(height > 0.4, height, np.random.default_rng(2).uniform(0, 0.5, len(height)))  # grass
    las.x = np.asarray(las.x) + 80
    las.write(tmp_path / "b.las")
    given = (
        f"survey.model={tmp_path / 't/model'}",
        "survey.classes=[]",
        "areas.train=[]",
        "survey.sources=[a.las,b.las]",
    )
    bounds = ("classify.unsure=1", "classify.max_unsure=0.01", "classify.accept_drift=true", "plausibility.accept=true")
    told = []
    for edge in (50, 40):
        words = [w for s in (*given, *bounds, f"tile.size={edge}") for w in ("--set", s)]
        ended = fwclass("run", survey, "--out", tmp_path / f"r{edge}", "--workers", 0, *words)
        assert ended.returncode == 0 and "as of others, or more (b.las " in ended.stderr, ended.stderr
        told.append(json.loads((tmp_path / f"r{edge}" / "report.json").read_text())["unsure"])
    assert [name for name, _ in told[0]["files"]] == ["b.las"] and told[0] == told[1]
    words += ["--set", "classify.accept_drift=false", "--set", "classify.max_unsure=1"]
    ended = fwclass("run", survey, "--out", tmp_path / "r40", "--workers", 0, *words)
    assert ended.returncode == 4 and "heights are too noisy for a model" in ended.stderr, "grass hides all ground"


# ------------------------------------------------------------------ left without a class

KEYS = ["strip", "pulse", "echo_number"]
LEAVE = ("--set", "classify.leave=1", "--set", "classify.leave_below=1")


def echoes(root):
    table = package.open(root).echoes(columns=[*KEYS, "classification", "confidence"]).to_pandas()
    return table.sort_values(KEYS).reset_index(drop=True)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["in context", "one layer", "thinned"])
def test_unsure_echoes_are_left_and_nothing_else_changes(way, tmp_path):
    more = {"one layer": (), "in context": ("classify.context.cells=[1]",), "thinned": ("thin.rate=0.5",)}[way]
    words = [w for s in more for w in ("--set", s)]
    survey = small_survey(tmp_path)
    for name, settings in (("a", ()), ("b", LEAVE), ("c", (*LEAVE, "--set", "tile.size=40"))):
        ended = fwclass("run", survey, "--out", tmp_path / name, "--workers", 0, *words, *settings)
        assert ended.returncode == 0, ended.stderr
        assert ("got no class but code 1: their confidence is below 1" in ended.stderr) == (name != "a")
    a, b, c = (echoes(tmp_path / name) for name in "abc")
    unsure = a.confidence < 1 - 1e-6
    assert unsure.any() and (b.classification == a.classification.where(~unsure, 1)).all()
    assert (b.confidence.fillna(-1) == a.confidence.fillna(-1)).all() and b.equals(c), "whatever the tiles"
    report = json.loads((tmp_path / "b" / "report.json").read_text())
    assert {"name": "unclassified", "code": 1} in report["classes"]
    assert sum(report["accuracy"]["unclassified"]) > 0, "they are nobody's success"
    strip = laspy.read(tmp_path / "b/laz/strips/a.laz")
    assert np.bincount(strip.classification)[1] == unsure.sum()


def test_how_many_are_left_has_a_bound_of_its_own(tmp_path):
    """Who wants to look at more echoes does not judge the model by them: 0.6 is what the bound was measured with."""
    strict = PARAMS.model_copy(update={"leave": 1, "leave_below": 0.9})
    counts = np.zeros(101, np.int64)
    counts[[40, 80, 99]] = 50, 300, 650
    told = unsure_facts(counts, strict, given=CARD)
    assert (told["share"], told["left"]) == (0.05, 0.35) and len(told["remarks"]) == 1
    judge_unsure(told, strict, "m")


OLD = """
survey: {name: old, directory: ., sources: [a.las], crs: "EPSG:25832", reference: {kind: source}, features: [intensity],
  classes: [{name: ground, code: 2}, {name: plants, code: 64, codes: [5], legacy_code: 20}]}
areas: {train: [[500000, 5400000, 500020, 5400040]], gap: 0}
"""


@pytest.mark.parametrize(
    ("leave", "said"),
    [
        (20, "plants and unsure echoes (classify.leave) would both be written as code 20"),
        (64, "unsure echoes would get the code of a class"),
        (40, "unsure echoes (classify.leave) 40"),
        ("true", "neither true nor false can stand here"),
    ],
)
def test_unsure_echoes_never_share_a_code_in_old_points(leave, said, tmp_path):
    small_survey(tmp_path)
    las = laspy.convert(laspy.read(tmp_path / "a.las"), point_format_id=3)
    las.write(tmp_path / "a.las")
    (tmp_path / "old.yaml").write_text(OLD)
    for command in ("run", "plan"):
        ended = fwclass(command, tmp_path / "old.yaml", "--out", tmp_path / "r", "--set", f"classify.leave={leave}")
        assert ended.returncode == 2 and said in ended.stderr, ended.stderr
        assert not list(tmp_path.glob("r/store/*/*/receipt.json"))


def test_a_file_of_old_points_is_refused_alike(tmp_path):
    survey = small_survey(tmp_path)
    words = ("--model", tmp_path / "m", "--no-assess", "--out", tmp_path / "t", "--workers", 0)
    assert fwclass("train", survey, *words).returncode == 0
    words = ("classify", tmp_path / "a.las", tmp_path / "o.las", "--model", tmp_path / "m", "--legacy-code", "5=1")
    ended = fwclass(*words, "--set", "classify.leave=1")
    assert ended.returncode == 2 and "bush and unsure echoes (classify.leave) would both" in ended.stderr
    assert not (tmp_path / "o.las").exists()


def test_a_code_that_is_a_class_is_refused(tmp_path):
    ended = fwclass("run", small_survey(tmp_path), "--out", tmp_path / "r", "--set", "classify.leave=5")
    assert ended.returncode == 2 and "code of a class" in ended.stderr and not (tmp_path / "r").exists()


@pytest.mark.parametrize("method", ["rbf-svm", "linear-svm"])
def test_confidences_of_a_support_vector_machine_are_told_and_not_judged(method):
    told = facts(300, given={"method": method})
    assert "no probabilities" in told["remarks"][0]
    judge_unsure(told, PARAMS, "m")


def test_a_card_that_tells_numbers_that_are_none_says_nothing_of_strangers():
    card = {"measured": {"left_out": [judged(10**400, 0.9, "a")]}}
    assert "on what it had not seen" not in facts(100, given=card)["remarks"][0]
