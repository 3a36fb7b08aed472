"""`fwclass plan`: what a survey will take, before anything runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import JSON, OUTPUT, OVERWRITE, PATH, SET, WORKERS, cli
from fwclass.cli.run_words import WORKFLOW
from fwclass.cli.runner import cap_workers, cores_remark, open_runner
from fwclass.errors import ConfigError


@cli.command()
@click.argument("conf", type=PATH)
@click.option("--out", type=OUTPUT, help="Run directory (default: runs/<survey>); the plan goes to its plan/.")
@click.option(
    "--dry-run",
    "count",
    type=click.IntRange(1),
    metavar="N",
    help="Really run the N fullest tiles, in a scratch directory, and reckon with what they took.",
)
@click.option("--graph", is_flag=True, help="Only tell the stages that the run has, and what each reads.")
@WORKFLOW
@SET
@WORKERS
@OVERWRITE
@JSON
def plan(
    conf: Path,
    out: Path | None,
    count: int | None,
    graph: bool,
    workflow: str,
    settings: tuple[str, ...],
    workers: int | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Tell what a survey will take, from the headers of its files: tiles, memory, disk and time.

    Nothing is run but the tiles of --dry-run. Polygons of the tiles, a picture and the numbers go to plan/ in the run
    directory. What cannot fit is refused, with the numbers (exit code 2).
    """
    from fwclass.errors import visible
    from fwclass.graph.outputs import DELIVER_STRIP, check_class_codes
    from fwclass.operate.configured import configured
    from fwclass.operate.estimate.forecast import as_json as plain
    from fwclass.operate.estimate.forecast import make_forecast
    from fwclass.operate.estimate.headers import survey_facts
    from fwclass.operate.estimate.limits import refuse, room_at
    from fwclass.operate.estimate.output import check_free, write_plan
    from fwclass.operate.estimate.text import describe
    from fwclass.survey.gather import check_areas
    from fwclass.workflows import workflow_of

    chosen = workflow_of(workflow)
    if not chosen.stages and not graph:
        raise ConfigError(
            "this workflow goes through no survey, so there are no tiles to plan",
            where=f"workflow {workflow}",
            do="run it; --graph tells its stages",
        )
    own = {id(s) for s in chosen.stages} - {id(s) for s in workflow_of("classification").stages}
    if count is not None and (own or chosen.settle is not None):
        raise ConfigError(
            "tiles are tried with the stages of `classification` alone", where="--dry-run", do="leave one of them out"
        )
    config = configured(conf, settings, chosen.classifies)
    if graph:
        _tell_graph(config, chosen, as_json)
        return
    root = out if out is not None else Path("runs") / config.survey.name
    check_free(root, overwrite)
    number = cap_workers(config.run.workers) if workers is None else workers  # these may be another machine's
    if cap_workers(number) < number:
        click.echo(f"note: planned with {number} workers; here {cores_remark(number, cap_workers(number))}", err=True)
    begun = chosen.begin(config)
    _tell_unknown(config, chosen)
    copied = DELIVER_STRIP in chosen.stages
    facts = survey_facts(config, root, copied)
    check_areas(config, facts.box)
    if copied:
        check_class_codes({s.path.name: s.point_format for s in facts.sources}, begun.config)
    forecast = make_forecast(begun, facts, number, room_at(root), stages=chosen.all_stages)
    if count is not None:
        forecast = _dry_run(forecast, count, root, chosen.all_stages)
    paths = write_plan(forecast, root)
    written = "\n".join(f"written     {visible(p)}" for p in paths)
    click.echo(f"{describe(forecast)}\n\n{written}", err=as_json)
    if as_json:
        click.echo(json.dumps(plain(forecast, paths), indent=1))
    refuse(list(forecast.limits), config.path)


def _dry_run(forecast: Any, count: int, root: Path, stages: Any) -> Any:
    """The forecast again, by what the fullest tiles took."""
    from fwclass.errors import FwclassError
    from fwclass.operate.estimate.forecast import make_forecast
    from fwclass.operate.estimate.trial import run_trial, trial_of
    from fwclass.temporary import temporary_directory

    trial_ = trial_of(forecast, count, root)
    (root / "plan").mkdir(parents=True, exist_ok=True)
    with temporary_directory("trial", root / "plan") as scratch:
        with open_runner(scratch, forecast.workers, None, forecast.config.run) as runner:
            keys = run_trial(trial_, runner, count, forecast.halo)
            failures, store = runner.failures, runner.store
        if failures:
            first = failures[0]
            raise FwclassError(
                f"the dry run failed in {len(failures)} parts, first {first.stage}/{first.part}",
                got=first.message.splitlines()[0] if first.message else "",
                do="mend the cause; the run would fail too",
            )
        click.echo(f"dry run     tiles {', '.join(keys)} from {trial_.files:,} files", err=True)
        return make_forecast(forecast.begun, forecast.facts, forecast.workers, forecast.room, store, stages)


def _tell_unknown(config: Any, chosen: Any) -> None:
    """What is said of stages of a user, whose cost is not known."""
    own = [s.name for s in chosen.all_stages if s.name not in config.plan.stages]
    if own:
        click.echo(f"note: what {', '.join(own)} of {chosen.name} take is not known and not reckoned with", err=True)


def _tell_graph(config: Any, chosen: Any, as_json: bool) -> None:
    """The stages of a workflow in the order of the run: what a part of each is, and which others it reads."""
    from fwclass.graph.stage import Plan
    from fwclass.graph.stages import graph_of

    plan = chosen.begin(config) if chosen.stages else Plan(config)
    stages = graph_of(plan, chosen.all_stages)
    if as_json:
        click.echo(json.dumps(stages, indent=1))
        return
    wide = max(len(s["name"]) for s in stages)
    click.echo(f"{chosen.name}: {chosen.what}\n")
    click.echo(f"{'stage':<{wide}}  a part is    reads")
    for stage in stages:
        part = "one" if stage["over"] == "survey" else f"a {stage['over']}"
        click.echo(f"{stage['name']:<{wide}}  {part:<11}  {', '.join(stage['reads'])}".rstrip())
