"""One writer per run directory."""

from __future__ import annotations

import fcntl
import io
import json
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from fwclass.errors import FULL, ConfigError, LockedError, StoreError, visible
from fwclass.paths import below, open_below, open_regular, run_around


@dataclass(frozen=True)
class Lock:
    """A lock of a run: the name of its file, what a second one that asks for it is told, whose it is, and what comes
    of one that is lost."""

    name: str
    refusal: str
    do: str
    who: str
    then: str


WRITER = Lock(
    "lock",
    "another run is writing to this directory",
    "wait for it to end, or choose another --out",
    "run",
    "nothing more is committed",
)
STATE = "schedule.json"
"""At the run's root: how the holder of `SCHEDULE` stands."""
SCHEDULE = Lock(
    "schedule.lock",
    "another schedule is at work on this run directory",
    f"stop that one first ({STATE} in the run directory tells its state), or choose another --out",
    "schedule",
    "this one ends",
)


def refuse_inside(root: Path) -> None:
    """`ConfigError` for a run directory that would lie in another's store or delivery."""
    if run := run_around(root):
        raise around(root, run)


def around(place: object, run: object) -> ConfigError:
    """What to say of a place in the store or the delivery of a run."""
    return ConfigError(
        "the run directory would lie in what another run has made and delivers",
        where="--out",
        expected="a directory outside of the store and the deliveries of a run",
        got=f"{place}, in the run {run}",
        do="name another place",
    )


@contextmanager
def writer(root: Path, lock: Lock = WRITER) -> Iterator[Callable[[], None]]:
    """Hold the run directory `root`; a second writer gets a `LockedError` naming the first one's host and pid.

    Gives a function that raises `StoreError` when the directory is not the one any more that is held; what else goes
    wrong then is told as that. `ConfigError` as `refuse_inside`.

    The lock is the kernel's (`flock`) and goes with the process that held it, so none is left behind by a crash.
    """
    refuse_inside(root)
    path = below(root, f"store/{lock.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = open_below(root, f"store/{lock.name}", os.O_RDWR | os.O_APPEND | os.O_CREAT)
    with os.fdopen(handle, "r+") as stream:
        if not _try_lock(stream.fileno()):
            raise LockedError(lock.refusal, where=root, got=holder_text(_facts(stream) or {}), do=lock.do)
        stream.seek(0)
        stream.truncate()
        try:
            os.write(stream.fileno(), json.dumps({"host": socket.gethostname(), "pid": os.getpid()}).encode())
        except OSError as fault:  # the lock holds without the name, and who frees space needs it
            if fault.errno not in FULL:
                raise
        try:
            yield lambda: _same(path, stream.fileno(), root)
        except Exception:
            _same(path, stream.fileno(), root)  # the reason for all else, if it is one
            raise
        finally:
            stream.seek(0)
            stream.truncate()


def holder(root: Path, lock: Lock = WRITER) -> Mapping[str, Any] | None:
    """Host and pid of the run that is writing to `root`, None where there is none; nothing is written. Both are None
    of one that found no room on the disk for its name.

    On a file system without locks between hosts, what the file says is believed.
    """
    path = root / "store" / lock.name
    try:
        with io.TextIOWrapper(open_regular(path), errors="replace") as stream:
            facts = _facts(stream)
            if facts is None:
                return {"host": None, "pid": None} if _locked(stream.fileno()) else None
            if facts.get("host") == socket.gethostname() and not _locked(stream.fileno()):
                return None  # it was killed and left its name
            return facts
    except FileNotFoundError:
        return None


def holder_text(facts: Mapping[str, Any]) -> str:
    """Who holds a lock, in words."""
    return f"pid {facts.get('pid')} on {facts.get('host')}" if facts.get("pid") else "one that did not leave its name"


def _facts(stream: IO[str]) -> dict[str, Any] | None:
    """What the file of a lock says, None where it says nothing."""
    try:
        stream.seek(0)
        facts = json.loads(stream.read(200))
    except (ValueError, RecursionError):
        return None
    if not isinstance(facts, dict):
        return None
    return {str(k)[:80]: visible(v) if isinstance(v, str) else v for k, v in facts.items()}


def _same(path: Path, handle: int, root: Path) -> None:
    try:
        if os.path.samestat(path.stat(), os.fstat(handle)):
            return
        got = "another store in its place"
    except OSError as fault:
        got = str(fault.strerror)
    raise StoreError(
        "the run directory was removed while the run was under way",
        where=root,
        got=got,
        do="run the same again; it makes what is missing",
    )


def _try_lock(handle: int) -> bool:
    """Take the lock; tried for a tenth of a second, because `_locked` holds it for an instant."""
    for _ in range(5):
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except OSError:
            time.sleep(0.02)
    return False


def _locked(handle: int) -> bool:
    """Another process holds the lock."""
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    fcntl.flock(handle, fcntl.LOCK_UN)
    return False
