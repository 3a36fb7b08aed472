"""Writing an output file or directory whole or not at all: beside its place first, then renamed."""

from __future__ import annotations

import os
import re
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import psutil

from fwclass.errors import ConfigError

_standing: dict[Path, tuple[int, ...] | None] = {}
"""What stood where an output goes when `check_free` looked."""


def check_free(path: Path, overwrite: bool) -> None:
    """`ConfigError` where `path` is no file, or one that must not be replaced.

    From here on `written_whole` replaces nothing there but what stands there now: two commands with one output are not
    both done in silence.
    """
    if path.is_dir() or (path.exists() and not path.is_file()):
        raise ConfigError("the output is not a file", where=path, do="choose another name")
    if path.exists() and not overwrite:
        raise ConfigError("the output exists", where=path, do="choose another name, or add --overwrite")
    _standing[path.absolute()] = _identity(path)


def check_other(path: Path, source: Path) -> None:
    """`ConfigError` where `path` is the file `source`, under this name or another."""
    if path.exists() and source.exists() and path.samefile(source):
        raise ConfigError(
            "a file cannot be written onto itself", where=path, do="name another output; the input is never changed"
        )


def _identity(path: Path) -> tuple[int, ...] | None:
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_ino, state.st_size, state.st_mtime_ns


def _place(source: Path, target: Path) -> None:
    """Rename `source` to `target`, unless another process has written there since `check_free`."""
    where = target.absolute()
    if where not in _standing:
        source.replace(target)
        return
    try:
        if _identity(target) != _standing[where]:
            raise FileExistsError
        if _standing[where] is None:
            os.link(source, target)
    except FileExistsError:
        raise ConfigError(
            "another command has written the output while this one worked",
            where=target,
            got="this one's result is not kept",
            do="look at what is there; then run this command again, with another name or with --overwrite",
        ) from None
    except OSError:  # a file system without hard links
        pass
    source.replace(target)
    _standing[where] = _identity(target)


@cache
def _host() -> str:
    """This host, as part of a file's name."""
    return re.sub(r"[^A-Za-z0-9]+", "_", socket.gethostname())[:20]


def sweep(path: Path) -> None:
    """Remove what processes of this host that are gone have left beside `path` of an output of its name."""
    begins = f".{path.name}.{_host()}-"
    with os.scandir(path.parent) as entries:
        leftovers = [entry for entry in entries if entry.name.startswith(begins)]
    for entry in leftovers:
        number, part, _ = entry.name[len(begins) :].partition(".part")
        if not part or not number.isdecimal():
            continue
        with suppress(FileNotFoundError):  # another process has swept it
            mine = entry.stat(follow_symlinks=False).st_uid == os.geteuid()
            process = int(number)
            if mine and (process == os.getpid() or not psutil.pid_exists(process)):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    Path(entry.path).unlink()


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to; it becomes `path` when the block ends well, else it is removed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    sweep(path)
    beside = path.with_name(f".{path.name}.{_host()}-{os.getpid()}.part{path.suffix}")
    try:
        yield beside
        with beside.open("rb") as file:
            os.fsync(file.fileno())
        _place(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def write_page(path: Path, text: str) -> int:
    """Write a page of text, the same bytes on any system; its size [bytes]."""
    with written_whole(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
        return beside.stat().st_size


@contextmanager
def whole_directory(path: Path) -> Iterator[Path]:
    """A directory beside `path` to write to; it becomes `path` when the block ends well, else it is removed.

    `ConfigError`: there is something at `path`, other than an empty directory.
    """
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ConfigError(
            "a directory of its own is needed",
            where=path,
            expected="a new or empty directory",
            got="one with files" if path.is_dir() else "a file",
            do="name another",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    sweep(path)
    beside = path.with_name(f".{path.name}.{_host()}-{os.getpid()}.part")
    try:
        beside.mkdir()
        yield beside
        beside.replace(path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
