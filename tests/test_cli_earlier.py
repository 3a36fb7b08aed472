"""What an operator sees years later: a source that is gone, another survey, a copy without links, parts that were
removed, a configuration that moved."""

from __future__ import annotations

import json
import shutil
import unicodedata
from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey


@pytest.fixture(scope="module")
def run_once(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The small survey as two files, run once, and a copy of all."""
    place = tmp_path_factory.mktemp("earlier") / "place"
    place.mkdir()
    path = small_survey(place)
    whole = laspy.read(place / "a.las")
    x = np.asarray(whole.x)
    for name, rows in (("west", x < 500_040), ("east", x >= 500_040)):
        part = laspy.LasData(whole.header)
        part.points = whole.points[rows]
        part.write(place / f"{name}.las")
    path.write_text(path.read_text().replace("[a.las]", '["*st.las"]'))
    assert fwclass(*line(path)).returncode == 0
    return path, shutil.copytree(place, place.with_name("kept"), symlinks=True)


@pytest.fixture
def two(run_once: tuple[Path, Path]) -> Path:
    """As it was after the run, in the place where it was made, which a run directory knows."""
    path, kept = run_once
    shutil.rmtree(path.parent)
    shutil.copytree(kept, path.parent, symlinks=True)
    return path


def line(path: Path, *words: str) -> tuple[object, ...]:
    return ("run", path, "--out", path.parent / "r", "--workers", 0, *words)


def test_a_source_that_is_gone_is_told_once(two: Path) -> None:
    points = len(laspy.read(two.parent / "east.las").points)
    (two.parent / "east.las").rename(two.parent / "east.gone")
    ended = fwclass(*line(two))
    assert ended.returncode == 4 and "sources of the delivery before are gone" in ended.stderr, ended.stderr
    assert f"east.las ({points:,} points) is a source of the delivery before this one" in ended.stderr
    assert "east.las" in (two.parent / "r" / "report.html").read_text()
    history = json.loads(fwclass("history", two.parent / "r", "--json").stdout)
    assert [run["exit_code"] for run in history] == [0, 4]
    assert fwclass(*line(two)).returncode == 0  # the delivery is as it is wanted now
    ended = fwclass(*line(two, "--set", "train.trees=6"))
    assert ended.returncode == 0 and "east.las" not in ended.stderr, ended.stderr


def test_it_may_be_accepted(two: Path) -> None:
    (two.parent / "east.las").unlink()
    assert fwclass(*line(two, "--accept-implausible")).returncode == 0


def test_another_survey_in_the_same_place_is_told(two: Path) -> None:
    ended = fwclass(*line(two, "--set", "survey.name=other"))
    assert "the delivery before this one is of another survey, small" in ended.stderr, ended.stderr


def test_accuracies_of_other_tests_are_not_compared(two: Path) -> None:
    ended = fwclass(*line(two, "--set", "train.trees=1", "--set", "survey.features=[intensity]"))
    assert "LOST" in ended.stderr, ended.stderr
    ended = fwclass(
        *line(two, "--set", "train.trees=1", "--set", "survey.features=[intensity]", "--set", "areas.gap=5")
    )
    assert ended.returncode == 4 and "no better than chance" in ended.stderr, ended.stderr
    assert "LOST" not in ended.stderr, ended.stderr


def test_a_copy_without_links(two: Path) -> None:
    root = two.parent
    shutil.copytree(root / "r", root / "copy")  # follows links, as scp does
    for words in (("status", root / "copy"), ("run", two, "--out", root / "copy", "--workers", 0)):
        ended = fwclass(*words)
        assert ended.returncode == 1 and "was copied without its links" in ended.stderr, ended.stderr
        assert "cp -a" in ended.stderr
    shutil.copytree(root / "r" / "current", root / "delivery")
    ended = fwclass("diff", root / "r", root / "delivery")
    assert ended.returncode == 2 and "a delivery that was copied out of its run" in ended.stderr, ended.stderr


def test_seams_without_parts(two: Path) -> None:
    assert fwclass("clean", two.parent / "r", "--keep", "delivery").returncode == 0
    ended = fwclass("seams", two.parent / "r")
    assert ended.returncode == 1 and "--set run.keep_intermediate=true" in ended.stderr, ended.stderr


def test_a_configuration_that_moved(two: Path) -> None:
    two.rename(two.parent / "new.yaml")
    ended = fwclass("status", two.parent / "r")
    assert ended.returncode == 2 and "fwclass status NEW.yaml --out" in ended.stderr, ended.stderr
    assert fwclass("status", two.parent / "new.yaml", "--out", two.parent / "r").returncode == 0


def test_the_last_line_after_damage_mends_it(two: Path) -> None:
    table = next((two.parent / "r" / "store" / "features").rglob("*.parquet"))
    data = bytearray(table.read_bytes())
    data[len(data) // 2] ^= 1
    table.write_bytes(data)
    ended = fwclass(*line(two, "--set", "train.trees=6"))
    assert ended.returncode == 3, ended.stderr
    last = next(t for t in ended.stderr.splitlines() if "run the same again" in t)
    assert last.endswith("--verify"), last
    assert fwclass(*line(two, "--set", "train.trees=6", "--verify")).returncode == 0


def test_a_name_whose_letters_are_written_otherwise_is_the_same(two: Path) -> None:
    """A file that came back from a Mac (ö as two characters) was a source that is gone, by a name that looks alike."""
    composed, decomposed = "Größe_west.las", unicodedata.normalize("NFD", "Größe_west.las")
    for before, after in (("west.las", decomposed), (decomposed, composed)):
        (two.parent / before).rename(two.parent / after)
        ended = fwclass(*line(two))
        assert ended.returncode == (4 if before == "west.las" else 0), ended.stderr
    assert "sources of the delivery before" not in ended.stderr and "are gone" not in ended.stderr


def test_strips_that_have_one_name_elsewhere_are_told(two: Path) -> None:
    """Delivered side by side, and one of them lost without a word by who copies them to Windows."""
    assert "Windows" not in fwclass(*line(two)).stderr
    (two.parent / "east.las").rename(two.parent / "West.las")
    two.write_text(two.read_text().replace('"*st.las"', '"*est.las"'))
    ended = fwclass(*line(two))
    assert "note: West.las and west.las have one name on Windows and macOS" in ended.stderr, ended.stderr
