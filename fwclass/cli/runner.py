"""A run directory opened for work, and the words for parts that failed."""

from __future__ import annotations

import importlib.util
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import click

from fwclass.errors import ConfigError, several, visible
from fwclass.redact import redacted_words

NO_PAGE = "  (for its page: pip install 'fwclass[dashboard]')"

TOLD = 100
"""Failed parts that are listed at the end."""


def report_path(report: str | None, root: Any, workers: int, scheduler: str | None) -> Path | None:
    """Where Dask's performance report goes (None without ``--report``; empty: into the run directory); `ConfigError`
    where there will be none."""
    if report is None:
        return None
    path = Path(report) if report else (root if isinstance(root, Path) else Path()) / "performance.html"
    if path.suffix != ".html":
        raise ConfigError(
            "the performance report is a page",
            where="--report",
            expected="a name that ends in .html",
            got=report,
            do="name one, or give --report last for performance.html in the run directory",
        )
    if report and path.exists():
        raise ConfigError("there is such a file already", where=f"--report {path}", do="name another, or remove it")
    if scheduler is None and workers == 0:
        raise ConfigError(
            "the plain loop has no performance report: Dask writes it",
            where="--report",
            do="give --workers 1 or more, or --scheduler",
        )
    if importlib.util.find_spec("bokeh") is None:
        raise ConfigError("the performance report needs bokeh", where="--report", do="pip install 'fwclass[dashboard]'")
    return path


@contextmanager
def open_runner(
    location: Any, workers: int, scheduler: str | None, limits: Any, report: Path | None = None
) -> Iterator[Any]:
    """A run locked for writing, with its executor; `location` is its directory, or a `Remote` place; `limits` is
    section `run` of the configuration, `report` where Dask's performance report goes."""
    from fwclass.compiling import notify
    from fwclass.run.libraries import library_remarks
    from fwclass.run.local import Loop, WhenNeeded
    from fwclass.run.progress import Display
    from fwclass.run.runner import Runner
    from fwclass.store.bucket import Remote
    from fwclass.store.run_location import lock_run, unmade_again

    location = location.resolve() if isinstance(location, Path) else location
    with (
        unmade_again(location),
        Display() as display,
        notify(partial(display.compiling, "")),
        lock_run(location, display.say) as (location, held),
    ):

        def started() -> Any:
            from fwclass.run.cluster import CORES, Cluster

            remote = isinstance(location, Remote)
            cluster = Cluster(
                scheduler,
                cap_workers(workers, remote),
                limits.worker_memory_gib,
                limits.window,
                limits.retries,
                limits.split,
                watched=report is not None,
                say=display.say,
                part_hours=limits.part_hours,
                compiles=display.compiling,
            )
            display.say(f"dask             {cluster.dashboard or cluster.address + NO_PAGE}")
            remark = "" if scheduler is not None else cores_remark(workers, CORES, remote)
            if remark:
                display.say(f"workers          {remark}")
            display.workers = cluster.workers
            return cluster

        if scheduler is not None or report is not None:
            executor = started()
        else:
            executor = WhenNeeded(started) if workers else nullcontext(Loop(limits.part_hours, display.say))
        with executor as running:
            runner = Runner(location, running, display, held=held, accept_libraries=limits.accept_libraries)
            runner.store.clear_staging()
            for line in library_remarks(runner.store, limits.accept_libraries):
                display.say(f"libraries        {line}")
            with running.reported(report, display.say) if report is not None else nullcontext():
                yield runner
        runner.store.sweep()


def cap_workers(workers: int, remote: bool = False) -> int:
    """How many of so many `workers` a run on this machine starts: of a `remote` store, which is waited for, all; on the
    disk no more than cores."""
    from fwclass.run import cluster

    return workers if remote or workers <= 1 else min(workers, cluster.CORES)


def cores_remark(workers: int, cores: int, remote: bool = False) -> str:
    """What is said of a number of workers that leaves cores idle, or that these cannot serve (`cap_workers`); empty for
    none."""
    if workers > cores:
        if remote:
            return ""
        slower = f"more than this machine's {several(cores, 'core')} are slower"
        return f"{cores} started of {workers} asked for: {slower} (--scheduler takes any number)"
    if 2 * workers <= cores:
        return f"{workers} of {cores} cores: --workers N, or run.workers, takes more, each with memory of its own"
    return ""


def tell_failures(failures: list[Any], request: Any = None) -> None:
    """The parts that failed, and, with the run's `request`, the command that makes each alone."""
    click.echo(f"{several(len(failures), 'part')} failed; everything else is done and kept:", err=True)

    for outcome in failures[:TOLD]:
        first = visible(outcome.message.splitlines()[0]) if outcome.message else ""
        click.echo(f"  {outcome.stage}/{outcome.part}: {first}", err=True)
        alone = request.replay((outcome.stage, outcome.part)) if request is not None else ""
        if alone:
            click.echo(f"    alone: {alone}", err=True)
    if len(failures) > TOLD:
        click.echo(f"  and {len(failures) - TOLD} more; `fwclass status` lists all", err=True)
    words = redacted_words(sys.argv[1:])
    if any("--verify" in outcome.message for outcome in failures) and "--verify" not in words:
        words = [*words, "--verify"]
    again = shlex.join(["fwclass", *words])
    click.echo(f"mend the cause and run the same again; only the missing parts are made: {again}", err=True)
