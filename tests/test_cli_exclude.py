"""A file that cannot be read ends a run before anything is made, and `survey.exclude` goes on without it."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """The small survey as two files, with a third that ends in its header and a fourth that ends in its points."""
    path = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    (tmp_path / "a.las").unlink()
    x = np.asarray(whole.x)
    for name, rows in (("west.laz", x < 500_040), ("east.laz", x >= 500_040)):
        part = laspy.LasData(whole.header)
        part.points = whole.points[rows]
        part.write(tmp_path / name)
    sound = (tmp_path / "east.laz").read_bytes()
    (tmp_path / "cut.laz").write_bytes(sound[:100])
    middle = len(sound) // 2
    (tmp_path / "torn [1].laz").write_bytes(sound[:middle] + bytes(range(256)) * 2 + sound[middle + 512 :])
    path.write_text(path.read_text().replace("[a.las]", '["*.laz"]'))
    return path


def line(path: Path, *words: str) -> tuple[object, ...]:
    return ("run", path, "--out", path.parent / "r", "--workers", 0, *words)


def test_all_damaged_files_are_told_at_once_and_left_out_by_the_words_of_the_message(damaged: Path) -> None:
    ended = fwclass(*line(damaged))
    assert ended.returncode == 1 and not (damaged.parent / "r").exists(), ended.stderr
    assert "2 of 4 source files cannot be used" in ended.stderr and "cut.laz: " in ended.stderr, ended.stderr
    setting = next(row for row in ended.stderr.splitlines() if "survey.exclude: " in row)
    patterns = setting.partition("survey.exclude: ")[2].partition(']"]')[0].partition(" (`")[0]
    assert json.loads(patterns) == ["cut.laz", "torn [[]1].laz"]

    damaged.write_text(damaged.read_text().replace("  classes:", f"  exclude: {patterns}\n  classes:"))
    ended = fwclass(*line(damaged))
    assert ended.returncode == 0, ended.stderr
    assert "left out by survey.exclude: 2 source files, cut.laz, torn [1].laz" in ended.stderr
    report = json.loads((damaged.parent / "r" / "report.json").read_text())
    assert report["input"]["excluded"] == ["cut.laz", "torn [1].laz"]
    assert [f["path"] for f in report["input"]["files"]] == ["east.laz", "west.laz"]

    # another one that comes is told, though no part changes; one that was delivered and is left out is not lost
    (damaged.parent / "cut.laz").rename(damaged.parent / "cut2.laz")
    ended = fwclass(*line(damaged, "--set", "survey.exclude=[cut*, torn*]"))
    assert ended.returncode == 0 and "cut2.laz" in ended.stderr, ended.stderr
    ended = fwclass(*line(damaged, "--set", "survey.exclude=[cut*, torn*, east.laz]"))
    assert "gone" not in ended.stderr and "3 source files, cut2.laz, east.laz" in ended.stderr, ended.stderr


def test_a_pattern_that_leaves_nothing_out_is_refused(damaged: Path, tmp_path: Path) -> None:
    for text, words in (("[wast.laz]", "files like wast.laz"), ("['*']", "every source file is left out")):
        ended = fwclass("plan", damaged, "--out", tmp_path / "p", "--set", f"survey.exclude={text}")
        assert ended.returncode == 1 and words in ended.stderr and "survey.exclude" in ended.stderr, ended.stderr


def test_areas_by_files_leave_them_out_too(damaged: Path, tmp_path: Path) -> None:
    text = damaged.read_text().replace("train: [[500000, 5400000, 500030, 5400040]]", 'train: {files: ["[wt]*.laz"]}')
    damaged.write_text(text.replace("  classes:", "  exclude: [cut.laz, torn*]\n  classes:"))
    ended = fwclass("plan", damaged, "--out", tmp_path / "p")
    assert ended.returncode == 0, ended.stderr
