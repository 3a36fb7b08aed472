"""`fwclass init`: a first survey file for files that nobody has described yet."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from fwclass.cli.base import OUTPUT, OVERWRITE, PATH, cli


@cli.command()
@click.argument("files", nargs=-1, required=True, type=PATH)
@click.option("--to", type=OUTPUT, help="The survey file to write (default: standard output, to lie here).")
@click.option("--name", help="Of the survey (default: the directory's).")
@OVERWRITE
def init(files: tuple[Path, ...], to: Path | None, name: str | None, overwrite: bool) -> None:
    """Draft a survey file from FILES, or those of a directory: system, classes, a training area, a size of tiles.

    What the files do not tell is marked TO DO in it, and said here.
    """
    from fwclass.operate.draft.survey import draft
    from fwclass.publish.files import check_free, check_other, written_whole
    from fwclass.read.info import files_in

    named = tuple(one for path in files for one in (files_in(path) if path.is_dir() else (path,)))
    if to is not None:
        check_free(to, overwrite)
        for path in named:
            check_other(to, path)
    directory = files[0] if len(files) == 1 and files[0].is_dir() else None
    draft_of_files = draft(named, to.parent if to is not None else Path(), name, directory)
    if to is None:
        click.echo(draft_of_files.text, nl=False)
    else:
        with written_whole(to) as beside:
            beside.write_text(draft_of_files.text, encoding="utf-8")
    for note in draft_of_files.notes:
        click.echo(f"note: {note}", err=True)
    if not draft_of_files.notes and to is not None and sys.stderr.isatty():
        click.echo(f"look at {to}, then: fwclass run {to}", err=True)
