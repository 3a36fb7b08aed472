"""Every echo takes what its nearest sampled echo has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.neighbours import Points, nearest_within

DOUBLINGS = 5
"""The search begins at reach / 2^5 and doubles: most echoes are near to a sampled one, and a narrow search is quick."""


def index_of_followed(points: Points, sampled: NDArray[np.bool_], reach: float) -> NDArray[np.int64]:
    """For each of `points` the place, among the sampled ones, of the one that it follows: a sampled one itself.

    -1 where none is within `reach` [m].
    """
    places = np.empty(len(sampled), np.int64)
    places[sampled] = np.arange(int(sampled.sum()))
    others = ~sampled
    x, y, z = points
    places[others] = follow((x[others], y[others], z[others]), (x[sampled], y[sampled], z[sampled]), reach)
    return places


def follow(points: Points, sampled: Points, reach: float) -> NDArray[np.int64]:
    """For each of `points` (x, y, z) [m] the row of the nearest of `sampled` within `reach` [m], -1 if none.

    Exact; of equally near ones the one whose cell of the global grid comes first, then the lower row.
    """
    nearest = np.full(len(points[0]), -1, np.int64)
    rest = np.arange(len(nearest))
    for k in range(DOUBLINGS, -1, -1):
        if len(rest) == 0:
            break
        limit = reach if k == 0 else max(0.001, round(reach / 2**k, 3))
        near, _ = nearest_within((points[0][rest], points[1][rest], points[2][rest]), sampled, limit)
        hit = near >= 0
        nearest[rest[hit]] = near[hit]
        rest = rest[~hit]
    return nearest
