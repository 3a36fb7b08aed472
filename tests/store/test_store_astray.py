"""Readers of a run directory who are led to something else than its delivery: `status --verify` says so."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from commandline import fwclass
from smallsurvey import small_survey


@pytest.fixture
def delivered(tmp_path: Path) -> Path:
    survey = small_survey(tmp_path)
    ended = fwclass("run", survey, "--out", tmp_path / "run", "--workers", "0")
    assert ended.returncode == 0, ended.stderr
    return tmp_path / "run"


def verified(run: Path) -> tuple[int, str]:
    ended = fwclass("status", run, "--verify")
    return ended.returncode, ended.stdout + ended.stderr


def test_what_stands_in_the_place_of_a_link_is_told(delivered: Path, tmp_path: Path) -> None:
    assert verified(delivered)[0] == 0
    (delivered / "laz").unlink()
    (delivered / "laz" / "tiles").mkdir(parents=True)
    code, said = verified(delivered)
    assert code == 3 and "astray   laz is no link to the delivery" in said and "move away" in said
    shutil.rmtree(delivered / "laz")
    assert fwclass("run", tmp_path / "s.yaml", "--out", delivered, "--workers", "0").returncode == 0
    assert verified(delivered)[0] == 0

    shutil.copytree(delivered, tmp_path / "other", symlinks=True)
    shown = (delivered / "current").readlink()
    (delivered / "current").unlink()
    (delivered / "current").symlink_to(tmp_path / "other" / shown)
    code, said = verified(delivered)
    assert code == 3 and "astray   current is no link" in said
    assert fwclass("run", tmp_path / "s.yaml", "--out", delivered, "--workers", "0").returncode == 0
    assert verified(delivered)[0] == 0
