"""The cloth of the cloth simulation filter: particles on a raster, their fall, and how they let each other down.

Heights are in whole millimetres of a cloud turned upside down, so that the cloth falls onto the lowest points. A
particle stops for good where it meets its intersection height. Every pass is made from the values before it, never
in place: no particle is first, and a mirrored cloud gives a mirrored cloth.
"""

from __future__ import annotations

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.kernel import kernel

TILE = 16
"""Particles along the edge of the squares that fall asleep and wake together."""

GHOSTS = 2
"""Particles beyond each edge that mirror those inside; as far as a particle feels its neighbours."""

START = 60.0
"""[m] The cloth starts at the highest inverted height within so many metres, not at the highest of all."""

GRAVITY = 100.0
"""[mm] of a step of time 1; half the 0.2 m of Zhang's program, for cloth passes that are fewer than its."""

DAMPING = 0.01
"""Share of a particle's speed that is lost in a step (Zhang's program)."""

DRAWS = {1: (4, 0.2), 2: (5, 0.18), 3: (5, 0.2)}
"""By rigidness: passes of the inner constraints in a step, and the share by which each of four neighbours in a row
draws a particle in a pass (0.2: the mean of the five). Stiff enough for the widest roofs, as Zhang's cloth is. A share
near 0.25 leaves the particle itself no weight, and the cloth never comes to rest."""

STILL = 5.0
"""[mm] A piece of cloth that falls less in a step has come to rest (Zhang et al. 2016: 0.005 m)."""

SLOPE_STEP = 300.0
"""[mm] Neighbours whose intersection heights differ by less lie on one slope (Zhang's program: 0.3 m)."""

SLOPE_PARTICLES = 50
"""A piece of movable cloth of at most so many particles is left as it hangs (Zhang's program)."""

NEAR = 32
"""Cells within which the nearest of several equally near heights is the lowest point's."""


@kernel
def nearest_heights(x, y, z, cell, nrows, ncols):  # type: ignore[no-untyped-def]
    """Inverted height of the point nearest to each particle (cell centre) in its cell, NaN without one.

    `x`, `y` from the window's corner and `z`, all integers [mm]; of equally near points the lowest counts.
    """
    best = np.full((nrows, ncols), np.iinfo(np.int64).max)
    out = np.full((nrows, ncols), np.nan)
    for i in range(len(x)):
        c, r = x[i] // cell, y[i] // cell
        # twice the offsets from the centre: whole numbers
        u, v = 2 * (x[i] - c * cell) - cell, 2 * (y[i] - r * cell) - cell
        d = u * u + v * v
        if d < best[r, c] or (d == best[r, c] and -z[i] > out[r, c]):
            best[r, c], out[r, c] = d, -z[i]
    return out


