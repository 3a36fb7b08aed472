"""What one tile says about the gains of its strips: counts that add up, whatever the tiles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import millimetres, whole_millimetres
from fwclass.radiometry.formulas import WHITE, backscatter, beam_area, cross_section
from fwclass.radiometry.params import RadiometryParams
from fwclass.radiometry.ranges import BEAM, ranges, with_beams
from fwclass.schema import Table, require
from fwclass.stage import Chunk

STEP = 1.0 / 4096.0
"""Width of a histogram's bin, in natural logarithms: 0.024 %, below any error that matters."""

PARTS = 720_720
"""Parts of a cell: a whole number of them for every share 2 / k up to 16 strips."""

UNFIT = 1 | 2 | 4 | 8 | 16
"""`fit_flags` that keep an echo out of a comparison: saturated, overlapping, poor, at the edge, vendor's."""

NORMAL = ("normal_x", "normal_y", "normal_z")
READS = ("strip", "x", "y", "z", "gps_time", *BEAM, "energy", "number_of_echoes", "fit_flags", "beam_range", *NORMAL)
"""Columns that radiometry reads."""


@dataclass(frozen=True)
class Overlap:
    """Histograms of logarithms, in bins of `STEP`; all counts are whole, so that sums are exact in any order.

    Attributes
    ----------
    first, second, difference, cells : sorted rows of one histogram per pair of strips, first < second: in `cells`
        cells the median ln γ of `first` minus that of `second` fell into bin `difference`. A cell that k strips share
        counts 2 / k for each of their pairs, as the pairs are not independent; `cells` are in units of 1 / `PARTS`.
    target_strip, target_level, target_echoes : one histogram per strip of the uncalibrated ln(γ / 4) of echoes on the
        target.
    strip, echoes : usable echoes of every strip.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    difference: NDArray[np.int64]
    cells: NDArray[np.int64]
    target_strip: NDArray[np.int64]
    target_level: NDArray[np.int64]
    target_echoes: NDArray[np.int64]
    strip: NDArray[np.int64]
    echoes: NDArray[np.int64]

    def arrays(self) -> dict[str, NDArray[np.int64]]:
        """The arrays (int64, of one length for each count) that a store keeps; `from_arrays` makes the record again."""
        return dict(vars(self))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Overlap:
        """The record whose `arrays`, int64 (n,) by name, these are."""
        return cls(**{name: np.asarray(arrays[name], np.int64) for name in cls.__dataclass_fields__})


def overlap(chunk: Chunk, trajectory: Table | None, params: RadiometryParams) -> Overlap:
    """Compare the strips of one tile, cell by cell, by their uncalibrated γ.

    Usable are single echoes without a fault, with range and normal, up to ``overlap.max_incidence``. The cells hang on
    the global origin. A cell belongs to the tile that owns the first of its usable echoes, so that it counts once
    whatever the tiles; the chunk needs a halo of one cell. The target's echoes count in the tile that owns them.
    """
    require(chunk.table, READS, chunk.tile.key)
    core = np.zeros(chunk.table.rows, bool)
    core[chunk.core] = True
    rows, level = _levels(chunk.table, trajectory, params)
    strip = chunk.table["strip"][rows].astype(np.int64)
    core = core[rows]
    x, y = chunk.table["x"][rows], chunk.table["y"][rows]
    hits = core & (within(params.target.polygon, x, y) if params.target else False)
    target = np.floor((level[hits] - np.log(WHITE)) / STEP).astype(np.int64)
    return Overlap(*_pairs(x, y, strip, level, core, params), *_count(strip[hits], target), *_count(strip[core]))


def merge(parts: Iterable[Overlap]) -> Overlap:
    """The sum of all tiles' statistics, in any order."""
    every = list(parts)
    joined = [np.concatenate([getattr(p, n) for p in every] or [_NONE]) for n in Overlap.__dataclass_fields__]
    return Overlap(
        *_count(*joined[:3], weight=joined[3]),
        *_count(*joined[4:6], weight=joined[6]),
        *_count(joined[7], weight=joined[8]),
    )


