"""Places with so many echoes that the time of a neighbourhood would have no bound.

Cubes of one global lattice (`FeaturesParams.dense_cell`) that hold more than `dense_echoes` echoes are **dense**. Of
the echoes of a dense cube one counts in every small cube of `dense_step`, the first in canonical order, and what is
computed for it holds for all echoes of its small cube. Equal points so become one.

Cylinders also see what stands one above the other: **columns** of `dense_column` of which more than `dense_in_column`
echoes would count are thinned in the same way, by the smallest cubes of `dense_step`, twice, four times, … its edge
that leave no more. The lattices hang on the global origin and a cube or column is looked at whole, so neither tiles
nor the order of rows change a result.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.features.params import FeaturesParams
from fwclass.grid import millimetres, whole_millimetres
from fwclass.schema import Table
from fwclass.stage import Chunk

SLOTS = 1 << 16
"""Least counters of the first look, which takes cubes by a hash of their place; a power of two."""

MIXED = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)
"""Odd factors that spread places over counters (Steele, Lea and Flood 2014; Collet, xxHash)."""

Rows = NDArray[np.int64]
Place = tuple[Rows, Rows, Rows]


@dataclass(frozen=True)
class Thinned:
    """A chunk of which dense cubes keep a few echoes.

    Attributes
    ----------
    chunk : what is kept; its core rows are those that the core rows of the whole chunk take their values from.
    source : int64 (core rows of the whole chunk,), the core row of `chunk` that each takes its values from.
    """

    chunk: Chunk
    source: NDArray[np.int64]


@dataclass(frozen=True)
class Fullest:
    """Echoes in dense cubes or columns, and the fullest of these: how many it holds, and its corner [m]."""

    echoes: int
    most: int
    corner: tuple[float, ...]

    @classmethod
    def of_parts(cls, parts: Iterable[Mapping[str, Any] | None]) -> Fullest | None:
        """All of what parts of a survey hold (plain data), None where none holds any."""
        each = [cls(p["echoes"], p["most"], tuple(p["corner"])) for p in parts if p]
        fullest = min(each, key=lambda c: (-c.most, c.corner), default=None)
        return cls(sum(c.echoes for c in each), fullest.most, fullest.corner) if fullest else None

    def text(self) -> str:
        """How many echoes the fullest holds, and where [m]."""
        return f"the fullest {self.most:,} at {', '.join(f'{v:.1f}' for v in self.corner)}"


@dataclass(frozen=True)
class Crowd:
    """What lies in dense cubes, and what in dense columns; None where nothing does."""

    cubes: Fullest | None
    columns: Fullest | None

    @classmethod
    def of_parts(cls, parts: Iterable[Mapping[str, Any] | None]) -> Crowd | None:
        """All of what parts of a survey hold (`facts`), None where nothing is dense."""
        known = [p for p in parts if p]
        cubes, columns = (Fullest.of_parts(p[name] for p in known) for name in ("cubes", "columns"))
        return cls(cubes, columns) if cubes or columns else None

    def facts(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)

    def text(self, params: FeaturesParams) -> str:
        """A remark for a user."""
        texts = []
        if self.cubes:
            texts.append(
                f"{self.cubes.echoes:,} echoes lie in cubes of {params.dense_cell:g} m that hold more than "
                f"{params.dense_echoes:,}, {self.cubes.text()}: there one echo counts in each cube of "
                f"{params.dense_step:g} m (features.dense_echoes)"
            )
        if self.columns:
            texts.append(
                f"{self.columns.echoes:,} echoes lie in columns of {params.dense_column:g} m of which more than "
                f"{params.dense_in_column:,} would count, {self.columns.text()}: there one echo counts in each cube "
                f"of {params.dense_step:g} m or more (features.dense_in_column)"
            )
        return "; ".join(texts)


def thin_dense(chunk: Chunk, params: FeaturesParams) -> Thinned | None:
    """`chunk` without the echoes that do not count, None where no cube and no column is dense.

    `Thinned` also says for every echo of the core, (core,), which row of the thinned core it takes its features
    from.
    """
    place = _millimetres(chunk.table)
    owner = _owners(place, params)
    owner = _among(place, owner, params)[0]
    counting = np.flatnonzero(owner == np.arange(len(owner)))
    if len(counting) == len(owner):
        return None
    owners, source = np.unique(owner[chunk.core], return_inverse=True)
    core = np.searchsorted(counting, owners)
    return Thinned(Chunk(chunk.table.take(counting), core, chunk.tile), source)


def crowd_facts(chunk: Chunk, params: FeaturesParams) -> dict[str, Any] | None:
    """What of the core lies in dense cubes and columns, see `Crowd.facts`; None where nothing does."""
    place = _millimetres(chunk.table)
    core = np.zeros(chunk.table.rows, np.bool_)
    core[chunk.core] = True
    rows, count = _find_crowded(np.arange(chunk.table.rows), place, params.dense_cell, params.dense_echoes)
    cubes = _fullest(rows, count, core, place, params.dense_cell)
    _, rows, count = _among(place, _owners(place, params), params)
    columns = _fullest(rows, count, core, place[:2], params.dense_column)
    return Crowd(cubes, columns).facts() if cubes or columns else None


def _millimetres(table: Table) -> Place:
    return millimetres(table["x"]), millimetres(table["y"]), millimetres(table["z"])


def _owners(place: Place, params: FeaturesParams) -> Rows:
    """Of every row the one that counts for it, as dense cubes have it."""
    owner = np.arange(len(place[0]))
    dense, _ = _find_crowded(owner, place, params.dense_cell, params.dense_echoes)
    if len(dense):
        step = whole_millimetres(params.dense_step, "features.dense_step")
        rows, first = _group(dense, [axis[dense] // step for axis in place])
        owner[rows] = rows[first]
    return owner


def _among(place: Place, owner: Rows, params: FeaturesParams) -> tuple[Rows, Rows, Rows]:
    """`owner` as dense columns have it; all rows in such columns, and how many rows of its column would count."""
    edge = whole_millimetres(params.dense_column, "features.dense_column")
    step = whole_millimetres(params.dense_step, "features.dense_step")
    counting = np.flatnonzero(owner == np.arange(len(owner)))
    dense, count = _find_crowded(counting, place[:2], params.dense_column, params.dense_in_column)
    if len(dense) == 0:
        return owner, dense, dense
    would = np.zeros(len(owner), np.int64)
    would[dense] = count
    would = would[owner]
    speaks = np.arange(len(owner))
    while len(dense):
        column = [axis[dense] // edge for axis in place[:2]]
        at, first = _group(np.arange(len(dense)), [*column, *(axis[dense] // step for axis in place)])
        speaks[dense[at]] = dense[at[first]]
        dense, _ = _find_crowded(np.unique(speaks[dense]), place[:2], params.dense_column, params.dense_in_column)
        step *= 2
    # An owner of an owner: what a first round left is thinned by the next, of twice the edge.
    while not np.array_equal(speaks, speaks[speaks]):
        speaks = speaks[speaks]
    rows = np.flatnonzero(would)
    return speaks[owner], rows, would[rows]


def _fullest(rows: Rows, count: Rows, core: NDArray[np.bool_], place: tuple[Rows, ...], edge: float) -> Fullest | None:
    """What of the core `rows` in crowded cubes or columns hold, None where none is of the core."""
    own = core[rows]
    if not own.any():
        return None
    size = whole_millimetres(edge, "features.dense")
    cubes = [axis[rows[own]] // size for axis in place]
    fullest = np.lexsort((*cubes, -count[own]))[0]
    return Fullest(int(own.sum()), int(count[own][fullest]), tuple(int(cube[fullest]) * size / 1000 for cube in cubes))


def _find_crowded(rows: Rows, place: tuple[Rows, ...], edge: float, most: int) -> tuple[Rows, Rows]:
    """Those of `rows`, rising, whose cube (column, of two axes) of `edge` [m] holds more than `most` of them, and how
    many that are.

    First by counters that several cubes may share, which is quick, then among the few rows left cube by cube.
    """
    size = whole_millimetres(edge, "features.dense")
    n = len(rows)
    if n <= most:
        return rows[:0], rows[:0]
    slots = max(SLOTS, 1 << (4 * n - 1).bit_length())
    slot = np.zeros(n, np.uint64)
    for axis, factor in zip(place, MIXED, strict=False):
        slot += (axis[rows] // size).astype(np.uint64) * np.uint64(factor)
    slot >>= np.uint64(64 - (slots.bit_length() - 1))
    at = slot.astype(np.int64)
    rows = rows[np.bincount(at, minlength=slots)[at] > most]
    if len(rows) == 0:
        return rows, rows
    rows, first = _group(rows, [axis[rows] // size for axis in place])
    starts = np.flatnonzero(first == np.arange(len(first)))
    count = np.diff(np.append(starts, len(first)))[np.searchsorted(starts, first)]
    dense = count > most
    order = np.argsort(rows[dense], kind="stable")
    return rows[dense][order], count[dense][order]


def _group(rows: Rows, cubes: Sequence[Rows]) -> tuple[Rows, Rows]:
    """`rows` by their `cubes`, rising within each, and the place of the first of every row's cube."""
    order = np.lexsort((rows, *cubes))
    new = np.zeros(len(rows), np.bool_)
    new[:1] = True
    for cube in cubes:
        new[1:] |= np.diff(cube[order]) != 0
    return rows[order], np.maximum.accumulate(np.where(new, np.arange(len(rows)), 0))
