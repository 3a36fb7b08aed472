"""Marks of points below gaps, below surfaces, and far from the mean of others around."""

from __future__ import annotations

import numpy as np

from fwclass.kernel import kernel

COUNTED = 24
"""Last echoes in 3 x 3 cells that tell a surface above another echo."""

FEW, ALONE = 2, 0.01
"""Others as low, and share of the last echoes around as high as it, up to which an echo below a surface is alone: what
a wood lets through hangs together."""

THICK, TOLERANCE, RISE = 300.0, 300.0, 0.1
"""mm of a layer that is a surface; mm by which heights differ of what hangs together, and more by the distance."""

BINS = 300
"""Of a third of a layer each, that a surface is looked for in above a point: 30 m."""


@kernel
def mark_below_gaps(z, start, ncols, nrows, size, cell, col0, row0, most, gap, steepest, shape, around, noise):  # type: ignore[no-untyped-def]
    """Mark in `noise` bool (points,) points below gaps: `size` is the edge of a cell in cells of the index, heights z
    (points,) and edges are in millimetres."""
    lowest = np.empty(most + 1)
    area = 9.0 * (size * cell) ** 2
    for big_r in range(row0 // size, (row0 + nrows - 1) // size + 1):
        for big_c in range(col0 // size, (col0 + ncols - 1) // size + 1):
            r0, c0 = big_r * size - row0, big_c * size - col0
            bottom = _bottom(z, start, ncols, nrows, r0, c0, size, noise)
            if bottom == np.inf or _has_company(
                z, start, ncols, nrows, r0 - size, c0 - size, 3 * size, bottom, most, gap, steepest, area, around
            ):
                continue
            total, kept = _lowest_of(z, start, ncols, nrows, r0 - size, c0 - size, 3 * size, noise, lowest)
            density = total / area
            level = _level(lowest, kept, total, density, gap + steepest / np.sqrt(density), shape, around)
            if level >= bottom:
                _mark(z, start, ncols, nrows, r0, c0, size, level, noise)


@kernel
def _bottom(z, start, ncols, nrows, r0, c0, edge, skipped):  # type: ignore[no-untyped-def]
    """Lowest point of a square of cells, inf where there is none."""
    low = np.inf
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            if z[i] < low and not skipped[i]:
                low = z[i]
    return low


@kernel
def _has_company(z, start, ncols, nrows, r0, c0, edge, bottom, most, gap, steepest, area, around):  # type: ignore[no-untyped-def]
    """Are more points within one gap above `bottom` than a group may have? Then no gap above it counts.

    A shortcut: points already found are not left out, so that it is true less often than it could be, never more.
    """
    left, right = max(c0, 0), min(c0 + edge, ncols)
    bottom_r, top_r = max(r0, 0), min(r0 + edge, nrows)
    total = 0
    for r in range(bottom_r, top_r):
        total += start[r * ncols + right] - start[r * ncols + left]
    limit = min(most, total // around)
    top = bottom + gap + steepest * np.sqrt(area / total)
    n = 0
    for r in range(bottom_r, top_r):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            n += bottom <= z[i] <= top
        if n > limit:
            return True
    return False


@kernel
def _lowest_of(z, start, ncols, nrows, r0, c0, edge, skipped, lowest):  # type: ignore[no-untyped-def]
    """Number of points in a square of `edge` cells, and how many of their lowest are in `lowest`, in order."""
    total, kept, room = 0, 0, len(lowest)
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            if skipped[i]:
                continue
            total += 1
            if kept == room and z[i] >= lowest[room - 1]:
                continue
            j = kept if kept < room else room - 1
            while j > 0 and lowest[j - 1] > z[i]:
                lowest[j] = lowest[j - 1]
                j -= 1
            lowest[j] = z[i]
            kept = kept + 1 if kept < room else room
    return total, kept


@kernel
def _level(lowest, kept, total, density, gap, shape, around):  # type: ignore[no-untyped-def]
    """Height of the highest point that lies below a gap, −inf if none does; groups above one another count apart."""
    level, since = -np.inf, 0
    for k in range(1, kept):
        step = lowest[k] - lowest[k - 1]
        few = (k - since) * around <= total - k and k - since <= max(1.0, density * (shape * step) ** 2)
        if step > gap and few:
            level, since = lowest[k - 1], k
    return level


@kernel
def _mark(z, start, ncols, nrows, r0, c0, edge, level, noise):  # type: ignore[no-untyped-def]
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            noise[i] |= z[i] <= level


@kernel
def mark_below_surfaces(x, y, z, start, ncols, nrows, size, cell, col0, row0, gap, share, judged, noise):  # type: ignore[no-untyped-def]
    """Mark in `noise` bool (points,) points below surfaces, of those that are not `judged` yet bool (points,) in cells
    with `COUNTED` points in 3 x 3 of them, which are judged then: `size` is the edge of a cell in cells of the index;
    x, y, z (points,), the edge `cell` of those and the gap are in millimetres."""
    lowest, bins = np.empty(FEW + 2), np.empty(BINS, np.int64)
    nothing = np.zeros(len(z), np.bool_)
    sparse_r, sparse_c = nrows, ncols  # the cell last seen with too few: points of a cell mostly follow one another
    for k in range(len(z)):
        if judged[k]:
            continue
        r0 = (y[k] // cell + row0) // size * size - row0
        c0 = (x[k] // cell + col0) // size * size - col0
        if r0 == sparse_r and c0 == sparse_c:
            continue
        if _count(start, ncols, nrows, r0 - size, c0 - size, 3 * size) < COUNTED:
            sparse_r, sparse_c = r0, c0
            continue
        total, _ = _lowest_of(z, start, ncols, nrows, r0 - size, c0 - size, 3 * size, nothing, lowest)
        left, right = max(c0, 0), min(c0 + size, ncols)
        for r in range(max(r0, 0), min(r0 + size, nrows)):
            for i in range(start[r * ncols + left], start[r * ncols + right]):
                if judged[i]:
                    continue
                judged[i] = True
                if z[i] + gap >= lowest[FEW + 1]:
                    continue
                most = _thickest(z, start, ncols, nrows, r0 - size, c0 - size, 3 * size, z[i] + gap, bins)
                if most < share * total:
                    continue
                n, near = _company(x, y, z, start, ncols, nrows, r0 - 4 * size, c0 - 4 * size, 9 * size, i)
                noise[i] = near <= max(FEW, ALONE * n)


@kernel
def _count(start, ncols, nrows, r0, c0, edge):  # type: ignore[no-untyped-def]
    """Points in a square of `edge` cells."""
    n, left, right = 0, max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        n += start[r * ncols + right] - start[r * ncols + left]
    return n


@kernel
def _thickest(z, start, ncols, nrows, r0, c0, edge, bottom, bins):  # type: ignore[no-untyped-def]
    """Points in the fullest layer above `bottom` of a square of cells: three bins, together `THICK`."""
    bins[:] = 0
    step = THICK / 3.0
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for i in range(start[r * ncols + left], start[r * ncols + right]):
            if z[i] > bottom and z[i] - bottom < BINS * step:
                bins[int((z[i] - bottom) / step)] += 1
    most = 0
    for k in range(2, BINS):
        most = max(most, bins[k - 2] + bins[k - 1] + bins[k])
    return most


@kernel
def _company(x, y, z, start, ncols, nrows, r0, c0, edge, i):  # type: ignore[no-untyped-def]
    """Points of a square of cells, and how many others of them are about as high as point `i`."""
    total, near = 0, -1
    left, right = max(c0, 0), min(c0 + edge, ncols)
    for r in range(max(r0, 0), min(r0 + edge, nrows)):
        for j in range(start[r * ncols + left], start[r * ncols + right]):
            total += 1
            dx, dy = float(x[j] - x[i]), float(y[j] - y[i])
            near += abs(z[j] - z[i]) <= TOLERANCE + RISE * np.sqrt(dx * dx + dy * dy)
    return total, near


@kernel
def mark_beyond_sigma(x, y, z, start, ncols, nrows, radius, sigma, least, fewest, above, noise):  # type: ignore[no-untyped-def]
    """Mark in `noise` bool (points,), false before, points that are further from the mean height of the others within
    `radius` than `sigma` of their standard deviations; x, y, z int64 (points,), sorted into cells, and lengths in
    millimetres.

    Whole numbers are added up, so that the sums do not depend on the order of the points.
    """
    for r in range(nrows):
        r0, r1 = max(r - 1, 0), min(r + 2, nrows)
        for c in range(ncols):
            c0, c1 = max(c - 1, 0), min(c + 2, ncols)
            first, last = start[r * ncols + c], start[r * ncols + c + 1]
            if first == last:
                continue
            low, high = z[first], z[first]
            for row in range(r0, r1):
                for j in range(start[row * ncols + c0], start[row * ncols + c1]):
                    low = z[j] if z[j] < low else low
                    high = z[j] if z[j] > high else high
            for i in range(first, last):
                if high - z[i] <= least and not (above and z[i] - low > least):
                    continue
                n, total, square, lonely = -1, 0, 0, True
                # the points beside it in its cell, near it in most files, tell soonest that it is not alone
                for j in range(max(i - 1, first), min(i + 2, last)):
                    dx, dy = x[j] - x[i], y[j] - y[i]
                    lonely &= j == i or abs(z[j] - z[i]) > least or dx * dx + dy * dy > radius * radius
                if not lonely:
                    continue
                for row in range(r0, r1):
                    for j in range(start[row * ncols + c0], start[row * ncols + c1]):
                        dx, dy, dz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                        if dx * dx + dy * dy <= radius * radius:
                            n += 1
                            total += dz
                            square += dz * dz
                            lonely &= j == i or abs(dz) > least
                            if not lonely:
                                break
                    if not lonely:
                        break
                if n < fewest or not lonely:
                    continue
                mean = total / n
                deviation = np.sqrt(max(square / n - mean * mean, 0.0))
                noise[i] = (abs(mean) if above else mean) > sigma * deviation
