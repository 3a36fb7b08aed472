"""What a run takes on disk, and what of it: its deliveries, its parts by stage, a simulated survey."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fwclass.errors import several
from fwclass.store.bucket import Remote
from fwclass.store.run_location import RunLocation
from fwclass.survey.gather import SIMULATED

NAMED = 3
"""Stages that are named of those that take most."""


@dataclass(frozen=True)
class Sizes:
    """Bytes of a run; a file with several names counts once, as a delivery's are the store's.

    Attributes
    ----------
    files, total : of everything.
    delivery, earlier : what readers see now, and what deliveries before it alone have.
    survey : a simulated survey's files.
    parts : of the store, by stage, without what a delivery has.
    """

    files: int
    total: int
    delivery: int
    earlier: int
    survey: int
    parts: Mapping[str, int]

    def as_data(self) -> dict[str, Any]:
        """As plain data."""
        return {**self.__dict__, "parts": dict(self.parts)}

    def as_text(self) -> str:
        """In one line."""
        words = [f"the delivery {_mb(self.delivery)}"] if self.delivery else []
        words += [f"earlier ones {_mb(self.earlier)}"] if self.earlier else []
        words += [f"the simulated survey {_mb(self.survey)}"] if self.survey else []
        if self.parts:
            most = sorted(self.parts, key=lambda stage: -self.parts[stage])[:NAMED]
            some = ", ".join(f"{stage} {_mb(self.parts[stage])}" for stage in most)
            words.append(f"parts {_mb(sum(self.parts.values()))} ({some}{', …' if len(self.parts) > NAMED else ''})")
        return f"disk: {_mb(self.total)} MB in {several(self.files, 'file')}" + (
            f": {', '.join(words)}" if words else ""
        )


def _mb(size: int) -> str:
    return f"{size / 1e6:,.1f}"


def sizes_of(location: RunLocation, current: str | None) -> Sizes:
    """The sizes of the run at `location`, whose generation `current` is what readers see."""
    kinds: dict[object, tuple[int, str, int]] = {}
    for names, identity, size in _files(location):
        rank, kind = _kind(names, current)
        if identity not in kinds or rank < kinds[identity][0]:
            kinds[identity] = rank, kind, size
    by_kind: Counter[str] = Counter()
    for _, kind, size in kinds.values():
        by_kind[kind] += size
    parts = {kind.removeprefix("store/"): n for kind, n in by_kind.items() if kind.startswith("store/")}
    delivery, earlier, survey = (by_kind[k] for k in ("delivery", "earlier", "survey"))
    return Sizes(len(kinds), sum(by_kind.values()), delivery, earlier, survey, parts)


def _kind(names: tuple[str, ...], current: str | None) -> tuple[int, str]:
    """What a file belongs to; where it has several names, the least counts."""
    if names[0] == "generations" and len(names) > 1:
        return (0, "delivery") if names[1] == current else (1, "earlier")
    if names[0] == "store" and len(names) > 3:  # stage, part, file
        return (2, f"store/{names[1]}")
    return (3, "survey" if names[0] == SIMULATED else "other")


def _files(location: RunLocation) -> Iterator[tuple[tuple[str, ...], object, int]]:
    """Every file's path below the run as names, what it is the same by, and its bytes."""
    if isinstance(location, Remote):
        for item in location.objects.list(""):
            yield tuple(item.key.split("/")), item.key, item.size
        return
    for directory, _, names in os.walk(location):
        below = Path(directory).relative_to(location).parts
        for name in names:
            try:
                facts = os.lstat(f"{directory}/{name}")
            except FileNotFoundError:  # it went just now
                continue
            yield (*below, name), (facts.st_dev, facts.st_ino), facts.st_size
