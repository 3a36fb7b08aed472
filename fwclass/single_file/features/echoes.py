"""The echoes of one file of any kind: fitted to its waveforms, or its returns; with ground, heights and radiometry."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.classes import GROUND, HIGH_NOISE, LOW_NOISE
from fwclass.decompose.params import DecomposeParams
from fwclass.errors import ConfigError, InputError
from fwclass.formats.area_of_use import place_facts
from fwclass.formats.flat import TAKEN_FOR_METRES, refuse_source
from fwclass.formats.linear_units import LinearUnits, linear_units
from fwclass.formats.projected import metric_twin
from fwclass.graph.ground import FILTER_GROUND, GATHER_GROUND, GATHER_HEIGHT
from fwclass.ground.auto import adapt_filter
from fwclass.ground.params import GroundParams
from fwclass.ground.stage import GROUND_FILTER, TERRAIN, last_of
from fwclass.ground.tuning_params import GroundAutoParams
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.read.cloud import read_point_cloud
from fwclass.read.projection import is_brought
from fwclass.read.source import Source, is_beam_file, open_source, refuse_other_system
from fwclass.read.stage import check_source
from fwclass.read.text import is_text
from fwclass.report.ground import filter_facts, filter_remarks, sunken_remarks
from fwclass.report.plausibility import strip_plausibility
from fwclass.report.plausibility_remarks import plausibility_remarks
from fwclass.report.repeated import repeated_in_file
from fwclass.schema import IDENTITY, Table
from fwclass.single_file.decompose import add_radiometry, read_flight
from fwclass.single_file.ground.params import FileJob, ground_params, used_params, with_assignments
from fwclass.single_file.lines import lines_of
from fwclass.single_file.strip import strip_of
from fwclass.single_file.tiles import MAKE_HEIGHTS, FileConfig, FileTiles, Tell, points_of, with_noise_flags
from fwclass.survey.systems import given_crs
from fwclass.waveforms import IMPLAUSIBLE

PLACE = (*IDENTITY, "number_of_echoes", "x", "y", "z", "gps_time", "source_class")
"""Columns that are written whatever is asked for."""

FOR_RADIOMETRY = (
    *("beam_x", "beam_y", "beam_z", "beam_range"),
    *("amplitude", "amplitude_db", "width", "energy", "fit_flags", "origin"),
)


CONVERT = "convert it first (for example with PDAL's filters.reprojection)"

OF_ECHOES = (
    *("read", "pulse", "decompose", "ground", "ground_auto", "terrain", "features", "radiometry", "plausibility"),
)
"""Sections of the configuration that echoes of a file and their heights obey."""


@dataclass(frozen=True)
class FileEchoes:
    """The echoes of a file.

    Attributes
    ----------
    table : in canonical order; columns that the file cannot give are left out.
    crs : `pyproj.CRS` or None.
    notes : what is to be said of them.
    judged : what `report.judge_echoes` judges of them.
    links : pulse and echo number of the echo of every point, in the file's order; None for a text.
    """

    table: Table
    crs: Any
    notes: tuple[str, ...]
    judged: Mapping[str, Any]
    links: Table | None = None


@dataclass(frozen=True)
class EchoJob(FileJob):
    """What a command on the echoes of a file was asked for, besides what every `FileJob` is.

    Attributes
    ----------
    own_ground : heights count from class 2 of the file, not from the ground that a filter finds.
    auto : the filter's parameters are adapted to the echoes, as `fwclass ground --auto` does.
    trajectory, undulation : where the sensor flew, and metres to take from its heights.
    skip_missing : features that the file cannot give are left out and told; else they are an error.
    """

    own_ground: bool = False
    auto: bool = False
    trajectory: Path | None = None
    undulation: float = 0.0
    skip_missing: bool = False


def read_echoes(path: Path, columns: Iterable[str], settings: tuple[str, ...], crs: Any, tell: Tell) -> FileEchoes:
    """Echoes of a file with `columns`, `PLACE` and what radiometry needs.

    `InputError`: a file that cannot be read, is empty, or does not count in metres.
    """
    if (is_text(path) and not is_beam_file(path)) or not path.is_file():
        return _of_text(path, crs)
    return _of_source(open_source(path), (*PLACE, *columns, *FOR_RADIOMETRY), settings, crs, tell)


def _of_text(path: Path, crs: Any) -> FileEchoes:
    cloud = read_point_cloud(path, crs)
    _check_metres(cloud.units, cloud.crs, path)
    rows = np.flatnonzero(cloud.usable)
    number = np.arange(len(rows))
    columns: dict[str, NDArray] = {"strip": np.zeros(len(rows)), "pulse": number, "echo_number": np.ones(len(rows))}
    columns |= {axis: getattr(cloud, axis)[rows] for axis in "xyz"}
    if cloud.classes is not None:
        columns["source_class"] = cloud.classes[rows]
    lost, place = cloud.points - len(rows), _place_of(Table(columns), cloud.crs)
    notes = (
        f"{len(rows):,} points",
        *([f"{lost:,} lines without usable coordinates are left out"] if lost else []),
        *([TAKEN_FOR_METRES] if cloud.crs is None else []),
        *(place["remarks"] if place else ()),
    )
    return FileEchoes(Table(columns), cloud.crs, notes, {"place": place})


def _place_of(table: Table, crs: Any, own: Any = None, of_file: Sequence[str] = ()) -> dict[str, Any] | None:
    if not table.rows:
        return None
    low, high = ([float(f(table[a])) for a in "xyz"] for f in (np.min, np.max))
    return place_facts(crs, low, high, own=own, of_file=of_file)


def _of_source(source: Source, columns: Iterable[str], settings: tuple[str, ...], crs: Any, tell: Tell) -> FileEchoes:
    read = conf.section("read", settings)
    crs = _system_of(source, read.project_to, crs)
    check_source(source, read)
    fit: DecomposeParams = conf.section("decompose", settings)
    with strip_of(source, settings, tell) as strip:
        tables = list(strip.echoes(columns))
        links = strip.links() if tables else None
        counts, noise, faults, places = strip.counts(), strip.noise(), strip.faults(), strip.places()
        returns = strip.returns()
    if not tables or not sum(t.rows for t in tables):
        raise InputError("the file has no points and no pulses", where=source.path, do="check the delivery")
    table = Table.concat(tables)
    notes = [f"{table.rows:,} echoes" + (" fitted to waveforms" if source.has_waves else ", the file's returns")]
    notes += [TAKEN_FOR_METRES] if crs is None else []
    place = _place_of(table, crs, source.crs, source.faults)
    notes += place["remarks"] if place else []
    judged = strip_plausibility(source.path.stem, source.n_points, counts, noise, places, faults, source.n_records)
    notes += plausibility_remarks([judged], fit)
    notes += [f"fault: {name}: {count:,}" for name, count in sorted(faults.items()) if count]
    if table.rows and not source.has_waves and "intensity" in table and not table["intensity"].any():
        notes.append("every intensity is 0: features of amplitude and intensity say nothing")
    repeated = repeated_in_file(table, source.path.name)
    for facts in (returns, repeated):
        notes += (facts or {}).get("remarks", ())
    empty = [n for n in table if n not in PLACE and table[n].dtype.kind == "f" and np.isnan(table[n]).all()]
    return FileEchoes(
        table.select(n for n in table if n not in empty),
        crs,
        tuple(notes),
        {"place": place, "plausibility": judged, "returns": returns, "repeated": repeated},
        links,
    )


def _system_of(source: Source, project_to: str | None, crs: Any) -> Any:
    """The system of the echoes of `source`: the one that they are brought into, the one that the user names (`crs`),
    or the file's own."""
    if project_to is not None and is_brought(source.crs):
        target = given_crs(project_to, "read.project_to")
        if crs is not None and not crs.equals(target, ignore_axis_order=True):
            raise ConfigError(
                "the file is brought into another system than the one that is named",
                where="--set read.project_to, --crs",
                expected="one system",
                got=f"{project_to} and {crs.name}",
                do="leave --crs out",
            )
        _check_metres(linear_units(target, None, source.path), target, "read.project_to", "name one in metres")
        return target
    crs = crs if crs is not None else source.crs
    refuse_source(source, crs)
    refuse_other_system(source, crs)
    units = linear_units(crs, getattr(source, "header", None), source.path)
    if not units.metres:
        twin = (metric_twin(crs) if crs is not None else "") or "EPSG:<code>"
        brings = f"--set read.project_to={twin} brings it into metres as it is read"
        _check_metres(units, crs, source.path, brings if is_brought(source.crs) else CONVERT)
    return crs


