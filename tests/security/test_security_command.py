"""The command that a configuration names is code of whoever wrote it: it is run when the user says so."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from commandline import fwclass
from schedulemaker import FAILS_AT_ONCE

WORDS = ("schedule", "c.yaml", "--every", "1h", "--once", "--out", "r")


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """A configuration with a command that leaves a file."""
    command = [sys.executable, "-c", "open('ran', 'w')"]
    (tmp_path / "data").mkdir()
    (tmp_path / "c.yaml").write_text(FAILS_AT_ONCE.replace("look:", f"command: {json.dumps(command)}, look:"))
    return tmp_path


def test_a_configurations_command_is_not_run_unasked(survey: Path) -> None:
    ended = fwclass(*WORDS, cwd=survey)
    assert ended.returncode == 2 and "--allow-command" in ended.stderr and sys.executable not in ended.stderr
    assert not (survey / "ran").exists() and not (survey / "r").exists()
    assert fwclass(*WORDS, "--set", "schedule.command=[]", cwd=survey).returncode == 1
    assert not (survey / "ran").exists()


@pytest.mark.parametrize("how", ["word", pytest.param("environment", marks=pytest.mark.slow), "own"])
def test_it_is_run_when_the_user_says_so(how: str, survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    more: tuple[str, ...] = ("--allow-command",)
    if how == "environment":
        more = ()
        monkeypatch.setenv("FWCLASS_ALLOW_COMMAND", "1")
    elif how == "own":
        more = ("--set", f"schedule.command={json.dumps([sys.executable, '-c', 'open(chr(114) + chr(97), chr(119))'])}")
    assert fwclass(*WORDS, *more, cwd=survey).returncode == 1
    assert (survey / ("ra" if how == "own" else "ran")).exists()
