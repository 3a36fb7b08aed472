"""Places with so many echoes that the time of a neighbourhood would have no bound.

Cubes of one global lattice (`FeaturesParams.dense_cell`) that hold more than `dense_echoes` echoes are **dense**. Of
the echoes of a dense cube one counts in every small cube of `dense_step`, the first in canonical order, and what is
computed for it holds for all echoes of its small cube. Equal points so become one. The lattice hangs on the global
origin and a cube is looked at whole, so neither tiles nor the order of rows change a result.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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

Place = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


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
class Crowd:
    """Echoes in dense cubes, and the fullest of these cubes: how many echoes it holds, and its corner [m]."""

    echoes: int
    most: int
    corner: tuple[float, ...]

    @classmethod
    def of_parts(cls, parts: Iterable[Mapping[str, Any] | None]) -> Crowd | None:
        """All of what parts of a survey told (`told`), None where none has a dense cube."""
        crowds = [cls(p["echoes"], p["most"], tuple(p["corner"])) for p in parts if p]
        fullest = min(crowds, key=lambda c: (-c.most, c.corner), default=None)
        return cls(sum(c.echoes for c in crowds), fullest.most, fullest.corner) if fullest else None

    def told(self) -> dict[str, Any]:
        """Plain data."""
        return {"echoes": self.echoes, "most": self.most, "corner": list(self.corner)}

    def text(self, params: FeaturesParams) -> str:
        """A remark for a user."""
        place = ", ".join(f"{v:.1f}" for v in self.corner)
        return (
            f"{self.echoes:,} echoes lie in cubes of {params.dense_cell:g} m that hold more than "
            f"{params.dense_echoes:,}, the fullest {self.most:,} at {place}: there one echo counts in each cube of "
            f"{params.dense_step:g} m (features.dense_echoes)"
        )


def thinned(chunk: Chunk, params: FeaturesParams) -> Thinned | None:
    """`chunk` without the echoes that do not count, None where no cube is dense."""
    place = _millimetres(chunk.table)
    dense = _dense(place, params)[0]
    if len(dense) == 0:
        return None
    step = whole_millimetres(params.dense_step, "features.dense_step")
    rows, first = _grouped(dense, place, step)
    owner = np.arange(chunk.table.rows)
    owner[rows] = rows[first]
    kept = np.flatnonzero(owner == np.arange(len(owner)))
    owners, source = np.unique(owner[chunk.core], return_inverse=True)
    core = np.searchsorted(kept, owners)
    return Thinned(Chunk(chunk.table.take(kept), core, chunk.tile), source)


def crowd_facts(chunk: Chunk, params: FeaturesParams) -> dict[str, Any] | None:
    """What of the core lies in dense cubes, see `Crowd.told`; None where nothing does."""
    place = _millimetres(chunk.table)
    dense, count = _dense(place, params)
    own = np.zeros(chunk.table.rows, np.bool_)
    own[chunk.core] = True
    own = own[dense]
    if not own.any():
        return None
    edge = whole_millimetres(params.dense_cell, "features.dense_cell")
    cubes = [axis[dense[own]] // edge for axis in place]
    fullest = np.lexsort((*cubes, -count[own]))[0]
    corner = tuple(int(cube[fullest]) * edge / 1000 for cube in cubes)
    return Crowd(int(own.sum()), int(count[own][fullest]), corner).told()


def _millimetres(table: Table) -> Place:
    return millimetres(table["x"]), millimetres(table["y"]), millimetres(table["z"])


def _dense(place: Place, params: FeaturesParams) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows in dense cubes, rising, and how many echoes the cube of each holds.

    First by counters that several cubes may share, which is quick, then among the few rows left cube by cube.
    """
    edge = whole_millimetres(params.dense_cell, "features.dense_cell")
    n = len(place[0])
    slots = max(SLOTS, 1 << (4 * n - 1).bit_length()) if n else SLOTS
    slot = np.zeros(n, np.uint64)
    for axis, factor in zip(place, MIXED, strict=True):
        slot += (axis // edge).astype(np.uint64) * np.uint64(factor)
    slot >>= np.uint64(64 - (slots.bit_length() - 1))
    at = slot.astype(np.int64)
    rows = np.flatnonzero(np.bincount(at, minlength=slots)[at] > params.dense_echoes)
    if len(rows) == 0:
        return rows, rows
    rows, first = _grouped(rows, place, edge)
    starts = np.flatnonzero(first == np.arange(len(first)))
    count = np.diff(np.append(starts, len(first)))[np.searchsorted(starts, first)]
    dense = count > params.dense_echoes
    order = np.argsort(rows[dense], kind="stable")
    return rows[dense][order], count[dense][order]


def _grouped(rows: NDArray[np.int64], place: Place, edge: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`rows` by cubes of `edge` [mm], rising within each, and the place of the first of every row's cube."""
    cubes = [axis[rows] // edge for axis in place]
    order = np.lexsort((rows, *cubes))
    new = np.zeros(len(rows), np.bool_)
    new[:1] = True
    for cube in cubes:
        new[1:] |= np.diff(cube[order]) != 0
    return rows[order], np.maximum.accumulate(np.where(new, np.arange(len(rows)), 0))