def _check_metres(units: LinearUnits, crs: Any, where: object, do: str = CONVERT) -> None:
    if not units.metres:
        raise InputError(
            "the coordinates are not in metres",
            where=where,
            expected="a projected coordinate system in metres: the scales of the features are metres",
            got=f"{crs.name if crs else 'no system named'}; {units.source}",
            do=do,
        )


def with_noise(echoes: FileEchoes, settings: tuple[str, ...], tell: Tell) -> FileEchoes:
    """`echoes` with `noise`, which is no neighbour, where it is not known yet."""
    return replace(echoes, table=with_noise_flags(echoes.table, FileConfig(settings), tell))


def with_lines(echoes: FileEchoes, path: Path, settings: tuple[str, ...]) -> FileEchoes:
    """`echoes` of which is known how their flight lines lie (`lines_of`)."""
    facts, said = lines_of(echoes.table, path, settings)
    return replace(echoes, notes=(*echoes.notes, *said), judged={**echoes.judged, "strips": facts})


def with_heights(echoes: FileEchoes, job: EchoJob, tell: Tell) -> FileEchoes:
    """`echoes` with `height_above_ground` and `noise`: ground by a filter, or by class 2 of the file.

    `InputError`: the file has no ground of its own.
    """
    table, settings = echoes.table, job.settings
    points = points_of(table, GROUND_FILTER.reads)
    sound = (points["fit_flags"] & IMPLAUSIBLE) == 0
    stages, words, given = [MAKE_HEIGHTS, GATHER_HEIGHT], {MAKE_HEIGHTS.name: "terrain: block"}, dict[str, Any]()
    if not job.own_ground:
        params = ground_params(job.method, job.preset, () if job.auto else job.assignments, _of_ground(settings))
        adapted = ""
        if job.auto and sound.any():
            tell("measuring, then trying settings of the filter")
            before, rules = params, conf.section("ground_auto", settings)
            params = _adapted(points.take(sound), params, rules, job.assignments)
            adapted = _changes(before, params)
        given, note = {"ground": params}, f"ground by {params.method}{adapted}"
        stages += [FILTER_GROUND, GATHER_GROUND]
        words[FILTER_GROUND.name] = f"filter {params.method}: block"
    else:
        codes = table["source_class"] if "source_class" in table else np.zeros(table.rows, np.uint8)
        if not (codes == GROUND).any() and job.skip_missing:
            return echoes
        if not (codes == GROUND).any():
            raise InputError(
                "height_above_ground is asked for, and the input has no ground",
                where=job.source,
                expected="points of class 2",
                got=f"classes {', '.join(map(str, np.unique(codes)))}" if "source_class" in table else "no classes",
                do="leave --own-ground out, so that the ground is looked for; or leave height_above_ground out "
                "(--skip-missing)",
            )
        noise = np.isin(codes, (LOW_NOISE, HIGH_NOISE)) | ~sound
        points = points.with_columns({"ground": codes == GROUND, "noise": noise})
        note = "ground by class 2 of the file"
    tiles = FileTiles(points, FileConfig(settings, **given), stages, tell, words)
    heights = tiles.columns(GATHER_HEIGHT, TERRAIN.writes)
    flags = points if job.own_ground else Table(tiles.columns(GATHER_GROUND, ("ground", "noise")))
    without = int(np.isnan(heights["height_above_ground"]).sum())
    note = f"{note}: {int(flags['ground'].sum()):,} echoes" + (
        f"; {without:,} echoes have no terrain below" if without else ""
    )
    sunken = (
        sunken_remarks(heights["height_above_ground"], codes, conf.section("plausibility", settings))
        if job.own_ground
        else []
    )
    facts = filter_facts(tiles.facts_of_blocks(FILTER_GROUND), int(flags["ground"].sum()))
    odd = [] if job.own_ground else filter_remarks(facts, params)
    return replace(
        echoes,
        table=table.with_columns({**heights, "noise": flags["noise"]}),
        notes=(*echoes.notes, note, *sunken, *odd),
        judged={**echoes.judged, "ground": sunken, **facts},
    )


