"""How a run stands, and one part of it alone."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import click

from fwclass.cli.base import JSON, RUN, SET, cli, little_garbage
from fwclass.cli.run_words import AOI, TILES, WORKFLOW, chosen_tiles, location_of_run, own_file, read_request, run_at
from fwclass.cli.runner import open_runner, tell_failures
from fwclass.errors import PARTIAL, ConfigError, StoreError, visible


def _look(config: Any, request: Any) -> Any:
    """The parts of the run, looked at."""
    from fwclass.operate.status.walk import look_at
    from fwclass.workflows import workflow_of

    return look_at(
        location_of_run(request, config),
        lambda runner: workflow_of(request.workflow)(config, runner, request.wanted),
        config.run.accept_libraries,
    )


def alone(conf: Path, out: Any, settings: tuple[str, ...], workflow: str, only: str) -> None:
    """Make the part `only` (stage/part) in the plain loop, and nothing else."""
    from fwclass.operate.status.replay import task_alone

    config, request = read_request(conf, out, settings, workflow, None)
    from fwclass.operate.history import record_run

    location = location_of_run(request, config)
    with record_run(location, request, only) as entry, open_runner(location, 0, None, config.run) as runner:
        entry.begin(runner)
        run_status = _look(config, request)
        if run_status.fault is not None:
            raise run_status.fault
        task = task_alone(run_status, only, request)
        runner.do([task])
        outcome = runner.outcomes[task.name]
        if not outcome.ok:
            tell_failures([outcome], request)
            sys.exit(PARTIAL)
    word = "was done already" if outcome.status == "skipped" else f"is made, in {outcome.seconds:.2f} s"
    click.echo(f"{only} {word}", err=True)


def _verify_alone(location: Any, fault: StoreError, as_json: bool) -> NoReturn:
    """Verify what lies in a run that does not tell what it was asked for."""
    from fwclass.operate.status import verify as verifying
    from fwclass.store.run_location import open_store

    verified = verifying.verify(open_store(location, read_only=True, lists=True))
    click.echo(f"fwclass: {fault}", err=True)
    if as_json:
        click.echo(json.dumps(verified.as_data(), indent=1))
    else:
        click.echo("\n".join(verifying.rows(verified)) or verifying.SOUND)
    sys.exit(PARTIAL)


def _verify_copy(copy: Path, as_json: bool) -> NoReturn:
    """Verify a delivery that was copied elsewhere."""
    from fwclass.store.generations import copy_damage

    damaged = copy_damage(copy)
    if as_json:
        click.echo(json.dumps({"damaged_delivered": damaged}, indent=1))
    elif damaged:
        click.echo("\n".join(visible(f"damaged  {name}") for name in damaged))
    else:
        click.echo("all files of this delivery have the bytes that were written")
    sys.exit(PARTIAL if damaged else 0)


def _request_of_run(run: Any, workflow: str, verify: bool, as_json: bool) -> tuple[Any, Any]:
    """What a run directory was asked for last, and its configuration."""
    from fwclass.operate.configured import configured_as_kept
    from fwclass.operate.request import Request
    from fwclass.store.run_location import open_store
    from fwclass.workflows import workflow_of

    location = run_at(run)
    try:
        request = Request.kept(open_store(location, read_only=True), own_file(workflow))
    except StoreError as fault:
        if not verify:
            raise
        _verify_alone(location, fault, as_json)
    if Path(request.conf).is_absolute() and not Path(request.conf).is_file():
        raise ConfigError(
            "the configuration that the run was made with is not there any more",
            where=run,
            expected=request.conf,
            do=f"name where it is now: fwclass status NEW.yaml --out {shlex.quote(str(run))}",
        )
    return configured_as_kept(request, workflow_of(request.workflow).classifies), request


@cli.command()
@click.argument("conf_or_run", metavar="CONF|RUN", type=RUN)
@click.option("--out", type=RUN, help="With CONF: the run directory (default: runs/<survey>).")
@SET
@TILES
@AOI
@WORKFLOW
@click.option("--parts", "every", is_flag=True, help="List every part, done or not.")
@click.option(
    "--verify", is_flag=True, help="Read all files of parts and of all that was delivered, and compare their digests."
)
@JSON
def status(
    conf_or_run: Any,
    out: Any,
    settings: tuple[str, ...],
    tiles: str | None,
    aoi: Path | None,
    workflow: str,
    every: bool,
    verify: bool,
    as_json: bool,
) -> None:
    """Tell which parts of a run are done, stale (and why), missing, running or failed; nothing is made.

    A run directory is looked at as its last `fwclass run` was asked for; a configuration with the words given here.
    With --verify, RUN may also be a copy of a delivery elsewhere, as RUN/generations/0001 is one.
    Exit code 0 if all is done and delivered (and, with --verify, undamaged), or if of RUN the delivery alone was kept;
    3 if not.
    """
    little_garbage()
    from fwclass.store.generations import is_generation
    from fwclass.store.run_location import held_by
    from fwclass.store.url import is_url

    as_asked = is_url(conf_or_run) or conf_or_run.is_dir()
    if as_asked:
        if out is not None or settings or tiles or aoi or (workflow != "classification" and not own_file(workflow)):
            raise ConfigError(
                "a run directory is looked at as its run was asked for",
                where=conf_or_run,
                do=f"for another configuration: fwclass status CONF --out {shlex.quote(str(conf_or_run))} --set …",
            )
        if verify and is_generation(conf_or_run):
            _verify_copy(conf_or_run, as_json)
        config, request = _request_of_run(conf_or_run, workflow, verify, as_json)
    else:
        if len(conf_or_run.parts) > 1 and not conf_or_run.suffix and not conf_or_run.exists():
            raise ConfigError(
                "no such run directory",
                where=conf_or_run,
                expected="a directory that `fwclass run` has made, or a "
                "configuration (a YAML file, or the name of one that comes with fwclass)",
                do="give its path",
            )
        config, request = read_request(conf_or_run, out, settings, workflow, chosen_tiles(tiles, aoi))
    from fwclass.operate.schedule.state import standing
    from fwclass.operate.sizes import sizes_of
    from fwclass.operate.status.summary import as_data, as_text, is_cleaned, is_delivered

    location = location_of_run(request, config)
    writer, scheduled = held_by(location), standing(location)
    run_status = _look(config, request)
    from fwclass.operate.status import verify as verifying

    shown = run_status.store.generations.current()
    sizes = sizes_of(location, None if shown is None else shown.name)
    verified = verifying.verify(run_status.store) if verify else None
    if as_json:
        data = {**as_data(run_status, request, writer, every), "schedule": scheduled, "disk": sizes.as_data()}
        if verified is not None:
            data |= verified.as_data()
        click.echo(json.dumps(data, indent=1))
    else:
        if scheduled is not None:
            click.echo(_schedule_words(scheduled, near=isinstance(location, Path)))
        click.echo(as_text(run_status, request, writer, every))
        click.echo(sizes.as_text())
        if verified is not None:
            click.echo(verifying.as_text(verified, request))
    stands = is_delivered(run_status, request) or (as_asked and writer is None and is_cleaned(run_status))
    if not stands or (verified is not None and not verified.sound):
        sys.exit(PARTIAL)


def _schedule_words(scheduled: Mapping[str, Any], near: bool) -> str:
    """The schedule that keeps a run, and what it waits for; of a run that is not `near`, when it was last heard of."""
    when = f"next {scheduled['next']}" if scheduled.get("next") else "waits for files"
    heard = "" if near else f", heard of {scheduled.get('heartbeat')}"
    host = f"pid {scheduled.get('pid')} on {scheduled.get('host')}"
    return visible(f"a schedule is at work on it: {host}, {when}{heard}")
