"""Counts of right and wrong echoes by blocks of the global grid, whatever the tiles were."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import TileGrid
from fwclass.model import ClassDef, class_index, code_index


@dataclass(frozen=True)
class BlockCounts:
    """Confusion matrices of blocks, sorted by place; only blocks with a reference class.

    Attributes
    ----------
    place : int64 (blocks, 2), column and row of the block in the global grid.
    counts : int64 (blocks, classes, classes + 1), rows reference, columns predicted, last those without a class.
    """

    place: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        reference: NDArray[np.uint8],
        predicted: NDArray[np.uint8],
        classes: Sequence[ClassDef],
        size: float,
    ) -> BlockCounts:
        """Of echoes at (x, y) [m], by blocks of edge `size` [m]; rows without a reference class are left out."""
        n = len(classes)
        truth, answer = class_index(reference, classes), code_index(predicted, classes)
        known = np.flatnonzero(truth >= 0)
        place, block = _unique_places(*TileGrid(size).indices(x[known], y[known]))
        column = np.where(answer[known] >= 0, answer[known], n).astype(np.int64)
        cell = (block * n + truth[known]) * (n + 1) + column
        counts = np.bincount(cell, minlength=len(place) * n * (n + 1)).reshape(len(place), n, n + 1)
        return cls(place, counts.astype(np.int64))

    @classmethod
    def merged(cls, parts: Iterable[BlockCounts], classes: int) -> BlockCounts:
        """The same blocks added up, int64 (blocks, classes, classes + 1): tiles may cut a block; no parts give no
        blocks."""
        all_parts = list(parts)
        none = [cls(np.empty((0, 2), np.int64), np.empty((0, classes, classes + 1), np.int64))]
        place = np.concatenate([p.place for p in all_parts or none])
        counts = np.concatenate([p.counts for p in all_parts or none])
        once, block = np.unique(place, axis=0, return_inverse=True)
        total = np.zeros((len(once), *counts.shape[1:]), np.int64)
        np.add.at(total, block.reshape(-1), counts)
        return cls(once.reshape(-1, 2), total)


def _unique_places(column: NDArray[np.int64], row: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places that occur, (places, 2), sorted, and the number of each echo's; a tenth of the time of `np.unique` of
    pairs."""
    left, low = int(column.min(initial=0)), int(row.min(initial=0))
    rows = int(row.max(initial=0)) - low + 1
    once, number = np.unique((column - left) * rows + (row - low), return_inverse=True)
    return np.stack([once // rows + left, once % rows + low], axis=1), number
