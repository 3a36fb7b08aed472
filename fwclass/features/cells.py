"""Features of square cells of the global grid, and Fan 2013's height in a cell."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fwclass.features.attributes import Attributes, add_attributes, add_spread
from fwclass.features.eigen import SHAPES
from fwclass.features.measures import CODE, measure, needs
from fwclass.features.moments import AREA, HIGH, LOW, MOMENTS, N, Z, add_heights
from fwclass.grid import millimetres, whole_millimetres
from fwclass.kernel import kernel
from fwclass.schema import Scale
from fwclass.stage import Chunk
from fwclass.units import QUANTUM

BATCH = 4096
"""Cells, or echoes, that are worked on together."""

OF_THE_ECHO = ("height_above_mean", "height_above_lowest", "height_below_highest")
"""What differs between the echoes of a cell."""


def cells(chunk: Chunk, scale: Scale, bases: tuple[str, ...]) -> dict[str, NDArray[np.float32]]:
    """Features `bases` of the core rows, by base, over all rows of the chunk in their cell of edge ``scale.size`` [cm].

    Cells are half-open and hang on the global origin. Sums are taken relative to the cell's lowest echo. A cell that
    owns a core row must lie in the chunk: a halo of one edge does it.
    """
    order, start, own = _cells(chunk, scale.millimetres, scale.millimetres)
    z = millimetres(chunk.table["z"])
    needed = needs(bases)
    attributes = Attributes.of(chunk.table, needed)
    of_cell = {base: np.empty(len(start) - 1, np.float32) for base in bases if base not in OF_THE_ECHO}
    sums = np.empty((4, len(start) - 1))
    for first in range(0, len(start) - 1, BATCH):
        part = slice(first, min(first + BATCH, len(start) - 1))
        moments = np.zeros((MOMENTS, part.stop - first))
        moments[AREA] = scale.metres**2
        _fill(z, order, start[first : part.stop + 1], *attributes, needed.powers, moments, sums[:, part])
        for base, values in of_cell.items():
            measure(CODE[base], moments, np.empty((SHAPES, 0)), values[part])
    of_echo = _of_echoes(tuple(b for b in bases if b in OF_THE_ECHO), z[chunk.core], sums[:, own[chunk.core]])
    return {base: of_echo[base] if base in of_echo else of_cell[base][own[chunk.core]] for base in bases}


def height_in_cell(chunk: Chunk, cell_x: float, cell_y: float) -> NDArray[np.float64]:
    """z of the core rows minus the lowest z of all rows in their cell [m].

    Cells hang on the global origin; the lowest is the plain minimum, as Fan 2013 has it.
    """
    edges = (whole_millimetres(cell_x, "features.cell_x"), whole_millimetres(cell_y, "features.cell_y"))
    order, start, own = _cells(chunk, *edges)
    z = millimetres(chunk.table["z"])
    lowest = np.minimum.reduceat(z[order], start[:-1]) if len(z) else z
    return np.asarray((z[chunk.core] - lowest[own[chunk.core]]) * QUANTUM, np.float64)


def _cells(chunk: Chunk, edge_x: int, edge_y: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows by cell; the first of every taken cell, one more at the end; the cell of every row."""
    if chunk.table.rows == 0:
        return np.empty(0, np.int64), np.zeros(1, np.int64), np.empty(0, np.int64)
    col, row = millimetres(chunk.table["x"]) // edge_x, millimetres(chunk.table["y"]) // edge_y
    number = (row - row.min()) * (col.max() - col.min() + 1) + (col - col.min())
    order = np.argsort(number, kind="stable")
    new = np.diff(number[order], prepend=-1) != 0
    own = np.empty(len(order), np.int64)
    own[order] = np.cumsum(new) - 1
    return order, np.append(np.flatnonzero(new), len(order)), own


@kernel
def _fill(z, order, start, kinds, amplitude, width, intensity, powers, moments, sums):  # type: ignore[no-untyped-def]
    """Moments of the cells ``order[start[k]:start[k + 1]]``; `sums`: N, sum of heights above the lowest, lowest,
    highest [mm]."""
    m = np.zeros(MOMENTS)
    for k in range(len(start) - 1):
        at = order[start[k] : start[k + 1]]
        lowest = z[at[0]]
        for j in at:
            lowest = min(lowest, z[j])
        heights = np.empty(len(at))
        for e in range(len(at)):
            heights[e] = float(z[at[e]] - lowest)
        m[:] = 0.0
        m[AREA] = moments[AREA, k]
        add_heights(heights, m)
        add_spread(heights, powers, m)
        add_attributes(kinds, amplitude, width, intensity, at, m)
        moments[:, k] = m
        sums[0, k], sums[1, k], sums[2, k], sums[3, k] = m[N], m[Z], float(lowest), float(lowest) + m[HIGH]


def _of_echoes(bases: Iterable[str], z: NDArray[np.int64], sums: NDArray[np.float64]) -> dict[str, NDArray[np.float32]]:
    """Bases of `OF_THE_ECHO` of echoes of height `z` [mm] from the `sums` of their cells."""
    features = {base: np.empty(len(z), np.float32) for base in bases}
    for first in range(0, len(z) if features else 0, BATCH):
        part = slice(first, min(first + BATCH, len(z)))
        n, total, low, high = sums[:, part]
        moments = np.zeros((MOMENTS, part.stop - first))
        moments[N], moments[Z] = n, total - n * (z[part] - low)
        moments[LOW], moments[HIGH] = low - z[part], high - z[part]
        for base, values in features.items():
            measure(CODE[base], moments, np.empty((SHAPES, 0)), values[part])
    return features
