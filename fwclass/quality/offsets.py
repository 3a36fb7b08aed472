"""How far strips lie apart in plan: by roofs and slopes of all aspects that two of them see."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.hashing import hash_keys
from fwclass.quality.adjust import LEAST_SIGMA, ROUNDS, TUKEY
from fwclass.quality.planes import Planes, cell_pairs
from fwclass.units import SIGMA_PER_MAD

ALIKE = 0.1
"""Difference of two slopes from which on they are not of one surface."""

NEAR = 3.0
"""m in height, further apart they are not: 2 m in plan on a roof of 55 degrees."""

MOST = 200
"""Pairs of every two pieces of strips that are kept of a block: 30 tell the offset to a centimetre."""

LEAST, KNOWN = 20, 0.25
"""Pairs of every two strips, and the standard error of their offset [m], by which it is told."""

NO_TURN = 1e-4
"""Of the least eigenvalue of the slopes' second moments beside 1: slopes of one aspect do not tell both axes."""


@dataclass(frozen=True)
class SlopePairs:
    """Cells in which two pieces of strips see one steep plane.

    Attributes
    ----------
    first, second : numbers of the pieces, first < second, int32 (pairs,).
    east, north : slope, mean of both planes, float32.
    dz : height of the first less that of the second midway between the centres of their echoes [m], float64.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    east: NDArray[np.float32]
    north: NDArray[np.float32]
    dz: NDArray[np.float64]


def slope_pairs(planes: Planes, max_slope: float) -> SlopePairs:
    """Pairs of planes steeper than `max_slope` [deg] that two pieces see in one cell, at most `MOST` of every two:
    those whose cells have the smallest hashes, which are the same for any order of the echoes."""
    i, j, _ = cell_pairs(planes)
    dz = planes.steps(i, j)
    east, north = (planes.a[i] + planes.a[j]) / 2, (planes.b[i] + planes.b[j]) / 2
    alike = np.hypot(planes.a[i] - planes.a[j], planes.b[i] - planes.b[j]) <= ALIKE
    steep = np.hypot(east, north) > math.tan(math.radians(max_slope))
    some = np.flatnonzero(alike & steep & (np.abs(dz) <= NEAR))
    first, second = planes.piece[i[some]], planes.piece[j[some]]
    both = first << 32 | second
    drawn = hash_keys(0, ((planes.row[i[some]] << 32) + planes.col[i[some]]).astype(np.uint64))
    order = np.lexsort((drawn, both))
    begin = np.flatnonzero(np.diff(both[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(begin, np.diff(begin, append=len(order)))
    kept = order[rank < MOST]
    rows = some[kept]
    return SlopePairs(
        first[kept].astype(np.int32),
        second[kept].astype(np.int32),
        east[rows].astype(np.float32),
        north[rows].astype(np.float32),
        dz[rows],
    )


class Offsets:
    """Slopes that every two strips see, block by block."""

    def __init__(self) -> None:
        self._seen: dict[tuple[int, int], list[NDArray[np.float64]]] = {}

    def add(self, pairs: SlopePairs, number: NDArray[np.int64]) -> None:
        """Take in a block: `number` the strip of each of its pieces, int64 (pieces,)."""
        first, second = number[pairs.first], number[pairs.second]
        rows = np.stack([pairs.east, pairs.north, np.where(first > second, -pairs.dz, pairs.dz)]).astype(np.float64)
        low, high = np.minimum(first, second), np.maximum(first, second)
        for a, b in np.unique(np.stack([low, high], axis=1)[low != high], axis=0).tolist():
            self._seen.setdefault((a, b), []).append(rows[:, (low == a) & (high == b)])

    def facts(self, first: int, second: int, lift: float, flat: int) -> dict[str, Any] | None:
        """How far the first strip lies ``east`` and ``north`` of the second, their ``distance`` in plan, the larger
        standard ``error`` [m], and the number of ``slopes`` behind it; None where slopes do not tell.

        `lift`: mean height of the first above the second [m], over so many `flat` pairs of planes.
        """
        east, north, dz = np.concatenate(self._seen.get((first, second), [np.empty((3, 0))]), axis=1)
        if len(dz) < LEAST:
            return None
        design = np.stack([-east, -north, np.ones(len(dz))], axis=1)
        level = np.array([0.0, 0.0, 1.0])
        residual = np.zeros(len(dz))
        for k in range(2 * ROUNDS):
            size = np.abs(residual)
            spread = max(SIGMA_PER_MAD * float(np.median(size)), LEAST_SIGMA)
            if k < ROUNDS:  # least sums of |residual|: of slopes that face half of all ways the others are no outliers
                weight = spread / np.maximum(size, spread)
            else:
                weight = (1 - np.minimum(1.0, (size / (TUKEY * spread)) ** 2)) ** 2
            normal = design.T @ (design * weight[:, None]) + flat * np.outer(level, level)
            if np.linalg.eigvalsh(normal[:2, :2] / max(float(weight.sum()), 1.0))[0] < NO_TURN:
                return None
            x = np.linalg.solve(normal, design.T @ (weight * dz) + flat * lift * level)
            residual = dz - design @ x
        inside = weight > 0
        variance = float((weight * residual**2).sum() / max(inside.sum() - 3, 1))
        error = float(np.sqrt(variance * np.diag(np.linalg.inv(normal))[:2].max()))
        if error > KNOWN:
            return None
        east, north = map(float, x[:2])
        return {
            "east": east,
            "north": north,
            "distance": math.hypot(east, north),
            "error": error,
            "slopes": int(inside.sum()),
        }


def slopes_from(arrays: Mapping[str, NDArray]) -> SlopePairs:
    """The pairs of `BlockQuality.arrays`, (pairs,) each."""
    return SlopePairs(**{name: arrays[f"slope_{name}"] for name in SlopePairs.__dataclass_fields__})
