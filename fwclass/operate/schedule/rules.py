"""What a configuration says of a schedule: its ticks, its inbox, and both in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.operate.schedule.inbox import Inbox
from fwclass.operate.schedule.places import places_of
from fwclass.operate.schedule.ticks import Cron, Interval, Now, Ticks
from fwclass.store.run_location import RunLocation


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
    return Inbox(directory, places_of(config, directory), params)


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
