"""Temporary directories go with their command; what a killed one has left goes with the next."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import bagmaker
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "fuzz"))

import seeds

from fwclass import temporary
from fwclass.temporary import array_in_file, temporary_directory

HOLD = """
import sys
from pathlib import Path
from fwclass.temporary import array_in_file, temporary_directory
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

    def late(path: object, *more: int, **named: object) -> int:
        handle = first(path, *more, **named)
        if len(made) == 2 and str(path) == made[1]:
            Path(made[1]).rmdir()
        return handle

    monkeypatch.setattr(temporary.tempfile, "mkdtemp", swept)
    monkeypatch.setattr(temporary.os, "open", late)
    with temporary_directory("parts", tmp_path) as directory:
        assert len(made) == 3 and str(directory) == made[2] and directory.is_dir()


KERNELS = """
from fwclass.isolation import kernel_cache
(kernel_cache() / "a").write_bytes(bytes(1000))
END
"""
BAG = """
import sys
from pathlib import Path
from fwclass.street.frames import Scan
from fwclass.street.recording_bag import BagRecording
frames = BagRecording(Path(sys.argv[1]), Scan(19, -0.9, 0.1, 0.1, 30.0), None).frames()
next(frames)
END
"""
EXPORT = """
import sys
from pathlib import Path
from fwclass.publish.files import whole_directory
with whole_directory(Path(sys.argv[1])) as beside:
    (beside / "a").write_bytes(bytes(1000))
    END
"""
KILLED = "__import__('os').kill(__import__('os').getpid(), 9)"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a directory away")
def test_what_belongs_to_another_user_stays(tmp_path: Path) -> None:
    theirs = tmp_path / ".fwclass-parts-1"
    theirs.mkdir()
    os.chown(theirs, 65534, 65534)
    with temporary_directory("parts", tmp_path):
        pass
    assert list(tmp_path.iterdir()) == [theirs]


@pytest.mark.parametrize(
    ("work", "kind"),
    [(KERNELS, "fwclass-kernels-"), (BAG, "fwclass-bag-"), (EXPORT, ".out.")],
    ids=["kernels", "bag", "export"],
)
def test_what_a_killed_command_left_goes_with_the_next_one(work: str, kind: str, tmp_path: Path) -> None:
    """Compiled code that can be kept nowhere, a bag that is decompressed as a whole, a folder that is written."""
    bagmaker.write_bag2(tmp_path / "bag", seeds._frames(), compression="file")
    room = tmp_path / "room"
    room.mkdir()
    settings = {**os.environ, "TMPDIR": str(room), "XDG_CACHE_HOME": "/proc/none", "NUMBA_CACHE_DIR": ""}

    def ended(end: str) -> int:
        given = room / "out" if work is EXPORT else tmp_path / "bag"
        words = [sys.executable, "-c", work.replace("END", end), str(given)]
        return subprocess.run(words, env=settings, capture_output=True, check=False).returncode

    assert ended(KILLED) == -signal.SIGKILL
    assert [p.name.startswith(kind) for p in room.iterdir()] == [True]
    assert ended("pass") == 0
    assert [p.name for p in room.iterdir() if p.name.startswith(kind)] == []


def test_an_array_in_a_file_takes_its_room_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page of a file with holes that has no room on the disk ended the process by a signal."""
    with (tmp_path / "a.bin").open("w+b") as file:
        array = array_in_file(file, np.float64, (1000, 2))
        assert os.fstat(file.fileno()).st_blocks * 512 >= array.nbytes
        array[:] = 7.0
        assert array.sum() == 14_000.0
    with (tmp_path / "b.bin").open("w+b") as file:
        assert array_in_file(file, np.float64, (0, 2)).shape == (0, 2)
        monkeypatch.setattr(os, "posix_fallocate", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
        with pytest.raises(OSError, match="full"):
            array_in_file(file, np.float64, (1000, 2))
