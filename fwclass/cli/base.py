"""The command group, and the options that several commands share."""

from __future__ import annotations

from pathlib import Path

import click

from fwclass import __version__

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


@click.group(context_settings=CONTEXT)
@click.version_option(__version__, prog_name="fwclass")
def cli() -> None:
    """Classify airborne full-waveform lidar surveys: waveforms in, classified GIS-ready tiles out.

    Exit codes: 0 done, 1 failed, 2 usage or configuration, 3 some parts failed, 4 a quality threshold was missed,
    130 interrupted.
    """


PATH = click.Path(path_type=Path)
SET = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="SECTION.KEY=VALUE",
    help="Change one setting; may be repeated.",
)
SCHEDULER = click.option("--scheduler", metavar="ADDR", help="Dask scheduler, e.g. tcp://host:8786.")
WORKERS = click.option("--workers", type=click.IntRange(0), help="Processes on this machine; 0 runs a plain loop.")
JSON = click.option("--json", "as_json", is_flag=True, help="JSON on standard output.")
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
