"""Options and helpers of the commands that work on a run: which run, which tiles, by which workflow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import PATH
from fwclass.errors import ConfigError
from fwclass.workflows import WORKFLOWS

TILES = click.option("--tiles", metavar="12_34,…", help="Only these tiles, after decomposition.")
AOI = click.option("--aoi", type=PATH, metavar="FILE", help="Only tiles that the polygons of FILE share area with.")
WORKFLOW = click.option(
    "--workflow",
    default="classification",
    show_default=True,
    help=f"Which workflow: a name ({', '.join(WORKFLOWS)}), or a Python file of your own.",
)


def chosen_tiles(tiles: str | None, aoi: Path | None) -> frozenset[str] | Path | None:
    """The keys of ``--tiles`` or the file of ``--aoi``, None for all."""
    if tiles and aoi:
        raise ConfigError("tiles are chosen twice", where="--tiles, --aoi", do="leave one of them out")
    if aoi is not None and not aoi.is_file():
        raise ConfigError("there is no such file", where="--aoi", expected="a file of polygons", got=aoi)
    if tiles is None:
        return aoi
    if not tiles.strip(" ,"):
        raise ConfigError(
            "no tile is named", where="--tiles", expected="keys, as in 12_34,12_35", do="leave it out for all"
        )
    from fwclass.grid import TileGrid

    keys = frozenset(t.strip() for t in tiles.split(","))
    for key in sorted(keys):
        TileGrid(1.0).tile(key)  # its words for what is no key
    return keys


def out_directory(out: Any, config: Any) -> Any:
    """The run directory that ``--out`` names, or the survey's own: a path, or an address on object storage."""
    if out is not None and str(out) in ("", "."):
        raise ConfigError("--out is empty", where="--out", do="name a directory for this run alone")
    return out if out is not None else Path("runs") / config.survey.name


def read_request(
    conf: Path, out: Any, settings: tuple[str, ...], workflow: str, tiles: frozenset[str] | Path | None
) -> tuple[Any, Any]:
    """The configuration, and the `Request` that the words of the command make."""
    from fwclass.operate.configured import configured
    from fwclass.operate.request import Request
    from fwclass.workflows import workflow_of

    classifies = workflow_of(workflow).classifies
    if workflow.endswith(".py"):
        workflow = str(Path(workflow).resolve())
    config = configured(conf, settings, classifies)
    return config, Request.of(conf, out_directory(out, config), settings, workflow, tiles)


def own_file(workflow: str | None) -> str | None:
    """The workflow's file that the user named, None for a workflow of the program."""
    return workflow if workflow is not None and workflow.endswith(".py") else None


def location_of_run(request: Any, config: Any) -> Any:
    """Where the run of `request` lies."""
    from fwclass.store.run_location import location_of
    from fwclass.store.url import is_url, url_of

    named = url_of(request.root, "--out") if is_url(request.root) else Path(request.root)
    return location_of(named, config.store)


def run_at(place: Any) -> Any:
    """Where the run lies that a user named, a path or an address; `ConfigError` where none was ever begun."""
    from fwclass.store.history import is_run

    location = place.resolve() if isinstance(place, Path) else _remote(place)
    if not is_run(location):
        raise ConfigError(
            "no such run directory",
            where=place,
            expected="a directory, or an address, that `fwclass run` has made",
            do="give its path",
        )
    return location


def _remote(place: Any) -> Any:
    """The run at an address; what this loads, a directory is found without."""
    from fwclass import conf as configuration
    from fwclass.store.run_location import location_of

    return location_of(place, configuration.section("store"))
