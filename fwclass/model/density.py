"""How dense the echoes are that a model learned from, and those that it answers for."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

DENSITY = "density"
"""Key of a model's card: echoes per m² of its training areas."""

_EDGE = 4000
"""mm, squares of the global grid that echoes are counted in: at 0.3/m² five lie in one."""


def count_in_squares(x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 (squares, 3): column and row on the global grid of every square that holds an echo, and how many it holds;
    `x` and `y` (rows,) in mm."""
    column, row = x // _EDGE, y // _EDGE
    low = int(row.min(initial=0))
    width = int(row.max(initial=0)) - low + 1
    square, counts = np.unique(column * width + row - low, return_counts=True)  # rows of numbers take ten times as long
    return np.stack([square // width, square % width + low, counts], axis=1)


def density_of(counted: Iterable[NDArray[np.int64]]) -> float | None:
    """Echoes per m², the median over all squares that hold one; None without any. `counted`: of parts that share no
    echo, as `count_in_squares` gives them; squares may be cut by their borders."""
    parts = [*counted]
    if not sum(map(len, parts)):
        return None
    every = np.concatenate(parts)
    _, at = np.unique(every[:, :2], axis=0, return_inverse=True)
    return float(np.median(np.bincount(at.reshape(-1), every[:, 2]))) / (_EDGE * 0.001) ** 2
