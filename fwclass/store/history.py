"""The history of a run: a line when it begins, a line when it has ended, in ``store/history.jsonl``.

Lines are only ever added, each by one write that is flushed. A line that was torn (power cut, disk full) is passed
over. On object storage every line is an object (`remote_history`).
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fwclass.store.atomic import sync
from fwclass.store.lock import STATE

if TYPE_CHECKING:
    from fwclass.store.run_location import RunLocation

NAME, EARLIER = "history.jsonl", "history.1.jsonl"

HISTORY_BYTES = 4 << 20
"""A longer file becomes `EARLIER`, whose lines are then forgotten: some 5 000 runs stay, 10 000 at most."""


def append(location: RunLocation, line: Mapping[str, Any]) -> None:
    """Add a line, whole or torn, never mixed with another writer's; `OSError` or `StoreError` where it cannot be
    written."""
    if isinstance(location, Path):
        _append(location, line)
        return
    from fwclass.store import remote_history  # not at the top: a directory's history is told without what this needs

    remote_history.append(location.objects, line)


def _append(root: Path, line: Mapping[str, Any]) -> None:
    path = root / "store" / NAME
    path.parent.mkdir(parents=True, exist_ok=True)
    text = (json.dumps(line, sort_keys=True, allow_nan=False) + "\n").encode()
    with _alone(path.parent):
        if path.exists() and path.stat().st_size + len(text) > HISTORY_BYTES:
            path.replace(path.with_name(EARLIER))
        new = not path.exists()
        handle = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(handle, (b"\n" if _torn(handle) else b"") + text)
            os.fsync(handle)
        finally:
            os.close(handle)
        if new:
            sync(path.parent)


def lines(location: RunLocation, last: int | None = None) -> Iterator[dict[str, Any]]:
    """All lines in the order they were written; on object storage those of the `last` runs."""
    if isinstance(location, Path):
        return _lines(location)
    from fwclass.store import remote_history

    return remote_history.lines(location.objects, remote_history.LAST if last is None else last)


def lines_of(location: RunLocation, name: str) -> Iterator[dict[str, Any]]:
    """The lines of the run whose id is `name`."""
    if isinstance(location, Path):
        return (line for line in _lines(location) if str(line.get("id")) == name)
    from fwclass.store import remote_history

    return remote_history.lines_of(location.objects, name)


def is_run(location: RunLocation) -> bool:
    """A run was begun there, or a schedule."""
    if isinstance(location, Path):
        return (location / "store").is_dir() or (location / STATE).is_file()
    from fwclass.store import remote_history

    return remote_history.is_run(location.objects)


def _lines(root: Path) -> Iterator[dict[str, Any]]:
    for name in (EARLIER, NAME):
        try:
            stream = (root / "store" / name).open(encoding="utf-8", errors="replace")
        except FileNotFoundError:
            continue
        with stream:
            for text in stream:
                with contextlib.suppress(ValueError, RecursionError):
                    found = json.loads(text)
                    if isinstance(found, dict):
                        yield found


def _torn(handle: int) -> bool:
    """The last line has no end."""
    size = os.fstat(handle).st_size
    return size > 0 and os.pread(handle, 1, size - 1) != b"\n"


@contextlib.contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """One writer at a time, so that none writes into a file that another has just put away."""
    with (directory / "history.lock").open("a") as stream:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX)
        yield
