"""Places where many echoes are unsure: the work list."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

SHOWN = 0.8
"""Share of a place's echoes that its size is told of, so that one far echo does not make it large."""


@dataclass(frozen=True)
class Place:
    """Unsure echoes that lie together: how many, their middle, and how wide they are [m]."""

    echoes: int
    x: float
    y: float
    z: float
    size: float


def unsure_places(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], cell: float, most: int
) -> list[Place]:
    """Clusters of unsure echoes, the largest first.

    Squares of a global grid with edge `cell` [m] that touch, by a corner too, are one place: the result follows from
    the echoes alone, not from tiles or order.
    """
    if not len(x):
        return []
    squares, of = np.unique(np.floor(np.c_[x, y] / cell).astype(np.int64), axis=0, return_inverse=True)
    cluster = _joined(squares)[of.ravel()]
    count = np.bincount(cluster)
    out = []
    for k in np.argsort(-count, kind="stable")[:most].tolist():
        rows = np.flatnonzero(cluster == k)
        mx, my, mz = (float(np.median(v[rows])) for v in (x, y, z))
        far = np.hypot(x[rows] - mx, y[rows] - my)
        out.append(Place(len(rows), mx, my, mz, max(cell, 2.0 * float(np.quantile(far, SHOWN)))))
    return out


def _joined(squares: NDArray[np.int64]) -> NDArray[np.int32]:
    """The cluster of every square; `squares` ascend."""
    low = squares.min(axis=0) - 1
    width = int(squares[:, 1].max() - low[1]) + 2
    key = (squares[:, 0] - low[0]) * width + squares[:, 1] - low[1]
    pairs = []
    for step in (1, width - 1, width, width + 1):
        at = np.searchsorted(key, key + step)
        there = np.flatnonzero((at < len(key)) & (key[np.minimum(at, len(key) - 1)] == key + step))
        pairs.append(np.c_[there, at[there]])
    edges = np.concatenate(pairs)
    graph = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), (len(key), len(key)))
    return np.asarray(connected_components(graph, directed=False)[1], np.int32)
