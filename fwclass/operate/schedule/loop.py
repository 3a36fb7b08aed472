"""`fwclass schedule`: wait, run, tell, and wait again."""

from __future__ import annotations

import os
import signal
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from fwclass.conf import Config
from fwclass.errors import DONE, FAILED, INTERRUPTED, ConfigError, StoreError, visible
from fwclass.operate.history import REFUSED, Entry, past_run, utc, why_not, word_of
from fwclass.operate.request import Request
from fwclass.operate.schedule import notify, state
from fwclass.operate.schedule.child import Child, Signals
from fwclass.operate.schedule.inbox import Inbox, InboxDelivery
from fwclass.operate.schedule.intake import Intake
from fwclass.operate.schedule.source_directories import source_directories_of
from fwclass.operate.schedule.state import ScheduleState
from fwclass.operate.schedule.ticks import Cron, Interval, Now, Ticks, now
from fwclass.store import history
from fwclass.store.lock import SCHEDULE
from fwclass.store.refusals import LostRace
from fwclass.store.run_location import RunLocation, address_of, confirm, held_by, lock_run, without_retries


def as_typed(seconds: float | None) -> str | None:
    """An interval as a user types it."""
    if seconds is None:
        return None
    unit, size = next(((u, s) for u, s in (("d", 86400), ("h", 3600), ("m", 60)) if seconds % s == 0), ("s", 1))
    return f"{seconds / size:g}{unit}"


@dataclass(frozen=True)
class Order:
    """A run that is due: why, and what is delivered before it begins."""

    trigger: str
    deliveries: tuple[InboxDelivery, ...] = ()
    tick: str | None = None


