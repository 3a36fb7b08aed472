"""Echoes of one kind in cells of the global raster: counts, confidence, heights; and what hangs together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.pieces import pieces_of
from fwclass.schema import Table
from fwclass.vectors.params import VectorParams

APART = 2
"""Cells around one on the ground that hold no buildings together: an alley is as wide as a cell, and has an echo on the
ground in every second one."""

REGROWN = 5
"""Cells that a building grows back by: what a cell on the ground beside it, and an opening, take of its corners."""

MARGIN = 7 + APART + REGROWN
"""Cells around a window that decide which of its cells are of a building: a closing and two openings by one cell, what
is held apart, what grows back, and what meets."""

EIGHT = np.ones((3, 3), bool)
"""Neighbours by a side or a corner."""


@dataclass(frozen=True)
class Counts:
    """Of the cells of a window, row 0 in the south.

    Attributes
    ----------
    low : bool, an echo of another class lies near the ground.
    echoes, rated : int64, echoes, and those of them with a confidence.
    percent : int64, sum of their confidences in whole percent.
    top : float32, greatest height above ground [m], NaN where none is known.
    """

    low: NDArray[np.bool_]
    echoes: NDArray[np.int64]
    rated: NDArray[np.int64]
    percent: NDArray[np.int64]
    top: NDArray[np.float32]

    def within(self, part: tuple[slice, slice]) -> Counts:
        """Of the cells of a part of the window."""
        return Counts(self.low[part], self.echoes[part], self.rated[part], self.percent[part], self.top[part])


def count_cells(table: Table, window: Window, codes: Sequence[int], low: float) -> Counts:
    """Echoes of classes `codes` in the cells of `window`, and where others lie less than `low` [m] above the ground.

    `table` has x, y, height_above_ground, classification and confidence; what lies outside the window is left out.
    Sums are of whole numbers, so that the rows' order does not count.
    """
    place, inside = _places(table, window)
    table = table.take(inside)
    mine, height = np.isin(table["classification"], codes), table["height_above_ground"]
    cells = window.nrows * window.ncols
    beneath = np.bincount(place[~mine & (height < low)], minlength=cells) > 0
    place, height, sure = place[mine], height[mine], table["confidence"][mine].astype(np.float64)
    rated, known = np.isfinite(sure), np.isfinite(height)
    top = np.full(cells, -np.inf, np.float32)
    np.maximum.at(top, place[known], height[known])
    percent = np.bincount(place[rated], np.rint(100.0 * sure[rated]), cells)
    return Counts(
        beneath.reshape(window.shape),
        np.bincount(place, minlength=cells).reshape(window.shape),
        np.bincount(place[rated], minlength=cells).reshape(window.shape),
        percent.astype(np.int64).reshape(window.shape),
        np.where(np.isfinite(top), top, np.nan).astype(np.float32).reshape(window.shape),
    )


def highest_around(
    table: Table, window: Window, codes: Sequence[int], places: NDArray[np.int64], reach: int
) -> NDArray[np.float64]:
    """Greatest height above ground [m] of echoes of `codes` no further in plan than `reach` cells from the middle of
    each of the cells `places` int64 (n, 2), row and column; NaN where there is none.

    `table` has x, y, height_above_ground and classification. Distances are whole numbers: no rounding decides.
    """
    out = np.full(len(places), -np.inf)
    number = np.full((window.nrows + 2 * reach, window.ncols + 2 * reach), -1)
    number[tuple(places.T + reach)] = np.arange(len(places))
    square = np.ones((2 * reach + 1, 2 * reach + 1), bool)
    near = scipy.ndimage.binary_dilation(number >= 0, square)[
        reach : reach + window.nrows, reach : reach + window.ncols
    ]
    at, inside = _places(table, window)
    rows = np.flatnonzero(inside)[near.ravel()[at]]
    rows = rows[np.isin(table["classification"][rows], codes) & np.isfinite(table["height_above_ground"][rows])]
    mm = whole_millimetres(window.cell, "cell")
    x, y = (millimetres(table[n][rows]) - mm * first for n, first in (("x", window.col), ("y", window.row)))
    col, row, height = x // mm, y // mm, table["height_above_ground"][rows]
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            of = number[row + reach + down, col + reach + right]
            aside, along = 2 * x - (2 * (col + right) + 1) * mm, 2 * y - (2 * (row + down) + 1) * mm
            some = (of >= 0) & (aside**2 + along**2 <= (2 * reach * mm) ** 2)
            np.maximum.at(out, of[some], height[some])
    return np.where(np.isfinite(out), out, np.nan)


@dataclass(frozen=True)
class Passage:
    """How far pulses come through vegetation, of the cells of a window: int64, row 0 in the south.

    Attributes
    ----------
    pulses : that end in the cell, by their last echo.
    through : those of them that end near the ground.
    echoes : of vegetation away from the ground.
    """

    pulses: NDArray[np.int64]
    through: NDArray[np.int64]
    echoes: NDArray[np.int64]

    def within(self, part: tuple[slice, slice]) -> Passage:
        """Of the cells of a part of the window."""
        return Passage(self.pulses[part], self.through[part], self.echoes[part])


def count_passage(table: Table, last: NDArray[np.bool_], window: Window, codes: Sequence[int], clear: float) -> Passage:
    """Pulses in the cells of `window`, of which the echoes `last` (rows,) are the ends, and echoes of `codes` that lie
    `clear` [m] above the ground and more; echoes without a height do not count.

    `table` has x, y, height_above_ground and classification.
    """
    place, inside = _places(table, window)
    high = table["height_above_ground"][inside] >= clear
    ends = last[inside] & np.isfinite(table["height_above_ground"][inside])
    mine = np.isin(table["classification"][inside], codes)
    cells = window.nrows * window.ncols
    pulses, through, echoes = (
        np.bincount(place[some], minlength=cells).reshape(window.shape) for some in (ends, ends & ~high, mine & high)
    )
    return Passage(pulses, through, echoes)


def _places(table: Table, window: Window) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The cells of the echoes that lie in a window, row by row, and which these are."""
    mm = whole_millimetres(window.cell, "cell")
    col, row = millimetres(table["x"]) // mm - window.col, millimetres(table["y"]) // mm - window.row
    inside = (col >= 0) & (row >= 0) & (col < window.ncols) & (row < window.nrows)
    return (row * window.ncols + col)[inside], inside


