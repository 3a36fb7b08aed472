"""Temporary directories go with their command; what a killed one has left goes with the next."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from fwclass.store import temporary
from fwclass.store.temporary import temporary_directory

HOLD = """
import sys
from pathlib import Path
from fwclass.store.temporary import temporary_directory
with temporary_directory("parts", Path(sys.argv[1])) as directory:
    (directory / "a").write_bytes(bytes(1000))
    print(directory, flush=True)
    sys.stdin.read()
"""


def holder(place: Path) -> tuple[subprocess.Popen[str], Path]:
    words = [sys.executable, "-c", HOLD, str(place)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_it_is_there_while_it_is_used_and_then_not(tmp_path: Path) -> None:
    with temporary_directory("parts", tmp_path) as one, temporary_directory("parts", tmp_path) as two:
        assert one.is_dir() and two.is_dir() and one != two and one.name.startswith(".fwclass-parts-")
        (one / "a").mkdir()
    assert list(tmp_path.iterdir()) == []
    with temporary_directory("parts") as directory:
        assert directory.parent == Path(tempfile.gettempdir()) and directory.stat().st_mode & 0o77 == 0


def test_what_a_killed_process_left_goes_with_the_next_and_what_lives_stays(tmp_path: Path) -> None:
    dead, left = holder(tmp_path)
    living, held = holder(tmp_path)
    assert left.is_dir()  # nobody is dead yet
    dead.send_signal(signal.SIGKILL)
    dead.wait()
    assert left.is_dir()
    for name in ("other", ".fwclass-others-1"):
        (tmp_path / name).mkdir()
    (tmp_path / ".fwclass-parts-link").symlink_to(tmp_path / "other")
    (tmp_path / ".fwclass-parts-file").touch()
    with temporary_directory("parts", tmp_path):
        names = {p.name for p in tmp_path.iterdir()}
        assert not left.exists() and (held / "a").is_file()
        assert {"other", ".fwclass-others-1", ".fwclass-parts-link", ".fwclass-parts-file"} < names
    living.communicate("")
    assert not held.exists() and living.returncode == 0


def test_one_that_is_taken_for_left_before_it_is_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, real, first = [], tempfile.mkdtemp, os.open

    def swept(**named: object) -> str:
        made.append(real(**named))
        if len(made) == 1:
            Path(made[0]).rmdir()
        return made[-1]

    def late(path: object, *more: int) -> int:
        handle = first(path, *more)
        if len(made) == 2 and str(path) == made[1]:
            Path(made[1]).rmdir()
        return handle

    monkeypatch.setattr(temporary.tempfile, "mkdtemp", swept)
    monkeypatch.setattr(temporary.os, "open", late)
    with temporary_directory("parts", tmp_path) as directory:
        assert len(made) == 3 and str(directory) == made[2] and directory.is_dir()
