"""The survey's files: found, and checked from their headers."""

from __future__ import annotations

import glob
import json
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fwclass.conf import Config, own_settings
from fwclass.conf.files import PUBLIC, public_data
from fwclass.errors import ConfigError, InputError, visible
from fwclass.formats.flat import refuse_unless_flat
from fwclass.grid import Box
from fwclass.paths import name_fault
from fwclass.publish.strips import check_records
from fwclass.read.quantities import quantities_of
from fwclass.read.riegl_sdf import is_sdf, library_path
from fwclass.read.source import LasSource, Source, open_source
from fwclass.read.stage import check_source, with_settings
from fwclass.run.runner import Runner
from fwclass.store.remote_file import Location, local
from fwclass.store.url import Url, is_url, url_of
from fwclass.survey.bounds import flat_bounds
from fwclass.survey.check_point_file import check_point_file
from fwclass.survey.file_digests import Digests
from fwclass.survey.files import box_text, find_files, in_any_form, joint_bounds, without_excluded
from fwclass.survey.layout import FileDigests, Strip, Survey
from fwclass.survey.numbering import assign_numbers
from fwclass.survey.reference import (
    reference_clouds,
    reference_corrections,
    reference_echo_labels,
    reference_polygons,
    shape_file,
)
from fwclass.survey.systems import common_crs, given_crs, overruled_systems, system_of, without_heights

SIMULATED = "survey"
"""Where a simulated survey lies below its run directory."""


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
    return in_any_form(path if path.is_absolute() else (config.path.parent / path).resolve())


def gather(
    config: Config, runner: Runner, copied: bool = False, models: Iterable[tuple[Location, str] | None] = ()
) -> Survey:
    """Find and check all files before anything is computed. `copied`: strips are delivered, so that all of their
    records must be where the headers place them. `models`: places and digests of those that are read too."""
    directory = directory_of(config, runner.root)
    digests = Digests(runner.store)
    for model in filter(None, models):
        digests.of_model(*model)
    digests.of_settings(own_settings(config))
    places, opened, full, excluded = open_survey(config, directory, copied, digests)
    say = runner.display.say
    if copied and (alike := _alike(s.path.name for s in opened)):
        say(f"note: {visible(' and '.join(alike))} have one name on Windows and macOS: copied there, one strip is lost")
    user_crs, crs = given_crs(config.survey.crs, "survey.crs"), common_crs(config, full, runner)
    numbered = assign_numbers(s.path.stem for s in opened)
    bounds, faults = _bounds_of(zip(places, opened, strict=True))
    _refuse_faulty(faults, len(places), config)
    for source in full:
        own, ends = user_crs or system_of(source), bounds[source.path]
        refuse_unless_flat(own, ends[:3], ends[3:], source.path, max(source.scales[:2]))
    box = joint_bounds(bounds.values())
    check_areas(config, box)  # before all files are read for their digests
    strips = tuple(
        Strip(numbered[p.stem], p, digests_of(_here(p, s), p, digests), s.point_format)
        for p, s in zip(places, opened, strict=True)
    )
    _refuse_same_file(strips)
    timed = [s for s in full if not isinstance(s, LasSource) or s.header.has_gps_time]
    standard = bool(timed) and all(s.standard_gps_time for s in timed)
    flown = digests.find(config.survey.trajectory.files, directory, "survey.trajectory.files", config)
    require_distinct([local(p) for p in flown])
    trajectory = tuple((p, digests.of([local(p)], p)) for p in flown)
    polygons = reference_polygons(config, directory, digests, crs, say)
    clouds = reference_clouds(config, directory, digests, box)
    by_echo = reference_echo_labels(config, directory, digests)
    water = shape_file("water", config.water, config, directory, digests, crs, box, say)
    breaklines = shape_file("breaklines", config.breaklines, config, directory, digests, crs, box, say)
    check_points = check_point_file(config, directory, digests, crs, box)
    area = shape_file("quality.area", config.quality.area, config, directory, digests, crs, box, say)
    corrections = reference_corrections(config, directory, digests, runner.store)
    digests.save()
    runner.external += digests.asked
    waves, both = config.survey.echoes != "returns", zip(places, opened, strict=True)
    quantities = {s.path.name: quantities_of(_here(p, s), waves) for p, s in both if s.n_records}
    more_files: dict[str, Any] = {"water": water, "breaklines": breaklines, "check_points": check_points, "area": area}
    weekly = tuple(s.path.name for s in timed if isinstance(s, LasSource) and not s.standard_gps_time)
    stated = {s.path.name: s.bounds for s in full if isinstance(s, LasSource) and s.target is None}
    more = more_files | {"overruled": overruled_systems(config, full), "weekly": weekly, "excluded": excluded}
    more |= {"heightless": without_heights(config, full, crs), "stated": stated}
    return Survey(strips, clouds, crs, standard, trajectory, polygons, quantities, by_echo, corrections, **more)


