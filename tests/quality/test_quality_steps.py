"""Steps in height between files and lines are told with their deviation, and refused above a documented bound."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey
from stripmaker import NORTH, line, write_lines

from fwclass.errors import QualityError
from fwclass.quality.steps import HeightSteps, judge_steps, step_remarks, told_steps

ONE = line(0)
NO_STEP: dict[str, Any] = {"steps": []}


def measure(place: Path, *words: object) -> tuple[Any, Any]:
    """How the quality workflow ends for the files of a directory, and the strips of its report."""
    (place / "s.yaml").write_text("survey: {name: steps, sources: ['*.las']}\n")
    line = ("run", place / "s.yaml", "--out", place / "r", "--workflow", "quality", "--workers", 0, *words)
    ended = fwclass(*line, "--set", "terrain.block=128", "--set", "ground.block=128")
    return ended, json.loads((place / "r" / "report.json").read_text())


def cut(place: Path, y: float, lift: float) -> None:
    """A flight line as two files that meet at `y` and share nothing, the northern one lifted [m]."""
    north = ONE["y"] >= y
    write_lines(place / "south.las", [ONE], ~north)
    write_lines(place / "north.las", [{**ONE, "z": ONE["z"] + lift}], north)


@pytest.mark.parametrize("y", [NORTH + 120, NORTH + 122])  # on an edge of cells of 4 m, and amid them
@pytest.mark.parametrize(
    ("lift", "told", "code"),
    [(0.25, True, 4), pytest.param(-0.25, True, 4, marks=pytest.mark.slow), (0.1, True, 0), (0.04, False, 0)],
)
def test_a_file_delivered_anew_at_another_height(tmp_path: Path, y: float, lift: float, told: bool, code: int) -> None:
    cut(tmp_path, y, lift)
    ended, report = measure(tmp_path)
    steps = report["quality"]["strips"]["steps"]
    assert ended.returncode == code, ended.stderr
    assert bool(steps) == told == any("above" in text for text in report["remarks"])
    if told:
        (one,) = steps
        high, low = ("north", "south") if lift > 0 else ("south", "north")
        assert {one["first"], one["second"]} == {high, low} and one["seen"] == (
            "border" if y == NORTH + 120 else "overlap"
        )
        assert abs(abs(one["step"]) - abs(lift)) < 4 * one["deviation"] / one["places"] ** 0.5 + 0.002
        words = f"{high} lies {abs(one['step']):.3f} m above {low} (standard deviation {one['deviation']:.3f} m"
        assert words in ended.stderr and words in report["remarks"][0]
        assert words in (tmp_path / "r" / "quality.html").read_text()
    if code:
        assert "do not lie at one height" in ended.stderr
        assert measure(tmp_path, "--accept-implausible")[0].returncode == 0


def test_lines_of_one_file_and_whatever_the_tiles(tmp_path: Path) -> None:
    write_lines(tmp_path / "all.las", [ONE, line(1, (0.2, 0, 0)), line(2)])
    facts = []
    for size in (50, 90):
        ended, report = measure(tmp_path, "--set", f"tile.size={size}")
        assert ended.returncode == 4 and "flight lines" in ended.stderr, ended.stderr
        facts.append(report["quality"]["strips"]["steps"])
    assert facts[0] == facts[1]
    assert {(one["first"], one["second"]) for one in facts[0]} == {("line 1", "line 2"), ("line 2", "line 3")}
    assert all(abs(abs(one["step"]) - 0.2) < 0.01 and one["by"] == "times" for one in facts[0])


def test_every_workflow_that_measures_strips_tells_it(tmp_path: Path) -> None:
    cut(tmp_path, NORTH + 120, 0.12)
    (tmp_path / "s.yaml").write_text("survey: {name: steps, sources: ['*.las']}\n")
    ended = fwclass("run", tmp_path / "s.yaml", "--out", tmp_path / "g", "--workers", 0, "--workflow", "ground")
    assert ended.returncode == 0 and "remark      north lies 0.1" in ended.stderr, ended.stderr


def test_a_sound_survey_has_none(tmp_path: Path) -> None:
    assert fwclass("run", small_survey(tmp_path), "--out", tmp_path / "r", "--workers", 0).returncode == 0
    assert json.loads((tmp_path / "r" / "report.json").read_text())["quality"]["strips"]["steps"] == []


def steps_of(dz: list[float], swap: bool = False) -> HeightSteps:
    steps, n = HeightSteps(1.0), len(dz)
    one, two = np.full(n, 2), np.full(n, 7)
    for k in (slice(0, n // 2), slice(n // 2, n)):  # block by block
        values = np.array(dz)[k]
        steps.add(*((two[k], one[k], -values) if swap else (one[k], two[k], values)))
    return steps


def test_median_and_deviation_by_hand() -> None:
    dz = [*np.random.default_rng(0).normal(0.3, 0.02, 1000).tolist(), 0.95, -0.95, 3.0, -1.5]
    for swap in (False, True):
        (one,) = steps_of(dz, swap).facts()
        assert (one["first"], one["second"], one["places"]) == (2, 7, 1002)
        assert abs(one["step"] - np.median(dz)) < 0.002 and abs(one["deviation"] - 0.02) < 0.002
    same = HeightSteps(1.0)
    same.add(np.array([3, 3]), np.array([3, 3]), np.array([0.5, 0.5]))
    assert same.facts() == []


def test_what_is_not_sure_is_not_told() -> None:
    def told(dz: list[float]) -> list[dict[str, Any]]:
        return told_steps({("files", "border"): (steps_of(dz), {2: "a", 7: "b"})})

    assert told([0.3] * 5) and not told([0.3] * 4)
    assert not told([-0.4, -0.1, 0.2, 0.4, 0.7, 0.2])  # a wall's foot
    assert not told([0.07] * 50) and told([0.09] * 50)


def test_lines_are_not_told_where_files_are() -> None:
    ways = {
        ("files", "overlap"): (steps_of([0.3] * 9), {2: "a", 7: "b"}),
        ("times", "overlap"): (steps_of([0.1] * 9), {}),
    }
    assert [one["by"] for one in told_steps(ways)] == ["files"]
    assert [one["by"] for one in told_steps({k: v for k, v in ways.items() if k[0] == "times"})] == ["times"]


def test_the_bound() -> None:
    facts = {"steps": told_steps({("files", "overlap"): (steps_of([0.3] * 9), {2: "a", 7: "b"})})}
    judge_steps(facts, 0.31, False, "s")
    judge_steps(facts, 0.16, True, "s")
    judge_steps({}, 0.16, False, "s")  # quality.json of an earlier version
    assert step_remarks({}) == step_remarks(NO_STEP) == []
    with pytest.raises(QualityError, match="one height"):
        judge_steps(facts, 0.16, False, "s")
