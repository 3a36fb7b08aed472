"""The survey's files: found, checked from their headers, and simulated where it has none of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from fwclass.conf import Config
from fwclass.conf.files import PUBLIC, public_data
from fwclass.conf.sets import feature_set
from fwclass.errors import ConfigError, InputError
from fwclass.formats.flat import refuse_source, refuse_unless_flat
from fwclass.formats.grid_files import without_paths
from fwclass.formats.projected import project
from fwclass.graph.check_points import check_point_file
from fwclass.graph.file_digests import Digests
from fwclass.graph.files import box_text, find_files, joint_bounds
from fwclass.graph.layout import Strip, Survey
from fwclass.graph.numbering import assign_numbers
from fwclass.graph.reference import (
    area_file,
    breakline_file,
    reference_clouds,
    reference_corrections,
    reference_echo_labels,
    reference_polygons,
    water_polygons,
)
from fwclass.graph.stage import Plan, Result, Stage, StageInputs
from fwclass.graph.tiling import CLOUD_ROWS, max_of, min_of
from fwclass.grid import Box
from fwclass.paths import name_fault
from fwclass.publish.strips import check_records
from fwclass.read.pls_read import pulse_bounds
from fwclass.read.pulsewaves import PulseSource
from fwclass.read.quantities import quantities_of
from fwclass.read.source import BeamSource, LasSource, Source, open_source, refuse_other_system
from fwclass.read.stage import check_source, read_cloud, with_settings
from fwclass.run.part import Name
from fwclass.run.runner import Runner
from fwclass.simulate.params import SimulateParams
from fwclass.store.receipts import Receipt
from fwclass.store.remote_file import Location, local
from fwclass.store.run_store import Store
from fwclass.store.url import Url, is_url, url_of

SIMULATED = "survey"
"""Where a simulated survey lies below its run directory."""

EDGE_POINTS = 5
"""Along each edge of a box that is brought into another system."""

LOOKED_AT = 100_000
"""Points at the start of a file that its header is held against."""


def simulate_part(here: StageInputs, params: SimulateParams, prefix: str) -> Result:
    """A strip of the simulated survey, or its trajectory, in the directory `prefix`."""
    from fwclass.simulate.stage import plan_strips, simulate_strip, write_trajectory  # other surveys need not load it

    directory = here.directory / prefix
    directory.mkdir(parents=True, exist_ok=True)
    if here.part == TRUTH:
        from fwclass.simulate.truth import write_truth

        write_truth(params, directory)
        return {}
    if here.part == TRAJECTORY:
        write_trajectory(params, directory)
        return {}
    facts = dict(simulate_strip(params, next(s for s in plan_strips(params) if s.name == here.part), directory))
    facts.pop("seconds", None)
    return facts


TRAJECTORY, TRUTH = "trajectory", "truth"
"""The parts of the simulation that are no strips."""


def simulation(prefix: str) -> Stage:
    """The stage that makes a survey, one part for every strip; files go to `prefix` below the run directory."""

    def parts(plan: Plan) -> list[str]:
        from fwclass.simulate.flight import plan_strips

        return [*(s.name for s in plan_strips(plan.config.simulate)), TRAJECTORY, TRUTH]  # type: ignore[arg-type]

    return Stage(
        "simulate",
        1,
        "file",
        "pulse",
        simulate_part,
        when=lambda plan: plan.config.simulate is not None,
        parts=parts,
        arguments=lambda plan: {"params": plan.config.simulate, "prefix": prefix},
        where="run",
    )


SIMULATE = simulation(SIMULATED)


BAD_FILES = 20
"""Files that cannot be used that are named."""


def directory_of(config: Config, root: Path) -> Path | Url:
    """Where the survey's files lie."""
    if config.simulated:
        return root / SIMULATED
    named = config.survey.directory or "."
    if is_url(named):
        return url_of(named, f"{config.path}: survey.directory")
    if named.startswith(PUBLIC):
        return public_data(named, config.path, config.survey.origin)
    path = Path(named)
    return path if path.is_absolute() else (config.path.parent / path).resolve()


