"""Classes whose code the points of a strip cannot hold are told before anything is computed."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pytest
from commandline import Ended, fwclass

SURVEY = """
survey:
  name: old
  directory: .
  sources: [a.las]
  crs: EPSG:25832
  reference: {kind: source}
  features: [intensity]
  classes: [{name: ground, code: 64, codes: [2]%s}, {name: building, code: 6, codes: [6]}]
areas: {train: [[500000, 5400000, 500010, 5400020]], gap: 0}
"""


@pytest.mark.parametrize(("point_format", "legacy", "code"), [(3, "", 2), (6, "", 0), (3, ", legacy_code: 2", 0)])
def test_a_code_that_does_not_fit(tmp_path: Path, point_format: int, legacy: str, code: int) -> None:
    _survey(tmp_path, point_format)
    planned, ended = _plan(tmp_path, legacy), _run(tmp_path, legacy)
    assert planned.returncode == ended.returncode == code, ended.stderr
    if code:
        assert "ground 64" in ended.stderr and "legacy_code" in ended.stderr
        assert planned.stderr == ended.stderr
        assert not list((tmp_path / "r" / "store").glob("*/*/receipt.json"))


def test_another_legacy_code_trains_nothing_anew(tmp_path: Path) -> None:
    _survey(tmp_path, 3)
    for written in (31, 30):
        ended = _run(tmp_path, f", legacy_code: {written}")
        assert ended.returncode == 0, ended.stderr
        assert {written, 6} == set(np.unique(laspy.read(tmp_path / "r" / "laz" / "strips" / "a.laz").classification))
        card = json.loads((tmp_path / "r" / "model" / "card.json").read_text())
        assert [c.get("legacy_code") for c in card["classes"]] == [written, None]
    made = {line.split()[0] for line in ended.stderr.splitlines() if line.endswith("computed")}
    assert made == {"train", "classify", "publish-strip"}  # the card of the model is read where echoes are classified


def _survey(place: Path, point_format: int) -> None:
    r = np.random.default_rng(1)
    x, y = r.uniform(0, 20, (2, 800))
    house = y > 10
    xyz = np.c_[500_000 + x, 5_400_000 + y, 100 + 5.0 * house]
    classes, light = np.where(house, 6, 2), np.where(house, 90, 10)
    lasmaker.write_las(place / "a.las", xyz, point_format=point_format, classification=classes, intensity=light)


def _plan(place: Path, legacy: str) -> Ended:
    (place / "c.yaml").write_text(SURVEY % legacy)
    return fwclass("plan", "c.yaml", "--out", "r", cwd=place)


def _run(place: Path, legacy: str) -> Ended:
    (place / "c.yaml").write_text(SURVEY % legacy)
    words = ("--out", "r", "--workers", "0", "--set", "train.trees=2", "--set", "publish.figure_pixels=200")
    return fwclass("run", "c.yaml", *words, cwd=place)
