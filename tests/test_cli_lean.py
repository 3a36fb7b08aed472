"""`run.keep_intermediate: lean`: bulky parts that are made quickly go, and nothing that is delivered is another."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from commandline import fwclass
from smallsurvey import small_survey

LEAN = ("--set", "run.keep_intermediate=lean")


def delivered(root: Path) -> dict[str, str]:
    told = {"report.html", "report.json", "generation.json", "manifest.json"}
    files = sorted(p for p in (root / "current").resolve().rglob("*") if p.is_file() and p.name not in told)
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("lean")
    small_survey(place)
    return place


def test_a_lean_run_delivers_the_same_and_learns_anew(place: Path) -> None:
    words = ("run", "s.yaml", "--workers", 0)
    ended = fwclass(*words, "--out", "r", *LEAN, cwd=place)
    assert ended.returncode == 0 and "parts emptied (run.keep_intermediate)" in ended.stderr, ended.stderr
    for stage in ("features", "training", "split"):
        files = [p.name for p in (place / "r/store" / stage).rglob("*") if p.is_file()]
        assert set(files) == {"receipt.json"}, files

    ended = fwclass("status", "r", "--verify", cwd=place)
    assert ended.returncode == 0 and "parts are done" in ended.stdout, ended.stdout
    ended = fwclass(*words, "--out", "r", *LEAN, cwd=place)
    assert ended.returncode == 0 and " computed" not in ended.stderr, ended.stderr

    ended = fwclass(*words, "--out", "r", *LEAN, "--set", "train.trees=3", cwd=place)
    assert ended.returncode == 0 and "features         made anew" in ended.stderr, ended.stderr
    assert "split            made" not in ended.stderr  # nothing reads it
    assert fwclass(*words, "--out", "whole", "--set", "train.trees=3", cwd=place).returncode == 0
    assert delivered(place / "r") == delivered(place / "whole")

    # without the setting all parts are there again, and the delivery is what it was
    ended = fwclass("status", "s.yaml", "--out", "r", "--set", "train.trees=3", cwd=place)
    assert ended.returncode == 3 and "its files were removed to save room" in ended.stdout, ended.stdout
    ended = fwclass(*words, "--out", "r", "--set", "train.trees=3", cwd=place)
    assert ended.returncode == 0 and list((place / "r/store/features").rglob("table.parquet")), ended.stderr
    assert delivered(place / "r") == delivered(place / "whole")
