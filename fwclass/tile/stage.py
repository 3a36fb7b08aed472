"""Scatter echoes to the tiles that own them, bring each tile into its final row order, and tell what it has twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import TileGrid, millimetres
from fwclass.hashing import mix
from fwclass.schema import Table, canonical_key
from fwclass.stage import Computation
from fwclass.units import ADJUSTED, GPS_WEEK

MORTON_CELL = 2_000
"""Edge of the cells of the spatial sort [mm]; only the order of rows in a tile depends on it."""

SAME_CELL = 500
"""Edge of the cells within which an echo is looked for that was measured once and stands in two files [mm]: more than
adjustments of strips move it, few of which lose it at a cell's edge."""

TICK = 1e-6
"""s, in which times are compared: standard GPS time is stored to 2.4e-7 s, pulses follow at 5e-7 s at least."""


@dataclass(frozen=True)
class Split:
    """Rows of a span in tile order; tile k has rows ``offsets[k]:offsets[k + 1]`` of `table`."""

    table: Table
    keys: tuple[str, ...]
    offsets: NDArray[np.int64]


def split(table: Table, grid: TileGrid) -> Split:
    """Sort the rows of a span (any table with x, y [m]) by the tile that owns them, each tile's in their order."""
    ix, iy = grid.indices(table["x"], table["y"])
    order = np.lexsort((iy, ix))
    sx, sy = ix[order], iy[order]
    new = np.ones(len(order), bool)
    new[1:] = (sx[1:] != sx[:-1]) | (sy[1:] != sy[:-1])
    first = np.flatnonzero(new)
    keys = tuple(f"{sx[i]}_{sy[i]}" for i in first)
    return Split(table.take(order), keys, np.append(first, len(order)).astype(np.int64))