def open_survey(
    config: Config, directory: Path | Url, copied: bool, digests: Digests | None = None
) -> tuple[list[Location], list[Source], list[Source], tuple[str, ...]]:
    """Where the survey's sources are, all of them opened and checked, those that hold anything, and the names of those
    that ``survey.exclude`` leaves out; `InputError` for names that two of them share, and where none does."""
    asked = config.survey.sources, directory, "survey.sources"
    matching = digests.find(*asked, config) if digests else find_files(*asked, config.path, config.store)
    places, excluded = without_excluded(matching, config.survey.exclude, directory, config.path, config.store)
    opened = open_all(places, config, copied, deep=digests is not None)
    require_distinct([s.path for s in opened])
    full = [s for s in opened if s.n_records]
    if not full:
        raise InputError(
            "the source files have no points and no pulses",
            where=", ".join(str(s.path) for s in opened[:3]),
            do="check the delivery; there is nothing to classify",
        )
    return places, opened, full, excluded


def open_all(places: Sequence[Location], config: Config, copied: bool = False, deep: bool = False) -> list[Source]:
    """Every source, opened and checked, also for what a copy of its points needs where they are `copied`; `InputError`
    naming all that cannot be used, and `deep`, with them, those whose points cannot be read."""
    opened: list[Source] = []
    faults: dict[Location, InputError] = {}
    for place in places:
        try:
            source = with_settings(open_source(local(place)), config.read)
            check_source(source, config.read)
            if copied and isinstance(source, LasSource):
                check_records(source.path)
            opened.append(source)
        except InputError as fault:
            faults[place] = fault
    if faults and deep:
        sound = [p for p in places if p not in faults]
        faults |= _bounds_of(zip(sound, opened, strict=True))[1]
    _refuse_faulty(faults, len(places), config)
    return opened


def _bounds_of(
    sources: Iterable[tuple[Location, Source]],
) -> tuple[dict[Path, tuple[float, ...]], dict[Location, InputError]]:
    """Bounds of those that hold anything, and the faults of those whose points cannot be read."""
    bounds, faults = {}, {}
    for place, source in sources:
        try:
            if source.n_records:
                bounds[source.path] = flat_bounds(_here(place, source))
        except InputError as fault:
            faults[place] = fault
    return bounds, faults


def _refuse_faulty(faults: Mapping[Location, InputError], files: int, config: Config) -> None:
    """As `refuse_unusable`, with how to go on without them."""
    if not faults:
        return
    base = str(directory_of(config, Path())).rstrip("/")
    names = [glob.escape(str(place).removeprefix(f"{base}/")) for place in list(faults)[:BAD_FILES]]
    words = ", ".join(json.dumps(name, ensure_ascii=False) for name in names)
    otherwise = f"go on without {'it' if len(faults) == 1 else 'them'} by survey.exclude: [{words}]"
    refuse_unusable(list(faults.values()), files, f"{config.path}: survey.sources", otherwise)


def refuse_unusable(faults: Sequence[InputError], files: int, where: str, otherwise: str) -> None:
    """`InputError` naming all of so many `files` that cannot be used, if `faults` tell of any.

    `otherwise`: what can be done about a file that cannot be mended."""
    if len(faults) == 1:
        one = faults[0]
        raise type(one)(
            one.what, where=one.where, expected=one.expected, got=one.got, do=f"{one.do}; or {otherwise}"
        ) from one
    if faults:
        lines = [f"{Path(f.where or '').name}: {f.what}{f', {f.got}' if f.got else ''}" for f in faults[:BAD_FILES]]
        lines += [f"and {len(faults) - BAD_FILES} more"] if len(faults) > BAD_FILES else []
        raise InputError(
            f"{len(faults)} of {files} source files cannot be used",
            where=where,
            got="\n    ".join(["", *lines]),
            do=f"get them again, or {otherwise} (`fwclass info` tells all of each)",
        )


def _here(place: Location, source: Source) -> Source:
    """An opened source, fetched once more if its copy on this host had to make room for others."""
    local(place)
    return source


def digests_of(source: Any, place: Location, digests: Digests) -> FileDigests:
    """The files of a strip and, where a vendor's library reads it, that library: another one may give other samples."""
    waves = source.waves.path
    files = [source.path, *([waves] if waves is not None and waves != source.path else [])]
    return (*digests.of(files, place), *(digests.of([library_path()]) if is_sdf(source.path) else ()))


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


def _alike(names: Iterable[str]) -> list[str]:
    """The first names whose strips differ in nothing but capitals and how letters are written, [] for none."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(unicodedata.normalize("NFC", Path(name).stem).casefold(), []).append(name)
    return next((group for group in groups.values() if len(group) > 1), [])


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
