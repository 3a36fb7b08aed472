"""The section `schedule`: when `fwclass schedule` runs a survey, and whom it tells."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo

from cronsim import CronSim, CronSimError
from pydantic import BeforeValidator, Field, SecretStr, field_validator, model_validator

from fwclass.params import Params

SECRET = ("webhook", "command")
"""Keys whose values are never shown."""

_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_DURATION = re.compile(r"(\d+(?:\.\d+)?)([smhd])")


LONGEST = 3660 * 86400.0
"""Seconds: ten years, beyond which a calendar of the machine may not reach."""


def seconds_of(value: Any) -> Any:
    """``90s``, ``15m``, ``1h30m``, ``1d``, or a number of seconds, as seconds; `ValueError` for anything else."""
    if isinstance(value, bool):
        raise ValueError("a time like 90s, 15m, 1h30m or 1d is wanted")
    if isinstance(value, str):
        text = value.strip().lower()
        if not text or _DURATION.sub("", text):
            raise ValueError("a time like 90s, 15m, 1h30m or 1d is wanted")
        return sum(float(number) * _UNITS[unit] for number, unit in _DURATION.findall(text))
    return value


def interval(text: str) -> float:
    """`seconds_of` a text; `ValueError` where no time goes by."""
    seconds = float(seconds_of(text))
    if not 0 < seconds <= LONGEST:
        raise ValueError("a time greater than 0 and of at most 3660d is wanted, like 90s, 15m, 1h30m or 1d")
    return seconds


def cron_rule(expression: str) -> str:
    """`expression`, five fields as of crontab(5); `ValueError` where it says nothing, or never comes."""
    from datetime import UTC, datetime

    text = " ".join(expression.split())
    if len(text.split(" ")) != 5:
        raise ValueError('five fields are wanted: minute, hour, day, month, weekday, as in "0 3 * * *"')
    try:
        next(CronSim(text, datetime(2000, 1, 1, tzinfo=UTC)))
    except (CronSimError, AssertionError) as fault:
        raise ValueError(
            f"no cron expression: {fault or 'a step needs a place to start'}"
            " (minute 0-59, hour 0-23, day 1-31, month 1-12, weekday 0-7)"
        ) from None
    except StopIteration:
        raise ValueError("it never comes") from None
    return text


Seconds = Annotated[float, BeforeValidator(seconds_of)]


class ScheduleSection(Params):
    """When a survey is run again, and what happens then; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    every : interval between the beginnings of runs [s], or null.
    cron : five fields of crontab(5), or null.
    timezone : name in the IANA database of the zone that the fields of `cron` are in.
    inbox : directory whose complete files are moved into the survey and run, relative to the survey's file, or null.
    into : where they go, relative to survey.directory; null: where survey.sources finds a file of that name.
    complete : settled: a file has not changed for `settle` and agrees with its header; marker: a file with one of
        `markers` after its name stands beside it, and it agrees with its header; either.
    partial : endings of names that uploads have before they are whole; such files wait for another name.
    settle : how long a file must not have changed [s].
    hold : how long complete files wait for others that still change [s].
    keep_replaced : of every file that was delivered again, so many older versions stay in ``<inbox>/replaced``.
    look : how often inbox and clock are looked at [s].
    heartbeat : how often the status file is written while nothing happens [s].
    clock_back : a clock that goes back by less does not make a tick come twice; one that goes back by more was
        wrong, and ticks are counted anew [s].
    stop_grace : how long a run may take to end when the schedule is stopped [s].
    webhook : http or https address that the record of an ended run is sent to, or null.
    webhook_token_env : environment variable with a token for it, or null.
    webhook_timeout : for each step of a try [s].
    webhook_tries, webhook_pause : tries, and how long before the second one [s], twice as long before the next.
    command : words of a command that gets the record on its standard input; empty: none.
    command_timeout : after which it is ended [s].
    """

    every: Annotated[Seconds, Field(gt=0, le=LONGEST)] | None
    cron: str | None
    timezone: str
    inbox: str | None
    into: str | None
    complete: Literal["settled", "marker", "either"]
    markers: tuple[Annotated[str, Field(pattern=r"^\.[\w.-]+$")], ...] = Field(min_length=1)
    partial: tuple[Annotated[str, Field(pattern=r"^\.[\w.-]+$")], ...]
    settle: Annotated[Seconds, Field(ge=0)]
    hold: Annotated[Seconds, Field(ge=0)]
    keep_replaced: int = Field(ge=0)
    look: Annotated[Seconds, Field(gt=0)]
    heartbeat: Annotated[Seconds, Field(gt=0)]
    clock_back: Annotated[Seconds, Field(ge=0)]
    stop_grace: Annotated[Seconds, Field(ge=0)]
    webhook: SecretStr | None
    webhook_token_env: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")] | None
    webhook_timeout: Annotated[Seconds, Field(gt=0)]
    webhook_tries: int = Field(ge=1)
    webhook_pause: Annotated[Seconds, Field(ge=0)]
    command: tuple[str, ...]
    command_timeout: Annotated[Seconds, Field(gt=0)]

    @field_validator("cron")
    @classmethod
    def _cron(cls, value: str | None) -> str | None:
        return None if value is None else cron_rule(value)

    @field_validator("timezone")
    @classmethod
    def _zone(cls, value: str) -> str:
        try:
            ZoneInfo(value)
        except (OSError, ValueError, KeyError):
            raise ValueError("a name of the IANA time zone database is wanted, as in Europe/Berlin") from None
        return value

    @field_validator("webhook")
    @classmethod
    def _address(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None:
            _check_address(value.get_secret_value())
        return value

    @model_validator(mode="after")
    def _fit(self) -> ScheduleSection:
        if self.every is not None and self.cron is not None:
            raise ValueError("`every` and `cron` exclude one another")
        address = self.webhook.get_secret_value() if self.webhook is not None else ""
        if self.webhook_token_env is not None and "@" in urlsplit(address).netloc:
            raise ValueError("`webhook` names a user, and `webhook_token_env` a token: one of them is wanted")
        return self


def _check_address(text: str) -> None:
    """`ValueError`, without a word of the address, where it cannot be one of the web."""
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError:
        raise ValueError("an address that begins with https:// or http:// is wanted") from None
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ValueError("an address that begins with https:// or http:// is wanted")
    if not text.isascii() or any(c.isspace() or c in "\"'<>`|\\" or not c.isprintable() for c in text):
        raise ValueError("the address has characters that must be written as %XX")
