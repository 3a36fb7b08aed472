"""Commands that look at single files or fit their waveforms: info, decompose, assess."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from fwclass.cli.base import (
    ACCEPT_IMPLAUSIBLE,
    JSON,
    MIRROR_BEAMS,
    OUTPUT,
    OVERWRITE,
    PATH,
    SET,
    Finite,
    cli,
    work_here,
)
from fwclass.errors import FAILED, FwclassError


def _numbers(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[int, ...]:
    """``3,17`` as numbers."""
    try:
        return tuple(int(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise click.BadParameter(f"{text!r} is no list of whole numbers like 3,17,200") from None


@cli.command()
@click.argument("files", nargs=-1, required=True, type=PATH)
@click.option("--waveforms", is_flag=True, help="Fit the waveforms of one file, and draw some of its pulses.")
@click.option("--pulse", "pulses", metavar="N,N,…", callback=_numbers, help="With --waveforms: these, from 0.")
@click.option("--out", type=OUTPUT, help="With --waveforms: the picture (default: <file>-waveforms.png, here).")
@SET
@OVERWRITE
@JSON
def info(
    files: tuple[Path, ...],
    waveforms: bool,
    pulses: tuple[int, ...],
    out: Path | None,
    settings: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
) -> None:
    """What files, or those of a directory, hold: formats, packets, descriptors, CRS, classes, and what is wrong.

    With --waveforms: chosen pulses of one file with their fitted echoes, and the echoes that its vendor's returns miss.
    """
    if waveforms:
        _info_waveforms(files, pulses, settings, out, overwrite, as_json)
    elif pulses or settings or overwrite or out is not None:
        raise click.UsageError("--pulse, --out, --set and --overwrite belong to --waveforms")
    else:
        _info_facts(files, as_json)


def _info_waveforms(
    files: tuple[Path, ...],
    pulses: tuple[int, ...],
    settings: tuple[str, ...],
    out: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    from fwclass.single_file.waveforms.text import describe
    from fwclass.single_file.waveforms.view import look

    if len(files) > 1:
        raise click.UsageError("--waveforms takes one file")
    report = look(files[0], pulses, settings, out, overwrite)
    click.echo(json.dumps(report, indent=1) if as_json else describe(report))


def _info_facts(files: tuple[Path, ...], as_json: bool) -> None:
    from fwclass.read.info import describe, files_in
    from fwclass.read.info import info as facts_of
    from fwclass.read.info_together import describe_together
    from fwclass.store.unchanged import check_unchanged

    facts, faults = [], []
    files = tuple(one for path in files for one in (files_in(path) if path.is_dir() else (path,)))
    for path in files:
        try:
            with check_unchanged(path):
                fact = facts_of(path)
            facts.append(fact)
        except FwclassError as fault:
            faults.append(fault)
            click.echo(f"fwclass: {fault}", err=True)
    if as_json:
        click.echo(json.dumps(facts if len(files) > 1 else (facts[0] if facts else None), indent=1))
    else:
        click.echo("\n\n".join(filter(None, (*map(describe, facts), describe_together(facts)))))
    if faults:
        sys.exit(FAILED)


@cli.command()
@click.argument("source", type=PATH)
@click.argument("output", type=OUTPUT)
@click.option("--trajectory", type=PATH, help="Where the sensor flew (text or SBET): gives ranges and radiometry.")
@click.option(
    "--undulation", type=Finite(), default=0.0, help="Metres to take from the trajectory's heights: the geoid's height."
)
@click.option(
    "--crs",
    metavar="EPSG:CODE",
    help="The coordinate system, instead of what the file names; files in degrees, or geocentric, are brought into it.",
)
@SET
@OVERWRITE
@ACCEPT_IMPLAUSIBLE
@MIRROR_BEAMS
def decompose(
    source: Path,
    output: Path,
    trajectory: Path | None,
    undulation: float,
    crs: str | None,
    settings: tuple[str, ...],
    overwrite: bool,
    accept_implausible: bool,
    mirror_beams: bool,
) -> None:
    """One file: waveforms to echoes with extra bytes (LAZ)."""
    work_here()
    from fwclass import conf
    from fwclass.report.judge_echoes import judge_echoes
    from fwclass.single_file.decompose import decompose_file

    settings += ("plausibility.accept=true",) if accept_implausible else ()
    settings += ("read.mirror_beams=true",) if mirror_beams else ()
    sentences, judged = decompose_file(source, output, settings, overwrite, trajectory, undulation, crs)
    click.echo(sentences, err=True)
    judge_echoes(judged, conf.section("plausibility", settings), source)


@cli.command()
@click.argument("reference", type=PATH)
@click.argument("prediction", type=PATH)
@click.option("--map", "codes", metavar="NAME=2;NAME=3,4,5", help="Classes by name and reference codes.")
@click.option("--ground", is_flag=True, help="Two classes: ground (2) against everything else.")
@click.option("--objects", metavar="NAMES", help="Classes whose objects are judged (default: 6, 13 to 17, 19, 64 on).")
@ACCEPT_IMPLAUSIBLE
@JSON
def assess(
    reference: Path,
    prediction: Path,
    codes: str | None,
    ground: bool,
    objects: str | None,
    accept_implausible: bool,
    as_json: bool,
) -> None:
    """Confusion matrix and figures of a classified cloud against a reference cloud, and how many objects are found.

    Both are LAS, LAZ, COPC, or text with a label: class codes, or 0 ground and 1 object; or quoted patterns
    ('tiles/*.laz'), whose files of one name are compared. Or two directories of assessed runs: what the second gains
    over the first, with intervals.
    """
    if reference.is_dir() and prediction.is_dir():
        _assess_runs(reference, prediction, as_json)
        return
    from fwclass.assess.confusion import describe
    from fwclass.assess.objects import describe_objects
    from fwclass.single_file.assess import assess_files
    from fwclass.single_file.likeness import judge_likeness

    figures = assess_files(reference, prediction, codes, ground, objects)
    if as_json:
        click.echo(json.dumps(figures, indent=1))
    else:
        click.echo("\n\n".join(filter(None, (describe(figures), describe_objects(figures["objects"])))))
    matched, lost = figures["matched"], figures["unmatched"]
    click.echo(f"{matched:,} of {matched + lost:,} reference points have a predicted point", err=True)
    if left_out := figures["left_out"]:
        by_code = ", ".join(f"{code}: {n:,}" for code, n in left_out.items())
        share = 100 * sum(left_out.values()) / matched
        click.echo(f"not counted: {share:.1f} % of them, of codes that no class has ({by_code})", err=True)
    if lost > matched:
        click.echo("WARNING: the two clouds hardly overlap; the figures stand for the small part that does", err=True)
    for text in figures["remarks"]:
        click.echo(f"remark: {text}", err=True)
    judge_likeness(figures["implausible"], accept_implausible, f"{reference}, {prediction}")


def _assess_runs(first: Path, second: Path, as_json: bool) -> None:
    from fwclass.operate.assess_runs import assess_runs, describe

    intervals = assess_runs(first, second)
    click.echo(json.dumps(intervals, indent=1) if as_json else describe(intervals))
