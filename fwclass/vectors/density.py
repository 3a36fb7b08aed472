"""How dense the pulses lie, and how fine cells may be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.vectors.params import VectorParams


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
