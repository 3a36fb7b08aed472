"""What a part's work reads from the store: tables, arrays, and overlapping chunks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box, Tile, TileGrid
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.stage import Chunk
from fwclass.store.arrays import read_arrays
from fwclass.store.remote_file import Location, local
from fwclass.store.run_store import Store
from fwclass.store.tables import read_table, row_groups

TABLE = "table.parquet"

_ROUNDING = 0.001
"""m, beyond the halo of a piece: coordinates are whole millimetres."""


@dataclass(frozen=True)
class PartInputs:
    """What one part's work reads: the store, and files from outside, whose digests by name are `external`.

    `split`: where the work holds much, it is to be done in `split` × `split` pieces of a tile.
    """

    store: Store
    external: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    split: int = field(default=1, kw_only=True)

    def local(self, place: Location) -> Path:
        """A file from outside on this host; one on object storage is fetched, and is what the part was planned with."""
        return local(place, self.external)

    def table(self, stage: str, part: str, columns: Iterable[str] | None = None, name: str = TABLE) -> Table:
        return read_table(self.store.path(stage, part, name), columns)

    def fragment(self, stage: str, part: str, group: int) -> Table:
        """One row group of a scattered chunk."""
        return read_table(self.store.path(stage, part, TABLE), None, [group])

    def groups(self, stage: str, part: str, groups: list[int]) -> Table:
        """Chosen row groups of a part's table."""
        return read_table(self.store.path(stage, part, TABLE), None, groups)

    def arrays(self, stage: str, part: str, name: str) -> tuple[dict[str, NDArray], dict[str, Any]]:
        return read_arrays(self.store.path(stage, part, name))

    def meta(self, stage: str, part: str) -> Mapping[str, Any]:
        receipt = self.store.receipt(stage, part)
        return receipt.meta if receipt else {}

    def rows(self, part: str, columns: Mapping[str, str], box: Box | None = None, base: str = "tile") -> Table:
        """Columns of a tile from the stages that wrote them, side by side; only rows inside `box` if given.

        `columns` maps column to stage. All tables of a tile have the rows and row groups of `base`.
        """
        groups = row_groups(self.store.path(base, part, TABLE), box)
        by_stage: dict[str, list[str]] = {}
        for name, stage in columns.items():
            by_stage.setdefault(stage, []).append(name)
        if box is not None:
            mine = by_stage.setdefault(base, [])
            mine += [n for n in ("x", "y") if n not in mine]
        found: dict[str, NDArray] = {}
        for stage, names in by_stage.items():
            found |= dict(read_table(self.store.path(stage, part, TABLE), names, groups))
        table = Table({n: found[n] for n in found})
        return table if box is None else table.take(box.contains(table["x"], table["y"]))

    def chunk(self, tile: Tile, halo: float, columns: Mapping[str, str], present: Iterable[str]) -> Chunk:
        """The overlapping chunk of `tile`: its rows and its neighbours' within `halo` [m], in canonical order."""
        wanted = {**dict.fromkeys((*IDENTITY, "x", "y"), "tile"), **columns}
        core = self.rows(tile.key, wanted).select(wanted)
        parts = [core]
        box, here = tile.box.grown(halo), set(present)
        if halo > 0:
            for other in TileGrid(tile.size).touching(box):
                if other.key != tile.key and other.key in here:
                    parts.append(self.rows(other.key, wanted, box).select(wanted))
        table = Table.concat(parts)
        order = np.argsort(canonical_key(table), kind="stable")
        place = np.empty(table.rows, np.int64)
        place[order] = np.arange(table.rows)
        return Chunk(table.take(order), place[: core.rows], tile)

    def chunks(
        self, tile: Tile, halo: float, columns: Mapping[str, str], present: Iterable[str]
    ) -> Iterator[tuple[NDArray[np.int64], Chunk]]:
        """The tile in pieces: which of its rows, and the overlapping chunk that has these as its core."""
        if self.split == 1:
            whole = self.chunk(tile, halo, columns, present)
            yield np.arange(len(whole.core)), whole
            return
        wanted = {**dict.fromkeys((*IDENTITY, "x", "y"), "tile"), **columns}
        own = self.rows(tile.key, dict.fromkeys(("x", "y"), "tile"))
        piece, here = _piece(tile, self.split, own["x"], own["y"]), set(present) | {tile.key}
        for k in range(self.split**2):
            rows = np.flatnonzero(piece == k)
            if len(rows) == 0:
                continue
            box = _piece_box(tile, self.split, k).grown(halo + _ROUNDING)
            parts, core = [], np.zeros(0, bool)
            for other in TileGrid(tile.size, tile.origin).touching(box):
                if other.key in here:
                    table = self.rows(other.key, wanted, box).select(wanted)
                    mine = np.zeros(table.rows, bool)
                    if other.key == tile.key:
                        mine = _piece(tile, self.split, table["x"], table["y"]) == k
                    core = np.concatenate([core, mine])
                    parts.append(table)
            table = Table.concat(parts)
            order = np.argsort(canonical_key(table), kind="stable")
            place = np.empty(table.rows, np.int64)
            place[order] = np.arange(table.rows)
            yield rows, Chunk(table.take(order), place[core], tile)

    def runs_of_rows(self, part: str, columns: Mapping[str, str]) -> Iterator[Table]:
        """A tile's columns as `rows` gives them; in pieces, row group by row group and each in `split` cuts."""
        if self.split == 1:
            yield self.rows(part, columns)
            return
        stages = sorted(set(columns.values()))
        for group in row_groups(self.store.path("tile", part, TABLE), None):
            made: dict[str, NDArray] = {}
            for stage in stages:
                names = [n for n, s in columns.items() if s == stage]
                made |= dict(read_table(self.store.path(stage, part, TABLE), names, [group]))
            table = Table({n: made[n] for n in columns})
            for rows in np.array_split(np.arange(table.rows), self.split**2):
                if len(rows):
                    yield table.take(rows)

    def inside(
        self, box: Box, size: float, columns: Mapping[str, str], present: Iterable[str], base: str = "tile"
    ) -> Table:
        """Rows of every tile inside `box`, with x and y."""
        here = set(present)
        wanted = {**dict.fromkeys(("x", "y"), base), **columns}
        parts = [self.rows(t.key, wanted, box, base) for t in TileGrid(size).touching(box) if t.key in here]
        return Table.concat([p.select(wanted) for p in parts]) if parts else Table.empty(wanted)


def _piece(tile: Tile, split: int, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int64]:
    """In which of ``split`` × ``split`` squares of the tile each of its rows lies; rounding takes none out of all."""
    box, edge = tile.box, tile.size / split
    column, row = (np.floor((v - low) / edge).astype(np.int64) for v, low in ((x, box.xmin), (y, box.ymin)))
    return np.clip(column, 0, split - 1) * split + np.clip(row, 0, split - 1)


def _piece_box(tile: Tile, split: int, k: int) -> Box:
    box, edge = tile.box, tile.size / split
    x, y = box.xmin + (k // split) * edge, box.ymin + (k % split) * edge
    return Box(x, y, x + edge, y + edge)
