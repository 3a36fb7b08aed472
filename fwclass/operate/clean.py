"""The work of `fwclass clean`: removes earlier deliveries, and the store's parts that the current one can spare."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from fwclass.errors import ConfigError
from fwclass.graph.stages import STAGES
from fwclass.operate.sizes import sizes_of
from fwclass.run.logs import remove_logs
from fwclass.store.run_location import RunLocation, lock_run, open_store

Keep = Literal["delivery", "deliveries", "latest"]


def make_lean(location: RunLocation, tell: Callable[[str], None]) -> tuple[int, int]:
    """Remove the files of parts of bulky stages (`Stage.bulky`), and keep what is known of them; how many parts that
    are, and the bytes."""
    bulky = {stage.name for stage in STAGES if stage.bulky}
    with lock_run(location, tell) as (own, _):
        store = open_store(own)
        before = sizes_of(own, None).total
        count = store.empty(name for name in store.parts() if name[0] in bulky)
        return count, before - sizes_of(own, None).total


@dataclass(frozen=True)
class Cleaned:
    """What went: `generations` by name, how many `parts` of the store; bytes of the run `before` and `after`. What
    stays of earlier generations, each with the directories that it alone has."""

    generations: tuple[str, ...]
    unique: dict[str, list[str]]
    parts: int
    before: int
    after: int

    @property
    def freed(self) -> str:
        """The sizes, in words."""
        return f"{self.before / 1e6:,.1f} MB before, {self.after / 1e6:,.1f} MB now"


def clean(location: RunLocation, keep: Keep, tell: Callable[[str], None]) -> Cleaned:
    """Remove earlier deliveries unless all ``deliveries`` stay, and all parts unless the ``latest`` ones do.

    An earlier delivery that alone has what another workflow made (a classification, before ``--workflow quality``)
    stays.
    The logs of removed parts go with them. A simulated survey's files, the history and the words of the last run stay.
    The same run makes all parts anew, and the same delivery.

    `ConfigError`: only what was delivered is to stay, and the current delivery is not whole. `LockedError`: a run is
    under way. `StoreError`: links of the run directory lead elsewhere, or something else stands in their place.
    """
    with lock_run(location, tell) as (own, _):
        store = open_store(own)
        store.generations.check_links()
        current = store.generations.current()
        if keep != "latest" and (current is None or not current.whole):
            raise ConfigError(
                "nothing would be left: the run has no whole delivery",
                where=store.where,
                expected="a current generation that is whole",
                got="none" if current is None else f"{current.name}, which is not",
                do="finish the run first, or --keep latest",
            )
        before = sizes_of(own, None).total
        generations = [] if keep == "deliveries" else store.generations.retire_earlier()
        unique = {} if keep == "deliveries" else store.generations.unique()
        parts = []
        if keep != "latest":
            simulated = {receipt.part for receipt in store.receipts("simulate")}
            parts = [name for name in store.parts() if name[0] != "simulate" or name[1] not in simulated]
            store.remove_all(parts)
            remove_logs(own, parts)
        store.clear_staging()
        return Cleaned(tuple(generations), unique, len(parts), before, sizes_of(own, None).total)
