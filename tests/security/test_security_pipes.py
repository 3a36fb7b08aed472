"""A pipe under a name where a file is wanted keeps nobody waiting."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest
from commandline import fwclass
from schedulemaker import FAILS_AT_ONCE, strip

from fwclass import conf
from fwclass.conf.files import read
from fwclass.errors import FwclassError, InputError
from fwclass.paths import open_regular
from fwclass.read.cloud import read_point_cloud
from fwclass.read.polygons import open_polygons
from fwclass.read.source import open_source
from fwclass.read.text import read_text
from fwclass.read.trajectory import read_trajectory
from fwclass.store.models import load_model
from fwclass.survey.files import find_files
from fwclass.workflows import workflow_of


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    (tmp_path / "c.yaml").write_text(FAILS_AT_ONCE)
    strip(tmp_path / "a.las")
    return tmp_path


WORDS = [
    ("info", "P"),
    ("info", "a.las", "P"),
    ("info", "P", "--waveforms"),
    ("decompose", "P", "o.laz"),
    ("decompose", "a.las", "o.laz", "--trajectory", "P"),
    ("assess", "P", "a.las"),
    ("assess", "a.las", "P"),
    ("ground", "P", "o.laz"),
    ("normalize", "P", "o.laz"),
    ("features", "P", "o.parquet"),
    ("classify", "P", "o.laz", "--model", "m"),
    ("classify", "a.las", "o.laz", "--model", "P"),
    ("run", "P"),
    ("run", "c.yaml", "--aoi", "P"),
    ("plan", "P"),
    ("status", "P"),
    ("history", "P"),
    ("schedule", "P", "--every", "1h"),
    ("schedule", "c.yaml", "--inbox", "P"),
    ("run", "c.yaml", "--out", "P"),
    ("seams", "P"),
    ("export", "P", "o.onnx"),
]


@pytest.mark.parametrize("words", WORDS, ids=lambda words: "-".join(words))
@pytest.mark.parametrize("ending", ["", ".las", ".gpkg"])
def test_a_pipe_is_refused(words: tuple[str, ...], ending: str, place: Path) -> None:
    os.mkfifo(place / f"P{ending}")
    ended = fwclass(*(f"P{ending}" if w == "P" else w for w in words), cwd=place)
    assert ended.returncode == 2 and "is a pipe" in ended.stderr, ended.stderr


def test_a_workflows_file_is_no_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.py")
    with pytest.raises(FwclassError, match="no file"):
        workflow_of(str(tmp_path / "pipe.py"))


def test_devices_and_sockets_are_refused(place: Path) -> None:
    assert "is a device" in fwclass("info", "/dev/zero").stderr
    with socket.socket(socket.AF_UNIX) as own:
        own.bind(str(place / "s.las"))
        assert "is a socket" in fwclass("info", place / "s.las").stderr


READERS = {
    "a.las": open_source,
    "a.pls": open_source,
    "a.txt": read_text,
    "b.las": read_point_cloud,
    "a.gpkg": open_polygons,
    "a.geojson": open_polygons,
    "a.shp": open_polygons,
    "a.parquet": open_polygons,
    "a.csv": read_trajectory,
    "a.yaml": read,
    "a": open_regular,
}


@pytest.mark.parametrize("name", READERS)
def test_readers_wait_for_no_pipe_that_a_configuration_names(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(FwclassError):
        READERS[name](tmp_path / name)


def test_a_model_is_no_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "card.json")
    with pytest.raises(InputError):
        load_model(tmp_path)


def test_a_directory_and_a_file_are_what_they_are(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x")
    with open_regular(tmp_path / "a") as file:
        assert file.read() == b"x"
    with pytest.raises(IsADirectoryError):
        open_regular(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "b")


def test_a_file_that_keeps_its_readers_waiting_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the kernel's log, ``/proc/kmsg``, which says that it is an empty file; a link of a model may lead there."""
    (tmp_path / "a").write_bytes(b"")
    with open_regular(tmp_path / "a") as file:
        assert file.read() == b""

    def wait(*_: object) -> bytes:
        raise BlockingIOError

    monkeypatch.setattr(os, "read", wait)
    with pytest.raises(InputError, match="this is no file"):
        open_regular(tmp_path / "a")


def test_a_file_of_the_system_is_read_from_its_beginning() -> None:
    with open_regular("/proc/self/status") as file:
        assert file.read().startswith(b"Name:")


def test_a_pipe_among_the_sources_is_refused(tmp_path: Path) -> None:
    """It was left out without a word."""
    (tmp_path / "a.laz").write_bytes(b"")
    os.mkfifo(tmp_path / "b.laz")
    for pattern in ("*.laz", "**/*.laz"):
        with pytest.raises(InputError, match="a pipe"):
            find_files([pattern], tmp_path, "survey.sources", tmp_path / "s.yaml", conf.section("store", ()))
