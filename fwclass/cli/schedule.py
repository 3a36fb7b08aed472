"""`fwclass schedule` runs a survey again and again; `fwclass history` tells what was run."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import JSON, PATH, RUN, SCHEDULER, SET, WORKERS, cli
from fwclass.cli.run_words import WORKFLOW, location_of_run, read_request, run_at
from fwclass.errors import ConfigError, visible


@cli.command()
@click.argument("conf", type=PATH)
@click.option("--out", type=RUN, help="Run directory, or s3://bucket/directory (default: runs/<survey>).")
@click.option("--every", metavar="TIME", help="Interval between the beginnings of runs: 90s, 15m, 1h30m, 1d.")
@click.option("--cron", metavar='"M H D M W"', help="Five fields as of crontab(5), in schedule.timezone.")
@click.option("--inbox", type=PATH, help="Move complete files from this directory into the survey, and run.")
@click.option("--once", is_flag=True, help="End after one run, with its exit code.")
@click.option(
    "--allow-command",
    is_flag=True,
    envvar="FWCLASS_ALLOW_COMMAND",
    help="Run the command that the configuration names.",
)
@SET
@WORKFLOW
@SCHEDULER
@WORKERS
def schedule(
    conf: Path,
    out: Any,
    every: str | None,
    cron: str | None,
    inbox: Path | None,
    once: bool,
    allow_command: bool,
    settings: tuple[str, ...],
    workflow: str,
    scheduler: str | None,
    workers: int | None,
) -> None:
    """Run a survey on an interval, by a cron expression, or when files are delivered, until told to stop.

    Each run is what `fwclass run` does, in a process of its own, and has a line in `fwclass history`. The section
    `schedule` of the configuration has the same and more: webhook, command, how files are known to be complete. How it
    stands is in schedule.json in the run directory, or at the run's address. Exit code 0 when ended by SIGTERM, 130 by
    Ctrl-C; with --once that of the run.
    """
    from fwclass.operate.schedule.loop import Schedule

    config, request = read_request(conf, out, (*settings, *_settings_of(every, cron, inbox)), workflow, None)
    own = any(setting.strip().startswith("schedule.command") for setting in settings)
    if config.schedule.command and not (allow_command or own):
        raise ConfigError(
            "the configuration names a command, which would be run with your rights",
            where=f"{config.path}: schedule.command",
            expected="--allow-command, or FWCLASS_ALLOW_COMMAND=1",
            do="read the configuration, then give --allow-command; or leave it out: --set schedule.command=[]",
        )
    words: list[str] = []
    if scheduler is not None:
        words += ["--scheduler", scheduler]
    if workers is not None:
        words += ["--workers", str(workers)]
    location = location_of_run(request, config)
    sys.exit(Schedule(config, request, location, tuple(words), once, lambda text: click.echo(text, err=True)).keep())


def _settings_of(every: str | None, cron: str | None, inbox: Path | None) -> list[str]:
    """The options as settings, checked like those of the configuration that they replace."""
    if every is not None and cron is not None:
        raise ConfigError("--every and --cron exclude one another", where="--every, --cron", do="give one of them")
    from fwclass.conf.schedule import cron_rule, interval

    settings: dict[str, Any] = {}
    for option, other, typed, rule in (("every", "cron", every, interval), ("cron", "every", cron, cron_rule)):
        if typed is not None:
            try:
                settings |= {option: rule(typed), other: None}
            except ValueError as fault:
                raise ConfigError(str(fault), where=f"--{option}", got=repr(typed), do="correct it") from None
    if inbox is not None:
        settings["inbox"] = str(inbox.resolve())
    return [f"schedule.{name}={json.dumps(value)}" for name, value in settings.items()]


@cli.command()
@click.argument("run", type=RUN)
@click.option(
    "--last",
    "count",
    type=click.IntRange(1),
    metavar="N",
    help="Only the last N runs (default: all; of a run on object storage, the last 200).",
)
@JSON
def history(run: Any, count: int | None, as_json: bool) -> None:
    """Tell what was run in RUN, a directory or s3://bucket/directory: when, why, how it ended, and how many parts were
    made."""
    from fwclass.operate.history import past_runs, table

    runs = past_runs(run_at(run), count)
    click.echo(json.dumps(runs, indent=1) if as_json else visible(table(runs), "\n"))
