"""`fwclass label`: classes corrected in QGIS."""

from __future__ import annotations

import getpass
import time
from pathlib import Path

import click

from fwclass.cli.base import PATH, cli
from fwclass.cli.status import chosen_tiles


def _login() -> str:
    try:
        return getpass.getuser()
    except (KeyError, ImportError, OSError):  # a user without a name, as containers have them
        return ""


@cli.group()
def label() -> None:
    """Correct classes of a run in QGIS (docs/corrections.md)."""


@label.command()
@click.argument("run", type=PATH)
@click.argument("directory", metavar="DIR", type=PATH)
@click.option("--tiles", help="Keys of the tiles, e.g. 12_34,12_35.")
@click.option("--least-sure", type=click.IntRange(1), metavar="N", help="The N tiles whose classes are least sure.")
def checkout(run: Path, directory: Path, tiles: str | None, least_sure: int | None) -> None:
    """Copy delivered tiles to DIR, to be edited in QGIS there: the delivery itself is never changed."""
    from fwclass.delivery.checkout import check_out, least_sure_tiles

    if (tiles is None) == (least_sure is None):
        raise click.UsageError("give either --tiles or --least-sure")
    keys = chosen_tiles(tiles, None) if least_sure is None else least_sure_tiles(run, least_sure)
    click.echo(check_out(run, directory, keys if isinstance(keys, frozenset) else ()), err=True)


@label.command()
@click.argument("directory", metavar="DIR", type=PATH)
@click.option("--run", type=PATH, help="Where the run is, if it was moved since.")
@click.option("--who", default=_login, help="Who changed the classes (default: the name of the login).")
def collect(directory: Path, run: Path | None, who: str) -> None:
    """Make corrections of the run from the classes that were changed in DIR; the next `fwclass run` learns from them.

    Collecting again adds what was changed since; a change that was undone is taken back.
    """
    from fwclass.delivery.collect import collect as collected

    click.echo(collected(directory, run, who, time.time_ns() // 1000))
