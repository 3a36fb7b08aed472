"""`fwclass ground`: the ground points of one file, without a run directory."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import compiling, conf
from fwclass.classes import GROUND, HIGH_NOISE, LOW_NOISE, UNCLASSIFIED
from fwclass.errors import InputError
from fwclass.formats.area_of_use import place_facts
from fwclass.formats.flat import HIGHEST, LONGEST, TAKEN_FOR_METRES
from fwclass.graph.ground import FILTER_GROUND, GATHER_GROUND
from fwclass.ground.auto import adapt_filter
from fwclass.ground.filters import Flags
from fwclass.ground.params import GroundParams
from fwclass.ground.tuning_params import GroundAutoParams
from fwclass.read.cloud import PointCloud, read_point_cloud, returns_of
from fwclass.read.las import LasSource
from fwclass.report.ground import filter_facts, filter_remarks
from fwclass.report.repeated import repeated_in_file
from fwclass.report.returns import places_facts
from fwclass.schema import Table
from fwclass.single_file.ground.output import check_copy, check_output, write_points
from fwclass.single_file.ground.params import FileJob, ground_params, used_params, with_assignments
from fwclass.single_file.ground.rasters import check_extent, terrain_of, write_rasters
from fwclass.single_file.ground.stray import describe_stray, stray_points
from fwclass.single_file.lines import lines_of
from fwclass.single_file.tiles import FileConfig, FileTiles, Tell, quiet
from fwclass.store.unchanged import of_unchanged
from fwclass.survey.systems import given_crs

MANY = 100
"""So many points within a metre are no survey."""

LACKING, LACKING_SHARE = 1_000, 0.1
"""Pulses without their last return, and their share, before it is said; 0 to 0.017 in fourteen public files."""

Adapt = Callable[[PointCloud, NDArray[np.bool_], GroundParams], tuple[GroundParams, dict[str, Any]]]
"""``adapt(cloud, shown, params)``: other parameters, and what was measured, as plain data."""


@dataclass(frozen=True)
class GroundJob(FileJob):
    """What `fwclass ground` was asked for, besides what every `FileJob` is.

    Attributes
    ----------
    keep_classes : points that are no ground keep the class they came with.
    use_flagged : withheld and synthetic points are shown to the filter too.
    rasters : GeoTIFFs to write, by name: ``dtm``, ``dsm``, ``ndsm``, ``hillshade``, ``slope``,
        ``roughness``.
    adapt : changes the parameters once the points are there.
    """

    keep_classes: bool = False
    use_flagged: bool = False
    rasters: dict[str, Path] = field(default_factory=dict)
    adapt: Adapt | None = None


@of_unchanged
def ground_file(job: GroundJob, tell: Tell = quiet) -> dict[str, Any]:
    """Find the ground of a file and write its points with new classes; what was done, as plain data.

    Ground becomes class 2, what the filter takes for noise class 7, everything else class 1. With `keep_classes` the
    others keep the class they came with (but 2, which becomes 1), and points that came as noise (7, 18) stay what
    they are and the filter does not see them. Nothing is written before all of it is known. `tell` is called with every
    step.

    `ConfigError`: an output, filter or parameter that cannot be used. `InputError`: an input that cannot be used.
    """
    started = time.perf_counter()
    check_output(job.source, job.output, job.overwrite, job.rasters.values())
    params = ground_params(job.method, job.preset, () if job.adapt else job.assignments, job.settings)
    publish, terrain = conf.section("publish", job.settings), conf.section("terrain", job.settings)
    tell("reading")
    cloud = read_point_cloud(job.source, given_crs(job.crs, "--crs"))
    check_copy(cloud, job.output, job.overwrite)
    shown = shown_points(cloud, job.keep_classes, job.use_flagged)
    if job.rasters:
        check_extent(cloud, shown, terrain.cell, publish.cog_block)
    measured: dict[str, Any] = {}
    compiled = compiling.compile_seconds()
    if job.adapt is not None:
        params, measured = job.adapt(cloud, require_shown(cloud, shown), params)
        params = with_assignments(params, job.assignments)
    at, before = time.perf_counter(), compiling.compile_seconds()
    flags, facts = flags_and_facts(cloud, shown, params, tell)
    filtering = time.perf_counter() - at - (compiling.compile_seconds() - before)
    classes = classes_of(cloud, flags, job.keep_classes)
    if job.rasters:
        tell("terrain")
        terrains = terrain_of(cloud, flags, shown, job.settings)
    tell("writing")
    written = write_points(cloud, job.output, classes, publish)
    rasters = write_rasters(cloud, terrains, job.rasters, publish) if job.rasters else {}
    codes, counts = np.unique(classes, return_counts=True)
    stray = stray_points(cloud, shown)
    judged, odd = judged_of_cloud(cloud, flags.noise | ~shown, job.settings)
    odd += [*(last_returns_lack(cloud) if params.last_returns else ()), *filter_remarks(facts, params)]
    return {
        "input": str(job.source),
        "output": str(job.output),
        "method": params.method,
        "preset": job.preset,
        "parameters": used_params(params),
        "measured": measured,
        "points": cloud.points,
        "unusable": unusable(cloud),
        "shown": int(shown.sum()),
        "left_out": int((cloud.usable & ~shown).sum()),
        "stray": len(stray),
        "last_returns": int((shown & cloud.last).sum()),
        "ground": int(flags.ground.sum()),
        "noise": int(flags.noise.sum()),
        "classes": {str(c): int(n) for c, n in zip(codes, counts, strict=True)},
        "crs": cloud.units.source,
        "metres_per_unit": {"xy": cloud.units.xy, "z": cloud.units.z},
        "rasters": rasters,
        "waveforms": written.get("wdp"),
        "judged": {**judged, **facts},
        "notes": _notes(cloud, shown, flags, stray, [*written.get("notes", ()), *odd]),
        "seconds": {
            "filter": round(filtering, 3),
            "compiling": round(compiling.compile_seconds() - compiled, 3),
            "all": round(time.perf_counter() - started, 3),
        },
    }


def shown_points(cloud: PointCloud, keep_classes: bool = False, use_flagged: bool = False) -> NDArray[np.bool_]:
    """Which points the filter may see: usable ones, not withheld or synthetic, with kept classes not noise."""
    shown = cloud.usable.copy()
    if not use_flagged:
        shown &= ~cloud.flagged
    if keep_classes and cloud.classes is not None:
        shown &= ~came_as_noise(cloud)
    return shown


def came_as_noise(cloud: PointCloud) -> NDArray[np.bool_]:
    """Points of class 7 or 18."""
    if cloud.classes is None:
        return np.zeros(cloud.points, bool)
    return (cloud.classes == LOW_NOISE) | (cloud.classes == HIGH_NOISE)


def filter_cloud(cloud: PointCloud, shown: NDArray[np.bool_], params: GroundParams, tell: Tell = quiet) -> Flags:
    """The flags alone of `flags_and_facts`."""
    return flags_and_facts(cloud, shown, params, tell)[0]


def flags_and_facts(
    cloud: PointCloud, shown: NDArray[np.bool_], params: GroundParams, tell: Tell = quiet
) -> tuple[Flags, dict[str, Any]]:
    """Flags of all points of `cloud`, and what of its ground lies on wide roofs or in pits
    (`report.ground.filter_facts`); only `shown` points take part.

    `InputError`: no point is left to look at.
    """
    rows = np.flatnonzero(require_shown(cloud, shown))
    if params.last_returns and not cloud.last[rows].any():
        raise InputError(
            "no point is the last return of its pulse",
            where=cloud.path,
            expected="return numbers that reach the number of returns",
            got=f"none among {len(rows):,} points",
            do="let all returns be ground: --param last_returns=false",
        )
    tiles = FileTiles(
        Table(
            {
                **{axis: getattr(cloud, axis)[rows] for axis in "xyz"},
                "echo_number": np.ones(len(rows)),
                "number_of_echoes": np.where(cloud.last[rows], 1, 2),
                "fit_flags": np.zeros(len(rows)),
            }
        ),
        FileConfig((), ground=params),
        (FILTER_GROUND, GATHER_GROUND),
        tell,
        {FILTER_GROUND.name: f"filter {params.method}: block"},
    )
    flags = Flags(np.zeros(cloud.points, bool), np.zeros(cloud.points, bool))
    for name, values in tiles.columns(GATHER_GROUND, ("ground", "noise")).items():
        getattr(flags, name)[rows] = values
    return flags, filter_facts(tiles.facts_of_blocks(FILTER_GROUND), int(flags.ground.sum()))


def require_shown(
    cloud: PointCloud, shown: NDArray[np.bool_], unless_noise: str = "leave out --keep-classes"
) -> NDArray[np.bool_]:
    """`shown`, or `InputError` where no point is; `unless_noise` says what to do where all came as noise."""
    if not shown.any():
        flagged = int((cloud.usable & cloud.flagged).sum())
        noise = cloud.points - flagged - int((~cloud.usable).sum())
        ways = [w for w, n in (("add --use-flagged", flagged), (unless_noise, noise)) if n]
        raise InputError(
            "no point is left for the filter",
            where=cloud.path,
            expected="points that are neither withheld nor synthetic, nor noise whose class is kept",
            got=f"0 of {cloud.points:,}: {flagged:,} withheld or synthetic, {noise:,} noise",
            do=" and ".join(ways) or "check the file",
        )
    return shown


def classes_of(cloud: PointCloud, flags: Flags, keep_classes: bool) -> NDArray[np.uint8]:
    """Class code of every point."""
    classes = np.full(cloud.points, UNCLASSIFIED, np.uint8)
    if keep_classes and cloud.classes is not None:
        classes = np.where(cloud.classes == GROUND, UNCLASSIFIED, cloud.classes).astype(np.uint8)
    classes[flags.noise] = LOW_NOISE
    classes[flags.ground] = GROUND
    return classes


def looks_like_degrees(cloud: PointCloud) -> bool:
    """No coordinate system, numbers of longitudes and latitudes, and all within one of them: a dense patch, or what
    `flat` cannot tell from one."""
    x, y = cloud.x[cloud.usable], cloud.y[cloud.usable]
    near = np.ptp(x) < 1.0 and np.ptp(y) < 1.0 and len(x) >= MANY
    return bool(cloud.crs is None and near and np.abs(x).max() <= LONGEST and np.abs(y).max() <= HIGHEST)


def unusable(cloud: PointCloud) -> dict[str, int]:
    """Points that no filter can use, by reason."""
    counts = {"not finite": cloud.unfinished, "beyond any place on earth": cloud.absurd}
    return {name: n for name, n in counts.items() if n}


def place_of_cloud(cloud: PointCloud) -> dict[str, Any]:
    """What is odd about where the points lie, as `report.facts.judge_place` takes it."""
    if looks_like_degrees(cloud):
        remark = "the coordinates look like degrees, and were taken for metres: reproject the file first"
        return {"remarks": [remark], "elsewhere": True}
    axes = (cloud.x, cloud.units.xy), (cloud.y, cloud.units.xy), (cloud.z, cloud.units.z)
    low, high = ([float(f(a[cloud.usable])) / unit for a, unit in axes] for f in (np.min, np.max))
    own, header, of_file = (getattr(cloud.source, name, None) for name in ("crs", "header", "faults"))
    return place_facts(cloud.crs, low, high, header, own, of_file or ())


def judged_of_cloud(
    cloud: PointCloud, noise: NDArray[np.bool_], settings: tuple[str, ...] = ()
) -> tuple[dict[str, Any], list[str]]:
    """What `report.judge_echoes` judges of the points of a file, and all that is to be said of them; `noise` (n,) is no
    surface."""
    name, rows = cloud.path.name, np.flatnonzero(cloud.usable)
    table = Table({axis: getattr(cloud, axis)[rows] for axis in "xyz"})
    returns = places_facts([table[axis] for axis in "xyz"], cloud.beams, name, conf.section("plausibility"))
    judged: dict[str, Any] = {"place": place_of_cloud(cloud), "returns": returns}
    of_points: Any = {column: values[rows] for column, values in returns_of(cloud).items()}
    said: tuple[str, ...] = ()
    times = {"gps_time": of_points["gps_time"]} if of_points else {}
    repeated = repeated_in_file(table.with_columns(times), name)
    if isinstance(cloud.source, LasSource):  # points of a text have no times, and may lie that dense
        judged["repeated"] = repeated
    if of_points:
        of_points |= {"strip": np.zeros(len(rows), np.int16), "noise": noise[rows]}
        judged["strips"], said = lines_of(table.with_columns(of_points), cloud.path, settings)
    facts_of = (judged["place"], returns, repeated or {})
    return judged, [*cloud.cut_packets, *(r for facts in facts_of for r in facts.get("remarks", ())), *said]


def last_returns_lack(cloud: PointCloud) -> list[str]:
    """That many pulses lack their last return, of which ground is made."""
    if cloud.lastless < LACKING or cloud.lastless <= LACKING_SHARE * cloud.several:
        return []
    return [
        f"of {cloud.several:,} pulses with several returns, at least, {cloud.lastless:,} lack their last one (first "
        "returns alone, or lost return numbers), and ground is made of last returns: --param last_returns=false takes "
        "all"
    ]


def _notes(
    cloud: PointCloud, shown: NDArray[np.bool_], flags: Flags, stray: NDArray[np.int64], notes: list[str]
) -> list[str]:
    if cloud.crs is None and isinstance(cloud.source, LasSource) and not looks_like_degrees(cloud):
        notes.append(TAKEN_FOR_METRES)
    if isinstance(cloud.source, LasSource) and cloud.crs is not cloud.source.crs:
        notes.append("the output keeps the coordinate system that the input names, not that of --crs")
    if len(stray):
        ground = int(flags.ground[stray].sum())
        notes.append(
            f"{describe_stray(cloud, stray)}; {ground:,} of them {'is' if ground == 1 else 'are'} called ground"
        )
    if not flags.ground.any():
        notes.append("no ground was found: water, or a filter that does not suit this place")
    elif _flat(cloud, shown):
        notes.append("all points have the same height: nothing tells ground from objects, so all may be called ground")
    return notes


def _flat(cloud: PointCloud, shown: NDArray[np.bool_]) -> bool:
    return bool(np.ptp(cloud.z[shown]) == 0.0)


def adapting(choose: bool, settings: tuple[str, ...] = (), tell: Tell = quiet) -> Adapt:
    """What changes parameters to suit a cloud; with `choose` the filter too. `tell` gets how much is tried."""
    rules: GroundAutoParams = conf.section("ground_auto", settings)

    def adapt(cloud: PointCloud, shown: NDArray[np.bool_], params: GroundParams) -> tuple[GroundParams, dict[str, Any]]:
        method = rules.method if choose or params.method == "auto" else params.method
        tried = len(rules.updates(method))
        tell(f"measuring, then trying {tried} settings of {method}" if tried else "measuring")
        points = cloud.x[shown], cloud.y[shown], cloud.z[shown]
        suited = adapt_filter(points, cloud.last[shown], params, rules, method)
        return suited.params, suited.measured.plain()

    return adapt
