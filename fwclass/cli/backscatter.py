"""Commands for those who want the waveform, not echoes: voxels, profile."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fwclass.cli.base import PATH, RUN, SCHEDULER, SET, WORKERS, cli
from fwclass.cli.survey import How, run_configuration

WORKFLOW = "backscatter"
SOURCE = click.argument("source", metavar="CONF|FILE", type=PATH)
OUT = click.option("--out", type=RUN, help="Run directory (default: runs/<survey>-backscatter).")
SAMPLES = click.option("--samples", is_flag=True, help="Deliver the samples, freed of the pulse, as points too.")
CRS = click.option(
    "--crs", metavar="EPSG:CODE", help="Coordinate system; files in degrees, or geocentric, are brought into it."
)


@cli.command()
@SOURCE
@OUT
@click.option("--size", type=float, metavar="METRES", help="Edge of a voxel (as --set voxels.size=…).")
@SAMPLES
@CRS
@SET
@SCHEDULER
@WORKERS
def voxels(source: Path, size: float | None, settings: tuple[str, ...], **options: Any) -> None:
    """Voxels: returned energy, hits, passes, occlusion, transmittance, as one Zarr group.

    Of a survey (CONF), or of one file of waveforms; nothing is classified. What the run directory has of it already is
    not made again.
    """
    settings += ("voxels.write=true", *((f"voxels.size={size}",) if size is not None else ()))
    _run(source, settings, **options)


@cli.command()
@SOURCE
@OUT
@click.option("--cell", type=float, metavar="METRES", help="Edge of a cell (as --set profile.cell=…).")
@SAMPLES
@CRS
@SET
@SCHEDULER
@WORKERS
def profile(source: Path, cell: float | None, settings: tuple[str, ...], **options: Any) -> None:
    """Vertical profiles by cell: energy a metre of height above ground, relative heights, cover, as one Zarr group.

    Of a survey (CONF), or of one file of waveforms; nothing is classified. What the run directory has of it already is
    not made again.
    """
    settings += ("profile.write=true", *((f"profile.cell={cell}",) if cell is not None else ()))
    _run(source, settings, **options)


def _run(
    source: Path,
    settings: tuple[str, ...],
    out: Any,
    samples: bool,
    crs: str | None,
    scheduler: str | None,
    workers: int | None,
) -> None:
    from fwclass.operate.file_as_survey import survey_of, system_settings

    settings += ("samples.write=true",) if samples else ()
    settings += system_settings(source, crs) if crs is not None else ()
    conf, named = survey_of(source, out)
    for name, key in (("voxels.zarr", "voxels.write"), ("profiles.zarr", "profile.write")):
        if f"{key}=true" not in settings and isinstance(named, Path) and (named / name).exists():
            click.echo(
                f"note        {named / name} is of an earlier delivery, which stays beside the new one below "
                f"{named / 'generations'}; --set {key}=true delivers both",
                err=True,
            )
    run_configuration(conf, named, settings, None, WORKFLOW, How(scheduler, workers))
