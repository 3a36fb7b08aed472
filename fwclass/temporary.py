"""Directories for the time of a command, beside an output or in the system's place for temporary files (``TMPDIR``).

Each is locked while its process lives. So the next command tells what one that was killed has left, and removes it.
"""

from __future__ import annotations

import fcntl
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


@contextmanager
def temporary_directory(kind: str, beside: Path | None = None) -> Iterator[Path]:
    """A fresh directory for `kind` of work below `beside`, hidden there, or in the system's place; removed at the end.

    Those of the same kind, place and user whose processes are gone are removed first.
    """
    place = beside if beside is not None else Path(tempfile.gettempdir())
    prefix = f"{'.' if beside is not None else ''}fwclass-{kind}-"
    for left in place.glob(f"{prefix}*"):
        _remove_left(left)
    directory, handle = _make_locked(place, prefix)
    try:
        yield directory
    finally:
        shutil.rmtree(directory, ignore_errors=True)
        os.close(handle)


def array_in_file(file: IO[bytes], dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """An array that lies in an empty `file` instead of memory. Its room on the disk is taken at once: a full disk is an
    `OSError` here, where it would be a signal as soon as one of its pages is written."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if not size:
        return np.empty(shape, dtype)
    if hasattr(os, "posix_fallocate"):  # not on macOS
        os.posix_fallocate(file.fileno(), 0, size)
    return np.memmap(file, dtype, "r+", shape=shape)


def _make_locked(place: Path, prefix: str) -> tuple[Path, int]:
    """A directory, and the handle that holds its lock."""
    while True:
        directory = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
        with suppress(FileNotFoundError):  # another process took it for left, before it was locked
            handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
            with suppress(OSError):  # there are file systems without locks: no other process gets one there either
                fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
            if directory.is_dir():
                return directory, handle
            os.close(handle)


def _remove_left(directory: Path) -> None:
    """Remove a directory of this user that no process holds; anything else stays."""
    try:
        handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return
    try:
        if os.fstat(handle).st_uid == os.geteuid():
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(directory, ignore_errors=True)
    except OSError:
        return
    finally:
        os.close(handle)
