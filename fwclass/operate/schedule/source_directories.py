"""Where in a survey a delivered file belongs, by the patterns of survey.sources."""

from __future__ import annotations

import glob
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError
from fwclass.paths import WAVEFORM_ENDINGS, path_matches
from fwclass.survey.files import in_any_form, matching_files

REPLACED = "replaced"
"""Directory in the inbox where older versions of files that came again are kept, each in one named by the time."""

WAVES = frozenset(ending for endings in WAVEFORM_ENDINGS.values() for ending in endings)


@dataclass(frozen=True)
class SourceDirectories:
    """Directories of a survey's sources.

    `patterns`: of survey.sources, absolute; `left_out`: of survey.exclude, likewise; `into`: the directory that was
    asked for, or None.
    """

    patterns: tuple[str, ...]
    into: Path | None
    left_out: tuple[str, ...] = ()

    def of(self, name: str) -> Path | None:
        """The directory in which the survey finds a file of this name; None where it finds none."""
        for pattern in self.patterns:
            parents = [p for p in PurePath(pattern).parts[:-1] if p != "**"]
            directory = self.into or Path(*map(_plain, parents))
            if (self.into or not any(map(_wild, parents))) and self.finds(directory / name):
                return directory
        return None

    def home(self, name: str, directory: Path) -> Path:
        """The directory of the one source that has this name, whatever its ending, or `place` where there is none or
        several are."""
        stem = PurePath(name).stem.lower()
        try:
            paths = {path for pattern in self.patterns for path in matching_files(pattern, Path("/"))}
        except InputError:  # which the run will tell
            return directory
        homes = {p.parent for p in paths if p.stem.lower() == stem and p.suffix.lower() in WAVEFORM_ENDINGS}
        return homes.pop() if len(homes) == 1 else directory

    def finds(self, path: Path) -> bool:
        """The survey takes `path` for one of its sources."""
        return _matches(path, self.patterns) and not _matches(path, self.left_out)


def _matches(path: Path, patterns: Iterable[str]) -> bool:
    return any(path_matches(path.parts, PurePath(p).parts) for p in patterns)


def source_directories_of(config: Config, inbox: Path) -> SourceDirectories:
    """Of the sources of `config`.

    `ConfigError`: a survey without files of its own, or an inbox that lies where the survey looks for its sources.
    """
    named = "" if config.simulated else config.survey.directory or "."
    if not named or "://" in named:
        raise ConfigError(
            "an inbox needs a survey with files in a directory of this machine",
            where=f"{config.path}: survey.directory",
            got=named or "none: the survey is simulated",
            do="leave the inbox out, or name a directory",
        )
    directory = in_any_form((config.path.parent / named).resolve())
    patterns, left_out = (
        tuple(str(Path(glob.escape(str(directory))) / p) for p in some)
        for some in (config.survey.sources, config.survey.exclude)
    )
    into = None if config.schedule.into is None else (directory / config.schedule.into).resolve()
    kept = inbox / REPLACED / "0"
    for pattern in patterns:
        if any(path_matches(place.parts, PurePath(pattern).parts[:-1]) for place in (inbox, inbox / REPLACED, kept)):
            raise ConfigError(
                "the inbox, or what it keeps of older files, lies where the survey looks for its sources: half a file "
                "would be classified, or an older version",
                where=inbox,
                expected=f"a directory that {pattern} does not reach",
                do="choose another inbox",
            )
    return SourceDirectories(patterns, into, left_out)


def _wild(part: str) -> bool:
    return glob.has_magic(_escapes_out(part))


def _plain(part: str) -> str:
    return part.replace("[[]", "[").replace("[*]", "*").replace("[?]", "?")


def _escapes_out(part: str) -> str:
    """`part` without what `glob.escape` has made."""
    return part.replace("[[]", "").replace("[*]", "").replace("[?]", "")