def gather(config: Config, runner: Runner, copied: bool = False) -> Survey:
    """Find and check all files before anything is computed; simulate them first where the survey has none. `copied`:
    strips are delivered, so that all of their records must be where the headers place them."""
    if config.simulate is not None:
        if isinstance(runner.store.where, Url):
            raise ConfigError(
                "a simulated survey cannot lie on object storage",
                where=f"{config.path}: survey.directory",
                do="fwclass simulate CONF --out DIR, copy DIR to object storage, and set survey.directory to it",
            )
        tasks = SIMULATE.tasks(Plan(config))
        if len(runner.do(tasks)) < len(tasks):
            raise InputError("the survey could not be simulated", where=runner.root, do="see the failed parts above")
    directory = directory_of(config, runner.root)
    digests = Digests(runner.store)
    places = find_files(config.survey.sources, directory, "survey.sources", config.path, config.store)
    opened = open_all(places, config, copied)
    require_distinct([s.path for s in opened])
    full = [s for s in opened if s.n_records]
    if not full:
        raise InputError(
            "the source files have no points and no pulses",
            where=", ".join(str(s.path) for s in opened[:3]),
            do="check the delivery; there is nothing to classify",
        )
    user_crs, crs = given_crs(config.survey.crs, "survey.crs"), common_crs(config, full, runner)
    numbered = assign_numbers(s.path.stem for s in opened)
    bounds = {s.path: flat_bounds(_here(p, s)) for p, s in zip(places, opened, strict=True) if s.n_records}
    for source in full:
        own, ends = user_crs or system_of(source), bounds[source.path]
        refuse_unless_flat(own, ends[:3], ends[3:], source.path, max(source.scales[:2]))
    box = joint_bounds(bounds.values())
    check_areas(config, box)  # before all files are read for their digests
    strips = tuple(
        Strip(numbered[p.stem], p, digests.of(_files_of(_here(p, s)), p), s.point_format)
        for p, s in zip(places, opened, strict=True)
    )
    _refuse_same_file(strips)
    standard = all(s.standard_gps_time for s in opened)
    flown = find_files(config.survey.trajectory.files, directory, "survey.trajectory.files", config.path, config.store)
    require_distinct([local(p) for p in flown])
    trajectory = tuple((p, digests.of([local(p)], p)) for p in flown)
    of_labels = given_crs(config.survey.reference.crs, "survey.reference.crs")
    polygons = reference_polygons(config, directory, digests, crs, of_labels)
    clouds = reference_clouds(config, directory, digests, box)
    by_echo = reference_echo_labels(config, directory, digests)
    of_water = given_crs(config.water.crs, "water.crs")
    water = water_polygons(config, directory, digests, crs, of_water, box)
    of_lines = given_crs(config.breaklines.crs, "breaklines.crs")
    breaklines = breakline_file(config, directory, digests, crs, of_lines, box)
    of_points = given_crs(config.quality.check_points.crs, "quality.check_points.crs")
    check_points = check_point_file(config, directory, digests, crs, of_points, box)
    of_area = given_crs(config.quality.area.crs, "quality.area.crs")
    area = area_file(config, directory, digests, crs, of_area, box)
    corrections = reference_corrections(config, directory, digests, runner.store.where)
    digests.save()
    quantities = {s.path.name: quantities_of(_here(p, s)) for p, s in zip(places, opened, strict=True) if s.n_records}
    more_files = {"water": water, "breaklines": breaklines, "check_points": check_points, "area": area}
    return Survey(strips, clouds, crs, standard, trajectory, polygons, quantities, by_echo, corrections, **more_files)


def open_all(places: Sequence[Location], config: Config, copied: bool = False) -> list[Source]:
    """Every source, opened and checked, also for what a copy of its points needs where they are `copied`; `InputError`
    naming all that cannot be used."""
    opened, faults = [], []
    for place in places:
        try:
            source = with_settings(open_source(local(place)), config.read)
            check_source(source, config.read)
            if copied and isinstance(source, LasSource):
                check_records(source.path)
            opened.append(source)
        except InputError as fault:
            faults.append(fault)
    if len(faults) == 1:
        raise faults[0]
    if faults:
        lines = [f"{Path(f.where).name}: {f.what}{f', {f.got}' if f.got else ''}" for f in faults[:BAD_FILES]]
        lines += [f"and {len(faults) - BAD_FILES} more"] if len(faults) > BAD_FILES else []
        raise InputError(
            f"{len(faults)} of {len(places)} source files cannot be used",
            where=f"{config.path}: survey.sources",
            got="\n    ".join(["", *lines]),
            do="get them again, or take them out of the survey's directory (`fwclass info` tells all of each)",
        )
    return opened


def _here(place: Location, source: Source) -> Source:
    """An opened source, fetched once more if its copy on this host had to make room for others."""
    local(place)
    return source


