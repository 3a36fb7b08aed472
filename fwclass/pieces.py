"""Which things hang together by pairs of them, and which cells of the global grid by their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MOST_BY_HAND = 100_000
"""Things that are grouped in 0.04 s; `scipy.sparse.csgraph` groups more sooner, and takes 0.2 s to load."""


def linked_groups(count: int, first: NDArray[np.integer], second: NDArray[np.integer]) -> NDArray[np.int64]:
    """int64 (count,): group of every one of `count` things that the pairs `first`, `second` (pairs,) link, numbered
    from 0 by their first things."""
    if count > MOST_BY_HAND:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        links = coo_array((np.ones(len(first), bool), (first, second)), (count, count))
        return np.asarray(connected_components(links, directed=False)[1], np.int64)
    lowest, before = np.arange(count), np.empty(0, np.int64)
    while not np.array_equal(lowest, before):
        before = lowest.copy()
        np.minimum.at(lowest, first, before[second])
        np.minimum.at(lowest, second, before[first])
        lowest = lowest[lowest]  # of the lowest one that hangs together with it, that one's
    return np.unique(lowest, return_inverse=True)[1].astype(np.int64)


def pieces_of(row: NDArray[np.int64], col: NDArray[np.int64]) -> NDArray[np.int32]:
    """int32 (cells,): the piece of every cell, numbered from 0 by their first cells; cells that touch by a side or a
    corner are of one piece. `row` and `col`, int64 (cells,), by row and column, each cell once."""
    if not len(row):
        return np.zeros(0, np.int32)
    wide = int(col.max() - col.min()) + 3
    key = row * wide + (col - col.min())
    ends = []
    for step in (1, wide - 1, wide, wide + 1):
        place = np.minimum(np.searchsorted(key, key + step), len(key) - 1)
        near = np.flatnonzero(key[place] == key + step)
        ends.append(np.stack([near, place[near]]))
    one, other = np.concatenate(ends, axis=1)
    return linked_groups(len(key), one, other).astype(np.int32)
