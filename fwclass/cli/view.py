"""`fwclass view`: a run in the browser."""

from __future__ import annotations

from pathlib import Path

import click

from fwclass.cli.base import PATH, SET, cli


@cli.command()
@click.argument("run", type=PATH)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Listen there (default: any free port).")
@click.option("--no-browser", is_flag=True, help="Print the address only.")
@click.option("--against", type=PATH, metavar="OTHER", help="Another run of the same survey, side by side.")
@click.option("--allow-run", is_flag=True, help="Let the page start the run's last command once more.")
@SET
def view(
    run: Path, port: int, no_browser: bool, against: Path | None, allow_run: bool, settings: tuple[str, ...]
) -> None:
    """Look at a run: its cloud, the waveform behind an echo, and why it has its class; correct classes.

    The page is served on 127.0.0.1 alone, and answers who has the address that is printed. Ctrl-C ends it.
    """
    from fwclass import conf
    from fwclass.delivery.viewing import serve_view

    serve_view(run, conf.section("view", settings), port, against, not no_browser, click.echo, allow_run)
