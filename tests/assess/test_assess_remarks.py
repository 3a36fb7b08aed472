"""What is said beside an accuracy: nothing beside a sound one, and why and what to do beside each kind of weak one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fwclass import conf
from fwclass.assess.remarks import Extent, pure_share, remarks

SOUND = Extent(echoes=10_000, scored=4_000, others={"66": 20}, apart=15.0, reach=12.0)
FIGURES = {"blocks": 40, "pure_share": 0.4}


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
        ({"pure_share": 0.95}, SOUND, ("95 % of the tested echoes", "label whole places")),
        ({}, replace(SOUND, apart=2.0), ("Tested 2 m", "reaches 12 m", "--set areas.gap=12")),
        ({}, replace(SOUND, scored=360), ("3.6 % of the echoes were tested", "label places of every kind")),
        ({}, replace(SOUND, others={"17": 300, "9": 1}), ("3.0 %", "17 (300 echoes), 9 (1 echoes)", "survey.classes")),
    ],
)
def test_every_weakness_has_a_remark_of_its_own(figures, tested, words, params):
    told = remarks({**FIGURES, **figures}, tested, params)
    assert len(told) == 1 and all(word in told[0] for word in words), told


def test_blocks_of_one_class_are_pure_but_for_strays():
    blocks = np.zeros((4, 2, 3), np.int64)
    blocks[0] = [[100, 0, 0], [0, 0, 0]]
    blocks[1] = [[0, 1, 0], [90, 9, 100]]  # 199 of 200 of one class, whatever was called
    blocks[2] = [[60, 0, 0], [0, 40, 0]]
    assert pure_share(blocks) == pytest.approx(300 / 400)
    assert pure_share(blocks[3:]) is None
