"""Which points another one near by undercuts, by a pyramid of minima."""

from __future__ import annotations

import numpy as np

from fwclass.kernel import inlined, kernel


@kernel
def not_undercut(x, y, z, start, values, firsts, rows, cols, cell, radius, slope, tolerance, kept):  # type: ignore[no-untyped-def]
    """Fills in `kept` bool (points,): no point within `radius` lies lower than slope × distance + tolerance below it.

    x, y, z int64 (points,) are sorted into cells, of which `start` has the first point of each; the pyramid of minima
    `values`, whose levels begin at `firsts` and have `rows` and `cols`, is walked down from the cells around each
    point. All lengths are in millimetres.

    A cell is left out with all below it if it is too far, or its lowest point too high where the cell is nearest.
    """
    top = len(firsts) - 1
    levels, nodes = np.empty(4 * top + 16, np.int64), np.empty(4 * top + 16, np.int64)
    edge, first, wide = cell << top, firsts[top], cols[top]
    reach = radius * radius
    for i in range(len(x)):
        px, py, drop = float(x[i]), float(y[i]), z[i] - tolerance
        kept[i] = not _surely(px, py, drop, values, firsts, cols, cell, radius, slope)
        n = 0
        if kept[i]:
            for r in range(max((y[i] - radius) // edge, 0), min((y[i] + radius) // edge + 1, rows[top])):
                for c in range(max((x[i] - radius) // edge, 0), min((x[i] + radius) // edge + 1, wide)):
                    if _may(px, py, drop, values[first + r * wide + c], float(edge), r, c, reach, slope):
                        levels[n], nodes[n] = top, r * wide + c
                        n += 1
        while n > 0:
            n -= 1
            level, node = levels[n] - 1, nodes[n]
            if level < 0:
                for j in range(start[node], start[node + 1]):
                    room = drop - z[j]
                    dx, dy = x[j] - px, y[j] - py
                    d = dx * dx + dy * dy
                    if room > 0.0 and d <= reach and slope * slope * d < room * room:
                        kept[i] = False
                        n = 0
                        break
                continue
            row0, col0 = 2 * (node // cols[level + 1]), 2 * (node % cols[level + 1])
            for row in range(row0, min(row0 + 2, rows[level])):
                for col in range(col0, min(col0 + 2, cols[level])):
                    k = row * cols[level] + col
                    if _may(px, py, drop, values[firsts[level] + k], float(cell << level), row, col, reach, slope):
                        levels[n], nodes[n] = level, k
                        n += 1


@inlined
def _surely(px, py, drop, values, firsts, cols, cell, radius, slope):  # type: ignore[no-untyped-def]
    """Does the lowest point of a cell that the point lies in undercut it, wherever in the cell it is?"""
    undercut = False
    for level in range(len(firsts)):
        edge = float(cell << level)
        c, r = int(px / edge), int(py / edge)
        dx, dy = px - c * edge, py - r * edge
        dx = dx if dx > edge - dx else edge - dx
        dy = dy if dy > edge - dy else edge - dy
        far = np.sqrt(dx * dx + dy * dy)
        if far > radius:
            break
        undercut |= values[firsts[level] + r * cols[level] + c] + slope * far < drop
    return undercut


@inlined
def _may(px, py, drop, low, edge, r, c, reach, slope):  # type: ignore[no-untyped-def]
    """Could a point as low as `low` undercut from the nearest place of a cell? Without a root: both sides squared."""
    room = drop - low
    left, bottom = c * edge - px, r * edge - py
    dx = left if left > 0.0 else (-left - edge if -left > edge else 0.0)
    dy = bottom if bottom > 0.0 else (-bottom - edge if -bottom > edge else 0.0)
    near = dx * dx + dy * dy
    return room > 0.0 and near <= reach and slope * slope * near < room * room
