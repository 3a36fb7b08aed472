"""The command group, and the options that several commands share."""

from __future__ import annotations

import gc
import json
import math
import re
from pathlib import Path
from typing import Any, get_args

import click

from fwclass import __version__
from fwclass.classifiers import ClassifierMethod
from fwclass.errors import visible
from fwclass.paths import run_around, strange_kind
from fwclass.store.url import SCHEMES, is_url, url_of

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


@click.group(context_settings=CONTEXT)
@click.version_option(__version__, prog_name="fwclass")
def cli() -> None:
    """Classify airborne full-waveform lidar surveys: waveforms in, classified GIS-ready tiles out.

    Exit codes: 0 done, 1 failed, 2 usage or configuration, 3 some parts failed, 4 a quality threshold was missed,
    130 interrupted (Ctrl-C, SIGTERM, SIGHUP).
    """
    from fwclass import compiling  # not for --help

    compiling.listeners[:] = [_compiling]


def _compiling(begins: bool) -> None:
    """For commands that show no progress."""
    from fwclass import compiling

    if begins and compiling.listeners:
        compiling.listeners.clear()
        click.echo(f"{compiling.ONCE}; `fwclass compile` makes all kernels ahead", err=True)


def tell(facts: Any, words: str, as_json: bool) -> None:
    """Write `words` for people on standard error and, with --json, the `facts` on standard output."""
    click.echo(words, err=True)
    if as_json:
        click.echo(json.dumps(facts, indent=1))


def little_garbage() -> None:
    """For commands that load much and end: modules and receipts are none, and to look for it takes a tenth of them."""
    gc.set_threshold(50_000, 20, 20)


def work_here() -> None:
    """For commands that compute on one file and end: as `little_garbage`, memory of arrays is kept for others, and
    nothing else has the cores."""
    from fwclass import cores, memory  # not for --help

    little_garbage()
    memory.keep_freed()
    cores.use_all()


def _is_utf8(path: Path) -> bool:
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _checked(value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
    """`value`, unless it is empty, which would mean the current directory, or an address with one slash."""
    if value == "":
        raise click.BadParameter("it is empty; name a file or a directory (. is the current one)", ctx, param)
    if not _is_utf8(place := Path(value).absolute()):
        words = (
            f"{visible(place)} is no name in UTF-8, which other programs need; rename it, or choose another directory"
        )
        raise click.BadParameter(words, ctx, param)
    if kind := strange_kind(value):
        raise click.BadParameter(f"{value} is {kind}; name a file or a directory", ctx, param)
    if re.match(rf"({'|'.join(SCHEMES)}):/?[^/]", str(value)):
        raise click.BadParameter(f"{value}: an address has two slashes, as in s3://bucket/directory", ctx, param)
    return value


def _check_seen(value: Any, param: click.Parameter | None, ctx: click.Context | None) -> None:
    """Usage error for a name that would colour, erase or break the lines that tell of it."""
    if visible(value) != str(value):
        words = f"{visible(value)} has a character that cannot be seen, as the end of a line; choose another name"
        raise click.BadParameter(words, ctx, param)


class LocalPath(click.Path):
    """A path of this host; an address on object storage is refused in words."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if is_url(value):
            self.fail(
                f"{value} is on object storage, and this command takes files of this host; `fwclass run`, `status`, "
                "`schedule`, `history`, `seams` and `view` take the address of a run (docs/many-machines.md)",
                param,
                ctx,
            )
        return super().convert(_checked(value, param, ctx), param, ctx)


class OutputPath(LocalPath):
    """A path to write to, whose name can be seen, and which lies in no run's store or delivery, whatever links lead
    there."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = super().convert(value, param, ctx)
        _check_seen(value, param, ctx)
        if run := run_around(Path(path)):
            self.fail(
                f"{path} lies in what the run {run} has made and delivers, which commands leave as it is; name another "
                "place",
                param,
                ctx,
            )
        return path


class Finite(click.FloatRange):
    """A number of a range, which is there: what is no number (``nan``) lies outside of none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number; usage error for ``nan`` and ``inf``."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is no finite number", param, ctx)
        return number


class RunPlace(click.Path):
    """A path of this host whose name can be seen, or an address on object storage."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if is_url(value):
            return url_of(value, param.get_error_hint(ctx).strip("'") if param and ctx else "")
        path = super().convert(_checked(value, param, ctx), param, ctx)
        _check_seen(value, param, ctx)
        return path


PATH = LocalPath(path_type=Path)
OUTPUT = OutputPath(path_type=Path)
RUN = RunPlace(path_type=Path)
SET = click.option(
    "--set", "settings", multiple=True, metavar="SECTION.KEY=VALUE", help="Change one setting; may be repeated."
)
SCHEDULER = click.option("--scheduler", metavar="ADDR", help="Dask scheduler, e.g. tcp://host:8786.")
MOST_WORKERS = 10_000
"""As of `run.workers`, whose section would take its time at every start."""
WORKERS = click.option(
    "--workers",
    type=click.IntRange(0, MOST_WORKERS),
    metavar="N",
    help="Processes on this machine; 0 runs a plain loop.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="JSON on standard output.")
ACCEPT_IMPLAUSIBLE = click.option(
    "--accept-implausible",
    is_flag=True,
    help="Do not end with exit code 4 where echoes are implausible (plausibility).",
)
CLASSIFIER = click.option("--method", metavar="NAME", help=f"{', '.join(get_args(ClassifierMethod))}.")
ACCEPT_DRIFT = click.option(
    "--accept-drift",
    is_flag=True,
    help="Do not end with exit code 4 where the model has not seen such data (classify.max_outside).",
)
MIRROR_BEAMS = click.option(
    "--mirror-beams",
    is_flag=True,
    help="Turn the horizontal parts of all beams round (read.mirror_beams): some converters stored them so.",
)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
