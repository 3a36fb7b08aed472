"""What rooms and graph share of a stage: the chunk that it works on, what it reads and writes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Tile
from fwclass.schema import Table, canonical_key


@dataclass(frozen=True)
class Chunk:
    """The overlapping chunk that a tile stage works on.

    `table`: core and halo rows, in canonical order (strip, pulse, echo number), so that sums over neighbours do not
    depend on how the survey was cut. `core`: shape (n_core,), for every row that the tile owns, in the tile's row
    order, its index in `table`. `tile`: the owner tile.
    """

    table: Table
    core: NDArray[np.int64]
    tile: Tile

    @classmethod
    def of(cls, rows: Table, core: slice | NDArray[np.bool_], tile: Tile) -> Chunk:
        """A chunk of `rows` in any order, those of the tile (`core`) in the tile's."""
        order = np.argsort(canonical_key(rows), kind="stable")
        index = np.empty(rows.rows, np.int64)
        index[order] = np.arange(rows.rows)
        return cls(rows.take(order), index[core], tile)


@dataclass(frozen=True)
class Computation:
    """What a room computes of echoes, as the stages of the graph declare it.

    Attributes
    ----------
    name : of the stage that runs it, in the store, in receipts and on the command line.
    version : raised by hand whenever the same input and params would give another output.
    reads, writes : the columns it reads and the new columns it writes.
    halo : distance around its tile that it reads [m], from its params.
    """

    name: str
    version: int
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    halo: Callable[[Any], float] = lambda params: 0.0
