"""`fwclass view`: a run in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import OUTPUT, OVERWRITE, PATH, RUN, SET, cli


@cli.command()
@click.argument("run", type=RUN)
@click.option("--port", type=click.IntRange(0, 65535), help="Listen there (default: any free port).")
@click.option("--no-browser", is_flag=True, help="Print the address only.")
@click.option("--against", type=RUN, metavar="OTHER", help="Another run of the same survey, side by side.")
@click.option("--allow-run", is_flag=True, help="Let the page start the run's last command once more.")
@click.option("--worklist", type=OUTPUT, metavar="FILE", help="Write the unsure places as a GeoPackage, and end.")
@click.option("--places", type=PATH, metavar="FILE", help="Go through these places, e.g. of `fwclass suggest`.")
@click.option("--export", type=OUTPUT, metavar="DIR", help="Write the page to a new folder for web servers, and end.")
@SET
@OVERWRITE
def view(
    run: Any,
    port: int | None,
    no_browser: bool,
    against: Any,
    allow_run: bool,
    worklist: Path | None,
    places: Path | None,
    export: Path | None,
    settings: tuple[str, ...],
    overwrite: bool,
) -> None:
    """Look at a run: its cloud, the waveform behind an echo, and why it has its class; correct classes.

    The page is served on 127.0.0.1 alone, and answers who has the address that is printed. Ctrl-C ends it.
    """
    from fwclass import conf
    from fwclass.cli.run_words import run_at
    from fwclass.store.url import is_url

    run, against = (run_at(place) if is_url(place) else place for place in (run, against))
    params = conf.section("view", settings)
    if worklist is not None and export is not None:
        raise click.UsageError("--worklist and --export are two commands")
    if places is not None and (worklist is not None or export is not None):
        raise click.UsageError("--places is for the page that is served: it goes without --worklist and --export")
    if worklist is not None:
        if against is not None or port is not None or no_browser or allow_run:
            raise click.UsageError(
                "--worklist serves nothing: it goes without --against, --port, --no-browser and --allow-run"
            )
        from fwclass.delivery.worklist import write_work_list

        click.echo(write_work_list(run, params, worklist, overwrite), err=True)
        return
    if export is not None:
        if port is not None or no_browser or overwrite:
            raise click.UsageError("--export serves nothing: it goes without --port, --no-browser and --overwrite")
        from fwclass.delivery.exported import export_view

        click.echo(export_view(run, against, params, export, lambda text: click.echo(text, err=True)), err=True)
        return
    if overwrite:
        raise click.UsageError("--overwrite belongs to --worklist")
    from fwclass.delivery.viewing import serve_view

    serve_view(run, params, port or 0, against, not no_browser, click.echo, allow_run, places)