@dataclass
class Schedule:
    """A survey that is run again and again in one place, `location`.

    `words`: more of ``fwclass run``, where it runs (--workers, --scheduler). `say`: a line for the user.
    """

    config: Config
    request: Request
    location: RunLocation
    words: tuple[str, ...]
    once: bool
    say: Callable[[str], None]
    signals: Signals = field(default_factory=Signals)
    _ticks: Ticks | None = None
    _intake: Intake | None = None

    def keep(self) -> int:
        """Until told to stop, or for one run; the exit code.

        `ConfigError`: nothing says when to run, the inbox cannot be one, or the webhook's token is not there.
        `LockedError`: another schedule is at work on the run. `LostRace`: another one has taken it over, because this
        one was not heard of (object storage).
        """
        inbox = inbox_of(self.config, self.location)
        if inbox is None and self.config.schedule.every is None and self.config.schedule.cron is None:
            raise ConfigError(
                "nothing says when to run",
                where=f"{self.config.path}: schedule",
                expected="every, cron or inbox",
                do="for example: fwclass schedule CONF --every 1h",
            )
        token = self.config.schedule.webhook_token_env
        if self.config.schedule.webhook is not None and token is not None and not os.environ.get(token):
            raise ConfigError(
                f"the environment variable {token} is not set",
                where=f"{self.config.path}: schedule.webhook_token_env",
                expected="the token for the webhook",
                do="set it where the schedule is started, or leave the key out",
            )
        with lock_run(self.location, self._say, SCHEDULE) as (location, self._held), self.signals:
            params = self.config.schedule
            self._state = ScheduleState(location, rules(self.config), params.heartbeat, params.look, self._say)
            self._state.resume()
            if inbox is not None and isinstance(location, Path):
                self._intake = Intake(inbox, location, self._state, self._say)
            self._ticks = ticks_of(self.config, self._state.last_tick, now())
            try:
                return self._go()
            finally:
                self._state.state, self._state.next, self._state.run = state.STOPPED, None, None
                self._state.write(now(), always=True)

    def _go(self) -> int:
        self._say(f"pid {os.getpid()} runs: {self.request.command()}")
        when = {**rules(self.config), "every": as_typed(self.config.schedule.every)}
        self._say("when: " + ", ".join(f"{k} {v}" for k, v in when.items() if v is not None))
        while self.signals.first is None:
            moment = now()
            order = self._due(moment)
            self._check(asked=order is not None)
            code = None if order is None else self._carry_out(order)
            if code is None:  # nothing was run
                self._state.write(moment)
                self.signals.wait(self._pause(moment))
            elif self.once and self.signals.first is None:
                return code
        self._say(f"told to stop by {self.signals.first.name}")
        return INTERRUPTED if self.once or self.signals.first is signal.SIGINT else DONE

    def _check(self, asked: bool) -> None:
        """`LostRace` once another schedule has taken this one over; `asked`: object storage is asked, before a run.

        A store that does not answer stops nothing, and a directory that was removed is made again by the next run.
        """
        try:
            self._held()
            if asked:
                confirm(without_retries(self._state.location), SCHEDULE)
        except LostRace:
            raise
        except StoreError:
            pass

    def _pause(self, moment: Now) -> float:
        """Until the next look, or the tick if that comes sooner."""
        look = self.config.schedule.look
        return look if self._ticks is None else min(look, self._ticks.wait(moment))

    def _deliveries(self, moment: Now) -> tuple[InboxDelivery, ...]:
        return () if self._intake is None else self._intake.deliveries(moment)

    def _due(self, moment: Now) -> Order | None:
        """The run that is due now. A tick is taken by it, whatever comes of the run."""
        deliveries = self._deliveries(moment)
        if self._intake is not None:
            self._intake.look_again(moment)
        if self._ticks is not None:
            self._ticks = self._ticks.follow_clock(moment)
            wait = self._ticks.wait(moment)
            self._state.next = _steady(self._state.next, moment.wall + wait)
            if wait <= 0.0:
                self._ticks = self._ticks.after_run(moment)
                self._state.next = _steady(None, moment.wall + self._ticks.wait(moment))
                if isinstance(self._ticks, Cron):
                    self._state.last_tick = self._ticks.last
                return Order(self._ticks.trigger, deliveries, utc(moment.wall + wait))
        if deliveries or (self._state.owed and held_by(self.location) is None):
            return Order("inbox", deliveries)
        return None

    def _carry_out(self, order: Order) -> int | None:
        """Deliver, run, tell; the run's exit code, None where nothing was run."""
        files = [] if self._intake is None else self._intake.deliver(order.deliveries)
        if order.trigger == "inbox" and (not self._state.owed or held_by(self.location) is not None):
            return None
        named = {str(f["name"]) for f in files}
        files += [{"name": name} for name in self._state.owed if name not in named]
        why = {"trigger": order.trigger} | ({"tick": order.tick} if order.tick else {})
        record = self._run(why | ({"files": files} if files else {}))
        if not self._still_owed(record):
            self._state.owed = []
        if self._intake is not None and (self.once or self.signals.first is not None):  # nobody looks later
            self._intake.look_again(now(), settled=False)
        self._say(f"run ended: {record['word']}, {record.get('seconds', 0):g} s")
        self._state.last = record
        self._tell_ended(record)
        if record["word"] == word_of(INTERRUPTED):
            return INTERRUPTED
        return int(record["exit_code"]) if record["exit_code"] >= 0 else FAILED

    def _still_owed(self, record: Mapping[str, Any]) -> bool:
        """Files were not run: another run held the directory, or this one was ended with the schedule."""
        ended = record["exit_code"] < 0 or record["exit_code"] == INTERRUPTED
        return record["word"] == REFUSED or (self.signals.first is not None and ended)

    def _run(self, why: Mapping[str, Any]) -> dict[str, Any]:
        """A run as a process of its own, and its record, written for it where it could not do so itself."""
        params = self.config.schedule
        order = {"id": uuid.uuid4().hex, "why": why}
        began, clock = time.time(), time.monotonic()
        self._say(f"a run begins ({why['trigger']})")
        try:
            child = Child((*self.request.words(), *self.words), order, params.webhook_token_env)
        except OSError as fault:  # no memory, too many processes: the next tick tries again
            self._say(f"the run could not be started: {fault.strerror or fault}")
            code = FAILED
        else:
            self._state.state, self._state.runs = state.RUNNING, self._state.runs + 1
            self._state.run = {"pid": child.pid, "began": utc(began), "why": dict(why)}
            code = child.wait(self.signals, params.stop_grace, params.look, self._beat)
            self._state.state, self._state.run = state.WAITING, None
        record = self._record_of(
            Entry(self.location, self.request, id=str(order["id"]), why=why, began=began, clock=clock), code
        )
        return {**record, "run": str(address_of(self.location)), "survey": self.config.survey.name}

    def _record_of(self, entry: Entry, code: int) -> dict[str, Any]:
        """What the run itself has told of its end, or else what is told for it in `entry`, with its exit code."""
        try:
            record = past_run(self.location, entry.id)
        except StoreError as fault:
            self._say(f"the history cannot be read: {why_not(fault)}")
            return entry.ending(code, word_of(code), "the history could not be read")
        if record is not None and "exit_code" in record:
            return record
        if self.signals.first is not None and code > 0:  # it was stopped before it knew how to end
            code = INTERRUPTED
        entry.end(code, word_of(code), "the run could not tell its end itself")
        return entry.last

    def _beat(self) -> None:
        """While something is under way: what arrives is looked at, and the status written."""
        moment = now()
        self._deliveries(moment)
        self._state.write(moment)

    def _tell_ended(self, record: Mapping[str, Any]) -> None:
        """Webhook and command; how they went is told, and added to the run's history."""
        results = notify.tell_within(self.config.schedule, record, self.signals, self._beat)
        if not results:
            return
        for kind, facts in results.items():
            if not facts["ok"]:
                self._say(f"{kind} {facts['to']}: {facts['fault']} ({facts['tries']} tries)")
        self._state.last = {**record, "told": results}
        try:
            history.append(self.location, {"record": "told", "id": record.get("id"), "told": results})
        except (OSError, StoreError) as fault:
            self._say(f"the history cannot be written: {why_not(fault)}")

    def _say(self, text: str) -> None:
        self.say(f"{utc(time.time())} schedule: {visible(text)}")


