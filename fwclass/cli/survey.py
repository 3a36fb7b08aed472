"""Commands that work on a whole survey in a run directory: run, demo, simulate."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import (
    ACCEPT_DRIFT,
    ACCEPT_IMPLAUSIBLE,
    MIRROR_BEAMS,
    OUTPUT,
    PATH,
    RUN,
    SCHEDULER,
    SET,
    WORKERS,
    cli,
    little_garbage,
)
from fwclass.cli.run_words import AOI, TILES, WORKFLOW, chosen_tiles, location_of_run, out_directory, read_request
from fwclass.cli.runner import open_runner, report_path, tell_failures
from fwclass.cli.status import alone
from fwclass.errors import FAILED, PARTIAL, ConfigError, FwclassError


@dataclass(frozen=True)
class How:
    """What `fwclass run` is told besides what to make: where it runs, `page` for Dask's performance report, whether to
    `verify` what is there first."""

    scheduler: str | None
    workers: int | None
    fail_fast: bool = False
    page: str | None = None
    verify: bool = False


def run_configuration(
    conf: Path, out: Any, settings: tuple[str, ...], tiles: frozenset[str] | Path | None, workflow: str, how: How
) -> None:
    """Run a workflow on the survey in `conf` and print what came of it."""
    little_garbage()
    config, request = read_request(conf, out, settings, workflow, tiles)
    root = out_directory(out, config)
    count = config.run.workers if how.workers is None else how.workers
    performance = report_path(how.page, root, count, how.scheduler)
    from fwclass.operate.history import record_run

    if request.aoi is not None:
        request.wanted.check()
    _check_apart(request.root, config)
    from fwclass.store.run_location import unmade_again

    location = location_of_run(request, config)
    with unmade_again(location), record_run(location, request) as entry:
        _run(config, request, root, replace(how, workers=count), performance, entry)


def _check_apart(root: str, config: Any) -> None:
    """`ConfigError` for a run directory that is the sources' own: what it delivers would be found among them."""
    from fwclass.store.url import is_url, url_of
    from fwclass.survey.gather import directory_of

    if config.simulated:
        return
    where: Any = url_of(root, "--out") if is_url(root) else Path(root).resolve()
    there = directory_of(config, Path(root))
    if where == (there.resolve() if isinstance(there, Path) else there):
        raise ConfigError(
            "the run directory is the directory of the sources",
            where="--out",
            got=root,
            expected="a directory for this run alone",
            do="name another, for example one beside it",
        )


def _run(config: Any, request: Any, root: Any, how: How, performance: Path | None, entry: Any) -> None:
    from fwclass.operate.clean import clean, make_lean
    from fwclass.operate.whole_run import run_survey
    from fwclass.report.judge import judge_report

    with open_runner(entry.location, how.workers or 0, how.scheduler, config.run, performance) as runner:
        try:
            done = run_survey(config, runner, request, entry, how.fail_fast, how.verify)
        except (FwclassError, OSError):
            if runner.failures:
                tell_failures(runner.failures, request)
            raise
    for line in done.sentences(request, root, config.run.keep_generations):
        click.echo(line, err=True)
    if performance is not None:
        click.echo(f"dask report {performance}", err=True)
    if done.failures:
        tell_failures(done.failures, request)
        sys.exit(PARTIAL)
    judge_report(done.report, config, done.superseded is not None)
    if config.run.keep_intermediate == "lean" and done.generation.whole:
        parts, size = make_lean(entry.location, lambda text: click.echo(text, err=True))
        click.echo(f"store       {parts:,} parts emptied (run.keep_intermediate), {size / 1e6:,.1f} MB", err=True)
    if not config.run.keep_intermediate and done.generation.whole:
        gone = clean(entry.location, "deliveries", lambda text: click.echo(text, err=True))
        click.echo(f"store       {gone.parts:,} parts removed (run.keep_intermediate), {gone.freed}", err=True)


