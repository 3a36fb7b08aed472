"""Echoes that stand in the sources twice are counted, told and refused, whatever the tiles."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

from fwclass.schema import Table
from fwclass.tile.stage import repeats

CUT, RIM = 500_040.0, 2.0


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """The small survey as two files with a common rim, the second in reverse order."""
    path = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    x = np.asarray(whole.x)
    for name, mask in (("west", x < CUT + RIM), ("east", x > CUT - RIM)):
        part = laspy.LasData(whole.header)
        part.points = whole.points[np.flatnonzero(mask)[:: 1 if name == "west" else -1]]
        part.write(tmp_path / f"{name}.las")
    path.write_text(path.read_text().replace("[a.las]", "[west.las, east.las]"))
    return path


@pytest.mark.parametrize("words", [(), ("--workflow", "ground"), ("--workflow", "quality")])
def test_a_common_rim_is_told_and_refused(survey: Path, words: tuple[str, ...]) -> None:
    x = np.asarray(laspy.read(survey.parent / "a.las").x)
    rim = int(((x > CUT - RIM) & (x < CUT + RIM)).sum())
    facts = []
    for size in (25, 60):
        root = survey.parent / f"r{size}"
        line = ("run", survey, "--out", root, "--workers", 0, "--set", f"tile.size={size}", *words)
        ended = fwclass(*line)
        assert ended.returncode == 4 and "the sources have too many echoes twice" in ended.stderr, ended.stderr
        assert f"{rim:,} echoes, {100 * rim / (len(x) + rim):.1f} %, have place and time of another" in ended.stderr
        facts.append(json.loads((root / "report.json").read_text())["repeated"])
        assert (root / "report.html").exists() and "common rim" in (root / "report.html").read_text()
    assert facts[0] == facts[1] and facts[0]["echoes"] == rim
    ((one, other, count),) = facts[0]["files"]
    assert {one, other} == {"west.las", "east.las"} and count == rim
    assert fwclass(*line, "--accept-implausible").returncode == 0


def test_a_sound_survey_has_none(tmp_path: Path) -> None:
    assert fwclass("run", small_survey(tmp_path), "--out", tmp_path / "r", "--workers", 0).returncode == 0
    assert json.loads((tmp_path / "r" / "report.json").read_text())["repeated"] is None


def table(rows: list[tuple[float, float, float, float, int]]) -> Table:
    x, y, z, time, strip = zip(*rows, strict=True)
    return Table(
        {"x": np.array(x), "y": np.array(y), "z": np.array(z)}
        | {"gps_time": np.array(time), "strip": np.array(strip, np.uint16)}
    )


def test_repetitions_by_hand() -> None:
    nan = np.nan
    rows = [(1.0, 2, 3, 7, 5), (1.0, 2, 3, 7, 2), (1.0, 2, 3, 8, 2), (1.0, 2, 3, nan, 2), (1.0, 2, 3, nan, 2)]
    rows += [(1.0, 2, 3, 7, 9), (2.0, 1, 3, 7, 9), (1.001, 2, 3, 7, 2), (-1.0, 2, 3, 7, 5)]
    assert repeats(table(rows)) == [[2, 2, 1], [2, 5, 1], [2, 9, 1]]
    assert repeats(table(rows[:1])) == [] == repeats(table(rows[6:]))


def test_repetitions_in_any_order_and_number() -> None:
    rng = np.random.default_rng(3)
    rows = [(*rng.integers(0, 4, 4).astype(float), int(k)) for k in rng.integers(0, 3, 2000)]
    counted = repeats(table(rows))
    assert counted == repeats(table([rows[k] for k in rng.permutation(2000)]))
    assert sum(n for _, _, n in counted) == 2000 - len({r[:4] for r in rows})
