"""Files and directories that appear whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fwclass.errors import DamagedError, StoreError

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
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            state.update(block)
    return state.hexdigest()


def files_below(directory: Path) -> list[Path]:
    """Every file below `directory`, sorted by relative path."""
    return sorted((p for p in directory.rglob("*") if p.is_file()), key=lambda p: p.relative_to(directory).as_posix())


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
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with beside.open("wb") as stream:
            stream.write(data)
            if flush:
                stream.flush()
                os.fsync(stream.fileno())
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
    if flush:
        sync(path.parent)


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
    """Plain data of a file; `DamagedError` where it is none."""
    return from_json(path.read_bytes(), path)


@contextmanager
def staged(parent: Path, *below: str) -> Iterator[Path]:
    """A fresh directory to write into, ``parent/<unique>/*below``; what is still there at the end is removed."""
    own = parent / uuid.uuid4().hex
    directory = own.joinpath(*below)
    directory.mkdir(parents=True)
    try:
        yield directory
    finally:
        shutil.rmtree(own, ignore_errors=True)


def move_into_place(source: Path, target: Path, flush: bool = True) -> None:
    """Rename a flushed file or directory to `target`; an older one there is replaced.

    Without `flush` it may be gone after a power cut.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.is_dir():
        shutil.rmtree(target)
    source.replace(target)
    if flush:
        sync(target.parent)


def clear_staged(own: Path) -> None:
    """Take a staged directory away, at one stroke: who still writes there cannot commit what is left of it."""
    gone = own.with_name(f"cleared-{uuid.uuid4().hex}")
    with contextlib.suppress(OSError):
        own.rename(gone)
    shutil.rmtree(gone, ignore_errors=True)


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
