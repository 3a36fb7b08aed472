"""What a part's work reads from the store: tables, arrays, and overlapping chunks; nothing that it did not declare."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import DamagedError, StoreError
from fwclass.grid import Box, Tile, TileGrid
from fwclass.schema import IDENTITY, Table
from fwclass.stage import Chunk
from fwclass.store.arrays import read_arrays
from fwclass.store.remote_file import Location, local
from fwclass.store.row_digests import Within, row_digests_of
from fwclass.store.run_store import Store
from fwclass.store.table_cache import groups_touching, read_kept, rows_of_groups
from fwclass.store.tables import read_table, row_groups

TABLE = "table.parquet"

_ROUNDING = 0.001
"""m, beyond the halo of a piece: coordinates are whole millimetres."""


class UndeclaredRead(StoreError):
    """The work of a part reads what its task does not name: that would not be in its key, and a stale part be kept."""


@dataclass(frozen=True)
class Declared:
    """What a task says that it reads: the parts that it `needs`, of those with digests of pieces what is `within`."""

    task: tuple[str, str]
    needs: frozenset[tuple[str, str]]
    within: Within = None


@dataclass(frozen=True)
class PartInputs:
    """What one part's work reads: parts of the store, and files from outside, whose digests by name are `external`.

    `split`: where the work holds much, it is to be done in `split` × `split` pieces of a tile. `declared`: all that may
    be read; None for who reads a finished run and writes no part. Every read raises `UndeclaredRead` for anything else.
    """

    _store: Store
    external: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    split: int = field(default=1, kw_only=True)
    declared: Declared | None = field(default=None, kw_only=True)

    def local(self, location: Location) -> Path:
        """A file from outside on this host; one on object storage is fetched, and is what the part was planned with."""
        return local(location, self.external)

    def path(self, stage: str, part: str, name: str) -> Path:
        """A file or directory of a part, which is read whole."""
        self._check(stage, part)
        if self.declared is not None and isinstance(self.declared.within, Box):
            digests = row_digests_of(self.meta(stage, part), f"{stage}/{part}")
            if digests is not None and "size" in digests:
                self._refuse(f"all of {stage}/{part}", "what lies in the box that the task is bound to")
        return self._store.path(stage, part, name)

    def table(self, stage: str, part: str, columns: Iterable[str] | None = None, name: str = TABLE) -> Table:
        """A part's table; `columns` None for all."""
        return read_table(self.path(stage, part, name), columns)

    def fragment(self, stage: str, part: str, tile: str) -> Table:
        """The rows of a tile in a span that is cut by tile: a row group, whose number its receipt tells."""
        self._check(stage, part)
        if self.declared is not None and isinstance(self.declared.within, str) and self.declared.within != tile:
            self._refuse(f"rows of tile {tile} in {stage}/{part}", f"those of {self.declared.within}")
        group = self.meta(stage, part)["tiles"][tile][0]
        return read_table(self._store.path(stage, part, TABLE), None, [group])

    def groups(self, stage: str, part: str, groups: list[int]) -> Table:
        """Chosen row groups of a part's table."""
        return read_table(self.path(stage, part, TABLE), None, groups)

    def arrays(
        self, stage: str, part: str, name: str, only: tuple[str, ...] | None = None
    ) -> tuple[dict[str, NDArray], dict[str, Any]]:
        """Arrays of a part (`only` some of them) and their attributes."""
        return read_arrays(self.arrays_path(stage, part, name), only)

    def arrays_path(self, stage: str, part: str, name: str) -> Path:
        """The file or directory of a part's arrays."""
        return self.path(stage, part, self._store.arrays_name(stage, part, name))

    def meta(self, stage: str, part: str) -> Mapping[str, Any]:
        """What the receipt of a part says besides its files; nothing of a part that is not done."""
        self._check(stage, part)
        receipt = self._store.receipt(stage, part)
        return receipt.meta if receipt else {}

    def digest(self, stage: str, part: str) -> str:
        """Digest of a part; empty for one that is not done."""
        self._check(stage, part)
        receipt = self._store.receipt(stage, part)
        return receipt.digest if receipt else ""

    def _check(self, stage: str, part: str, columns: Iterable[str] = ()) -> None:
        """Refuse a part that is not declared, naming the `columns` that are asked of it."""
        if self.declared is not None and (stage, part) not in self.declared.needs:
            some = ", ".join(columns)
            self._refuse(
                f"{some + ' of ' if some else ''}{stage}/{part}",
                f"parts of the stages {', '.join(sorted({s for s, _ in self.declared.needs})) or '(none)'}",
                f"declare {f'the columns {some}, which stage {stage} writes' if some else f'stage {stage}'}",
            )

    def _check_rows(self, part: str, base: str, box: Box | None) -> None:
        """Refuse rows outside the box that the task is bound to."""
        within = self.declared.within if self.declared is not None else None
        if not isinstance(within, Box):
            return
        if box is None:
            bounds = self.meta(base, part).get("bounds")
            if bounds is None:
                return
            box = Box(bounds[0], bounds[1], bounds[3], bounds[4])
        if not within.holds(box):
            self._refuse(f"rows of {base}/{part} in {box.bounds}", f"rows in {within.bounds}", "declare a larger halo")

    def _refuse(self, got: str, expected: str, do: str = "declare it") -> NoReturn:
        raise UndeclaredRead(
            "the work of a part reads what its task does not declare",
            where="/".join(self.declared.task) if self.declared is not None else "",
            expected=expected,
            got=got,
            do=f"{do} in the stage's record: what is read without it is in no key, and a change of it goes unseen",
        )

    def rows(self, part: str, columns: Mapping[str, str], box: Box | None = None, base: str = "tile") -> Table:
        """Columns of a tile from the stages that wrote them, side by side; only rows inside `box` if given.

        `columns` maps column to stage. All tables of a tile have the rows and row groups of `base`.
        """
        for stage in {base, *columns.values()}:
            self._check(stage, part, [n for n, s in columns.items() if s == stage])
        self._check_rows(part, base, box)
        by_stage: dict[str, list[str]] = {}
        for name, stage in columns.items():
            by_stage.setdefault(stage, []).append(name)
        if box is not None:
            mine = by_stage.setdefault(base, [])
            mine += [n for n in ("x", "y") if n not in mine]
        paths = {base: self._store.path(base, part, TABLE)}
        groups = groups_touching(paths[base], box)
        if box is not None and not groups:  # most neighbours of a sparse tile: nothing of theirs is opened
            return Table.empty(dict.fromkeys(itertools.chain(*by_stage.values())))
        paths |= {stage: self._store.path(stage, part, TABLE) for stage in by_stage if stage != base}
        arrays: dict[str, NDArray] = {}
        for stage, names in by_stage.items():
            arrays |= dict(read_kept(paths[stage], names, groups))
            _check_lengths(arrays, f"{stage}/{part}")
        if box is None:
            return Table({n: v.copy() for n, v in arrays.items()})  # stages may write to it, the next reader sees it
        return Table(arrays).take(box.contains(arrays["x"], arrays["y"]))

    def rows_at(self, part: str, columns: Mapping[str, str], rows: NDArray[np.int64]) -> Table:
        """As `rows`, of the tile's rows number `rows` (rising) alone; no more than a row group is held beside them."""
        stages = sorted({"tile", *columns.values()})
        for stage in stages:
            self._check(stage, part, [n for n, s in columns.items() if s == stage])
        self._check_rows(part, "tile", None)
        paths = {stage: self._store.path(stage, part, TABLE) for stage in stages}
        pieces, first = [], 0
        for group, count in enumerate(rows_of_groups(paths["tile"])):
            mine = rows[slice(*np.searchsorted(rows, (first, first + count)))] - first
            first += count
            if len(mine) == 0:
                continue
            arrays: dict[str, NDArray] = {}
            for stage, path in paths.items():
                names = [n for n, s in columns.items() if s == stage]
                arrays |= dict(read_table(path, names, [group])) if names else {}
                _check_lengths(arrays, f"{stage}/{part}")
            pieces.append(Table({n: arrays[n] for n in columns}).take(mine))
        return Table.concat(pieces) if pieces else Table.empty(columns)

    def chunk(self, tile: Tile, halo: float, columns: Mapping[str, str], present: Iterable[str]) -> Chunk:
        """The overlapping chunk of `tile`: its rows and its neighbours' within `halo` [m], in canonical order."""
        stages = {**dict.fromkeys((*IDENTITY, "x", "y"), "tile"), **columns}
        core = self.rows(tile.key, stages).select(stages)
        parts = [core]
        box, here = tile.box.grown(halo), set(present)
        if halo > 0:
            for key in TileGrid(tile.size, tile.origin).keys_touching(box):
                if key != tile.key and key in here:
                    parts.append(self.rows(key, stages, box).select(stages))
        return Chunk.of(Table.concat(parts), slice(core.rows), tile)

    def chunks(
        self, tile: Tile, halo: float, columns: Mapping[str, str], present: Iterable[str]
    ) -> Iterator[tuple[NDArray[np.int64], Chunk]]:
        """The tile in pieces: which of its rows, and the overlapping chunk that has these as its core."""
        if self.split == 1:
            whole = self.chunk(tile, halo, columns, present)
            yield np.arange(len(whole.core)), whole
            return
        stages = {**dict.fromkeys((*IDENTITY, "x", "y"), "tile"), **columns}
        own = self.rows(tile.key, dict.fromkeys(("x", "y"), "tile"))
        piece, here = _piece(tile, self.split, own["x"], own["y"]), set(present) | {tile.key}
        for k in range(self.split**2):
            rows = np.flatnonzero(piece == k)
            if len(rows) == 0:
                continue
            around = tile.box.grown(halo)
            box = _piece_box(tile, self.split, k).grown(halo + _ROUNDING).common(around) or around
            parts, core = [], np.zeros(0, bool)
            for key in TileGrid(tile.size, tile.origin).keys_touching(box):
                if key in here:
                    table = self.rows(key, stages, box).select(stages)
                    mine = np.zeros(table.rows, bool)
                    if key == tile.key:
                        mine = _piece(tile, self.split, table["x"], table["y"]) == k
                    core = np.concatenate([core, mine])
                    parts.append(table)
            yield rows, Chunk.of(Table.concat(parts), core, tile)

    def cuts(self, part: str, columns: Mapping[str, str]) -> Iterator[Table]:
        """A tile's columns as `rows` gives them; in pieces, row group by row group and each in `split` cuts."""
        if self.split == 1:
            yield self.rows(part, columns)
            return
        stages = sorted(set(columns.values()))
        for stage in ("tile", *stages):
            self._check(stage, part, [n for n, s in columns.items() if s == stage])
        self._check_rows(part, "tile", None)
        for group in row_groups(self._store.path("tile", part, TABLE), None):
            arrays: dict[str, NDArray] = {}
            for stage in stages:
                names = [n for n, s in columns.items() if s == stage]
                arrays |= dict(read_table(self._store.path(stage, part, TABLE), names, [group]))
                _check_lengths(arrays, f"{stage}/{part}")
            table = Table({n: arrays[n] for n in columns})
            for rows in np.array_split(np.arange(table.rows), self.split**2):
                if len(rows):
                    yield table.take(rows)

    def inside(
        self, box: Box, size: float, columns: Mapping[str, str], present: Iterable[str], base: str = "tile"
    ) -> Table:
        """Rows of every tile inside `box`, with x and y."""
        here = set(present)
        stages = {**dict.fromkeys(("x", "y"), base), **columns}
        parts = [self.rows(key, stages, box, base) for key in TileGrid(size).keys_touching(box) if key in here]
        return Table.concat([p.select(stages) for p in parts]) if parts else Table.empty(stages)


def _check_lengths(arrays: Mapping[str, NDArray], part: str) -> None:
    """`DamagedError` where columns of a tile from several stages have not the same number of rows."""
    rows = {len(values) for values in arrays.values()}
    if len(rows) > 1:
        raise DamagedError(
            "a table of a finished part has other rows than its tile",
            where=part,
            expected="as many rows as the tables of all stages of the tile",
            got=f"tables of {' and '.join(map(str, sorted(rows)))} rows",
            do="take another run directory, or remove the part's receipt: the part is made anew",
        )


def _piece(tile: Tile, split: int, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int64]:
    """In which of ``split`` × ``split`` squares of the tile each of its rows lies; rounding takes none out of all."""
    box, edge = tile.box, tile.size / split
    column, row = (np.floor((v - low) / edge).astype(np.int64) for v, low in ((x, box.xmin), (y, box.ymin)))
    return np.clip(column, 0, split - 1) * split + np.clip(row, 0, split - 1)


def _piece_box(tile: Tile, split: int, k: int) -> Box:
    box, edge = tile.box, tile.size / split
    x, y = box.xmin + (k // split) * edge, box.ymin + (k % split) * edge
    return Box(x, y, x + edge, y + edge)
