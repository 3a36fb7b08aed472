"""The coordinate system of a survey and of its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pyproj import CRS
from pyproj.exceptions import CRSError

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError, first_few, several, visible
from fwclass.formats.crs import crs_of_wkt, doubtful_system, units_of
from fwclass.formats.epsg import without_false_codes
from fwclass.formats.flat import refuse_source
from fwclass.formats.grid_files import without_paths
from fwclass.formats.projected import metric_twin
from fwclass.read.projection import is_brought
from fwclass.read.source import Source, refuse_other_system
from fwclass.run.runner import Runner

NAMED = 3
"""Files that are named."""


def system_of(source: Source) -> CRS | None:
    """The system that a file is read in: the one that it is brought into, or its own."""
    return source.crs if source.target is None else given_crs(source.target, "read.project_to")


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
    for source in opened:
        path, crs = source.path, system_of(source)
        if user_crs is not None and crs is not None and not crs.equals(user_crs, ignore_axis_order=True):
            runner.display.say(f"note: survey.crs ({user_crs.name}) is used for {path.name}, which names {crs.name}")
        crs = user_crs or crs
        two = doubtful_system(source.faults) if user_crs is None else ""
        if two:
            runner.display.say(f"note: {source.path.name}: {two} (survey.crs names another)")
        if crs is None:
            raise InputError(
                "the coordinate system is unknown",
                where=path,
                expected="a CRS in the file, or survey.crs in the configuration",
                got="neither",
                do="--set survey.crs=EPSG:<code>, or --set survey.crs=none to go without",
            )
        if units := units_of(crs):
            raise InputError(
                "the coordinates are not in metres",
                where=path,
                expected="a projected CRS with x, y and z in metres: every distance here is one",
                got=f"{crs.name}, in {', '.join(units)}",
                do=_into_metres(source, crs),
            )
        if not any(crs.equals(other, ignore_axis_order=True) for other, _ in systems):  # whatever they call it
            systems.append((crs, path))
    fuller = with_heights([crs for crs, _ in systems])
    if len(systems) > 1 and fuller is None:
        raise InputError(
            "the files are in different coordinate systems",
            where=", ".join(str(path) for _, path in systems),
            got="; ".join(crs.name for crs, _ in systems),
            do=_way_out([crs for crs, _ in systems]),
        )
    _refuse_idle_target(config, opened, systems[0][0])
    if fuller is None:
        return systems[0][0].to_wkt()
    text = fuller.to_wkt()
    runner.display.say(f"note: {heights_taken(without_heights(config, opened, text), text)}")
    return text


def _into_metres(source: Source, crs: CRS) -> str:
    """What to do with a file whose places are in the system `crs`, not in metres."""
    if not is_brought(source.crs):
        return (
            "files that name this system themselves are brought into metres by read.project_to: write it into them "
            "(las2las, PDAL), and leave survey.crs out"
        )
    return (
        f"--set read.project_to={metric_twin(crs) or 'EPSG:<code>'} brings them into metres as they are read; or, if "
        "they name their unit wrongly, --set survey.crs=EPSG:<code>, or EPSG:<code>+<code of heights>"
    )


def _refuse_idle_target(config: Config, opened: Sequence[Source], system: CRS) -> None:
    """`ConfigError` where files are to be brought into another system, and none is, as all are in metres."""
    target = given_crs(config.read.project_to, "read.project_to")
    if target is None or any(s.target is not None for s in opened) or _one_plane([system, target]):
        return
    raise ConfigError(
        "files in metres are not brought into another system",
        where=f"{config.path}: read.project_to",
        expected=f"files in degrees, in feet or geocentric, or nothing but {system.name}",
        got=target.name,
        do="leave read.project_to out, or bring the files into that system before",
    )


def with_heights(systems: Sequence[CRS]) -> CRS | None:
    """The one of `systems` that says what heights are, where it is the only one and all others are its plane."""
    whole = [crs for crs in systems if crs.is_compound]
    flat = [crs for crs in systems if not crs.is_compound]
    one = len(whole) == 1 and flat and _one_plane(systems) and all(len(crs.axis_info) == 2 for crs in flat)
    return whole[0] if one else None


def without_heights(config: Config, opened: Sequence[Source], crs: str | None) -> tuple[str, ...]:
    """Names of the files whose own system says nothing of heights, where that of the survey (WKT), theirs, does."""
    survey = crs_of_wkt(crs)
    if config.survey.crs is not None or survey is None or not survey.is_compound:
        return ()
    return tuple(s.path.name for s in opened if (own := system_of(s)) is not None and not own.is_compound)


def heights_taken(files: Sequence[str], crs: str | None) -> str:
    """That heights of `files` are taken for those of the survey's system (WKT); "" for no files."""
    survey = crs_of_wkt(crs)
    if not files or survey is None:
        return ""
    names = first_few([*map(visible, files)], NAMED)
    return (
        f"the system of heights is not named in {several(len(files), 'file')} ({names}): taken for that of the others, "
        f"{survey.sub_crs_list[-1].name} (survey.crs names another)"
    )


def _one_plane(systems: Sequence[CRS]) -> bool:
    """Whether x and y are of one system."""
    flat = [crs.sub_crs_list[0] if crs.is_compound else crs for crs in systems]
    return all(crs.equals(flat[0], ignore_axis_order=True) for crs in flat)


def _way_out(systems: Sequence[CRS]) -> str:
    """What to do with files of several systems."""
    if _one_plane(systems):
        return (
            "x and y are in one system, and heights are not, or some files do not name theirs: bring them into one, "
            "or, if they are, --set survey.crs=EPSG:<code>+<code of heights>"
        )
    return "bring them into one system first, or, if one names it wrongly, --set survey.crs=EPSG:<code>"


def overruled_systems(config: Config, opened: Sequence[Source]) -> dict[str, str]:
    """By name of the file the system (WKT) that it names where survey.crs names another."""
    user_crs = given_crs(config.survey.crs, "survey.crs")
    if user_crs is None:
        return {}
    named = {source.path.name: source.crs for source in opened if source.target is None and source.crs is not None}
    return {name: crs.to_wkt() for name, crs in named.items() if not crs.equals(user_crs, ignore_axis_order=True)}


def given_crs(text: str | None, where: str) -> CRS | None:
    """The CRS that a user names; None for no text or `none`."""
    if text is None or text == "none":
        return None
    try:
        crs, paths = without_paths(CRS.from_user_input(text))
        if paths:
            raise CRSError(f"it names the file {paths[0]} by its path")
        crs, false = without_false_codes(crs)
    except CRSError as fault:
        raise ConfigError(
            "this is not a coordinate system", where=where, expected="for example EPSG:25832, or none", got=text
        ) from fault
    for kind, systems in false:
        if kind == "another":
            raise ConfigError(
                "the text names two coordinate systems", where=where, expected="one, as EPSG:25832", got=systems
            )
    return crs
