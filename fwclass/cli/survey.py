"""Commands that work on a whole survey in a run directory: run, demo, simulate."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from fwclass.cli.base import PATH, SCHEDULER, SET, WORKERS, cli
from fwclass.cli.road import open_road, tell_failures
from fwclass.errors import FAILED, PARTIAL, ConfigError, nearest


def _run(
    conf: Path, out: Path | None, settings: tuple[str, ...], tiles: frozenset[str] | None, workflow: str,
    scheduler: str | None, workers: int | None,
) -> None:  # fmt: skip
    from fwclass import conf as configuration
    from workflows import WORKFLOWS

    if workflow not in WORKFLOWS:
        raise ConfigError("no such workflow", where="--workflow", got=workflow, do=nearest(workflow, WORKFLOWS))
    config = configuration.load(conf, settings)
    if out is not None and str(out) in ("", "."):
        raise ConfigError("--out is empty", where="--out", do="name a directory for this run alone")
    root = out if out is not None else Path("runs") / config.survey.name
    count = config.run.workers if workers is None else workers
    from fwclass.assess.stage import judge
    from fwclass.run.report import summary

    with open_road(root, count, scheduler, config.run.worker_memory_gib) as road:
        report = WORKFLOWS[workflow](config, road, tiles)
        failures = road.failures
    click.echo(summary(report, root), err=True)
    if failures:
        tell_failures(failures)
        sys.exit(PARTIAL)
    if report["accuracy"]:
        judge(report["accuracy"], config.assess)


@cli.command()
@click.argument("conf", type=PATH)
@click.option("--out", type=PATH, help="Run directory (default: runs/<survey>).")
@SET
@click.option("--tiles", metavar="12_34,…", help="Only these tiles, after decomposition.")
@click.option("--workflow", default="classification", show_default=True, help="Which workflow.")
@SCHEDULER
@WORKERS
def run(
    conf: Path, out: Path | None, settings: tuple[str, ...], tiles: str | None, workflow: str, scheduler: str | None,
    workers: int | None,
) -> None:  # fmt: skip
    """Run a survey from its files to classified tiles; what is already done is skipped."""
    wanted = frozenset(t.strip() for t in tiles.split(",")) if tiles else None
    _run(conf, out, settings, wanted, workflow, scheduler, workers)


@cli.command()
@click.option("--out", type=PATH, default=Path("fwclass-demo"), show_default=True, help="Run directory.")
@WORKERS
def demo(out: Path, workers: int | None) -> None:
    """Simulate a small survey, run everything, print where to look."""
    _run(Path("demo"), out, (), None, "classification", None, workers)


@cli.command()
@click.argument("conf", type=PATH)
@click.option("--out", type=PATH, required=True, help="Directory for strips/ and reference/.")
@SET
@WORKERS
def simulate(conf: Path, out: Path, settings: tuple[str, ...], workers: int | None) -> None:
    """Simulate a survey: LAS + WDP strips and reference labels."""
    from fwclass import conf as configuration
    from fwclass.run.survey import simulate_tasks

    config = configuration.load(conf, settings)
    if config.simulate is None:
        raise ConfigError(
            "this survey has files of its own",
            where=f"{conf}: survey.directory",
            do="name a configuration without survey.directory",
        )
    count = config.run.workers if workers is None else workers
    with open_road(out, count, None, config.run.worker_memory_gib) as road:
        receipts = road.do(simulate_tasks(config.simulate, "."))
        failures = road.failures
    pulses = sum(int(r.meta.get("pulses", 0)) for r in receipts.values())
    click.echo(f"{pulses:,} pulses in {out / 'strips'}, reference in {out / 'reference'}", err=True)
    if failures:
        tell_failures(failures)
        sys.exit(FAILED)
