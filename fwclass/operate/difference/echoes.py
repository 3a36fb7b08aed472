"""Echoes of two deliveries held against each other by identity, tile by tile: whose class changed, and where."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box, Tile, TileGrid, groups
from fwclass.schema import IDENTITY, Table, lie_apart
from fwclass.store.tables import read_table

CELL = 10.0
"""m, cells that changed echoes are counted in; those of touching cells are one place."""

LEAST = 5
"""Changed echoes of a cell below which it makes no place."""

_COLUMNS = (*IDENTITY, "x", "y", "z", "classification")


@dataclass
class ClassChanges:
    """`matrix[before, after]`: echoes of both deliveries by class codes (256, 256). `only`: echoes of the first and the
    second alone. `apart`: of these, pairs of one identity in one tile that lie apart: other echoes have their numbers.
    `cells`: changed echoes by cell of `CELL` m."""

    matrix: NDArray[np.int64] = field(default_factory=lambda: np.zeros((256, 256), np.int64))
    only: tuple[int, int] = (0, 0)
    apart: int = 0
    cells: Counter[tuple[int, int]] = field(default_factory=Counter)

    @property
    def common(self) -> int:
        """Number of echoes that both deliveries have."""
        return int(self.matrix.sum())

    @property
    def changed(self) -> int:
        """Number of common echoes with another class."""
        return self.common - int(np.trace(self.matrix))

    def places(self) -> list[tuple[Box, int]]:
        """Boxes [m] of touching cells with many changed echoes, and how many of these; most first."""
        busy = {key: n for key, n in self.cells.items() if n >= LEAST}
        together = groups(Tile(i, j, CELL) for i, j in busy)
        boxes = [(_around(group), sum(busy[t.ix, t.iy] for t in group)) for group in together]
        return sorted(boxes, key=lambda place: (-place[1], place[0].bounds))


def _around(cells: tuple[Tile, ...]) -> Box:
    ends = np.array([t.box.bounds for t in cells])
    return Box(*ends[:, :2].min(axis=0).tolist(), *ends[:, 2:].max(axis=0).tolist())


def class_changes(first: Path, second: Path, sizes: tuple[float, float]) -> ClassChanges:
    """The echoes in the Parquet tiles below directories `first` and `second`, whose tiles have edges of `sizes` [m].

    Memory is that of a tile and of those of the other delivery that it touches.
    """
    changes = ClassChanges()
    only = np.zeros(2, np.int64)
    for before, after in _pairs(first, second, sizes):
        _, first_rows, second_rows = np.intersect1d(
            _keys(before), _keys(after), assume_unique=True, return_indices=True
        )
        same = ~lie_apart(before, first_rows, after, second_rows)
        changes.apart += int((~same).sum())
        first_rows, second_rows = first_rows[same], second_rows[same]
        only += before.rows - len(first_rows), 0
        was, now = before["classification"][first_rows], after["classification"][second_rows]
        changes.matrix += np.bincount(was.astype(np.int64) * 256 + now, minlength=1 << 16).reshape(256, 256)
        differ = first_rows[was != now]
        column, row = TileGrid(CELL).indices(before["x"][differ], before["y"][differ])
        changes.cells.update(zip(column.tolist(), row.tolist(), strict=True))
    only[1] = _rows(second) - changes.common
    changes.only = int(only[0]), int(only[1])
    return changes


def _pairs(first: Path, second: Path, sizes: tuple[float, float]) -> Iterator[tuple[Table, Table]]:
    """Every tile of the first delivery with the echoes of the second that may lie in it."""
    there = {path.stem for path in second.glob("*.parquet")}
    second_table = lru_cache(maxsize=16)(lambda key: read_table(second / f"{key}.parquet", _COLUMNS))
    first_grid, second_grid = (TileGrid(size) for size in sizes)
    for path in sorted(first.glob("*.parquet")):
        box = first_grid.tile(path.stem).box
        near = [second_table(key) for key in second_grid.keys_touching(box) if key in there]
        inside = [t.take(box.contains(t["x"], t["y"])) for t in near]
        joined = Table({n: np.concatenate([t[n] for t in inside]) for n in _COLUMNS}) if inside else None
        yield read_table(path, _COLUMNS), joined if joined is not None else Table.empty(_COLUMNS)


def _keys(table: Table) -> NDArray[np.uint64]:
    """Identity of every echo as one number: 16 bits of strip, 40 of pulse, 8 of echo."""
    strip, pulse, echo = (table[name].astype(np.uint64) for name in IDENTITY)
    return (strip << np.uint64(48)) | (pulse << np.uint64(8)) | echo


def _rows(directory: Path) -> int:
    return sum(read_table(path, ("echo_number",)).rows for path in directory.glob("*.parquet"))
