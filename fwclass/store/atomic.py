"""Files and directories that appear whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from fwclass.errors import DamagedError, StoreError
from fwclass.paths import open_regular

_BLOCK = 1 << 20


_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def digest_of(value: Any) -> str:
    """Digest of plain data: 32 hex digits of BLAKE2b over its canonical JSON."""
    return bytes_digest(_CANONICAL.encode(value).encode())


def bytes_digest(data: bytes) -> str:
    """Digest of bytes, 32 hex digits of BLAKE2b."""
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def file_digest(path: Path) -> str:
    """Digest of a file's bytes, 32 hex digits of BLAKE2b."""
    state = hashlib.blake2b(digest_size=16)
    with open_regular(path) as stream:
        while block := stream.read(_BLOCK):
            state.update(block)
    return state.hexdigest()


def names_below(directory: Path) -> list[str]:
    """Every file below `directory`, as sorted relative paths with ``/``; links to directories are not followed."""
    names, pending = [], [""]
    while pending:
        below = pending.pop()
        with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(f"{directory}/{below}") as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    pending.append(f"{below}{entry.name}/")
                elif entry.is_file():
                    names.append(below + entry.name)
    return sorted(names)


def files_below(directory: Path) -> list[Path]:
    """Every file below `directory`, sorted by relative path."""
    return [directory / name for name in names_below(directory)]


def sync(path: Path) -> None:
    """Flush a file or a directory entry to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str, flush: bool = True) -> None:
    """Write a small file beside, flush it, rename it into place.

    Without `flush` a power cut may leave an earlier file, none, or a torn one: for what tells of itself whether it is
    whole, and can be made again.
    """
    write_bytes(path, text.encode("utf-8"), flush)


def write_bytes(path: Path, data: bytes, flush: bool = True) -> None:
    """As `write_text`."""
    beside = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with _opened_to_write(beside) as stream:
            stream.write(data)
            if flush:
                stream.flush()
                os.fsync(stream.fileno())
        beside.replace(path)
    except BaseException as fault:
        if isinstance(fault, OSError) and not fault.filename:  # a full disk is told with its place
            fault.filename = str(path)
        beside.unlink(missing_ok=True)
        raise
    if flush:
        sync(path.parent)


def _opened_to_write(path: Path) -> BinaryIO:
    """The file, opened; its directory is made where there is none, which is tried second, as it is seldom so."""
    try:
        return path.open("wb")
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("wb")


def write_json(path: Path, value: Any) -> None:
    """Write plain data as `write_text` does."""
    write_text(path, to_json(value))


def to_json(value: Any) -> str:
    """Plain data as the store writes it."""
    return json.dumps(value, sort_keys=True, indent=1, allow_nan=False) + "\n"


def from_json(data: bytes, where: object) -> Any:
    """Plain data that lies at `where`; `DamagedError` where it is none."""
    try:
        return json.loads(data.decode())
    except (ValueError, RecursionError) as fault:  # no JSON, no text, a number too long, nested too deep
        raise DamagedError(
            "a JSON file of the store cannot be read",
            where=where,
            got=fault,
            do="remove the file; the run makes it anew",
        ) from fault


def read_json(path: Path) -> Any:
    """Plain data of a file; `DamagedError` where it is none, `InputError` for a pipe."""
    with open_regular(path) as stream:
        return from_json(stream.read(), path)


@contextmanager
def staged(parent: Path, *below: str) -> Iterator[Path]:
    """A fresh directory to write into, ``parent/<unique>/*below``; what is still there at the end is removed.

    The unique directory is that of the thread, which stages one after another, and stays: to make and remove it for
    every small part took as long as the part.
    """
    directory = _own_below(parent).joinpath(*below)
    try:
        directory.mkdir()
    except FileNotFoundError:  # the first of its kind, or somebody cleared it away
        directory.parent.mkdir(parents=True, exist_ok=True)
        directory.mkdir()
    except FileExistsError:  # of the same part, under way around this one
        directory = (parent / uuid.uuid4().hex).joinpath(*below)
        directory.mkdir(parents=True)
    try:
        yield directory
    finally:
        shutil.rmtree(directory, ignore_errors=True)  # mostly it was renamed


_own = threading.local()


def _own_below(parent: Path) -> Path:
    """The directory below `parent` that no other thread, and no process that this one has become by a fork, has."""
    who = parent, os.getpid()
    if getattr(_own, "who", None) != who:
        _own.who, _own.path = who, parent / uuid.uuid4().hex
    path: Path = _own.path
    return path


def move_into_place(source: Path, target: Path, flush: bool = True) -> None:
    """Rename a flushed file or directory to `target`; an older one there is replaced.

    Without `flush` it may be gone after a power cut.
    """
    try:
        source.replace(target)
    except FileNotFoundError:
        target.parent.mkdir(parents=True, exist_ok=True)
        source.replace(target)
    except OSError:
        if not target.is_dir():
            raise
        shutil.rmtree(target)
        source.replace(target)
    if flush:
        sync(target.parent)


def remove_directory(path: Path) -> None:
    """Remove a directory and what is in it, as far as that goes; nothing else, no link and no pipe, for whose other end
    `shutil.rmtree` would wait."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)


def clear_staged(own: Path) -> None:
    """Take a staged directory away, at one stroke: who still writes there cannot commit what is left of it."""
    gone = own.with_name(f"cleared-{uuid.uuid4().hex}")
    with contextlib.suppress(OSError):
        own.rename(gone)
    remove_directory(gone)


@contextmanager
def watched(directory: Path) -> Iterator[Callable[[], None]]:
    """What raises `StoreError` where `directory` was taken away since, also if its writer has made it again."""
    handle = os.open(directory, os.O_RDONLY)  # while it is open, no other directory can be taken for this one

    def check() -> None:
        if not directory.is_dir() or not os.path.samestat(directory.stat(), os.fstat(handle)):
            raise StoreError(
                "another run cleared away what was being made",
                where=directory,
                do="see which runs work in this directory, then run the same again",
            )

    try:
        yield check
    finally:
        os.close(handle)