def without_holes(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """`heights` with NaN replaced by the nearest particle's height; of equally near ones by the lowest point's.

    Further than `NEAR` cells from all heights, one of the equally near is taken.
    """
    empty = np.isnan(heights)
    if not empty.any():
        return heights
    out: NDArray[np.float64] = _nearest_around(heights, *_nearest_along(heights, NEAR), NEAR)
    far = np.isnan(out)
    if far.any():
        rows, cols = scipy.ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
        out[far] = heights[rows[far], cols[far]]
    return out


@kernel
def _nearest_along(heights, reach):  # type: ignore[no-untyped-def]
    """Distance [rows] of the nearest height in the same column and that height; reach + 1 and NaN without one."""
    nrows, ncols = heights.shape
    distance = np.full((nrows, ncols), reach + 1)
    value = np.full((nrows, ncols), np.nan)
    for r in range(nrows):
        for c in range(ncols):
            if not np.isnan(heights[r, c]):
                distance[r, c], value[r, c] = 0, heights[r, c]
            elif r > 0 and distance[r - 1, c] < reach:
                distance[r, c], value[r, c] = distance[r - 1, c] + 1, value[r - 1, c]
    for r in range(nrows - 2, -1, -1):
        for c in range(ncols):
            d, v = distance[r + 1, c] + 1, value[r + 1, c]
            if d < distance[r, c] or (d == distance[r, c] and v > value[r, c]):
                distance[r, c], value[r, c] = d, v
    return distance, value


@kernel
def _nearest_around(heights, distance, value, reach):  # type: ignore[no-untyped-def]
    nrows, ncols = heights.shape
    out = heights.copy()
    for r in range(nrows):
        for c in range(ncols):
            if not np.isnan(heights[r, c]):
                continue
            best = reach * reach + 1
            for k in range(reach + 1):
                if k * k > best:
                    break
                for b in (c - k, c + k):
                    if b < 0 or b >= ncols or distance[r, b] > reach:
                        continue
                    d = k * k + distance[r, b] * distance[r, b]
                    if d < best or (d == best and value[r, b] > out[r, c]):
                        best, out[r, c] = d, value[r, b]
    return out


def drop_cloth(
    heights: NDArray[np.float64], radius: int, rigidness: int, iterations: int, time_step: float, slope_smooth: bool
) -> NDArray[np.float64]:
    """Heights [mm] of a cloth that has fallen on `heights`, of the same shape; both edges are multiples of `TILE`.

    Parameters
    ----------
    heights : intersection height of every particle [mm], upside down, without NaN.
    radius : the cloth starts from the highest intersection height within so many cells.
    rigidness, iterations, time_step, slope_smooth : as in `CsfParams`.
    """
    ground = np.pad(heights, GHOSTS, mode="symmetric")
    start = scipy.ndimage.maximum_filter(heights, size=2 * radius + 1, mode="nearest")
    cloth = np.pad(start, GHOSTS, mode="symmetric")
    movable = np.ones(ground.shape, bool)
    pull = GRAVITY * time_step**4  # a force of time_step² that works for time_step² (Zhang's program)
    _fall(ground, movable, pull, *DRAWS[rigidness], iterations, min(STILL, pull / 4.0), cloth)
    inner = slice(GHOSTS, -GHOSTS)
    cloth, movable = cloth[inner, inner], movable[inner, inner]
    if slope_smooth:
        pieces, _ = scipy.ndimage.label(movable)
        large = movable & (np.bincount(pieces.ravel()) > SLOPE_PARTICLES)[pieces]
        _let_down(heights, large, movable, cloth)
    return cloth


@kernel
def _fall(ground, movable, pull, times, share, iterations, still, cloth):  # type: ignore[no-untyped-def]
    """Let `cloth` fall until every tile rests, or for `iterations` steps; `movable` is what never met `ground`.

    A tile sleeps where nothing of it and the eight around fell by `still` in the last step: the cloth rests, or swings
    back and will not come as low again. So a piece comes to rest by itself, whatever else lies in the box.
    """
    down, along = (ground.shape[0] - 2 * GHOSTS) // TILE, (ground.shape[1] - 2 * GHOSTS) // TILE
    old, other = cloth.copy(), cloth.copy()
    tiles = np.empty((down * along, 2), np.int64)
    moved = np.full((down + 2, along + 2), np.inf)
    loose = np.ones((down, along), np.bool_)
    for _ in range(iterations):
        n = _awake(moved, loose, still, tiles)
        if n == 0:
            return
        _step(tiles, n, pull, movable, old, cloth)
        for _ in range(times):
            _mirror(cloth)
            _pass_along(tiles, n, share, movable, cloth, other)
            _mirror(other)
            _pass_down(tiles, n, share, movable, other, cloth)
        _collide(tiles, n, ground, old, movable, moved, loose, cloth, other)


@kernel
def _awake(moved, loose, still, tiles):  # type: ignore[no-untyped-def]
    n = 0
    for r in range(loose.shape[0]):
        for c in range(loose.shape[1]):
            if loose[r, c] and moved[r : r + 3, c : c + 3].max() >= still:
                tiles[n, 0], tiles[n, 1] = r, c
                n += 1
    # a tile that sleeps did not move
    moved[:] = 0.0
    return n


@kernel
def _step(tiles, n, pull, movable, old, cloth):  # type: ignore[no-untyped-def]
    """Verlet's step of the movable particles."""
    for t in range(n):
        first, left = tiles[t, 0] * TILE + GHOSTS, tiles[t, 1] * TILE + GHOSTS
        for r in range(first, first + TILE):
            now, before, free = cloth[r, left:], old[r, left:], movable[r, left:]
            for j in range(TILE):
                h = now[j]
                then = h + (h - before[j]) * (1.0 - DAMPING) - pull
                before[j] = h
                now[j] = then if free[j] else h


@kernel
def _mirror(cloth):  # type: ignore[no-untyped-def]
    """Ghosts beyond the edges take the values of the particles that they mirror."""
    for k in range(GHOSTS):
        inside, last = 2 * GHOSTS - 1 - k, 2 * GHOSTS - 1 - k
        cloth[:, k] = cloth[:, inside]
        cloth[:, cloth.shape[1] - 1 - k] = cloth[:, cloth.shape[1] - 1 - last]
        cloth[k, :] = cloth[inside, :]
        cloth[cloth.shape[0] - 1 - k, :] = cloth[cloth.shape[0] - 1 - last, :]


@kernel
def _pass_along(tiles, n, share, movable, cloth, out):  # type: ignore[no-untyped-def]
    """Draw movable particles towards their two neighbours on each side in the row."""
    for t in range(n):
        first, left = tiles[t, 0] * TILE + GHOSTS, tiles[t, 1] * TILE
        for r in range(first, first + TILE):
            a, to, free = cloth[r, left:], out[r, left + GHOSTS :], movable[r, left + GHOSTS :]
            for j in range(TILE):
                mean = a[j + 2] * (1.0 - 4.0 * share) + share * ((a[j] + a[j + 4]) + (a[j + 1] + a[j + 3]))
                to[j] = mean if free[j] else a[j + 2]


@kernel
def _pass_down(tiles, n, share, movable, cloth, out):  # type: ignore[no-untyped-def]
    """Draw movable particles towards their two neighbours on each side in the column."""
    for t in range(n):
        first, left = tiles[t, 0] * TILE + GHOSTS, tiles[t, 1] * TILE + GHOSTS
        for r in range(first, first + TILE):
            a, b, own = cloth[r - 2, left:], cloth[r - 1, left:], cloth[r, left:]
            c, d, to, free = cloth[r + 1, left:], cloth[r + 2, left:], out[r, left:], movable[r, left:]
            for j in range(TILE):
                mean = own[j] * (1.0 - 4.0 * share) + share * ((a[j] + d[j]) + (b[j] + c[j]))
                to[j] = mean if free[j] else own[j]


@kernel
def _collide(tiles, n, ground, old, movable, moved, loose, cloth, other):  # type: ignore[no-untyped-def]
    """Stop particles that met their height; how far a tile fell, and whether any of it still can."""
    for t in range(n):
        first, left = tiles[t, 0] * TILE + GHOSTS, tiles[t, 1] * TILE + GHOSTS
        most, still_loose = 0.0, False
        for r in range(first, first + TILE):
            for c in range(left, left + TILE):
                if movable[r, c]:
                    way = old[r, c] - cloth[r, c]
                    most = way if way > most else most
                    if cloth[r, c] < ground[r, c]:
                        cloth[r, c], movable[r, c] = ground[r, c], False
                    else:
                        still_loose = True
                # a sleeping tile is read from either array
                other[r, c] = cloth[r, c]
        moved[tiles[t, 0] + 1, tiles[t, 1] + 1], loose[tiles[t, 0], tiles[t, 1]] = most, still_loose


@kernel
def _let_down(ground, large, movable, cloth):  # type: ignore[no-untyped-def]
    """Let large pieces of movable cloth down onto slopes, from the fixed particles at their edges inwards.

    What is reached by steps of less than `SLOPE_STEP` is the same in whatever order it is walked.
    """
    nrows, ncols = ground.shape
    reached = np.empty(nrows * ncols, np.int64)
    n = 0
    for i in range(nrows * ncols):
        if not movable[i // ncols, i % ncols]:
            reached[n] = i
            n += 1
    while n > 0:
        n -= 1
        r, c = reached[n] // ncols, reached[n] % ncols
        for a, b in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            if a < 0 or b < 0 or a >= nrows or b >= ncols or not large[a, b] or not movable[a, b]:
                continue
            if abs(ground[a, b] - ground[r, c]) < SLOPE_STEP:
                movable[a, b], cloth[a, b] = False, ground[a, b]
                reached[n] = a * ncols + b
                n += 1
