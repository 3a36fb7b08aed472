"""When the next run is due: a function of the clocks and of the last tick, and of nothing else.

Two clocks: `wall` is the time of day [s since the epoch], which people and time servers set; `steady` only goes
forward, through suspension of the machine too [s]. Intervals are measured by the steady clock, cron's fields read the
wall clock.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from zoneinfo import ZoneInfo

from cronsim import CronSim


@dataclass(frozen=True)
class Now:
    """Both clocks, read together [s]."""

    wall: float
    steady: float


def now() -> Now:
    """The time by both clocks."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)  # Linux's monotonic clock stands still while the machine sleeps
    return Now(time.time(), time.monotonic() if clock is None else time.clock_gettime(clock))


@dataclass(frozen=True)
class Interval:
    """A tick every `seconds`, the first at once; `due` is the next one [s of the steady clock]."""

    seconds: float
    due: float
    trigger = "interval"

    def follow_clock(self, now: Now) -> Interval:
        """Setting the wall clock changes nothing."""
        return self

    def wait(self, now: Now) -> float:
        """Seconds until the next tick, none or less if it is due."""
        return self.due - now.steady

    def after_run(self, now: Now) -> Interval:
        """The ticks until `now` have had their run: the next is the first one after it, however many were missed."""
        missed = math.floor((now.steady - self.due) / self.seconds)
        return replace(self, due=self.due + (missed + 1) * self.seconds)


@dataclass(frozen=True)
class Cron:
    """Ticks by the fields of crontab(5) in a time zone.

    `since`: ticks up to here are not waited for; `last`: when ticks last had their run, None for never; `back`: how
    far the clock may go back and still repeat no tick [s]. Times are of the wall clock.
    """

    rule: str
    zone: ZoneInfo
    back: float
    since: float
    last: float | None = None
    trigger = "cron"

    def follow_clock(self, now: Now) -> Cron:
        """After the clock was set back: ticks that had their run stay done, unless it went back by more than `back`."""
        if self.last is not None and now.wall < self.last - self.back:
            return replace(self, last=None, since=now.wall)
        if self.last is None and now.wall < self.since:
            return replace(self, since=now.wall)
        return self

    @property
    def next(self) -> float:
        """The first tick after the last run, or after the start."""
        return tick_after(self.rule, self.zone, self.since if self.last is None else self.last)

    def wait(self, now: Now) -> float:
        """Seconds until the next tick by the wall clock as it stands, none or less if it is due."""
        return self.next - now.wall

    def after_run(self, now: Now) -> Cron:
        """All ticks until `now` have had their run, however many were missed."""
        return replace(self, last=now.wall)


Ticks = Interval | Cron


def tick_after(rule: str, zone: ZoneInfo, moment: float) -> float:
    """The first tick of `rule` after `moment` [s since the epoch].

    As Debian's cron has it where the clocks change: a fixed time that the change leaves out comes right after it, one
    that it repeats comes once; hours or minutes given with ``*`` follow the clock, so that they come as often as it
    shows them.
    """
    start = datetime.fromtimestamp(moment, UTC).astimezone(zone)
    for tick in CronSim(rule, start):
        stamp = tick.timestamp()
        if stamp > moment:  # in the repeated hour the first of two equal times may lie behind
            return stamp
    raise AssertionError("a rule that was checked comes again")  # pragma: no cover
