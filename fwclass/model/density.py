"""How dense the echoes are that a model learned from, and those that it answers for: one measure of both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

DENSITY, BETWEEN = "density", "densities"
"""Keys of a model's card: `Densities` of its training areas, the middle one, and low and high."""

EDGE = 4.0
"""m, squares of the global grid that echoes are counted in: at 0.3/m² five lie in one."""


def squares_by_count(
    x: NDArray[np.int64], y: NDArray[np.int64], some: NDArray[np.bool_] | None = None
) -> dict[int, int]:
    """How many squares hold each number of echoes, those without any left out; `x` and `y` (echoes,) in mm. Of `some`
    (echoes,): the squares that hold one of these, with all of their echoes.

    So what is kept of n echoes has at most (2 n)^(1/2) numbers, and of parts that cut no square it adds up.
    """
    if not len(x):
        return {}
    mm = round(1000 * EDGE)
    column, row = x // mm, y // mm
    low = int(row.min())
    _, square, counts = np.unique(
        column * (int(row.max()) - low + 1) + row - low, return_inverse=True, return_counts=True
    )
    if some is not None:
        counts = counts[np.unique(square[some])]
    number, squares = np.unique(counts, return_counts=True)
    return dict(zip(number.tolist(), squares.tolist(), strict=True))


class Densities(NamedTuple):
    """Echoes per m² in the squares that echoes lie in: a tenth of the echoes has at most `low`, half at most `middle`,
    nine tenths at most `high`."""

    low: float
    middle: float
    high: float


def densities_of(parts: Iterable[Mapping[int, int]]) -> Densities | None:
    """How dense the echoes of all squares are that count; None without any. `parts`: of `squares_by_count`."""
    squares: Counter[int] = Counter()
    for part in parts:
        squares.update(part)
    if not squares:
        return None
    numbers = sorted(squares)
    below = np.cumsum([n * squares[n] for n in numbers])
    at = [int(np.searchsorted(below, share * below[-1])) for share in (0.1, 0.5, 0.9)]
    return Densities(*(numbers[k] / EDGE**2 for k in at))
