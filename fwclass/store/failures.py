"""Parts that failed, and what they said: kept until the part is made or the plan no longer has it.

A failure says nothing about what is done; that is told by receipts alone.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace

from fwclass.errors import StoreError, visible
from fwclass.store.atomic import to_json
from fwclass.store.bucket import Files
from fwclass.store.directory import failure_key


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
    """``store/failures/<stage>/<part>.json``, one file for every part that failed."""

    files: Files

    def record(self, failure: Failure) -> None:
        """Keep a failure. Where even that cannot be written (disk full) it is left: the run itself has told it."""
        with contextlib.suppress(OSError, StoreError):
            self.files.put(failure_key(failure.stage, failure.part), to_json(asdict(failure)))

    def all(self) -> dict[tuple[str, str], tuple[Failure, float]]:
        """Every failure by (stage, part), with the time it was written [s since the epoch]."""
        files = [h for h in self.files.list("store/failures") if not h.key.split("/")[-1].startswith(".")]
        failures = {}
        for one, data in zip(files, self.files.many([h.key for h in files]), strict=True):
            with contextlib.suppress(ValueError, TypeError, RecursionError):  # damaged: that it failed decides nothing
                failure = Failure(**json.loads(data[0])) if data else None
                if failure is not None and all(isinstance(text, str) for text in asdict(failure).values()):
                    failure = replace(failure, message=visible(failure.message, "\n\t"))
                    failures[failure.stage, failure.part] = failure, one.written
        return failures

    def forget(self, stage: str, names: Iterable[str]) -> None:
        """Remove what parts of `stage` said, by the names of the files."""
        self.files.delete(f"store/failures/{stage}/{name}" for name in names)
