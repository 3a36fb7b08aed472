"""`fwclass clean`: what a run keeps beside its delivery goes, or earlier deliveries."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from fwclass.errors import ConfigError
from fwclass.run.logs import remove_logs
from fwclass.store.bucket import Remote
from fwclass.store.run_location import RunLocation, locked, open_store

Keep = Literal["delivery", "deliveries", "latest"]


@dataclass(frozen=True)
class Cleaned:
    """What went: `generations` by name, how many `parts` of the store; bytes of the run `before` and `after`."""

    generations: tuple[str, ...]
    parts: int
    before: int
    after: int

    @property
    def freed(self) -> str:
        """The sizes, in words."""
        return f"{self.before / 1e6:,.1f} MB before, {self.after / 1e6:,.1f} MB now"


def clean(location: RunLocation, keep: Keep, tell: Callable[[str], None]) -> Cleaned:
    """Remove earlier deliveries unless all ``deliveries`` stay, and all parts unless the ``latest`` ones do.

    The logs of removed parts go with them. A simulated survey's files, the history and the words of the last run stay.
    The same run makes all parts anew, and the same delivery.

    Raises
    ------
    ConfigError
        Only what was delivered is to stay, and the current delivery is not whole.
    LockedError
        A run is under way.
    """
    with locked(location, tell) as (own, _):
        store = open_store(own)
        current = store.generations.current()
        if keep != "latest" and (current is None or not current.whole):
            raise ConfigError(
                "nothing would be left: the run has no whole delivery",
                where=store.where,
                expected="a current generation that is whole",
                got="none" if current is None else f"{current.name}, which is not",
                do="finish the run first, or --keep latest",
            )
        before = bytes_used(own)
        generations = [] if keep == "deliveries" else store.generations.retire_earlier()
        parts = []
        if keep != "latest":
            simulated = {receipt.part for receipt in store.receipts("simulate")}
            parts = [name for name in store.parts() if name[0] != "simulate" or name[1] not in simulated]
            store.remove_all(parts)
            remove_logs(own, parts)
        store.clear_staging()
        return Cleaned(tuple(generations), len(parts), before, bytes_used(own))


def bytes_used(location: RunLocation) -> int:
    """Bytes that a run takes: of files with several names once, as a delivery's are the store's."""
    if isinstance(location, Remote):
        return sum(item.size for item in location.objects.list(""))
    sizes: dict[tuple[int, int], int] = {}
    for directory, _, names in os.walk(location):
        for name in names:
            try:
                facts = os.lstat(f"{directory}/{name}")
            except FileNotFoundError:  # it went just now
                continue
            sizes[facts.st_dev, facts.st_ino] = facts.st_size
    return sum(sizes.values())