def _adapted(sound: Table, params: GroundParams, rules: GroundAutoParams, assignments: tuple[str, ...]) -> GroundParams:
    """Parameters that suit the `sound` echoes, but for those that are assigned."""
    method = None if params.method == "auto" else params.method
    places = sound["x"], sound["y"], sound["z"]
    return with_assignments(adapt_filter(places, last_of(sound), params, rules, method).params, assignments)


def _changes(given: GroundParams, params: GroundParams) -> str:
    """What was adapted, in words."""
    before, after = (used_params(p) for p in (given, params))
    words = [f"{name} {value:g}" for name, value in after.items() if isinstance(value, float) and value != before[name]]
    return f" with {', '.join(words)}" if words else ", nothing to adapt"


def _of_ground(settings: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(s for s in settings if s.strip().startswith("ground."))


def ranges(echoes: FileEchoes, job: EchoJob) -> bool:
    """Something tells how far the sensor was, and the echoes have beams."""
    known = job.trajectory is not None or conf.section("radiometry", job.settings).platform_altitude is not None
    return "beam_x" in echoes.table and "energy" in echoes.table and (known or "beam_range" in echoes.table)


def with_radiometry(echoes: FileEchoes, job: EchoJob) -> FileEchoes:
    """`echoes` with range, incidence and what follows, where something tells the range."""
    table = echoes.table
    if not ranges(echoes, job):
        return echoes
    missing = [n for n in FOR_RADIOMETRY if n not in table]
    whole = table.with_columns({n: np.full(table.rows, np.nan) for n in missing})
    flown = None
    if job.trajectory is not None:
        flown = read_flight(table, job.trajectory, echoes.crs, job.undulation)
    params = {name: conf.section(name, job.settings) for name in ("features", "radiometry")}
    columns, notes, odd = add_radiometry(whole, flown, params, job.trajectory)
    own = [n for n in RADIOMETRY.writes if n in columns]
    return replace(
        echoes,
        table=table.with_columns(columns.select(own)),
        notes=(*echoes.notes, *((*notes, *odd) if own else ())),
        judged={**echoes.judged, "radiometry": odd if own else []},
    )
