"""What the neighbours of an echo are, by the answers of a first layer: mean shares of every class in boxes of a fixed
lattice, for a second layer to decide by.

Source: auto-context (Tu and Bai 2010, IEEE TPAMI 32(10)); boxes, whole-number shares and the mean of both layers are
ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.shares import answer
from fwclass.grid import millimetres, whole_millimetres
from fwclass.kernel import kernel
from fwclass.model import Model
from fwclass.model.contextual import WHOLE
from fwclass.schema import Table
from fwclass.stage import Computation

CONTEXT = Computation(name="context", version=1, writes=())

REACH = 2
"""Cells that a box reaches beyond the echo's own on every side."""


def halo_of(cells: Iterable[float]) -> float:
    """Distance around an echo within which all boxes of cells of these edges [m] lie."""
    return (REACH + 1) * max(cells, default=0.0)


def whole_shares(X: NDArray[np.float32], model: Model) -> NDArray[np.uint8]:
    """uint8 (rows, classes): the shares that `model` gives the rows of X (rows, features), in 255ths. Sums of them are
    exact, whatever their order."""
    return np.rint(answer(X, model)[1] * WHOLE).astype(np.uint8)


def coarse_share_columns(codes: Iterable[int], base: str = "coarse_share") -> tuple[str, ...]:
    """Names of the columns with the first layer's share of every class."""
    return tuple(f"{base}_{int(code)}" for code in codes)


def context_of(
    table: Table, core: NDArray[np.int64], columns: Sequence[str], cells: Iterable[float]
) -> NDArray[np.uint8]:
    """uint8 (core rows, features), in the order of `model.contextual.context_names`: the own shares and the means of
    the boxes, in 255ths.

    Parameters
    ----------
    table : x, y, z and `columns` (uint8, 255ths) of the `core` rows, and of rows as far around as `halo_of` says.
    cells : edges of cells [m]. They hang on the global origin; a box is the echo's own cell and `REACH` more on every
        side, in plan (all heights) and in space.
    """
    shares = np.stack([table[n] for n in columns], axis=1)
    place = np.stack([millimetres(table[n]) for n in ("x", "y", "z")], axis=1)
    parts = [shares[core]]
    for edge in cells:
        parts += _means(place, shares, core, whole_millimetres(edge, "classify.context.cells"))
    return np.concatenate(parts, axis=1)


def _means(
    place: NDArray[np.int64], shares: NDArray[np.uint8], core: NDArray, edge: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """uint8 (core rows, classes): means of the boxes in plan and in space."""
    cell = place // edge
    if len(cell):
        cell -= cell.min(axis=0)
    width, depth = int(cell[:, 1].max(initial=0)) + 2 * REACH + 1, int(cell[:, 2].max(initial=0)) + 1
    key, level = cell[:, 0] * width + cell[:, 1], cell[:, 2]
    few = (int(key.max(initial=0)) + 1) * depth < 1 << 63  # one number for a cell is sorted in half the time
    order = np.argsort(key * depth + level) if few else np.lexsort((level, key))
    key, level = key[order], level[order]
    begins = np.ones(len(order), bool)
    begins[1:] = (key[1:] != key[:-1]) | (level[1:] != level[:-1])
    start = np.flatnonzero(begins)
    total = np.zeros((len(start) + 1, shares.shape[1] + 1), np.int64)
    for k, values in enumerate(shares[order].T):
        np.cumsum(np.add.reduceat(values, start, dtype=np.int64) if len(start) else start, out=total[1:, k])
    total[1:, -1] = np.append(start[1:], len(order))
    key, level = key[start], level[start]
    column = np.flatnonzero(np.append(True, key[1:] != key[:-1])) if len(key) else start
    plan, space = (np.empty((len(start), shares.shape[1]), np.uint8) for _ in range(2))
    first = np.append(column, len(start))
    _average(key[column], first, level, total, width, REACH, plan, space)
    of_row = np.empty(len(order), np.int64)
    of_row[order] = np.cumsum(begins) - 1
    return plan[of_row[core]], space[of_row[core]]


@kernel
def _average(
    column: NDArray[np.int64],
    first: NDArray[np.int64],
    level: NDArray[np.int64],
    total: NDArray[np.int64],
    width: int,
    reach: int,
    plan: NDArray[np.uint8],
    space: NDArray[np.uint8],
) -> None:
    """Means over boxes of voxels.

    Column c of voxels has key ``column[c]`` (x times `width` plus y, rising) and voxels ``first[c]`` to
    ``first[c + 1]`` with rising `level`; `total` (voxels + 1, classes + 1) are sums up to each, the last of rows.
    Writes `plan` and `space` (voxels, classes).
    """
    classes = total.shape[1] - 1
    near = np.empty((2 * reach + 1) ** 2, np.int64)
    low = np.empty(len(near), np.int64)
    high = np.empty(len(near), np.int64)
    sums = np.empty(classes + 1, np.int64)
    for c in range(len(column)):
        count = 0
        for step in range(-reach, reach + 1):
            at = column[c] + step * width
            other = np.searchsorted(column, at - reach)
            while other < len(column) and column[other] <= at + reach:
                near[count], low[count], high[count] = other, first[other], first[other]
                count += 1
                other += 1
        sums[:] = 0
        for n in range(count):
            for k in range(classes + 1):
                sums[k] += total[first[near[n] + 1], k] - total[first[near[n]], k]
        for k in range(classes):
            plan[first[c], k] = (2 * sums[k] + sums[classes]) // (2 * sums[classes])
        for voxel in range(first[c], first[c + 1]):
            for k in range(classes):
                plan[voxel, k] = plan[first[c], k]
            sums[:] = 0
            for n in range(count):
                end = first[near[n] + 1]
                while low[n] < end and level[low[n]] < level[voxel] - reach:
                    low[n] += 1
                while high[n] < end and level[high[n]] <= level[voxel] + reach:
                    high[n] += 1
                for k in range(classes + 1):
                    sums[k] += total[high[n], k] - total[low[n], k]
            for k in range(classes):
                space[voxel, k] = (2 * sums[k] + sums[classes]) // (2 * sums[classes])


def with_context(X: NDArray[np.float32], context: NDArray[np.uint8]) -> NDArray[np.float32]:
    """float32 (rows, features): features X of rows and their `context_of`, which the second layer sees as 0 to 1; as
    ``Contextual.deciding`` names them."""
    return np.concatenate([X, context.astype(np.float32) / np.float32(WHOLE)], axis=1)


def context_from(X: NDArray[np.float32]) -> NDArray[np.uint8]:
    """uint8 (rows, context): what `with_context` made these columns (rows, context) of."""
    return np.rint(X * np.float32(WHOLE)).astype(np.uint8)
