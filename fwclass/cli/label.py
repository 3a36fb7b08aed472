"""`fwclass label` and `fwclass suggest`: classes corrected in QGIS, confirmed, and where that teaches most."""

from __future__ import annotations

import getpass
import time
from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import OUTPUT, OVERWRITE, PATH, RUN, SET, Finite, cli
from fwclass.cli.run_words import chosen_tiles, run_at


def _login() -> str:
    try:
        return getpass.getuser()
    except (KeyError, ImportError, OSError):  # a user without a name, as containers have them
        return ""


def _location(run: Any) -> Any:
    from fwclass.store.url import is_url

    return run_at(run) if is_url(run) else run


@cli.group()
def label() -> None:
    """Correct classes of a run in QGIS (docs/corrections.md)."""


@label.command()
@click.argument("run", type=PATH)
@click.argument("directory", metavar="DIR", type=OUTPUT)
@click.option("--tiles", help="Keys of the tiles, e.g. 12_34,12_35.")
@click.option("--least-sure", type=click.IntRange(1), metavar="N", help="The N tiles whose classes are least sure.")
@click.option("--places", type=PATH, metavar="FILE", help="The tiles with these places, e.g. of `fwclass suggest`.")
def checkout(run: Path, directory: Path, tiles: str | None, least_sure: int | None, places: Path | None) -> None:
    """Copy delivered tiles to DIR, to be edited in QGIS there: the delivery itself is never changed."""
    from fwclass.delivery.checkout import check_out, least_sure_tiles
    from fwclass.delivery.places import tiles_with_places

    if sum(given is not None for given in (tiles, least_sure, places)) != 1:
        raise click.UsageError("give one of --tiles, --least-sure and --places")
    if places is not None:
        keys: Any = tiles_with_places(run, places)
    else:
        keys = chosen_tiles(tiles, None) if least_sure is None else least_sure_tiles(run, least_sure)
    click.echo(check_out(run, directory, keys if isinstance(keys, frozenset) else ()), err=True)


@label.command()
@click.argument("directory", metavar="DIR", type=PATH)
@click.option("--run", type=PATH, help="Where the run is, if it was moved since.")
@click.option("--who", default=_login, help="Who changed the classes (default: the name of the login).")
@click.option("--confirm", is_flag=True, help="What was not changed in these tiles was looked at, too, and is right.")
def collect(directory: Path, run: Path | None, who: str, confirm: bool) -> None:
    """Make corrections of the run from the classes that were changed in DIR; the next `fwclass run` learns from them.

    Collecting again adds what was changed since; a change that was undone is taken back. Where only what was wrong is
    given, a run learns that all that looks like it is wrong: mend a tile whole, and add --confirm.
    """
    from fwclass.delivery.collect import collect as collected
    from fwclass.delivery.suggested import confirm_tiles

    click.echo(collected(directory, run, who, time.time_ns() // 1000))
    if confirm:
        click.echo(confirm_tiles(directory, run, who, time.time_ns() // 1000))


@label.command()
@click.argument("run", type=RUN)
@click.argument("places", metavar="FILE", type=PATH)
@click.option("--who", default=_login, help="Who looked at them (default: the name of the login).")
def confirm(run: Any, places: Path, who: str) -> None:
    """Take the classes of all echoes in the places of FILE for right, as far as they were not corrected.

    They become corrections of the run: the next `fwclass run` learns from them.
    """
    from fwclass.delivery.suggested import confirm as confirmed

    click.echo(confirmed(_location(run), places, who, time.time_ns() // 1000), err=True)


@cli.command()
@click.argument("run", type=RUN)
@click.argument("output", metavar="OUT", type=OUTPUT)
@click.option("--places", type=click.IntRange(1, 100_000), help="How many (default: suggest.places).")
@click.option(
    "--size", type=Finite(1, 1000), help="Edge of a place [m] (default: suggest.size, wider where echoes are few)."
)
@SET
@OVERWRITE
def suggest(
    run: Any, output: Path, places: int | None, size: float | None, settings: tuple[str, ...], overwrite: bool
) -> None:
    """Write the places of a run whose labels would teach its model most to OUT (a GeoPackage).

    Correct what is wrong there (`fwclass view --places`, `fwclass label checkout --places`), confirm the rest
    (`fwclass label confirm`), and run again: docs/labels.md.
    """
    from fwclass import conf
    from fwclass.delivery.suggested import suggest as suggested

    given: dict[str, Any] = {} if places is None else {"places": places}
    given |= {} if size is None else {"size": size, "echoes": 0}
    conf.check_settings(settings, ("suggest",))
    params = conf.section("suggest", settings, {"suggest": given})
    click.echo(suggested(_location(run), params, output, overwrite), err=True)
