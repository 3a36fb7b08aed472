"""Classes whose code the points of a strip cannot hold are told before anything is computed."""

from __future__ import annotations

from pathlib import Path

import lasmaker
import numpy as np
import pytest
from commandline import fwclass

SURVEY = """
survey:
  name: old
  directory: .
  sources: [a.las]
  crs: EPSG:25832
  reference: {kind: source}
  features: [zc]
  classes: [{name: ground, code: 64, codes: [2]%s}, {name: building, code: 6, codes: [6]}]
areas: {train: [[500000, 5400000, 500010, 5400020]], gap: 0}
"""


@pytest.mark.parametrize(("point_format", "legacy", "code"), [(3, "", 2), (6, "", 0), (3, ", legacy_code: 2", 0)])
def test_a_code_that_does_not_fit(tmp_path: Path, point_format: int, legacy: str, code: int) -> None:
    r = np.random.default_rng(1)
    x, y = r.uniform(0, 20, (2, 800))
    house = y > 10
    xyz = np.c_[500_000 + x, 5_400_000 + y, 100 + 5.0 * house]
    lasmaker.write_las(tmp_path / "a.las", xyz, point_format=point_format, classification=np.where(house, 6, 2))
    (tmp_path / "c.yaml").write_text(SURVEY % legacy)
    words = ("--out", "r", "--workers", "0", "--set", "train.trees=2", "--set", "publish.figure_pixels=200")
    ended = fwclass("run", "c.yaml", *words, cwd=tmp_path)
    assert ended.returncode == code, ended.stderr
    if code:
        assert "ground 64" in ended.stderr and "legacy_code" in ended.stderr
        assert not list((tmp_path / "r" / "store").glob("*/*/receipt.json"))
