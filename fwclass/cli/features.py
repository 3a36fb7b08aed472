"""Features of one file, and the list of what there is: features."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import ACCEPT_IMPLAUSIBLE, JSON, OUTPUT, OVERWRITE, PATH, Finite, cli, tell, work_here
from fwclass.cli.ground import CRS, METHOD, PARAM, PRESET

SETS = click.option(
    "--set",
    "words",
    multiple=True,
    metavar="NAME|FILE|SECTION.KEY=VALUE",
    help="The feature set (default: `default`); or a setting, may be repeated.",
)


@cli.command()
@click.argument("source", metavar="[IN]", type=PATH, required=False)
@click.argument("output", metavar="[OUT.parquet]", type=OUTPUT, required=False)
@SETS
@click.option("--features", "listed", metavar="NAME,NAME,…", help="These features instead of a set.")
@click.option(
    "--list", "show", is_flag=True, help="Show all features and sets; with a set (--list NAME): its features."
)
@METHOD
@PRESET
@PARAM
@click.option("--auto", is_flag=True, help="Adapt the filter's parameters to the points first.")
@click.option("--own-ground", is_flag=True, help="Heights count from class 2 of the file; no filter.")
@click.option("--trajectory", type=PATH, help="Where the sensor flew (text or SBET): gives ranges and radiometry.")
@click.option(
    "--undulation", type=Finite(), default=0.0, help="Metres to take from the trajectory's heights: the geoid's height."
)
@click.option("--skip-missing", is_flag=True, help="Leave out features that the file cannot give, instead of an error.")
@CRS
@ACCEPT_IMPLAUSIBLE
@OVERWRITE
@JSON
def features(
    source: Path | None,
    output: Path | None,
    words: tuple[str, ...],
    show: bool,
    accept_implausible: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Features of every echo of one file as GeoParquet; or, with --list, which features and sets there are.

    IN is LAS, LAZ, COPC, PulseWaves or text. Waveforms are decomposed first; without them, returns are echoes. The
    ground, where heights above it are asked for, is looked for by a filter (--method, --preset, --param); class 2 of
    the file, which may be a reference, is taken with --own-ground alone.
    """
    work_here()
    from fwclass.single_file.features.names import sorted_settings

    named, settings = sorted_settings(words)
    if show:
        if output is not None or settings or options["listed"]:
            raise click.UsageError("--list shows features, or those of one set: --list NAME")
        _list(*((str(source), "--list") if source is not None else (named, "--set")), as_json)
        return
    if source is None or output is None:
        raise click.UsageError("IN and OUT.parquet are wanted, or --list")
    if options["own_ground"] and any(options[n] for n in ("method", "preset", "assignments", "auto")):
        raise click.UsageError("--own-ground takes the file's ground: no filter is run")
    from fwclass import conf
    from fwclass.report.judge_echoes import judge_echoes
    from fwclass.single_file.features.file import FeaturesJob, features_file
    from fwclass.single_file.features.listing import describe
    from fwclass.single_file.ground.steps import StepDisplay

    settings += ("plausibility.accept=true",) if accept_implausible else ()
    with StepDisplay() as steps:
        summary = features_file(FeaturesJob(source, output, named=named, settings=settings, **options), steps.tell)
    tell(summary, describe(summary), as_json)
    judge_echoes(summary["judged"], conf.section("plausibility", settings), source)


def _list(name: str | None, where: str, as_json: bool) -> None:
    from fwclass.single_file.features import listing

    facts = listing.everything() if name is None else listing.of_set(name, where)
    words = listing.describe_everything if name is None else listing.describe_set
    click.echo(json.dumps(facts, indent=1) if as_json else words(facts))
