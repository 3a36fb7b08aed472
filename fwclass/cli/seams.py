"""`fwclass seams`: whether the borders of tiles show in a run's results."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import JSON, OUTPUT, OVERWRITE, RUN, SET, Finite, cli
from fwclass.cli.run_words import own_file, run_at
from fwclass.errors import ConfigError, visible


@cli.command()
@click.argument("run", type=RUN)
@click.option("--share", type=Finite(0, 1, min_open=True), help="Of the borders (default: seams.share).")
@click.option("--length", type=Finite(0, min_open=True), help="Metres of borders instead of a share.")
@click.option("--shift", metavar="DX,DY", help="Of the grid, metres (default: half a tile).")
@click.option("--gpkg", type=OUTPUT, help="Write what was computed, and what differs, as polygons and points.")
@SET
@OVERWRITE
@click.option("--workflow", metavar="FILE.py", help="The workflow's file, where the run is of one.")
@JSON
def seams(
    run: Any,
    workflow: str | None,
    share: float | None,
    length: float | None,
    shift: str | None,
    gpkg: Path | None,
    settings: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
) -> None:
    """Compute strips along tile borders of a finished run once more under a shifted grid, and compare.

    The run is only read. Exit code 0 if no value differs, 4 if one does.
    """
    from fwclass.operate.configured import configured_as_kept
    from fwclass.operate.request import Request
    from fwclass.operate.seams.shifted_squares import shift_of
    from fwclass.operate.seams.summary import as_data, as_text, write_gpkg
    from fwclass.operate.seams.walk import SeamRequest
    from fwclass.operate.seams.walk import seams as measured
    from fwclass.publish.files import check_free
    from fwclass.run.progress import Display
    from fwclass.store.run_location import open_store
    from fwclass.workflows import workflow_of

    if share is not None and length is not None:
        raise ConfigError("--share and --length both say how much", where="--share, --length", do="give one of them")
    if gpkg is not None:
        check_free(gpkg, overwrite)
    location = run_at(run)
    request = Request.kept(open_store(location, read_only=True), own_file(workflow))
    classifies = workflow_of(request.workflow).classifies
    config = configured_as_kept(request, classifies, settings)
    asked = SeamRequest(
        shift_of(shift, config.tile.size),
        config.seams.share if share is None else share,
        length,
        request.wanted,
        request.workflow,
    )
    began = time.perf_counter()
    with Display() as display:
        result = measured(config, location, asked, display)
    took = time.perf_counter() - began
    click.echo(as_text(result, took), err=as_json)
    if as_json:
        click.echo(json.dumps(as_data(result, took), indent=1))
    if gpkg is not None:
        write_gpkg(result, gpkg, result.crs)
        click.echo(f"written: {visible(gpkg)}", err=True)
    result.judge()
