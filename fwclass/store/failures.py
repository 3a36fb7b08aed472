"""Parts that failed, and what they said: kept until the part is made or the plan no longer has it.

A failure says nothing about what is done; that is told by receipts alone.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from fwclass.errors import DamagedError, visible
from fwclass.store.atomic import read_json, write_json


@dataclass(frozen=True)
class Failure:
    """How a part failed the last time it was tried.

    `key`: what it was to be made under (as a receipt's), empty if unknown; `message`: for the user.
    """

    stage: str
    part: str
    key: str
    message: str


@dataclass(frozen=True)
class Failures:
    """``<directory>/<stage>/<part>.json``, one file for every part that failed."""

    directory: Path

    def _path(self, stage: str, part: str) -> Path:
        return self.directory / stage / f"{part}.json"

    def record(self, failure: Failure) -> None:
        """Keep a failure. Where even that cannot be written (disk full) it is left: the run itself has told it."""
        with contextlib.suppress(OSError):
            write_json(self._path(failure.stage, failure.part), asdict(failure))

    def clear(self, stage: str, part: str) -> None:
        """The part is made."""
        self._path(stage, part).unlink(missing_ok=True)

    def all(self) -> dict[tuple[str, str], tuple[Failure, float]]:
        """Every failure by (stage, part), with the time it was written [s since the epoch]."""
        found = {}
        for path in self.directory.glob("*/*.json"):
            if path.name.startswith("."):
                continue  # being written
            try:
                failure = Failure(**read_json(path))
                if not all(isinstance(t, str) for t in asdict(failure).values()):
                    raise TypeError("something that is no text")
                failure = replace(failure, message=visible(failure.message, "\n\t"))
                found[failure.stage, failure.part] = failure, path.stat().st_mtime
            except (FileNotFoundError, DamagedError, TypeError):
                continue  # made meanwhile, or damaged: that it failed is told, and decides nothing
        return found

    def forget_others(self, stage: str, keep: Iterable[str]) -> None:
        """Remove failures of parts of `stage` that the plan no longer has."""
        names = set(keep)
        for path in (self.directory / stage).glob("*.json"):
            if path.stem not in names:
                path.unlink(missing_ok=True)