def within(polygon: Sequence[tuple[float, float]], x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """bool (points,): whether (x, y) [m] lie in a polygon [m], by the number of edges that a ray towards +x meets."""
    inside = np.zeros(len(x), bool)
    for (x1, y1), (x2, y2) in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
        spans = (y1 > y) != (y2 > y)
        if y1 != y2:
            inside ^= spans & (x - x1 < (x2 - x1) * ((y - y1) / (y2 - y1)))
    return inside


_NONE = np.empty(0, np.int64)


def incidence_cosine(echoes: Table) -> NDArray[np.float64]:
    """|cosine| of the angle between beam and normal, in [0, 1]; NaN where one is missing."""
    beam = np.stack([echoes[name] for name in BEAM], axis=1).astype(np.float64)
    normal = np.stack([echoes[name] for name in NORMAL], axis=1).astype(np.float64)
    length = np.sqrt((beam**2).sum(axis=1) * (normal**2).sum(axis=1))
    dot = np.abs((beam * normal).sum(axis=1))
    return np.minimum(np.divide(dot, length, out=np.full(len(dot), np.nan), where=length > 0.0), 1.0)


def _levels(
    table: Table, trajectory: Table | None, params: RadiometryParams
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Rows of the usable echoes, and their ln γ with C_cal = 1 and gain 1."""
    rows = np.flatnonzero(
        (table["number_of_echoes"] == 1) & ((table["fit_flags"] & UNFIT) == 0) & (table["energy"] > 0)
    )
    some = with_beams(table.select(READS).take(rows), trajectory, params)
    cosine = incidence_cosine(some)
    rows, cosine = (v[cosine >= np.cos(np.radians(params.overlap.max_incidence))] for v in (rows, cosine))
    some = table.select(READS).take(rows)
    range_ = ranges(some, trajectory, params)
    sigma = cross_section(some["energy"].astype(np.float64), range_, params.extinction)
    gamma = backscatter(sigma, beam_area(range_, params.divergence), cosine)
    known = (gamma > 0.0) & np.isfinite(gamma)
    return rows[known], np.log(gamma[known])


def _count(*columns: NDArray, weight: NDArray | None = None) -> tuple[NDArray[np.int64], ...]:
    """Distinct rows of `columns`, sorted, and the sum of `weight` (or the number) of each."""
    rows = np.stack([np.asarray(c, np.int64) for c in columns], axis=1)
    weight = np.ones(len(rows), np.int64) if weight is None else weight
    distinct, at = np.unique(rows, axis=0, return_inverse=True)
    total = np.zeros(len(distinct), np.int64)
    np.add.at(total, at.ravel(), weight)
    return (*distinct.T.copy(), total)


def _pairs(
    x: NDArray, y: NDArray, strip: NDArray, level: NDArray, core: NDArray, params: RadiometryParams
) -> tuple[NDArray[np.int64], ...]:
    """Histogram rows (first, second, difference, cells) of the cells that this tile owns."""
    edge = whole_millimetres(params.overlap.cell, "radiometry.overlap.cell")
    col, row = millimetres(x) // edge, millimetres(y) // edge
    if len(x) == 0:
        return _NONE, _NONE, _NONE, _NONE
    _, first, cell = np.unique((row - row.min()) * (np.ptp(col) + 1) + col, return_index=True, return_inverse=True)
    keep = core[first][cell]
    cell, strip, level = cell[keep], strip[keep], level[keep]
    order = np.lexsort((level, strip, cell))
    cell, strip, level = cell[order], strip[order], level[order]
    begin = np.flatnonzero(np.diff(cell, prepend=-1) | np.diff(strip, prepend=-1))
    count = np.diff(begin, append=len(cell))
    middle = (level[begin + (count - 1) // 2] + level[begin + count // 2]) / 2.0 if len(begin) else level
    away = (level - np.repeat(middle, count)) ** 2
    square = np.add.reduceat(away, begin) if len(begin) else away
    good = (count >= params.overlap.least_echoes) & (square <= params.overlap.max_spread**2 * (count - 1))
    cell, strip, middle = cell[begin][good], strip[begin][good], middle[good]
    shared = np.bincount(cell)[cell] if len(cell) else cell
    pairs, parts = [_NONE.reshape(0, 3)], [_NONE]
    for ahead in range(1, len(cell)):
        a = np.flatnonzero(cell[ahead:] == cell[:-ahead])
        if len(a) == 0:
            break
        difference = np.floor((middle[a] - middle[a + ahead]) / STEP).astype(np.int64)
        pairs.append(np.stack([strip[a], strip[a + ahead], difference], axis=1))
        parts.append(2 * PARTS // shared[a])
    return _count(*np.concatenate(pairs).T, weight=np.concatenate(parts))
