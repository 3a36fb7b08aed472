"""Normals that agree on a side: it spreads from surfaces open to the sky to their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.features.spheres import AT_A_TIME
from fwclass.kernel import kernel
from fwclass.neighbours import CellIndex
from fwclass.stage import Chunk

SURE = np.cos(np.radians(30.0))
"""A normal less than 30 degrees off the vertical, with nothing above it, points up."""

STEPS = float(1 << 20)
"""Agreement of two normals is counted in whole parts of 1, so that its sum has no order."""


def sides(chunk: Chunk, normals: NDArray[np.float64], radius: float, rounds: int) -> NDArray[np.int8]:
    """int8 (rows,): 1 where the upward normal is the oriented one, -1 where its opposite is, 0 where no round came.

    `normals` float64 (rows, 3) of unit length, NaN where there is none; `radius` of the neighbourhoods [m].
    """
    table = chunk.table
    if table.rows == 0:
        return np.empty(0, np.int8)
    index = CellIndex.build(table["x"], table["y"], table["z"], cell=radius)
    sorted_normals = normals[index.order]
    side = np.zeros(table.rows, np.int8)
    grid = (index.x, index.y, index.z, index.start, index.ncols, index.nrows, index.cell)
    step = max(AT_A_TIME // (9 * int(np.diff(index.start).max())), 1)
    parts = [(begin, min(begin + step, table.rows)) for begin in range(0, table.rows, step)]
    for part in parts:
        _seed(*grid, sorted_normals, SURE, *part, side)
    for _ in range(rounds):
        before = side.copy()
        if sum(_spread(*grid, sorted_normals, before, *part, side) for part in parts) == 0:
            break
    out = np.empty(table.rows, np.int8)
    out[index.order] = side
    return out


@kernel
def _seed(x, y, z, start, ncols, nrows, radius, normals, sure, begin, end, side):  # type: ignore[no-untyped-def]
    """Side 1 where the normal is near the vertical and nothing is higher by more than the radius; of sorted points
    ``begin … end - 1``."""
    for row in range(nrows):
        for col in range(ncols):
            cell = row * ncols + col
            for i in range(max(start[cell], begin), min(start[cell + 1], end)):
                if normals[i, 2] >= sure and _open(x, y, z, start, ncols, nrows, radius, row, col, i):
                    side[i] = 1


@kernel
def _open(x, y, z, start, ncols, nrows, radius, row, col, i):  # type: ignore[no-untyped-def]
    """No echo within `radius` in plan is higher by more than it."""
    for r in range(max(row - 1, 0), min(row + 2, nrows)):
        for j in range(start[r * ncols + max(col - 1, 0)], start[r * ncols + min(col + 2, ncols)]):
            dx, dy = x[j] - x[i], y[j] - y[i]
            if z[j] - z[i] > radius and dx * dx + dy * dy <= radius * radius:
                return False
    return True


@kernel
def _spread(x, y, z, start, ncols, nrows, radius, normals, before, begin, end, side):  # type: ignore[no-untyped-def]
    """One round: of sorted points ``begin … end - 1`` those without a side in `before` get one in `side` from those
    with one; how many did."""
    changed = 0
    for row in range(nrows):
        for col in range(ncols):
            cell = row * ncols + col
            for i in range(max(start[cell], begin), min(start[cell + 1], end)):
                if before[i] == 0 and normals[i, 2] >= 0.0:
                    votes = _votes(x, y, z, start, ncols, nrows, radius, row, col, i, normals, before)
                    if votes != 0:
                        side[i] = 1 if votes > 0 else -1
                        changed += 1
    return changed


@kernel
def _votes(x, y, z, start, ncols, nrows, radius, row, col, i, normals, before):  # type: ignore[no-untyped-def]
    """Sum of side times agreement over the neighbours of point i, in whole parts of `STEPS`."""
    votes = np.int64(0)
    for r in range(max(row - 1, 0), min(row + 2, nrows)):
        for j in range(start[r * ncols + max(col - 1, 0)], start[r * ncols + min(col + 2, ncols)]):
            if before[j] != 0:
                dx, dy, dz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                if dx * dx + dy * dy + dz * dz <= radius * radius:
                    dot = normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1] + normals[i, 2] * normals[j, 2]
                    votes += before[j] * np.int64(np.rint(dot * STEPS))
    return votes
