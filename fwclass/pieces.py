"""Which cells of the global grid hang together."""

from __future__ import annotations

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray


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
    links = scipy.sparse.coo_array((np.ones(len(one), bool), (one, other)), (len(key), len(key)))
    _, piece = scipy.sparse.csgraph.connected_components(links, directed=False)
    return np.asarray(piece, np.int32)