def roofs(counts: Counts) -> NDArray[np.bool_]:
    """Cells that buildings cover, bool (rows, columns), each building apart from the next by a cell at least.

    Gaps of a cell are closed where nothing lies on the ground, and what is narrower than three cells is taken away.
    What hangs together away from cells on the ground is one building; it grows back over what was taken away, `REGROWN`
    cells at most. What is too narrow for that, as a shed is, is one of its own. Where two meet a cell is left out.

    A cell within `MARGIN` of the edge may lack what lies beyond.
    """
    there = counts.echoes > 0
    closed = scipy.ndimage.binary_closing(np.pad(there, 1), EIGHT)[1:-1, 1:-1]
    ground = counts.low & ~there
    cover = scipy.ndimage.binary_opening(closed & ~ground, EIGHT)
    inner = closed & ~scipy.ndimage.binary_dilation(ground, EIGHT, APART)
    labels, _ = scipy.ndimage.label(scipy.ndimage.binary_opening(inner, EIGHT), EIGHT)
    for _ in range(REGROWN):
        near = scipy.ndimage.maximum_filter(labels, 3, mode="constant")
        labels = np.where((labels == 0) & cover, near, labels)
    narrow, _ = scipy.ndimage.label(scipy.ndimage.binary_opening(cover & (labels == 0), EIGHT), EIGHT)
    labels = np.where(narrow > 0, narrow + labels.max(initial=0), labels)
    return np.asarray((labels > 0) & ~_touching(labels))


