"""Kernels of the mean field: the nearest echoes and their weights, and one round of all echoes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel


@kernel
def weigh(
    asked: NDArray[np.int64],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    z: NDArray[np.int64],
    rank: NDArray[np.int64],
    start: NDArray[np.int64],
    ncols: int,
    nrows: int,
    cell: int,
    reach: int,
    near: NDArray[np.int32],
    weight: NDArray[np.int32],
) -> None:
    """Writes the nearest others of the rows `asked`, and their weights [1/256], int32 (asked, neighbours), -1 and 0
    where there are fewer.

    `x`, `y`, `z` (points,) [mm] are sorted by cells of edge `cell` [mm], the first at 0; cell k begins at ``start[k]``.
    Of equally near ones those of lower `rank` (points,) count; it rises within a cell.
    """
    count = near.shape[1]
    best = np.empty(count, np.int64)
    limit = reach * reach
    for a in range(len(asked)):
        i = asked[a]
        c, r = x[i] // cell, y[i] // cell
        west, south = x[i] - c * cell, y[i] - r * cell
        inner = min(west, cell - west, south, cell - south)
        held, ring = 0, 0
        while True:
            for row in range(max(r - ring, 0), min(r + ring, nrows - 1) + 1):
                step = 1 if ring == 0 or row == r - ring or row == r + ring else 2 * ring
                for col in range(c - ring, c + ring + 1, step):
                    if col < 0 or col >= ncols:
                        continue
                    at = row * ncols + col
                    for j in range(start[at], start[at + 1]):
                        if held == count and best[count - 1] == 0:  # crowds at one place: all others have higher ranks
                            break
                        dx, dy, dz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                        apart = dx * dx + dy * dy + dz * dz
                        if apart > limit or j == i:
                            continue
                        k = held
                        if held == count:
                            k = count - 1
                            if apart > best[k] or (apart == best[k] and rank[j] > rank[near[a, k]]):
                                continue
                        else:
                            held += 1
                        while k > 0 and (
                            apart < best[k - 1] or (apart == best[k - 1] and rank[j] < rank[near[a, k - 1]])
                        ):
                            best[k], near[a, k] = best[k - 1], near[a, k - 1]
                            k -= 1
                        best[k], near[a, k] = apart, j
            seen = inner + ring * cell
            if seen > reach or (held == count and best[count - 1] < seen * seen):
                break
            if r - ring <= 0 and c - ring <= 0 and r + ring >= nrows - 1 and c + ring >= ncols - 1:
                break
            ring += 1
        end = (best[count - 1] if held == count else limit) + 1
        for k in range(held):
            weight[a, k] = (256 * (end - best[k])) // end


@kernel
def agree(
    asked: NDArray[np.int64],
    before: NDArray[np.uint8],
    now: NDArray[np.uint8],
    near: NDArray[np.int32],
    weight: NDArray[np.int32],
    cost: NDArray[np.float64],
    strength: float,
    after: NDArray[np.uint8],
    answers: NDArray[np.float64],
) -> None:
    """One round for the rows `asked`: `after` (points, classes) [1/255] and `answers` (asked, classes), of the own
    shares `before`, those of neighbours `now`, and ``cost``, the logarithm of every share in 255ths."""
    classes = before.shape[1]
    sums = np.empty(classes, np.int64)
    for a in range(len(asked)):
        i = asked[a]
        sums[:] = 0
        for k in range(near.shape[1]):
            j = near[a, k]
            if j < 0:
                break
            for c in range(classes):
                sums[c] += weight[a, k] * now[j, c]
        most = -np.inf
        for c in range(classes):
            answers[a, c] = cost[before[i, c]] + strength * sums[c]
            most = max(most, answers[a, c])
        total = 0.0
        for c in range(classes):
            answers[a, c] = np.exp(answers[a, c] - most)
            total += answers[a, c]
        for c in range(classes):
            answers[a, c] /= total
            after[i, c] = np.uint8(np.rint(255.0 * answers[a, c]))
