"""What is said beside an accuracy: nothing beside a sound one, and why and what to do beside each kind of weak one."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

from fwclass import conf
from fwclass.assess.blocks import BlockCounts
from fwclass.assess.remarks import Extent, judge_chance, judge_folds, pure_share, remarks
from fwclass.classes import ClassDef
from fwclass.errors import QualityError
from fwclass.graph.street import crown_accuracy
from fwclass.single_file.street.train import crown_lines

SOUND = Extent(echoes=10_000, scored=4_000, others={"66": 20}, apart=15.0, reach=12.0)
FIGURES = {
    "blocks": 40,
    "pure_share": 0.4,
    "confusion": [[90, 10], [10, 90]],
    "kappa": 0.8,
    "intervals": {"kappa": [0.7, 0.9]},
}
CHANCE = {"confusion": [[473, 285], [470, 250]], "kappa": -0.03, "intervals": {"kappa": [-0.06, 0.01]}}


@pytest.fixture(scope="module")
def params():
    return conf.section("assess")


def test_nothing_is_said_beside_a_large_mixed_and_distant_test(params):
    assert remarks(FIGURES, SOUND, params) == []
    assert remarks(FIGURES, replace(SOUND, apart=None), params) == [], "a model that learned elsewhere"
    assert remarks({**FIGURES, "pure_share": None}, SOUND, params) == []


@pytest.mark.parametrize(
    ("figures", "tested", "words"),
    [
        ({"blocks": 19}, SOUND, ("19 squares of 25 m", "test on 20 squares or more")),
        ({"blocks": 4}, SOUND, ("4 squares", "no interval is told below 5")),
        (
            {"blocks": 19},
            replace(SOUND, apart=30.0, reach=27.0),
            ("19 squares of 25 m", "20 squares or more of 54 m", "larger survey or smaller training areas"),
        ),
        ({}, replace(SOUND, apart=30.0, reach=27.0), ("intervals of the accuracy are too narrow", "assess.block=54")),
        ({}, replace(SOUND, others={"1": 300, "0": 9}), ("1 (300 echoes)", "nobody has sorted them")),
        (CHANCE, SOUND, ("Kappa is -0.030 (-0.060 to 0.010)", "labels those of these echoes")),
        ({"pure_share": 0.95}, SOUND, ("95 % of the tested echoes", "label whole places")),
        ({}, replace(SOUND, apart=2.0), ("tested 2 m", "reaches 12 m", "--set areas.gap=12")),
        ({}, replace(SOUND, scored=360), ("3.6 % of the echoes were tested", "label places of every kind")),
        ({}, replace(SOUND, others={"17": 300, "9": 1}), ("3.0 %", "17 (300 echoes), 9 (1 echoes)", "survey.classes")),
    ],
)
def test_every_weakness_has_a_remark_of_its_own(figures, tested, words, params):
    told = remarks({**FIGURES, **figures}, tested, params)
    assert len(told) == 1 and all(word in told[0] for word in words), told


def test_classes_by_chance_end_with_4_and_one_class_or_few_blocks_do_not(params):
    for figures in (CHANCE, {**CHANCE, "intervals": None}, {**CHANCE, "kappa": 0.01, "intervals": None}):
        with pytest.raises(QualityError, match="no better than chance"):
            judge_chance({**FIGURES, **figures}, False, "s.yaml")
        judge_chance({**FIGURES, **figures}, True, "s.yaml")
    judge_chance(FIGURES, False, "s.yaml")
    judge_chance({**FIGURES, "intervals": {"kappa": None}}, False, "s.yaml")
    judge_chance({**FIGURES, "intervals": {"kappa": [0.0, 0.9]}}, False, "s.yaml")
    judge_chance({**FIGURES, "confusion": [[60, 40], [40, 60]], "kappa": 0.2, "intervals": None}, False, "s.yaml")
    judge_chance({**FIGURES, "confusion": [[100, 0], [0, 0]], "kappa": 0.0, "intervals": None}, False, "s.yaml")
    judge_chance({**FIGURES, "confusion": [[0, 0], [0, 0]], "kappa": None, "intervals": None}, False, "s.yaml")


def test_crowns_by_chance_are_told_beside_their_figures():
    """`street train` told an error of 51 % and a kappa of 0.0004, and ended with 0."""
    counts = np.zeros((1, 2, 3), np.int64)
    counts[0, :, :2] = [[15_000, 14_000], [113_000, 105_500]]
    classes = [ClassDef("crown", 5, (5,)), ClassDef("other", 1, (1,))]
    accuracy = crown_accuracy(BlockCounts(np.zeros((1, 2), np.int64), counts), classes)
    assert accuracy["intervals"] is None and abs(accuracy["kappa"]) < 0.01
    assert "chance may agree with the reference as well" in crown_lines(accuracy)[-1]
    with pytest.raises(QualityError, match="no better than chance"):
        judge_chance(accuracy, False, "street.yaml")


def test_labels_of_other_echoes_are_told_by_a_run(tmp_path):
    """Their figure, 49 %, stood there alone, with exit code 0."""
    survey = small_survey(tmp_path)
    las = laspy.read(tmp_path / "a.las")
    las.classification = np.random.default_rng(1).permutation(np.asarray(las.classification))
    las.write(tmp_path / "a.las")
    line = ("run", survey, "--out", tmp_path / "r", "--workers", 0)
    ended = fwclass(*line)
    assert ended.returncode == 4 and "chance may agree with the reference as well" in ended.stderr, ended.stderr
    assert "chance may agree with the reference as well" in (tmp_path / "r" / "report.html").read_text()
    assert fwclass(*line, "--accept-implausible").returncode == 0
    ended = fwclass("train", survey, "--model", tmp_path / "m", *line[2:])
    assert ended.returncode == 4 and "no better than chance does" in ended.stderr, ended.stderr
    assert (tmp_path / "m" / "card.json").is_file()


def test_exchanged_codes_are_told_though_the_classifier_learns_them(tmp_path):
    """100.0 % overall, exit code 0: what is tested was exchanged as well."""
    survey = small_survey(tmp_path)
    las = laspy.read(tmp_path / "a.las")
    codes = np.asarray(las.classification)
    las.classification = np.where(codes == 2, 5, 2)
    las.write(tmp_path / "a.las")
    ended = fwclass("run", survey, "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 4 and "not what the reference calls ground" in ended.stderr, ended.stderr
    assert "hardly agree on what is ground (kappa -" in ended.stderr


def test_blocks_of_one_class_are_pure_but_for_strays():
    blocks = np.zeros((4, 2, 3), np.int64)
    blocks[0] = [[100, 0, 0], [0, 0, 0]]
    blocks[1] = [[0, 1, 0], [90, 9, 100]]  # 199 of 200 of one class, whatever was called
    blocks[2] = [[60, 0, 0], [0, 40, 0]]
    assert pure_share(blocks) == pytest.approx(300 / 400)
    assert pure_share(blocks[3:]) is None


@pytest.mark.parametrize(
    ("kappa", "spread", "folds", "refused"),
    [
        (0.01, 0.02, 5, True),
        (0.1, 0.02, 5, False),
        (0.15, 0.2, 5, True),
        (0.25, 0.5, 5, False),
        (-0.1, 0.0, 3, True),
        (None, None, 5, False),
        (0.0, None, 1, False),
    ],
)
def test_folds_that_agree_by_chance_are_refused(kappa, spread, folds, refused):
    validated = {"kappa": kappa, "kappa_std": spread, "folds": folds}
    judge_folds(validated, True, "here")
    with pytest.raises(QualityError, match="no better than chance") if refused else contextlib.nullcontext():
        judge_folds(validated, False, "here")
