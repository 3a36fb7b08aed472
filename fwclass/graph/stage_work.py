"""What makes a part of a stage, where it is made: the inputs that it declared, and the adapter that it runs in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.columns import declare
from fwclass.errors import FwclassError
from fwclass.grid import Tile
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.run.part import Name
from fwclass.schema import Column, Table
from fwclass.stage import Chunk
from fwclass.store.remote_file import Location
from fwclass.store.row_digests import ROW_DIGESTS, digests_by_square
from fwclass.store.table_cache import write_and_hold


@dataclass(frozen=True)
class StageInputs:
    """What the work of one part gets: its square, and what it declared of others.

    Attributes
    ----------
    inputs : the store, as far as it is declared.
    directory : where files of the part go.
    part, needs : its name, and the parts that it reads.
    square : its tile or block, None for other parts.
    halo : distance around `square` that is read [m].
    columns : stage of every column that is read, in the halo too; `own` of those read of the part's own tile alone.
    present : tiles that echoes are read of.
    tile_size : edge of the tiles [m].
    source : the file from outside that the part is made from.
    writes : the columns that its table is to have.
    """

    inputs: PartInputs
    directory: Path
    part: str
    needs: tuple[Name, ...] = ()
    square: Tile | None = None
    halo: float = 0.0
    columns: Mapping[str, str] = field(default_factory=dict)
    own: Mapping[str, str] = field(default_factory=dict)
    present: tuple[str, ...] = ()
    tile_size: float = 0.0
    source: Location | None = None
    writes: tuple[str, ...] = ()

    @property
    def tile(self) -> Tile:
        """The part's tile or block; `FwclassError` for a part without one."""
        if self.square is None:
            raise FwclassError("this part has no place", where=self.part)
        return self.square

    def parts(self, stage: str) -> tuple[str, ...]:
        """The parts of `stage` that are declared, in the order of the plan."""
        return tuple(part for name, part in self.needs if name == stage)

    def file(self) -> Path:
        """The file from outside, on this host."""
        if self.source is None:
            raise FwclassError("this part is made from no file", where=self.part)
        return self.inputs.local(self.source)

    def rows(self) -> Table:
        """All declared columns of the own tile, in its row order."""
        return self.inputs.rows(self.part, {**self.columns, **self.own})

    def own_rows(self) -> Table:
        """The columns that are read of the own tile alone."""
        return self.inputs.rows(self.part, self.own)

    def cuts(self) -> Iterator[Table]:
        """As `rows`, in pieces where memory is short."""
        return self.inputs.cuts(self.part, {**self.columns, **self.own})

    def chunk(self) -> Chunk:
        """The overlapping chunk: the own tile's rows and those of its neighbours within `halo`."""
        if not self.columns:
            return self.inputs.chunk(self.tile, 0.0, self.own, (self.part,))
        return self.inputs.chunk(self.tile, self.halo, self.columns, self.present)

    def chunks(self) -> Iterator[tuple[NDArray[np.int64], Chunk]]:
        """The overlapping chunk, or where memory is short pieces of it, each with the own rows that it has."""
        return self.inputs.chunks(self.tile, self.halo, self.columns, self.present)


Result = Table | Mapping[str, Any] | tuple[Table, Mapping[str, Any]]
"""What a stage's function returns: the part's table, what its receipt says besides, or both."""


@dataclass(frozen=True)
class Work:
    """The adapter that every part runs in: loads, calls the stage's function, checks the columns, writes."""

    function: Callable[..., Result]
    arguments: Mapping[str, Any]
    here: Callable[[PartInputs, Path], StageInputs]
    row_digests: bool = False
    declares: tuple[Column, ...] = ()

    def __call__(self, inputs: PartInputs, directory: Path) -> Mapping[str, Any]:
        here = self.here(inputs, directory)
        table, facts = self.result(here)
        if table is None:
            return facts
        write_and_hold(directory / TABLE, table)
        return {**facts, **(_row_digests(table, here) if self.row_digests else {})}

    def result(self, here: StageInputs) -> tuple[Table | None, Mapping[str, Any]]:
        """The part's table, if the stage gives one, and what its receipt says besides."""
        declare(self.declares)
        result = self.function(here, **self.arguments)
        if isinstance(result, Mapping) and not isinstance(result, Table):
            return None, result
        table, facts = (result, {}) if isinstance(result, Table) else result
        _check_columns(table, here)
        return table, facts


def _check_columns(table: Table, here: StageInputs) -> None:
    if set(table) != set(here.writes):
        raise FwclassError(
            "a stage writes other columns than its record says",
            where=here.part,
            expected=", ".join(here.writes),
            got=", ".join(table),
            do="name them in Stage.writes",
        )


def _row_digests(table: Table, here: StageInputs) -> Mapping[str, Any]:
    """Digests of the rows by square, so that who reads a halo is made anew for what changed in it, and no more."""
    located = table if "x" in table else here.inputs.rows(here.part, dict.fromkeys(("x", "y"), "tile"))
    return {ROW_DIGESTS: digests_by_square(table, located["x"], located["y"])}