@cli.command()
@click.argument("conf", type=PATH)
@click.option("--out", type=RUN, help="Run directory, or s3://bucket/directory (default: runs/<survey>).")
@SET
@TILES
@AOI
@WORKFLOW
@SCHEDULER
@WORKERS
@click.option(
    "--keep-going/--fail-fast",
    default=True,
    show_default=True,
    help="After a part has failed: make all that does not need it, or stop at once.",
)
@click.option(
    "--accept-libraries", is_flag=True, help="Parts made with other versions of libraries are done (see `status`)."
)
@ACCEPT_IMPLAUSIBLE
@ACCEPT_DRIFT
@MIRROR_BEAMS
@click.option("--only", metavar="STAGE/PART", help="Make this one part alone, in the plain loop.")
@click.option(
    "--verify",
    is_flag=True,
    help="First read all files of parts and of the delivery; make anew what is damaged, and what was made from it.",
)
@click.option(
    "--report",
    metavar="[FILE.html]",
    is_flag=False,
    flag_value="",
    help="Write Dask's performance report (default: performance.html in the run directory); needs bokeh.",
)
def run(
    conf: Path,
    out: Any,
    settings: tuple[str, ...],
    tiles: str | None,
    aoi: Path | None,
    workflow: str,
    scheduler: str | None,
    workers: int | None,
    keep_going: bool,
    accept_libraries: bool,
    accept_implausible: bool,
    accept_drift: bool,
    mirror_beams: bool,
    only: str | None,
    verify: bool,
    report: str | None,
) -> None:
    """Run a survey from its files to classified tiles; what is already done is skipped."""
    settings += ("run.accept_libraries=true",) if accept_libraries else ()
    settings += ("plausibility.accept=true",) if accept_implausible else ()
    settings += ("classify.accept_drift=true",) if accept_drift else ()
    settings += ("read.mirror_beams=true",) if mirror_beams else ()
    if only is None:
        how = How(scheduler, workers, not keep_going, report, verify)
        run_configuration(conf, out, settings, chosen_tiles(tiles, aoi), workflow, how)
        return
    if tiles or aoi or scheduler or workers or verify or report is not None:
        raise ConfigError(
            "--only makes one part, in this process",
            where="--only",
            do="leave --tiles, --aoi, --scheduler, --workers, --verify and --report out",
        )
    alone(conf, out, settings, workflow, only)


@cli.command()
@click.option("--out", type=OUTPUT, default=Path("demo-run"), show_default=True, help="Run directory.")
@WORKERS
def demo(out: Path, workers: int | None) -> None:
    """Simulate a small survey, run everything, print where to look."""
    run_configuration(Path("demo"), out, (), None, "classification", How(None, workers))
    click.echo(f"look at it  fwclass view {out}", err=True)


@cli.command()
@click.argument("conf", type=PATH)
@click.option("--out", type=OUTPUT, required=True, help="Directory for strips/ and reference/.")
@SET
@WORKERS
def simulate(conf: Path, out: Path, settings: tuple[str, ...], workers: int | None) -> None:
    """Simulate a survey: LAS + WDP strips and reference labels."""
    from fwclass import conf as configuration
    from fwclass.graph.simulation import simulation
    from fwclass.graph.stage import Plan

    config = configuration.load(conf, settings)
    if config.simulate is None:
        raise ConfigError(
            "this survey has files of its own",
            where=f"{conf}: survey.simulated",
            expected="survey.simulated: true, and no survey.directory",
            do="name a configuration that simulates, as demo",
        )
    count = config.run.workers if workers is None else workers
    with open_runner(out, count, None, config.run) as runner:
        receipts = runner.do(simulation(".").tasks(Plan(config)))
        failures = runner.failures
    pulses = sum(int(r.meta.get("pulses", 0)) for r in receipts.values())
    click.echo(f"{pulses:,} pulses in {out / 'strips'}, reference in {out / 'reference'}", err=True)
    if failures:
        tell_failures(failures)
        sys.exit(FAILED)