def _files_of(source: Any) -> list[Path]:
    store = source.waves
    return [source.path, *([store.path] if store.path is not None and store.path != source.path else [])]


def require_distinct(paths: Sequence[Path]) -> None:
    """`InputError` for names of sources that no output can have, or that two files share."""
    for path in paths:
        fault = name_fault(path.stem)
        if fault:
            raise InputError(
                "a source file has a name that no output can have",
                where=repr(str(path)),
                expected="a name that can be seen, of at most 200 bytes",
                got=fault,
                do="rename it: strips are delivered under their source's name",
            )
    twice = sorted(stem for stem, count in Counter(p.stem for p in paths).items() if count > 1)
    if twice:
        raise InputError(
            "two files of the survey have the same name",
            where=", ".join(str(p) for p in paths if p.stem == twice[0]),
            do="rename one: strips are delivered under their source's name, trajectories are told apart by theirs",
        )


def _refuse_same_file(strips: tuple[Strip, ...]) -> None:
    """Refuse a file that is listed under two names: its echoes would count twice."""
    by_digest: dict[str, Location] = {}
    for strip in strips:
        digest = strip.digests[0].digest
        if digest in by_digest:
            raise InputError(
                "two source files are the same file",
                where=f"{by_digest[digest]}, {strip.path}",
                do="remove one of them",
            )
        by_digest[digest] = strip.path


def header_box(path: Path) -> Box | None:
    """Where a source file says that it lies, None where it says nothing; `FwclassError` where it cannot be read."""
    source = open_source(path)
    return joint_bounds([_true_bounds(source)]) if source.n_records else None


def _true_bounds(source: Source) -> tuple[float, ...]:
    """The header's bounds, or the points' own where the first points disagree: some writers leave them empty."""
    if isinstance(source, PulseSource):
        bounds = np.array(source.bounds)
        return source.bounds if np.isfinite(bounds).all() and (bounds[3:5] > bounds[:2]).any() else pulse_bounds(source)
    if isinstance(source, BeamSource):
        return source.bounds
    low, high = source.bounds[:3], source.bounds[3:]
    cloud = read_cloud(source.path, 0, min(source.n_points, LOOKED_AT))
    points = [cloud[n] for n in "xyz"]
    wrong = any(p.min() < a - 1.0 or p.max() > b + 1.0 for p, a, b in zip(points, low, high, strict=True))
    if not wrong:
        return source.bounds
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for first in range(0, source.n_points, CLOUD_ROWS):
        cloud = read_cloud(source.path, first, min(source.n_points, first + CLOUD_ROWS))
        least = np.minimum(least, [min_of(cloud[n]) for n in "xyz"])
        most = np.maximum(most, [max_of(cloud[n]) for n in "xyz"])
    return (*least.tolist(), *most.tolist())


def system_of(source: Source) -> CRS | None:
    """The system that a file is read in: the one that it is brought into, or its own."""
    return source.crs if source.target is None else given_crs(source.target, "read.project_to")


def flat_bounds(source: Source) -> tuple[float, ...]:
    """Where a file's points lie in the system that it is read in, `_true_bounds`; of one that is brought into another
    the box around its box, with what curves between."""
    bounds, system = _true_bounds(source), system_of(source)
    if source.target is None or system is None:
        return bounds
    sides = [np.linspace(bounds[k], bounds[k + 3], EDGE_POINTS) for k in range(3)]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    there = project(source.crs, system, grid, source.path)
    return (*there.min(axis=0).tolist(), *there.max(axis=0).tolist())


