"""The history of a run: a line when it begins, a line when it has ended, in ``store/history.jsonl``.

Lines are only ever added, each by one write that is flushed. A line that was torn (power cut, disk full) is passed
over. On object storage, where nothing can be appended, every line is an object,
``store/history/<when the run began>-<id>-<record>.json``; a list of names is in the order of the runs' beginnings, by
the second and by the clock of the host that ran them.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fwclass.paths import below, open_below
from fwclass.store.atomic import sync
from fwclass.store.lock import SCHEDULE, STATE, WRITER

if TYPE_CHECKING:
    from fwclass.store.bucket import Remote
    from fwclass.store.objects import Objects

NAME, EARLIER = "history.jsonl", "history.1.jsonl"

HISTORY_BYTES = 4 << 20
"""A longer file becomes `EARLIER`, whose lines are then forgotten: some 5 000 runs stay, 10 000 at most."""

BELOW = "store/history"
RECORDS = ("begin", "end", "told")
KEPT = 5000
"""Runs that stay, as many as in a directory; who next holds the run's lock removes the oldest beyond."""
LAST = 200
"""Runs that are read where nobody says how many: each is an object or two."""

_NAME = re.compile(rf"{BELOW}/(?P<began>\d{{8}}T\d{{6}}Z)-(?P<id>\w+)-(?P<record>{'|'.join(RECORDS)})\.json", re.ASCII)


def append(location: Path | Remote, line: Mapping[str, Any]) -> None:
    """Add a line, whole or torn, never mixed with another writer's; `OSError` or `StoreError` where it cannot be
    written."""
    if isinstance(location, Path):
        _append(location, line)
    else:
        location.objects.put(_key(line), json.dumps(line, sort_keys=True, allow_nan=False).encode())


def _append(root: Path, line: Mapping[str, Any]) -> None:
    path = below(root, f"store/{NAME}")
    path.parent.mkdir(parents=True, exist_ok=True)
    text = (json.dumps(line, sort_keys=True, allow_nan=False) + "\n").encode()
    with _alone(root):
        if path.exists() and path.stat().st_size + len(text) > HISTORY_BYTES:
            path.replace(path.with_name(EARLIER))
        new = not path.exists()
        handle = open_below(root, f"store/{NAME}", os.O_RDWR | os.O_APPEND | os.O_CREAT)
        try:
            os.write(handle, (b"\n" if _torn(handle) else b"") + text)
            os.fsync(handle)
        finally:
            os.close(handle)
        if new:
            sync(path.parent)


def lines(location: Path | Remote, last: int | None = None) -> Iterator[dict[str, Any]]:
    """All lines in the order they were written; on object storage those of the `last` runs (`LAST`), without the
    beginning of one that has ended."""
    if isinstance(location, Path):
        return _lines(location)
    runs = list(_by_run(item.key for item in location.objects.list(BELOW)).values())
    return _read(location.objects, [key for keys in runs[-(LAST if last is None else last) :] for key in keys])


def lines_of(location: Path | Remote, name: str) -> Iterator[dict[str, Any]]:
    """The lines of the run whose id is `name`."""
    if isinstance(location, Path):
        return (line for line in _lines(location) if str(line.get("id")) == name)
    keys = _by_run(item.key for item in location.objects.list(BELOW)).get(_word(name), [])
    return _read(location.objects, keys)


def is_run(location: Path | Remote) -> bool:
    """A run was begun there, or a schedule."""
    if isinstance(location, Path):
        return (location / "store").is_dir() or (location / STATE).is_file()
    locks = location.objects.many([f"store/{lock.name}" for lock in (WRITER, SCHEDULE)])
    return any(lock is not None for lock in locks)


def _lines(root: Path) -> Iterator[dict[str, Any]]:
    for name in (EARLIER, NAME):
        try:
            stream = os.fdopen(open_below(root, f"store/{name}", os.O_RDONLY), encoding="utf-8", errors="replace")
        except FileNotFoundError:
            continue
        with stream:
            for text in stream:
                with contextlib.suppress(ValueError, RecursionError):
                    line = json.loads(text)
                    if isinstance(line, dict):
                        yield line


def _torn(handle: int) -> bool:
    """The last line has no end."""
    size = os.fstat(handle).st_size
    return size > 0 and os.pread(handle, 1, size - 1) != b"\n"


@contextlib.contextmanager
def _alone(root: Path) -> Iterator[None]:
    """One writer at a time, so that none writes into a file that another has just put away."""
    with os.fdopen(open_below(root, "store/history.lock", os.O_WRONLY | os.O_CREAT), "wb") as stream:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX)
        yield


# on object storage


def surplus(keys: Iterable[str]) -> list[str]:
    """Which of `keys` are lines of runs that have been there for too long."""
    runs = list(_by_run(keys, whole=True).values())
    return [key for some in runs[: max(0, len(runs) - KEPT)] for key in some]


def _key(line: Mapping[str, Any]) -> str:
    began = str(line.get("began") or datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    return f"{BELOW}/{re.sub('[-:]', '', began)}-{_word(str(line['id']))}-{line['record']}.json"


def _word(name: str) -> str:
    """An id as a part of a name: it may come from the environment."""
    return re.sub(r"[^0-9A-Za-z]", "_", name)[:100] or "_"


def _by_run(keys: Iterable[str], whole: bool = False) -> dict[str, list[str]]:
    """Names of lines by the run's id, in the order of the runs' beginnings; what is no line is passed over.

    Not `whole`: without a beginning whose run has ended, because the end repeats all of it.
    """
    runs: dict[str, dict[str, str]] = {}
    for match in filter(None, map(_NAME.fullmatch, sorted(keys))):
        runs.setdefault(match["id"], {})[match[0]] = match["record"]
    return {name: _in_order(records, whole) for name, records in runs.items()}


def _in_order(records: Mapping[str, str], whole: bool) -> list[str]:
    """Names of one run's lines, as they were written; `records`: what each is."""
    needed = [key for key, record in records.items() if whole or record != "begin" or "end" not in records.values()]
    return sorted(needed, key=lambda key: RECORDS.index(records[key]))


def _read(objects: Objects, keys: Iterable[str]) -> Iterator[dict[str, Any]]:
    """The lines that are there and are whole."""
    for data in objects.many(list(keys)):
        try:
            line = json.loads(data[0]) if data is not None else None
        except (ValueError, RecursionError):
            continue
        if isinstance(line, dict):
            yield line