def _steady(before: float | None, moment: float) -> float:
    """A time that is told: one that moves by less than a second and a half has not moved."""
    return before if before is not None and abs(before - moment) < 1.5 else round(moment)


def inbox_of(config: Config, location: RunLocation) -> Inbox | None:
    """The inbox that `config` names for the run in `location`; `ConfigError` where it cannot be one."""
    params = config.schedule
    if params.inbox is None:
        return None
    if not isinstance(location, Path):
        raise ConfigError(
            "an inbox needs a run directory of this machine",
            where="schedule.inbox, --out",
            got=location,
            expected="a lock that tells at once whether a run reads the survey",
            do="give a directory for --out, or --every or --cron in the inbox's place",
        )
    directory = (config.path.parent / params.inbox).resolve()
    if not directory.is_dir():
        raise ConfigError("the inbox is no directory", where="schedule.inbox", got=directory, do="make it first")
    return Inbox(directory, source_directories_of(config, directory), params)


def ticks_of(config: Config, last: float | None, moment: Now) -> Ticks | None:
    """When to run by the clock. `last`: the last tick of cron that an earlier schedule gave its run."""
    params = config.schedule
    if params.every is not None:
        return Interval(params.every, moment.steady)
    if params.cron is None:
        return None
    known = last if last is not None and last <= moment.wall + params.clock_back else None
    return Cron(params.cron, ZoneInfo(params.timezone), params.clock_back, moment.wall, known)


def rules(config: Config) -> dict[str, Any]:
    """When it runs, in words for the status file and the log."""
    p = config.schedule
    inbox = None if p.inbox is None else str((config.path.parent / p.inbox).resolve())
    return {"every": p.every, "cron": p.cron, "timezone": p.timezone if p.cron else None, "inbox": inbox}
