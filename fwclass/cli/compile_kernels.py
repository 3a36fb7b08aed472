"""`fwclass compile`: all kernels, ahead of the first run."""

from __future__ import annotations

import json

import click

from fwclass.cli.base import JSON, cli


@cli.command("compile")
@JSON
def compile_kernels(as_json: bool) -> None:
    """Compile all kernels for this machine, ahead of the first run.

    For an image, a package or a new machine: what is compiled is kept below the user's cache directory, or in the
    directory that NUMBA_CACHE_DIR names, and is good for this version, these libraries and this kind of processor.
    """
    from fwclass import compiling
    from fwclass.operate.compile_all import compile_all

    compiling.listeners.clear()
    result = compile_all(lambda text: click.echo(f"compiling        {text}", err=True))
    click.echo(
        f"{result['compiled']} kernels compiled in {result['seconds']:g} s; "
        f"{result['listed'] - len(result['left_out'])} that are called lie in {result['directory']}",
        err=True,
    )
    for text in result["left_out"]:
        click.echo(f"left out: {text}; it is compiled when it is called", err=True)
    if as_json:
        click.echo(json.dumps(result, indent=1))