def _spread_bits(v: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Bits of a 32-bit integer moved to the even places of 64."""
    for shift, mask in (
        (16, 0x0000FFFF0000FFFF),
        (8, 0x00FF00FF00FF00FF),
        (4, 0x0F0F0F0F0F0F0F0F),
        (2, 0x3333333333333333),
        (1, 0x5555555555555555),
    ):
        v = (v | (v << np.uint64(shift))) & np.uint64(mask)
    return v


def morton(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint64]:
    """uint64 (points,): Morton code of the global cells of `MORTON_CELL` [mm] that the points (x, y) [m] lie in."""
    half = 1 << 31
    cx = (millimetres(x) // MORTON_CELL + half).astype(np.uint64)
    cy = (millimetres(y) // MORTON_CELL + half).astype(np.uint64)
    return _spread_bits(cx) | (_spread_bits(cy) << np.uint64(1))


def assemble(fragments: list[Table], where: str) -> Table:
    """A tile's rows from all spans, all columns, in final order: Morton code, then (strip, pulse, echo_number).

    An identity that occurs twice is an error of the source (the same strip listed twice under two names differs in
    `strip` and is not one): `InputError`.
    """
    table = Table.concat(fragments)
    key = canonical_key(table)
    order = np.lexsort((key, morton(table["x"], table["y"])))
    ranked = np.sort(key)
    if (ranked[1:] == ranked[:-1]).any():
        raise InputError(
            "two echoes of a tile have the same strip, pulse and echo number",
            where=where,
            got=f"{int((ranked[1:] == ranked[:-1]).sum())} repeated",
            do="report this with the source file",
        )
    return table.take(order)


def assemble_points(fragments: list[Table]) -> Table:
    """A tile's reference points (x, y, z [m], gps_time [s], source_class), sorted by place, time and class: independent
    of how they were cut."""
    table = Table.concat(fragments)
    order = np.lexsort(
        (table["source_class"], table["gps_time"], table["z"], table["y"], table["x"], morton(table["x"], table["y"]))
    )
    return table.take(order)


def repeats(table: Table) -> list[list[int]]:
    """How many echoes are there twice, by pairs of strips: of files with a common rim, or of one file under two names,
    or of packets that were stored for every return of a pulse and are not read as one waveform.

    Parameters
    ----------
    table : x, y, z [m], gps_time [s] (NaN: one that is not known is like another) and strip; perhaps amplitude, width
        and misfit (NaN: not fitted).

    Returns
    -------
    [strip, strip of the repetition, echoes] in rising order, of echoes that have place (to the millimetre) and GPS time
    of another, and of others that have GPS time, fit to the last bit and cell of `SAME_CELL`: such are of the same
    samples. Of n alike n - 1 are repetitions, in the order of their strips.
    """
    time = np.where(np.isfinite(table["gps_time"]), table["gps_time"], -1.0).astype(np.float64)
    strips, place = table["strip"].astype(np.int64), [millimetres(table[n]).astype(np.int64) for n in "xyz"]
    again, pairs = _alike(strips, *place, time)
    if "misfit" in table:
        fitted = np.isfinite(table["misfit"]) & _is_timed(table["gps_time"])
        fitted[again] = False
        fit = (table[n][fitted].astype(np.float64) for n in ("amplitude", "width", "misfit"))
        cells = (values[fitted] // SAME_CELL for values in place[:2])
        pairs = np.concatenate([pairs, _alike(strips[fitted], *fit, *cells, time[fitted])[1]])
    kinds, counts = np.unique(pairs, axis=0, return_counts=True)
    return [[int(a), int(b), int(n)] for (a, b), n in zip(kinds, counts, strict=True)]


def _alike(strips: NDArray[np.int64], *columns: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows that agree with another in all `columns`, (rows,) of 64 bits each; and the strips of the first of each
    group and of every repetition, (repetitions, 2)."""
    key = np.zeros(len(strips), np.uint64)
    for values in columns:
        key = mix(key ^ values.view(np.uint64))
    again = np.sort(key)
    again = again[1:][again[1:] == again[:-1]]
    if not len(again):
        return np.empty(0, np.int64), np.empty((0, 2), np.int64)
    rows = np.flatnonzero(np.isin(key, again))
    rows = rows[np.lexsort((strips[rows], key[rows]))]
    same = key[rows[1:]] == key[rows[:-1]]
    first = np.maximum.accumulate(np.where(np.append(False, same), 0, np.arange(len(rows))))
    return rows, np.stack([strips[rows[first[1:]]], strips[rows[1:]]], axis=1)[same]


def twice_measured(table: Table) -> list[list[int]]:
    """How many echoes are another strip's, moved: of one GPS time (to `TICK`, of the week, in whatever format), echo
    number and cell of `SAME_CELL`, by pairs of strips; those that `repeats` counts are left out.

    Parameters
    ----------
    table : x, y, z [m], gps_time [s] (NaN and 0: not known), echo_number and strip. Echoes that share all of this with
        one of their own strip tell nothing. Nor do strips whose times are coarse, which no tile can tell: see
        `count_times`.

    Returns
    -------
    [strip, other strip, echoes, sum of the other's heights less the first's [mm]] in rising order.
    """
    if table.rows == 0 or (table["strip"] == table["strip"][0]).all():
        return []
    time, strips = table["gps_time"], table["strip"].astype(np.int64)
    rows = np.flatnonzero(_is_timed(time))
    x, y, z = (millimetres(table[n][rows]).astype(np.int64) for n in "xyz")
    number, ticks = table["echo_number"][rows].astype(np.int64), _week_ticks(time[rows])
    key = np.zeros(len(rows), np.uint64)
    for values in (ticks, number, x // SAME_CELL, y // SAME_CELL):
        key = mix(key ^ values.view(np.uint64))
    again = np.sort(key)
    some = np.flatnonzero(np.isin(key, again[1:][again[1:] == again[:-1]]))
    some = some[np.lexsort((strips[rows[some]], key[some]))]
    if not len(some):
        return []
    of = strips[rows[some]]
    same = key[some[1:]] == key[some[:-1]]
    unclear = np.isin(key[some], key[some[1:]][same & (of[1:] == of[:-1])])
    first = np.maximum.accumulate(np.where(np.append(False, same), 0, np.arange(len(some))))[1:]
    i, j = some[first], some[1:]
    moved = (x[i] != x[j]) | (y[i] != y[j]) | (z[i] != z[j]) | (time[rows[i]] != time[rows[j]])
    pair = same & ~unclear[1:] & moved
    both = np.stack([of[first], of[1:]], axis=1)[pair]
    kinds, at = np.unique(both, axis=0, return_inverse=True)
    lifted, counts = np.zeros(len(kinds), np.int64), np.bincount(at.reshape(-1), minlength=len(kinds))
    np.add.at(lifted, at.reshape(-1), (z[j] - z[i])[pair])
    return [[*map(int, ab), int(n), int(up)] for ab, n, up in zip(kinds.tolist(), counts, lifted, strict=True)]


def count_times(table: Table) -> list[int]:
    """[first echoes of pulses that have a gps_time [s] (NaN and 0: not known), how many different times these have]."""
    times = table["gps_time"][_is_timed(table["gps_time"]) & (table["echo_number"] == 1)]
    return [len(times), len(np.unique(times))]


def _is_timed(time: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(time) & (time != 0))


def _week_ticks(time: NDArray[np.float64]) -> NDArray[np.int64]:
    """Multiples of `TICK` since the week began, of times of the week, of standard and of adjusted standard time; those
    of whole and half microseconds lie amid a multiple's reach, so that rounding of the formats moves none."""
    adjusted = (time < 0) | ((time > GPS_WEEK) & (time < ADJUSTED))
    of_week = time % GPS_WEEK + np.where(adjusted, ADJUSTED % GPS_WEEK, 0.0)
    return np.floor(of_week % GPS_WEEK / TICK + 0.25).astype(np.int64)


SPLIT = Computation("split", 1)
TILE = Computation("tile", 6)
REFERENCE = Computation("reference", 1)
