"""``schedule.json`` in the run directory: how a schedule stands, for programs."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fwclass import __version__
from fwclass.errors import StoreError
from fwclass.run.history import utc
from fwclass.run.schedule.ticks import Now
from fwclass.store.atomic import read_json, write_json
from fwclass.store.lock import SCHEDULE, holder

NAME = "schedule.json"
WAITING, RUNNING, STOPPED = "waiting", "running", "stopped"


@dataclass
class State:
    """What is written; replaced as a whole, so that a reader sees one state or the next.

    Attributes
    ----------
    last_tick : wall clock of the last tick of cron that had its run [s since the epoch], None for none.
    owed : names of files that were delivered, but not run yet.
    """

    root: Path
    rules: Mapping[str, Any]
    heartbeat: float
    say: Callable[[str], None]
    state: str = WAITING
    next: float | None = None
    last: Mapping[str, Any] | None = None
    last_tick: float | None = None
    owed: list[str] = field(default_factory=list)
    waiting: list[dict[str, str]] = field(default_factory=list)
    run: Mapping[str, Any] | None = None
    runs: int = 0
    started: str = field(default_factory=lambda: utc(time.time()))
    _written: tuple[Any, ...] = ()
    _at: float = float("-inf")
    _broken: bool = False

    def resume(self) -> None:
        """Take over what an earlier schedule in this directory left."""
        path = self.root / NAME
        try:
            found = read_json(path) if path.exists() else {}
        except StoreError:
            found = {}
        if isinstance(found, dict):
            self.owed = [str(n) for n in found.get("owed") or ()]
            tick, last = found.get("last_tick"), found.get("last")
            self.last_tick = float(tick) if isinstance(tick, (int, float)) else None
            self.last = last if isinstance(last, dict) else None

    def write(self, now: Now, always: bool = False) -> None:
        """Where something has changed, or `heartbeat` seconds have gone by; a full disk is told, and stops nothing."""
        telling = (self.state, self.next, self.last, self.last_tick, self.owed, self.waiting, self.run)
        same = telling == self._written
        if same and not always and now.steady - self._at < self.heartbeat:
            return
        try:
            write_json(self.root / NAME, self._data(now))
            self._broken = False
        except OSError as fault:
            if not self._broken:
                self.say(f"{self.root / NAME} cannot be written: {fault.strerror or fault}")
            self._broken = True
        self._written = (*telling[:4], list(self.owed), list(self.waiting), self.run)
        self._at = now.steady

    def _data(self, now: Now) -> dict[str, Any]:
        return {
            "state": self.state, "next": None if self.next is None else utc(self.next), "last": self.last,
            "last_tick": self.last_tick, "owed": self.owed, "waiting": self.waiting, "run": self.run,
            "runs": self.runs, "started": self.started, "heartbeat": utc(now.wall), "pid": os.getpid(),
            "host": socket.gethostname(), "version": __version__, "rules": dict(self.rules),
        }  # fmt: skip


def standing(root: Path) -> dict[str, Any] | None:
    """The state of the schedule that is at work on `root`, None where none is."""
    kept = holder(root, SCHEDULE)
    path = root / NAME
    if kept is None or not path.exists():
        return None
    try:
        found = read_json(path)
    except (StoreError, FileNotFoundError):
        return None
    return found if isinstance(found, dict) else None
