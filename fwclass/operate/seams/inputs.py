"""Inputs of a stage for `fwclass seams`: the run's own columns, cut into tiles of a grid that lies elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fwclass.grid import Box, Tile, TileGrid
from fwclass.operate.seams.shifted_squares import ShiftedSquare
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Name
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.stage import Chunk
from fwclass.store.run_store import Store
from fwclass.tile.stage import assemble

HELD = 32
"""Tables of tiles that are kept in memory: the surroundings of a block."""
_PLACE = dict.fromkeys((*IDENTITY, "x", "y"), "tile")


@dataclass
class Tiles:
    """The tiles of a finished run, only read; `used` names those that were."""

    store: Store
    grid: TileGrid
    keys: frozenset[str]
    used: set[str] = field(default_factory=set)
    _tables: dict[tuple[str, tuple[str, ...]], Table] = field(default_factory=dict)

    def inside(self, box: Box, columns: Mapping[str, str], bands: Sequence[Box] | None = None) -> Table:
        """Echoes of all tiles (those that touch one of `bands`, if given) inside `box` with identity, x, y and
        `columns` (by stage), in the row order that a tile of that box would have."""
        stages = {**_PLACE, **columns}
        here = [t for t in self.grid.touching(box) if t.key in self.keys]
        here = [t for t in here if bands is None or any(s.touches(t.box) for s in bands)]
        parts = [self._tile(t.key, stages) for t in here]
        parts = [t.take(box.contains(t["x"], t["y"])) for t in parts]
        return assemble(parts, "a tile of the shifted grid") if parts else Table.empty(stages)

    def _tile(self, key: str, wanted: Mapping[str, str]) -> Table:
        self.used.add(key)
        name = (key, tuple(wanted))
        if name not in self._tables:
            if len(self._tables) >= HELD:
                self._tables.pop(next(iter(self._tables)))
            self._tables[name] = PartInputs(self.store).rows(key, wanted).select(wanted)
        return self._tables[name]


@dataclass(frozen=True)
class BandInputs(PartInputs):
    """For stages of tiles: a tile of the shifted grid owns the echoes of its bands, and no others.

    Columns that were computed once more are taken from `fresh` (by stage and part), all others from the run.
    """

    tiles: Tiles
    squares: Mapping[str, ShiftedSquare]
    fresh: Mapping[Name, Table]

    def rows(self, part: str, columns: Mapping[str, str], box: Box | None = None, base: str = "tile") -> Table:
        if base != "tile":
            return super().rows(part, columns, box, base)
        fresh = {n: s for n, s in columns.items() if (s, part) in self.fresh}
        table = self.stored(part, {n: s for n, s in columns.items() if n not in fresh})
        table = table.with_columns({n: self.fresh[s, part][n] for n, s in fresh.items()})
        return table if box is None else table.take(box.contains(table["x"], table["y"]))

    def stored(self, part: str, columns: Mapping[str, str]) -> Table:
        """As `rows`, all from the run."""
        square = self.squares[part]
        table = self.tiles.inside(square.tile.box, columns, square.bands)
        return table.take(square.holds(table["x"], table["y"]))

    def chunk(self, tile: Tile, halo: float, columns: Mapping[str, str], present: Iterable[str]) -> Chunk:
        stages = {**_PLACE, **columns}
        own = self.rows(tile.key, stages).select(stages)
        table = own
        if halo > 0:
            around = self.tiles.inside(tile.box.grown(halo), columns).select(stages)
            others = ~np.isin(canonical_key(around), canonical_key(own))
            table = Table.concat([own, around.take(others)])
        return Chunk.of(table, slice(own.rows), tile)


@dataclass(frozen=True)
class OtherTilesInputs(PartInputs):
    """For stages of blocks: the echoes in tiles of `grid` instead of the run's."""

    tiles: Tiles
    grid: TileGrid

    def rows(self, part: str, columns: Mapping[str, str], box: Box | None = None, base: str = "tile") -> Table:
        if base != "tile":
            return super().rows(part, columns, box, base)
        area = self.grid.tile(part).box
        inside = area if box is None else area.common(box)
        return self.tiles.inside(inside, columns) if inside is not None else Table.empty({**_PLACE, **columns})
