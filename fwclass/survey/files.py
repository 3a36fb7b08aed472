"""Files that a survey names, and the places that they cover."""

from __future__ import annotations

import glob
import itertools
import os
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from fwclass.errors import InputError
from fwclass.grid import Box
from fwclass.paths import path_matches, strange_kind
from fwclass.store.history import NAME as HISTORY
from fwclass.store.params import StoreParams
from fwclass.store.remote_file import Location, find_remote
from fwclass.store.url import Url


def find_files(
    patterns: Iterable[str], directory: Path | Url, setting: str, where: Path, params: StoreParams
) -> list[Location]:
    """Files that match, sorted by name; a pattern without a match is an error.

    A `directory` on object storage is talked to by `params`.
    """
    matching: dict[Location, None] = {}
    for pattern in patterns:
        matches = (
            sorted(find_remote(pattern, directory, params), key=str)
            if isinstance(directory, Url)
            else _in_any_form(pattern, directory)
        )
        if not matches:
            raise InputError(
                "no file matches",
                where=f"{setting} in {where}",
                expected=f"files like {pattern}",
                got=f"none in {directory}",
                do=f"check {setting} and survey.directory (left out: the directory of the survey's file)",
            )
        matching |= dict.fromkeys(matches)
    return sorted(matching, key=lambda p: (p.name, str(p)))


def without_excluded(
    places: Sequence[Location], exclude: Iterable[str], directory: Path | Url, where: Path, params: StoreParams
) -> tuple[list[Location], tuple[str, ...]]:
    """Those of `places` that no pattern of ``survey.exclude`` matches, and the names of the others.

    `InputError`: a pattern matches no file, or nothing is left.
    """
    excluded = {str(p) for p in find_files(exclude, directory, "survey.exclude", where, params)}
    kept = [p for p in places if str(p) not in excluded]
    if not kept:
        raise InputError(
            "every source file is left out",
            where=f"{where}: survey.exclude",
            got=", ".join(exclude),
            do="leave some in",
        )
    return kept, tuple(p.name for p in places if str(p) in excluded)


def _in_any_form(pattern: str, directory: Path) -> list[Path]:
    """As `matching_files`; where none does, an ö may be one character in the pattern and two in the names, as a Mac
    writes them, or the other way round."""
    forms = (pattern, *(unicodedata.normalize(form, pattern) for form in ("NFC", "NFD")))
    return next((files for form in forms if (files := matching_files(form, directory))), [])


def in_any_form(path: Path) -> Path:
    """`path`, or what differs from it in nothing but how its letters are written (see `_in_any_form`), where that is
    there alone; each directory on the way by itself."""
    there = Path(path.anchor)
    for name in path.parts[len(there.parts) :]:
        if not os.path.lexists(there / name):
            composed = unicodedata.normalize("NFC", name)
            readable = there.is_dir() and os.access(there, os.R_OK)
            entries = there.iterdir() if readable else ()
            alike = [p.name for p in entries if unicodedata.normalize("NFC", p.name) == composed]
            if len(alike) != 1:
                return path
            name = alike[0]
        there /= name
    return there


def matching_files(pattern: str, directory: Path) -> list[Path]:
    """As `matching_paths`, files alone; `InputError` for a pipe, a device or a socket."""
    return _files(matching_paths(pattern, directory))


def matching_paths(pattern: str, directory: Path) -> list[Path]:
    """Paths of this host below `directory` that match, sorted; where the pattern has ``**``, no directories.

    `InputError`: a directory on the way may not be read.
    """
    parts = Path(pattern).parts
    fixed = list(itertools.takewhile(lambda part: not glob.has_magic(part), parts))
    wild = parts[len(fixed) :]
    if "**" in wild and ".." not in wild:
        base = directory.joinpath(*fixed)
        return [p for p in sorted(_below(base)) if path_matches(p.relative_to(base).parts, wild)]
    here = Path(glob.escape(str(directory)))
    for count in range(len(fixed), len(parts)):
        for path in _globbed(here.joinpath(*parts[:count])):
            if os.path.isdir(path):  # noqa: PTH112 - Path's raises where nobody may look
                _check_readable(path)
    return _globbed(here / pattern)


def _globbed(pattern: Path) -> list[Path]:
    return sorted(map(Path, glob.glob(str(pattern), recursive=True)))  # noqa: PTH207


def _check_readable(directory: Path) -> None:
    """`glob` leaves out what it may not read; a survey does not lose files so. Hidden ones and `lost+found`, the file
    system's own, hold none."""
    if directory.name.startswith(".") or directory.name == "lost+found" or os.access(directory, os.R_OK | os.X_OK):
        return
    raise InputError(
        "a directory where sources may lie cannot be read",
        where=directory,
        expected="the right to list and to enter it",
        got="permission denied",
        do="change its permissions, or name the sources by a pattern that leaves it out",
    )


def _files(paths: Iterable[Path]) -> list[Path]:
    """Those that are files: nothing is left out unseen."""
    files: list[Path] = []
    for path in paths:
        if kind := strange_kind(path):
            raise InputError(
                "a source is no file",
                where=path,
                expected="a file on a disk",
                got=kind,
                do="move it away, or name the sources by a pattern that leaves it out",
            )
        if path.is_file():
            files.append(path)
    return files


def _below(directory: Path) -> Iterator[Path]:
    """Every file below `directory`, also through links, but no directory twice: links may lead back. Not those below
    run directories, whose deliveries are no sources."""
    waiting, visited = [directory], set()
    while waiting:
        path = waiting.pop()
        try:
            facts = path.stat()
            if (facts.st_dev, facts.st_ino) in visited:
                continue
            visited.add((facts.st_dev, facts.st_ino))
            _check_readable(path)
            entries = sorted(path.iterdir(), reverse=True)
        except OSError:  # it is gone by now, or a link that leads in a ring
            continue
        yield from (p for p in entries if not p.is_dir())
        waiting += [p for p in entries if p.is_dir() and not os.path.isfile(p / "store" / HISTORY)]  # noqa: PTH113


def joint_bounds(bounds: Iterable[tuple[float, ...]]) -> Box:
    """The box [m] around all `bounds` (xmin, ymin, zmin, xmax, ymax, zmax)."""
    rows = list(bounds)
    return Box(min(b[0] for b in rows), min(b[1] for b in rows), max(b[3] for b in rows), max(b[4] for b in rows))


def box_text(box: Box) -> str:
    """A box [m] as text, to a decimetre."""
    return "[" + ", ".join(f"{v:.1f}" for v in box.bounds) + "]"
