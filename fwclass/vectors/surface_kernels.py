"""Surfaces of cells smoothed and bent, scale by scale."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel


@kernel
def smooth(values, taps):  # type: ignore[no-untyped-def]
    """float64 (rows, columns): `values`, of that type and shape and 0 beyond it, weighted along both axes.

    Parameters
    ----------
    taps : float64 (reach + 1,), weight of the middle and of what lies so many cells to each side.
    """
    rows, cols = values.shape
    reach = len(taps) - 1
    wide = np.zeros((rows + 2 * reach, cols))
    for r in range(rows):
        for c in range(cols):
            wide[reach + r, c] = values[r, c]
    line, out = np.zeros(cols + 2 * reach), np.empty((rows, cols))
    for r in range(rows):
        middle = wide[reach + r]
        for c in range(cols):
            line[reach + c] = middle[c] * taps[0]
        middle = line[reach:]
        for k in range(reach, 0, -1):
            one, other, tap = wide[reach + r - k], wide[reach + r + k], taps[k]
            for c in range(cols):
                middle[c] += (one[c] + other[c]) * tap
        through = out[r]
        for c in range(cols):
            through[c] = middle[c] * taps[0]
        for k in range(reach, 0, -1):
            one, other, tap = line[reach - k :], line[reach + k :], taps[k]
            for c in range(cols):
                through[c] += (one[c] + other[c]) * tap
    return out


@kernel
def add_level(out, values, level, k):  # type: ignore[no-untyped-def]
    """Add `values` to `out`, float64 (rows, columns) as `level`, with a weight that falls from 1 where the level is `k`
    to 0 where it is another whole number."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            weight = 1.0 - abs(level[r, c] - k)
            if weight > 0.0:
                out[r, c] += weight * values[r, c]


@kernel
def add_bulge(out, values, level, k, factor):  # type: ignore[no-untyped-def]
    """Add the Laplacian of `values`, float64 (rows, columns), 0 beyond them, turned over and times `factor` to `out`,
    as `add_level` does."""
    rows, cols = out.shape
    for r in range(rows):
        for c in range(cols):
            weight = 1.0 - abs(level[r, c] - k)
            if weight > 0.0:
                south = values[r - 1, c] if r > 0 else 0.0
                north = values[r + 1, c] if r + 1 < rows else 0.0
                west = values[r, c - 1] if c > 0 else 0.0
                east = values[r, c + 1] if c + 1 < cols else 0.0
                along, across = values[r, c] * -2.0 + (south + north), values[r, c] * -2.0 + (west + east)
                out[r, c] -= weight * factor * (along + across)


@kernel
def add_round_crown(out, surface, row, col, wide, ways, lower):  # type: ignore[no-untyped-def]
    """Raise `out` to the round crown of one tree (`trees.round_crowns`).

    Parameters
    ----------
    out, surface : float64 (rows, columns) [m].
    row, col : of the top.
    wide : cells that the crown reaches from it.
    ways : int64 (directions, distances, 2), row and column of cells away from it, by distance in cells.
    lower : directions in which the surface is lower, of those at a distance.
    """
    rows, cols = out.shape
    height, seen = np.empty(wide + 1), np.empty(len(ways))
    for far in range(wide + 1):
        for k in range(len(ways)):
            r, c = row + ways[k, far, 0], col + ways[k, far, 1]
            value, at = surface[r, c] if 0 <= r < rows and 0 <= c < cols else 0.0, k
            while at > 0 and seen[at - 1] > value:
                seen[at] = seen[at - 1]
                at -= 1
            seen[at] = value
        height[far] = seen[lower]
        if far > 0:
            height[far] = min(height[far], height[far - 1])
    for r in range(max(0, row - wide), min(rows, row + wide + 1)):
        for c in range(max(0, col - wide), min(cols, col + wide + 1)):
            away = math.hypot(r - row, c - col)
            k = int(away)
            if k < wide:
                out[r, c] = max(out[r, c], (height[k + 1] - height[k]) * (away - k) + height[k])
            elif away == wide:
                out[r, c] = max(out[r, c], height[wide])
