"""A roof wider than the filter was told is taken for ground: told by what stands there, without a label."""

from __future__ import annotations

import json

import lasmaker
import numpy as np
import pytest
from commandline import fwclass

from fwclass.ground import measure
from fwclass.ground.raster.lattice import window_over
from fwclass.single_file.ground.file import GroundJob, ground_file

EDGE, WIDE = 130.0, 56.0
"""m, of the meadow, and of the hall in its middle; the filter knows buildings of 36 m."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """``a.las``: a meadow on a slope with a hall of 7 m on it, one point per m²."""
    place, rng = tmp_path_factory.mktemp("halls"), np.random.default_rng(2)
    x, y = rng.uniform(0, EDGE, (2, 17_000))
    hall = (np.abs(x - EDGE / 2) < WIDE / 2) & (np.abs(y - EDGE / 2) < WIDE / 2)
    z = 100 + np.where(hall, 0.03 * EDGE / 2 + 7, 0.03 * x) + rng.normal(0, 0.02, len(x))
    lasmaker.write_las(place / "a.las", np.c_[500_000 + x, 5_400_000 + y, z], point_format=6)
    (place / "g.yaml").write_text('survey: {name: g, sources: [a.las], crs: "EPSG:25832"}\n')
    return place


def test_one_file(place):
    ended = fwclass("ground", "a.las", "o.las", cwd=place)
    assert ended.returncode == 4 and (place / "o.las").is_file(), ended.stderr
    assert "wide roofs are taken for ground" in ended.stderr
    said = ended.stderr.split("ground.max_building_size=")[1].split(",")[0]
    wider = fwclass("ground", "a.las", "o.las", "--overwrite", "--param", f"max_building_size={said}", cwd=place)
    assert wider.returncode == 0 and "wide" not in wider.stderr, wider.stderr
    measured = fwclass("ground", "a.las", "o.las", "--overwrite", "--auto", cwd=place)
    assert measured.returncode == 0, measured.stderr
    (place / "f.yaml").write_text("features: [height_above_ground]\n")
    words = ("features", "a.las", "o.parquet", "--set", "f.yaml")
    ended = fwclass(*words, cwd=place)
    assert ended.returncode == 4 and "wide roofs are taken for ground" in ended.stderr, ended.stderr
    assert fwclass(*words, "--overwrite", "--accept-implausible", cwd=place).returncode == 0
    ended = fwclass("normalize", "a.las", "n.las", "--method", "smrf", cwd=place)
    assert ended.returncode == 4 and "wide roofs are taken for ground" in ended.stderr, ended.stderr


def test_what_lies_between_sites_far_apart_is_not_looked_at(tmp_path, monkeypatch):
    """Roofs are looked for in rasters; one over both sites would have millions of cells, each of hundreds of metres."""
    xy = np.random.default_rng(3).uniform(0, 60, (8_000, 2)) + np.repeat([[3e5, 5.4e6], [8e5, 5.9e6]], 4_000, axis=0)
    lasmaker.write_las(tmp_path / "a.las", np.c_[xy, 100 + 0.01 * xy[:, 1] % 1], point_format=6)
    windows = []
    monkeypatch.setattr(measure, "window_over", lambda *words: windows.append(window_over(*words)) or windows[-1])
    ground_file(GroundJob(tmp_path / "a.las", tmp_path / "o.las"))
    assert windows and max(w.ncols * w.nrows for w in windows) < 1e5


def test_a_run(place):
    words = ("run", "g.yaml", "--workflow", "ground", "--workers", 0, "--out", "r")
    ended = fwclass(*words, cwd=place)
    assert ended.returncode == 4 and "wide roofs are taken for ground" in ended.stderr, ended.stderr
    facts = json.loads((place / "r" / "report.json").read_text())["ground"]
    assert facts["halls"]["width"] == pytest.approx(WIDE, abs=8)  # two cells of the second raster
    assert 0.6 < facts["halls"]["ground"] / (WIDE**2 / EDGE**2 * 17_000) < 1, "all but the corners"
    assert any("it goes down on all sides" in r for r in facts["remarks"])
    wider = fwclass(*words, "--set", "ground.max_building_size=80", cwd=place)
    assert wider.returncode == 0, wider.stderr
    facts = json.loads((place / "r" / "report.json").read_text())["ground"]
    assert facts["halls"] == {"width": 0.0, "ground": 0} and facts["pits"] == 0


def test_low_noise_that_becomes_ground_is_told(tmp_path):
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 80, (2, 40_000))
    z = (
        100
        + 0.03 * x
        + rng.normal(0, 0.02, len(x))
        - np.where(rng.random(len(x)) < 0.005, rng.uniform(1, 5, len(x)), 0)
    )
    lasmaker.write_las(tmp_path / "a.las", np.c_[500_000 + x, 5_400_000 + y, z], point_format=6)
    ended = fwclass("ground", "a.las", "o.las", "--json", cwd=tmp_path)
    assert ended.returncode == 4 and "ground lies below the ground" in ended.stderr, ended.stderr
    assert "ground.noise.surface=true" in ended.stderr
    assert fwclass("ground", "a.las", "without.las", "--set", "ground.noise.surface=true", cwd=tmp_path).returncode == 0
    judged = json.loads(ended.stdout)["judged"]
    assert judged["pits"]["pits"] >= 20 and judged["halls"]["halls"] == {"width": 0.0, "ground": 0}
    (tmp_path / "g.yaml").write_text('survey: {name: g, sources: [a.las], crs: "EPSG:25832"}\n')
    counted = []
    for edge in (40, 100):
        words = (
            "run",
            "g.yaml",
            "--out",
            f"r{edge}",
            "--workflow",
            "ground",
            "--workers",
            0,
            "--set",
            f"tile.size={edge}",
        )
        ended = fwclass(*words, cwd=tmp_path)
        assert ended.returncode == 4 and "deeper below all ground around them" in ended.stderr, ended.stderr
        counted.append(json.loads((tmp_path / f"r{edge}" / "report.json").read_text())["ground"]["pits"])
    assert counted[0] == counted[1] >= 20
