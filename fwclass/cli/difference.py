"""`fwclass diff`: what changed between two deliveries."""

from __future__ import annotations

import json
from pathlib import Path

import click

from fwclass.cli.base import JSON, OUTPUT, OVERWRITE, PATH, cli
from fwclass.errors import visible


@cli.command()
@click.argument("run", type=PATH)
@click.argument("others", nargs=-1, metavar="[A [B] | RUN]")
@click.option("--gpkg", type=OUTPUT, help="Write the places whose echoes changed, as polygons.")
@OVERWRITE
@JSON
def diff(run: Path, others: tuple[str, ...], gpkg: Path | None, overwrite: bool, as_json: bool) -> None:
    """What changed between two deliveries: settings, inputs, libraries, accuracy, and echoes by class and place.

    Of RUN the last two, those numbered A and B, or A and the current one; or the current ones of two runs.
    """
    from fwclass.operate.difference.deliveries import crs_of, deliveries, describe, difference, write_places
    from fwclass.publish.files import check_free

    if gpkg is not None:
        check_free(gpkg, overwrite)
    first, second = deliveries(run, others)
    result, changes = difference(first, second)
    if gpkg is not None:
        write_places(gpkg, changes, crs_of(second))
        click.echo(f"written: {visible(gpkg)}", err=True)
    click.echo(json.dumps(result, indent=1) if as_json else describe(result))
