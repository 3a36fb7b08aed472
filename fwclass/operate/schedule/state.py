"""``schedule.json`` at the run's root: how a schedule stands, for programs."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fwclass import __version__
from fwclass.errors import StoreError
from fwclass.operate.history import utc, why_not
from fwclass.operate.schedule.ticks import Now
from fwclass.store.lock import SCHEDULE
from fwclass.store.lock import STATE as NAME
from fwclass.store.refusals import LostRace
from fwclass.store.run_location import RunLocation, address_of, held_by, read_note, write_note

LATEST = 253_402_300_799
"""s since the epoch, the end of the year 9999: what a date can tell."""

WAITING, RUNNING, STOPPED = "waiting", "running", "stopped"


@dataclass
class ScheduleState:
    """What is written; replaced as a whole, so that a reader sees one state or the next.

    Attributes
    ----------
    location : where the run lies, as the lock of the schedule gave it.
    patience : how long it is waited for object storage, which may answer later [s].
    last_tick : wall clock of the last tick of cron that had its run [s since the epoch], None for none.
    owed : names of files that were delivered, but not run yet.
    """

    location: RunLocation
    rules: Mapping[str, Any]
    heartbeat: float
    patience: float
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
    _writing: threading.Thread | None = None

    def resume(self) -> None:
        """Take over what an earlier schedule of this run left."""
        try:
            state = read_note(self.location, NAME)
        except StoreError:
            state = {}
        if isinstance(state, dict):
            owed, tick, last = (state.get(name) for name in ("owed", "last_tick", "last"))
            self.owed = [name for name in owed if isinstance(name, str)] if isinstance(owed, list) else []
            self.last_tick = float(tick) if isinstance(tick, (int, float)) and 0 <= tick <= LATEST else None
            self.last = last if isinstance(last, dict) else None

    def write(self, now: Now, always: bool = False) -> None:
        """Where something has changed, or `heartbeat` seconds have gone by; the last one `always`.

        A full disk, or object storage that does not answer, is told and stops nothing.
        """
        telling = (self.state, self.next, self.last, self.last_tick, self.owed, self.waiting, self.run)
        same = telling == self._written
        if same and not always and now.steady - self._at < self.heartbeat:
            return
        patience = self.heartbeat if always else self.patience  # nothing comes after the last one
        if self._writing is not None:
            self._writing.join(patience if always else 0.0)
            if self._writing.is_alive():
                return  # object storage hangs: what was put before this is still on its way
        self._put(self._data(now), patience)
        self._written = (*telling[:4], list(self.owed), list(self.waiting), self.run)
        self._at = now.steady

    def _put(self, data: Mapping[str, Any], patience: float) -> None:
        """On object storage in a thread of its own: ticks and signals do not wait for a server that hangs."""
        if isinstance(self.location, Path):
            self._write(data)
            return
        self._writing = threading.Thread(target=self._write, args=(data,), name="schedule.json", daemon=True)
        self._writing.start()
        self._writing.join(patience)

    def _write(self, data: Mapping[str, Any]) -> None:
        try:
            write_note(self.location, NAME, data, SCHEDULE)
            self._broken = False
        except LostRace:
            pass  # it is another schedule's by now, and this one is about to be told so
        except (OSError, StoreError) as fault:
            if not self._broken:
                self.say(f"{address_of(self.location) / NAME} cannot be written: {why_not(fault)}")
            self._broken = True

    def _data(self, now: Now) -> dict[str, Any]:
        return {
            "state": self.state,
            "next": None if self.next is None else utc(self.next),
            "last": self.last,
            "last_tick": self.last_tick,
            "owed": self.owed,
            "waiting": self.waiting,
            "run": self.run,
            "runs": self.runs,
            "started": self.started,
            "heartbeat": utc(now.wall),
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "version": __version__,
            "rules": dict(self.rules),
        }


def standing(location: RunLocation) -> dict[str, Any] | None:
    """The state of the schedule that is at work on the run in `location`, None where none is.

    On object storage one that was killed on another host counts as well, until somebody follows it: `heartbeat` tells.
    """
    if held_by(location, SCHEDULE) is None:
        return None
    try:
        state = read_note(location, NAME)
    except (StoreError, FileNotFoundError):
        return None
    return state if isinstance(state, dict) else None
