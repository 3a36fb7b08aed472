"""Two lines over a town (IGN LiDAR HD): they lie centimetres apart in plan, and one that is moved by 1.5 m is told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from commandline import fwclass
from stripmaker import write_lines


def quality(place: Path, east: float, expect: int) -> tuple[dict[str, Any], str]:
    """Strips of the two lines, the second moved to the east [m], and what the command said."""
    ended = fwclass("run", place / "s.yaml", "--workflow", "quality", "--out", place / f"r{east}", "--workers", "0")
    assert ended.returncode == expect, ended.stderr
    return json.loads((place / f"r{east}" / "quality.json").read_text())["strips"], ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("east", [0.0, 1.5])
def test_lines_lie_centimetres_apart_in_plan(shared_data: Path, tmp_path: Path, east: float) -> None:
    clouds = [laspy.read(p) for p in sorted((shared_data / "ign_hd").glob("urban_*.laz"))]
    fields = {"x": "x", "y": "y", "z": "z", "t": "gps_time", "of": "number_of_returns", "source": "point_source_id"}
    town = {n: np.concatenate([np.asarray(c[field]) for c in clouds]) for n, field in fields.items()}
    for number, source in enumerate(np.unique(town["source"])):
        line = {n: town[n][(town["source"] == source) & (town["of"] == 1)] for n in "xyzt"}
        write_lines(tmp_path / f"l{number}.las", [{**line, "x": line["x"] + number * east}])
    (tmp_path / "s.yaml").write_text("survey: {name: town, sources: ['l?.las'], crs: EPSG:2154}\n")
    strips, said = quality(tmp_path, east, 4 if east else 0)
    (pair,) = strips["between"]
    offset = pair["offset"]
    assert offset["error"] < 0.01 and offset["slopes"] > 30
    assert -offset["east"] == pytest.approx(east - 0.057, abs=0.02) and abs(offset["north"]) < 0.06
    assert ("l0 lies 1.4" in said and "west" in said) == bool(east)
