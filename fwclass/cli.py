"""The command line: a contract that scripts outside the project call."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from fwclass import __version__
from fwclass.errors import FAILED, INTERRUPTED, PARTIAL, ConfigError, FwclassError, nearest, system_error

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


@click.group(context_settings=CONTEXT)
@click.version_option(__version__, prog_name="fwclass")
def cli() -> None:
    """Classify airborne full-waveform lidar surveys: waveforms in, classified GIS-ready tiles out.

    Exit codes: 0 done, 1 failed, 2 usage or configuration, 3 some parts failed, 4 a quality threshold was missed,
    130 interrupted.
    """


def main() -> None:
    """Entry point: faults of data and configuration are told in words, without a traceback."""
    try:
        cli(standalone_mode=False)
    except click.exceptions.Exit as end:
        sys.exit(end.exit_code)
    except click.ClickException as fault:
        fault.show()
        sys.exit(fault.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted; run the same command again to go on", err=True)
        sys.exit(INTERRUPTED)
    except FwclassError as fault:
        click.echo(f"fwclass: {fault}", err=True)
        sys.exit(fault.exit_code)
    except BrokenPipeError:
        sys.exit(FAILED)
    except OSError as fault:
        click.echo(f"fwclass: {system_error(fault)}", err=True)
        sys.exit(FAILED)


_path = click.Path(path_type=Path)
_set = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="SECTION.KEY=VALUE",
    help="Change one setting; may be repeated.",
)
_scheduler = click.option("--scheduler", metavar="ADDR", help="Dask scheduler, e.g. tcp://host:8786.")
_workers = click.option("--workers", type=click.IntRange(0), help="Processes on this machine; 0 runs a plain loop.")
_json = click.option("--json", "as_json", is_flag=True, help="JSON on standard output.")
_overwrite = click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")


@contextmanager
def _road(root: Path, workers: int, scheduler: str | None, memory: float) -> Iterator[Any]:
    """A run directory locked for writing, with its executor."""
    from fwclass.run.local import Loop
    from fwclass.run.progress import Display
    from fwclass.run.road import Road
    from fwclass.store.lock import writer

    root = root.resolve()
    with writer(root), Display() as display:
        if scheduler is None and workers == 0:
            road = Road(root, Loop(), display)
            road.store.clear_staging()
            yield road
            return
        from fwclass.run.cluster import Cluster

        with Cluster(scheduler, workers, memory) as cluster:
            display.say(f"dask         {cluster.address}")
            road = Road(root, cluster, display)
            road.store.clear_staging()
            yield road


def _run(
    conf: Path, out: Path | None, settings: tuple[str, ...], tiles: frozenset[str] | None, workflow: str,
    scheduler: str | None, workers: int | None,
) -> None:  # fmt: skip
    from fwclass import conf as configuration
    from fwclass.assess.stage import judge
    from fwclass.run.report import summary
    from workflows import WORKFLOWS

    if workflow not in WORKFLOWS:
        raise ConfigError("no such workflow", where="--workflow", got=workflow, do=nearest(workflow, WORKFLOWS))
    config = configuration.load(conf, settings)
    if out is not None and str(out) in ("", "."):
        raise ConfigError("--out is empty", where="--out", do="name a directory for this run alone")
    root = out if out is not None else Path("runs") / config.survey.name
    count = config.run.workers if workers is None else workers
    with _road(root, count, scheduler, config.run.worker_memory_gib) as road:
        report = WORKFLOWS[workflow](config, road, tiles)
        failures = road.failures
    click.echo(summary(report, root), err=True)
    if failures:
        _tell_failures(failures)
        sys.exit(PARTIAL)
    if report["accuracy"]:
        judge(report["accuracy"], config.assess)


def _tell_failures(failures: list[Any]) -> None:
    click.echo(f"{len(failures)} parts failed; everything else is done and kept:", err=True)
    for outcome in failures:
        first = outcome.message.splitlines()[0] if outcome.message else ""
        click.echo(f"  {outcome.stage}/{outcome.part}: {first}", err=True)
    again = shlex.join(["fwclass", *sys.argv[1:]])
    click.echo(f"mend the cause and run the same again; only the missing parts are made: {again}", err=True)


@cli.command()
@click.argument("conf", type=_path)
@click.option("--out", type=_path, help="Run directory (default: runs/<survey>).")
@_set
@click.option("--tiles", metavar="12_34,…", help="Only these tiles, after decomposition.")
@click.option("--workflow", default="classification", show_default=True, help="Which workflow.")
@_scheduler
@_workers
def run(
    conf: Path, out: Path | None, settings: tuple[str, ...], tiles: str | None, workflow: str, scheduler: str | None,
    workers: int | None,
) -> None:  # fmt: skip
    """Run a survey from its files to classified tiles; what is already done is skipped."""
    wanted = frozenset(t.strip() for t in tiles.split(",")) if tiles else None
    _run(conf, out, settings, wanted, workflow, scheduler, workers)


@cli.command()
@click.option("--out", type=_path, default=Path("fwclass-demo"), show_default=True, help="Run directory.")
@_workers
def demo(out: Path, workers: int | None) -> None:
    """Simulate a small survey, run everything, print where to look."""
    _run(Path("demo"), out, (), None, "classification", None, workers)


@cli.command()
@click.argument("conf", type=_path)
@click.option("--out", type=_path, required=True, help="Directory for strips/ and reference/.")
@_set
@_workers
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
    with _road(out, count, None, config.run.worker_memory_gib) as road:
        receipts = road.do(simulate_tasks(config.simulate, "."))
        failures = road.failures
    pulses = sum(int(r.meta.get("pulses", 0)) for r in receipts.values())
    click.echo(f"{pulses:,} pulses in {out / 'strips'}, reference in {out / 'reference'}", err=True)
    if failures:
        _tell_failures(failures)
        sys.exit(FAILED)


def _numbers(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[int, ...]:
    """``3,17`` as numbers."""
    try:
        return tuple(int(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise click.BadParameter(f"{text!r} is no list of whole numbers like 3,17,200") from None


@cli.command()
@click.argument("files", nargs=-1, required=True, type=_path)
@click.option("--waveforms", is_flag=True, help="Fit the waveforms of one file, and draw some of its pulses.")
@click.option("--pulse", "pulses", metavar="N,N,…", callback=_numbers, help="With --waveforms: these, from 0.")
@click.option("--out", type=_path, help="With --waveforms: the picture (default: <file>-waveforms.png, here).")
@_set
@_overwrite
@_json
def info(
    files: tuple[Path, ...], waveforms: bool, pulses: tuple[int, ...], out: Path | None, settings: tuple[str, ...],
    overwrite: bool, as_json: bool,
) -> None:  # fmt: skip
    """What files hold: formats, packets, descriptors, CRS, classes, and what is wrong with them.

    With --waveforms: chosen pulses of one file with their fitted echoes, and the echoes that its vendor's returns miss.
    """
    if waveforms:
        _info_waveforms(files, pulses, settings, out, overwrite, as_json)
    elif pulses or settings or overwrite or out is not None:
        raise click.UsageError("--pulse, --out, --set and --overwrite belong to --waveforms")
    else:
        _info_facts(files, as_json)


def _info_waveforms(
    files: tuple[Path, ...], pulses: tuple[int, ...], settings: tuple[str, ...], out: Path | None, overwrite: bool,
    as_json: bool,
) -> None:  # fmt: skip
    from fwclass.run.waveforms_text import describe
    from fwclass.run.waveforms_view import look

    if len(files) > 1:
        raise click.UsageError("--waveforms takes one file")
    found = look(files[0], pulses, settings, out, overwrite)
    click.echo(json.dumps(found, indent=1) if as_json else describe(found))


def _info_facts(files: tuple[Path, ...], as_json: bool) -> None:
    from fwclass.read.info import describe
    from fwclass.read.info import info as facts_of

    facts, faults = [], []
    for path in files:
        try:
            facts.append(facts_of(path))
        except FwclassError as fault:
            faults.append(fault)
            click.echo(f"fwclass: {fault}", err=True)
    if as_json:
        click.echo(json.dumps(facts if len(files) > 1 else (facts[0] if facts else None), indent=1))
    else:
        click.echo("\n\n".join(describe(f) for f in facts))
    if faults:
        sys.exit(FAILED)


@cli.command()
@click.argument("source", type=_path)
@click.argument("output", type=_path)
@click.option("--trajectory", type=_path, help="Where the sensor flew (text or SBET): gives ranges and radiometry.")
@click.option("--undulation", default=0.0, help="Metres to take from the trajectory's heights: the geoid's height.")
@click.option("--crs", metavar="EPSG:CODE", help="Instead of the coordinate system that the file names.")
@_set
@_overwrite
def decompose(
    source: Path, output: Path, trajectory: Path | None, undulation: float, crs: str | None, settings: tuple[str, ...],
    overwrite: bool,
) -> None:  # fmt: skip
    """One file: waveforms to echoes with extra bytes (LAZ)."""
    from fwclass.run.decompose_file import decompose_file

    click.echo(decompose_file(source, output, settings, overwrite, trajectory, undulation, crs), err=True)


@cli.command()
@click.argument("reference", type=_path)
@click.argument("prediction", type=_path)
@click.option("--map", "codes", metavar="NAME=2;NAME=3,4,5", help="Classes by name and reference codes.")
@_json
def assess(reference: Path, prediction: Path, codes: str | None, as_json: bool) -> None:
    """Confusion matrix and figures of a classified cloud against a reference cloud."""
    from fwclass.assess.stage import describe
    from fwclass.run.assess_files import assess_files

    figures = assess_files(reference, prediction, codes)
    click.echo(json.dumps(figures, indent=1) if as_json else describe(figures))
    matched, lost = figures["matched"], figures["unmatched"]
    click.echo(f"{matched:,} of {matched + lost:,} reference points have a predicted point", err=True)
    if lost > matched:
        click.echo("WARNING: the two clouds hardly overlap; the figures stand for the small part that does", err=True)
