"""Commands about the ground: ground, normalize."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import click

from fwclass.cli.base import ACCEPT_IMPLAUSIBLE, JSON, OUTPUT, OVERWRITE, PATH, SET, cli, tell, work_here
from fwclass.ground.methods import Method

KINDS = "Kind of land: wilderness, nature, town, city, metro, dense-forest or steep."
PARAM = click.option("--param", "assignments", multiple=True, metavar="NAME=VALUE", help="A parameter of the filter.")
METHOD = click.option("--method", type=click.Choice(get_args(Method)), help="Filter (default: ground.method).")
PRESET = click.option("--preset", metavar="NAME", help=KINDS)
CRS = click.option("--crs", metavar="EPSG:CODE", help="Coordinate system, instead of the one that the file names.")
RASTERS = ("dtm", "dsm", "ndsm", "hillshade", "slope", "roughness")
FLAGGED = click.option("--use-flagged", is_flag=True, help="Show withheld and synthetic points to the filter too.")


@cli.command()
@click.argument("source", metavar="IN", type=PATH)
@click.argument("output", metavar="[OUT]", type=OUTPUT, required=False)
@METHOD
@PRESET
@PARAM
@SET
@click.option(
    "--auto", is_flag=True, help="Measure the points first and adapt the parameters; no --method: the filter too."
)
@click.option("--keep-classes", is_flag=True, help="What is no ground keeps its class; noise stays noise.")
@FLAGGED
@CRS
@click.option("--dtm", type=OUTPUT, help="Terrain as GeoTIFF.")
@click.option("--dsm", type=OUTPUT, help="Highest echoes as GeoTIFF.")
@click.option("--ndsm", type=OUTPUT, help="Height of the highest echoes above the terrain as GeoTIFF.")
@click.option("--hillshade", type=OUTPUT, help="Shaded relief of the terrain as GeoTIFF.")
@click.option("--slope", type=OUTPUT, help="Slope of the terrain as GeoTIFF [deg].")
@click.option("--roughness", type=OUTPUT, help="Spread of the ground points about their plane as GeoTIFF.")
@click.option("--cell", type=float, metavar="METRES", help="Edge of the rasters' cells (as --set terrain.cell=0.5).")
@click.option("--optimize", is_flag=True, help="Search the filter's parameters on labelled points; no OUT.")
@click.option("--compare", metavar="NAME,NAME,…|all", help="Several filters side by side on one page; no OUT.")
@click.option("--reference", type=PATH, help="With --optimize or --compare: the classes of the same points.")
@click.option("--out", type=OUTPUT, help="With --optimize or --compare: directory of what they write.")
@ACCEPT_IMPLAUSIBLE
@OVERWRITE
@JSON
def ground(
    source: Path, output: Path | None, optimize: bool, compare: str | None, as_json: bool, **options: Any
) -> None:
    """Ground points of one file: class 2, everything else class 1, noise class 7.

    IN is LAS, LAZ, COPC or text (x y z [label]); OUT is LAS, LAZ or text. Points keep their order and all their other
    fields. With --optimize or --compare nothing is classified, and there is no OUT.
    """
    if optimize and compare is not None:
        raise click.UsageError("--optimize and --compare are two commands: give one of them")
    if optimize or compare is not None:
        _study(source, output, compare, as_json, options)
        return
    if output is None:
        raise click.UsageError("Missing argument 'OUT': where the points go")
    if options.pop("reference") is not None or options.pop("out") is not None:
        raise click.UsageError("--reference and --out belong to --optimize and --compare")
    _classify(source, output, as_json, options)


def _classify(source: Path, output: Path, as_json: bool, options: dict[str, Any]) -> None:
    work_here()
    from fwclass import conf
    from fwclass.report.ground import judge_ground
    from fwclass.report.judge_echoes import judge_echoes
    from fwclass.single_file.ground.file import GroundJob, ground_file
    from fwclass.single_file.ground.steps import StepDisplay
    from fwclass.single_file.ground.text import describe

    auto, accepted = options.pop("auto"), options.pop("accept_implausible")
    wanted = {name: options.pop(name) for name in RASTERS}
    rasters = {name: path for name, path in wanted.items() if path is not None}
    if (cell := options.pop("cell")) is not None:
        if not rasters:
            raise click.UsageError("--cell is that of the rasters, and none is asked for; the filter's is a --param")
        options["settings"] += (f"terrain.cell={cell}",)
    with StepDisplay() as steps:
        if auto:
            options["adapt"] = _adapting(options, steps.tell)
        summary = ground_file(GroundJob(source, output, rasters=rasters, **options), steps.tell)
    tell(summary, describe(summary), as_json)
    bounds = conf.section("plausibility").model_copy(update={"accept": accepted})
    judge_echoes(summary["judged"], bounds, source)
    judge_ground({"echoes": summary["shown"], "ground": summary["ground"]}, bounds, source)


def _adapting(options: dict[str, Any], tell: Any) -> Any:
    """``--auto``; the filter is chosen too where nothing names one."""
    from fwclass.single_file.ground.file import adapting

    named = options["method"] or options["preset"] or any(s.startswith("ground.method") for s in options["settings"])
    return adapting(not named, options["settings"], tell)


def _study(source: Path, output: Path | None, methods: str | None, as_json: bool, options: dict[str, Any]) -> None:
    """Filters are looked at, no points are written."""
    unused = [
        f"--{n.replace('_', '-')}"
        for n in ("keep_classes", "use_flagged", *RASTERS, "cell", "accept_implausible")
        if options.pop(n)
    ]
    if output is not None or unused:
        raise click.UsageError(f"{unused[0] if unused else 'OUT'} has no place here: nothing is classified; see --out")
    from fwclass.single_file.ground.steps import StepDisplay

    auto = options.pop("auto")
    if methods is None:
        if auto:
            raise click.UsageError("--optimize searches what --auto would measure: give one of them")
        from fwclass.single_file.ground.search import describe, optimize

        with StepDisplay() as steps:
            result = optimize(source, say=steps.say, tell=steps.tell, **options)
    else:
        from fwclass.single_file.ground.compare import compare, describe

        if options.pop("method") or options.pop("assignments"):
            raise click.UsageError("--compare names its filters itself; give parameters with --set")
        with StepDisplay() as steps:
            adapt = _adapting({**options, "method": "each its own"}, steps.tell) if auto else None
            result = compare(source, methods, say=steps.say, tell=steps.tell, adapt=adapt, **options)
    tell(result, describe(result), as_json)


@cli.command()
@click.argument("source", metavar="IN", type=PATH)
@click.argument("output", metavar="OUT", type=OUTPUT)
@click.option("--height", type=click.Choice(["tin", "nearest", "raster"]), help="Above what (default: terrain.height).")
@click.option("--keep-z", is_flag=True, help="Leave z; put the height into the extra byte HeightAboveGround.")
@METHOD
@PRESET
@PARAM
@SET
@FLAGGED
@CRS
@ACCEPT_IMPLAUSIBLE
@OVERWRITE
@JSON
def normalize(source: Path, output: Path, as_json: bool, accept_implausible: bool, **options: Any) -> None:
    """Heights above ground of one file in place of z.

    The ground is what has class 2; with --method, --preset or --param it is looked for. All other fields stay.
    """
    work_here()
    from fwclass import conf
    from fwclass.report.judge_echoes import judge_echoes
    from fwclass.single_file.ground.normalize import NormalizeJob, normalize_file
    from fwclass.single_file.ground.steps import StepDisplay
    from fwclass.single_file.ground.text import describe_heights

    with StepDisplay() as steps:
        summary = normalize_file(NormalizeJob(source, output, **options), steps.tell)
    tell(summary, describe_heights(summary), as_json)
    bounds = conf.section("plausibility").model_copy(update={"accept": accept_implausible})
    judge_echoes(summary["judged"], bounds, source)
