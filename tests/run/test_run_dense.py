"""A run over a place denser than any survey ends, and its report says where that is."""

from __future__ import annotations

import json

import laspy
import numpy as np
import pytest
from commandline import fwclass

SURVEY = """
survey:
  name: crowd
  crs: EPSG:25832
  directory: strips
  sources: ["*.las"]
  features: [height_range_c100, planarity_r100]
  reference: {kind: source}
  classes:
    - {name: ground, code: 2, codes: [2]}
    - {name: vegetation, code: 5, codes: [5]}
areas:
  train: [[500000.0, 5400000.0, 500030.0, 5400030.0]]
train: {trees: 2}
tile: {size: 15}
"""


@pytest.mark.slow
def test_a_run_tells_where_few_echoes_count(tmp_path):
    rng = np.random.default_rng(1)
    x, y = (
        np.append(rng.uniform(0, 30, 3000), np.full(20_000, 15.0)),
        np.append(rng.uniform(0, 30, 3000), np.full(20_000, 9.0)),
    )
    plants = np.arange(len(x)) % 3 == 0
    z = 100.0 + np.where(plants, rng.uniform(1, 8, len(x)), 0.0)
    z[3000:] = 100.0
    data = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    data.header.scales, data.header.offsets = [0.001] * 3, [500_000.0, 5_400_000.0, 0.0]
    data.x, data.y, data.z, data.gps_time = 500_000.0 + x, 5_400_000.0 + y, z, np.arange(len(x)) * 1e-5
    data.return_number[:], data.number_of_returns[:] = 1, 1
    data.classification = np.where(plants, 5, 2).astype(np.uint8)
    (tmp_path / "strips").mkdir()
    data.write(tmp_path / "strips" / "a.las")
    (tmp_path / "survey.yaml").write_text(SURVEY)
    ended = fwclass("run", tmp_path / "survey.yaml", "--workers", "0", "--out", tmp_path / "r")
    assert ended.returncode == 0, ended.stderr
    (told,) = [t for t in json.loads((tmp_path / "r" / "report.json").read_text())["remarks"] if "features.dense" in t]
    assert told.startswith("20,000 echoes lie in cubes of 0.1 m that hold more than 64, the fullest 20,0")
    assert "at 500015.0, 5400009.0, 100.0" in told
    assert told in ended.stderr and told.split(":")[0] in (tmp_path / "r" / "report.html").read_text()