def common_crs(config: Config, opened: Sequence[Source], runner: Runner) -> str | None:
    """The survey's CRS as text (WKT), None where the configuration says `none`; what the user names wins."""
    user_crs = given_crs(config.survey.crs, "survey.crs")
    for source in opened:
        if source.target is None:
            refuse_source(source, user_crs or source.crs)
            refuse_other_system(source, user_crs)
        elif user_crs is not None and not user_crs.equals(system_of(source), ignore_axis_order=True):
            raise ConfigError(
                "the files are brought into another system than the survey's",
                where=f"{config.path}: read.project_to, survey.crs",
                expected=f"{source.target} twice, or no survey.crs",
                got=f"{source.target} and {config.survey.crs}",
                do="name one system",
            )
    if config.survey.crs is not None and user_crs is None:
        return None
    systems: list[tuple[CRS, Path]] = []
    for path, crs in ((source.path, system_of(source)) for source in opened):
        if user_crs is not None and crs is not None and not crs.equals(user_crs, ignore_axis_order=True):
            runner.display.say(f"note: survey.crs ({user_crs.name}) is used for {path.name}, which names {crs.name}")
        crs = user_crs or crs
        if crs is None:
            raise InputError(
                "the coordinate system is unknown",
                where=path,
                expected="a CRS in the file, or survey.crs in the configuration",
                got="neither",
                do="--set survey.crs=EPSG:<code>, or --set survey.crs=none to go without",
            )
        units = sorted({a.unit_name for a in crs.axis_info if abs(a.unit_conversion_factor - 1.0) > 1e-9})
        if units:
            raise InputError(
                "the coordinates are not in metres",
                where=path,
                expected="a projected CRS with x, y and z in metres: every distance here is one",
                got=f"{crs.name}, in {', '.join(units)}",
                do="convert the files (for example with PDAL's filters.reprojection) and run again",
            )
        if not any(crs.equals(known, ignore_axis_order=True) for known, _ in systems):  # whatever they call it
            systems.append((crs, path))
    if len(systems) > 1:
        raise InputError(
            "the files are in different coordinate systems",
            where=", ".join(str(path) for _, path in systems),
            got="; ".join(crs.name for crs, _ in systems),
            do="bring them into one system first, or, if one names it wrongly, --set survey.crs=EPSG:<code>",
        )
    return systems[0][0].to_wkt()


def given_crs(text: str | None, where: str) -> CRS | None:
    """The CRS that a user names; None for no text or `none`."""
    if text is None or text == "none":
        return None
    try:
        crs, paths = without_paths(CRS.from_user_input(text))
        if paths:
            raise CRSError(f"it names the file {paths[0]} by its path")
        return crs
    except CRSError as fault:
        raise ConfigError(
            "this is not a coordinate system", where=where, expected="for example EPSG:25832, or none", got=text
        ) from fault


def check_areas(config: Config, box: Box) -> None:
    """`ConfigError` where no training or test area touches `box`, or nothing would be left to test on."""
    if config.survey.model is not None and config.survey.reference.kind == "none":
        return  # nothing is trained and nothing assessed
    for kind in ("train", "test"):
        boxes = config.areas.boxes(kind)
        if boxes and not any(b.touches(box.grown(1.0)) for b in boxes):
            raise ConfigError(
                f"no {kind}ing area lies on the survey" if kind == "test" else "no training area lies on the survey",
                where=f"{config.path}: areas.{kind}",
                expected=f"boxes that touch {box_text(box)}",
                got=", ".join(box_text(b) for b in boxes),
                do="give the boxes in the survey's coordinates; `fwclass info` shows the files' bounds",
            )
    gap, train, test = config.areas.gap, config.areas.boxes("train"), config.areas.boxes("test")
    if test and all(any(_covers(b.grown(gap), t) for b in train) for t in test):
        raise ConfigError(
            "nothing is left to test on: every test area lies in a training area, or nearer to one than areas.gap",
            where=f"{config.path}: areas.test",
            expected=f"areas further than {gap:g} m from every training area",
            got=", ".join(box_text(t) for t in test),
            do="move the test areas, or leave them out (areas.test: []) to test on all that is far enough",
        )


def _covers(outer: Box, inner: Box) -> bool:
    low = outer.xmin <= inner.xmin and outer.ymin <= inner.ymin
    return low and inner.xmax <= outer.xmax and inner.ymax <= outer.ymax


def check_widths(config: Config, names: tuple[str, ...], splits: Mapping[Name, Receipt], store: Store) -> None:
    """`ConfigError` early if the forest is to decide by echo widths and no source has any."""
    chunks = [store.receipt("decompose", part) for stage, part in splits if stage == "split"]
    echoes = sum(int(r.meta["echoes"]) for r in chunks if r)
    without = sum(int(r.meta["without_width"]) for r in chunks if r)
    wide = [n for n in names if n.split("_")[0] == "width"]
    if wide and echoes and echoes == without:
        others = [n for n in names if n not in wide]
        plain = set(others) == set(feature_set("default").features)
        raise ConfigError(
            f"classes are to be told by {wide[0]!r}, and no echo of this survey has one",
            where=f"{config.path}: survey.features",
            expected="waveforms, or an extra byte `Pulse width`",
            got=f"{echoes} echoes without a width",
            do="--set survey.features=default" if plain else f'--set "survey.features=[{", ".join(others)}]"',
        )
