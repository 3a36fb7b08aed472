"""Clouds held whole in memory, worked on in the same blocks of the fixed global grid as a survey in tiles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Tile, TileGrid
from fwclass.ground.filters import Flags, ground_points
from fwclass.ground.params import GroundParams


def blocks_of(
    x: NDArray[np.float64], y: NDArray[np.float64], size: float, halo: float
) -> Iterator[tuple[Tile, NDArray[np.int64], NDArray[np.bool_]]]:
    """Every block that owns a point: (block, rows of its points and of those within `halo`, which of them it owns)."""
    if len(x) == 0:
        return
    grid = TileGrid(size)
    ix, iy = grid.indices(x, y)
    order = np.lexsort((iy, ix))
    first = np.flatnonzero(np.r_[True, (np.diff(ix[order]) != 0) | (np.diff(iy[order]) != 0)])
    rows = {
        (int(ix[order[a]]), int(iy[order[a]])): order[a:b] for a, b in zip(first, [*first[1:], len(x)], strict=True)
    }
    for cx, cy in sorted(rows):
        block = Tile(cx, cy, size)
        box = block.box.grown(halo)
        near = [rows[t.ix, t.iy] for t in grid.touching(box) if (t.ix, t.iy) in rows]
        members = np.sort(np.concatenate(near))
        members = members[box.contains(x[members], y[members])]
        yield block, members, (ix[members] == cx) & (iy[members] == cy)


def ground_by_blocks(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    last: NDArray[np.bool_],
    params: GroundParams,
) -> Flags:
    """`ground_points` of a whole cloud, block by block: what a survey in tiles would get.

    x, y, z (n,) [m] and `last` (n,) as in `ground_points`; none of them is NaN.
    """
    flags = Flags(np.zeros(len(x), bool), np.zeros(len(x), bool))
    for _, rows, own in blocks_of(x, y, params.block, params.halo):
        block_flags = ground_points(x[rows], y[rows], z[rows], last[rows], params)
        flags.ground[rows[own]], flags.noise[rows[own]] = block_flags.ground[own], block_flags.noise[own]
    return flags