def _touching(labels: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Cells with another label beside them, in the east or in the row north of them."""
    wide = np.pad(labels, 1)
    middle = wide[1:-1, 1:-1]
    beside = (wide[1:-1, 2:], wide[2:, :-2], wide[2:, 1:-1], wide[2:, 2:])
    return np.asarray((middle > 0) & np.any([(other > 0) & (other != middle) for other in beside], axis=0))


def pieces(mask: NDArray[np.bool_], counts: Counts, window: Window) -> tuple[Table, Table]:
    """The cells of `mask`, bool (rows, columns), as two tables, piece by piece: of those that lie inside `window`, and
    of those that reach its edge and may go on beyond it.

    Columns are `CELL_COLUMNS`; `component` numbers the pieces of both.
    """
    labels, number = scipy.ndimage.label(mask, EIGHT)
    rows, cols = np.nonzero(labels)
    which = labels[rows, cols]
    table = Table(
        {
            "component": which,
            "cell_row": rows + window.row,
            "cell_column": cols + window.col,
            "cell_echoes": counts.echoes[rows, cols],
            "cell_rated": counts.rated[rows, cols],
            "cell_percent": counts.percent[rows, cols],
            "cell_top": counts.top[rows, cols],
        }
    )
    edge = (rows == 0) | (cols == 0) | (rows == window.nrows - 1) | (cols == window.ncols - 1)
    reaching = np.zeros(number + 1, bool)
    reaching[which[edge]] = True
    order = np.argsort(which, kind="stable")
    beyond = reaching[which[order]]
    return table.take(order[~beyond]), table.take(order[beyond])


def join_cells(cells: Table) -> Table:
    """Cells of many windows, numbered anew by what touches by a side or a corner; by piece, row and column."""
    order = np.lexsort((cells["cell_column"], cells["cell_row"]))
    cells = cells.take(order)
    piece = pieces_of(cells["cell_row"].astype(np.int64), cells["cell_column"].astype(np.int64))
    cells = cells.with_columns({"component": piece})
    return cells.take(np.argsort(piece, kind="stable"))


def by_piece(cells: Table) -> list[Table]:
    """The cells of every piece, as `pieces` and `join_cells` order them."""
    first = np.flatnonzero(np.diff(cells["component"], prepend=-1, append=-1)) if cells.rows else np.zeros(1, int)
    return [cells.take(np.arange(a, b)) for a, b in zip(first[:-1], first[1:], strict=True)]


CELL_COLUMNS = ("component", "cell_row", "cell_column", "cell_echoes", "cell_rated", "cell_percent", "cell_top")


def pulses_by_square(x: NDArray[np.float64], y: NDArray[np.float64], window: Window) -> dict[int, int]:
    """How many squares of `window` hold each number of pulses, whose last echoes lie at (x, y) [m]; none with none."""
    mm = whole_millimetres(window.cell, "vectors.square")
    col, row = millimetres(x) // mm - window.col, millimetres(y) // mm - window.row
    inside = (col >= 0) & (row >= 0) & (col < window.ncols) & (row < window.nrows)
    counts = np.bincount((row * window.ncols + col)[inside])
    number, squares = np.unique(counts[counts > 0], return_counts=True)
    return dict(zip(number.tolist(), squares.tolist(), strict=True))


def median_density(squares: Mapping[int, int], edge: float) -> float:
    """Median over squares of `edge` [m] that hold a pulse of how many they hold [1/m2]; 0 without any."""
    numbers = sorted(squares)
    below = np.cumsum([squares[n] for n in numbers])
    return numbers[int(np.searchsorted(below, 0.5 * below[-1]))] / edge**2 if numbers else 0.0


def cell_of(density: float, params: VectorParams) -> float:
    """Edge of the cells for a density of pulses [1/m2]: the smallest that is not finer than their spacing, the largest
    where none is [m]."""
    if density <= 0.0:
        return params.cells[-1]
    least = params.finer / density**0.5
    return next((cell for cell in params.cells if cell >= least), params.cells[-1])
