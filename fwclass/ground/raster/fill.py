"""Filling the holes of a surface with a membrane: the solution of Laplace's equation between known cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel

SWEEPS = 40
"""Sweeps per level of the pyramid; what is left of the error is asserted in the tests."""

OVERRELAXATION = 1.6
"""Of each sweep; between 1 (Gauss–Seidel) and 2 (no convergence)."""

MANY = 0.1
"""Share of unknown cells above which it is quicker to visit all; it changes no bit."""


def fill_gaps(surface: NDArray[np.float64], corner: tuple[int, int] = (0, 0)) -> NDArray[np.float64]:
    """`surface` with its NaN cells filled by a membrane that is free at the array's edge.

    Coarse to fine: the surface of half the resolution is filled first and is what the sweeps start from.
    The number of sweeps is fixed, so the answer is a function of the input alone. All NaN stays all NaN.
    `corner` is the row and column of the first cell in the global raster: the coarser cells hang on that, so that
    they are the same for every window.
    """
    known = np.isfinite(surface)
    if known.all() or not known.any():
        return surface.copy()
    row, col = corner
    # two rows become one wherever they lie, or they would stay two for ever across the global raster's origin
    odd_row, odd_col = (p % 2 if n > 2 else 0 for p, n in zip(corner, surface.shape, strict=True))
    coarse = fill_gaps(_halve(surface, odd_row, odd_col), (row // 2, col // 2))
    out = np.where(known, surface, 0.0)
    _start_from(coarse, known, odd_row, odd_col, out)
    _relax(known, SWEEPS, OVERRELAXATION, out)
    return out


@kernel
def _halve(surface, odd_row, odd_col):  # type: ignore[no-untyped-def]
    """Mean of the known cells of every 2 × 2, NaN where there is none; an odd first row or column is alone."""
    nrows, ncols = surface.shape
    out = np.full(((nrows + odd_row + 1) // 2, (ncols + odd_col + 1) // 2), np.nan)
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            total, n = 0.0, 0
            for i in range(max(2 * r - odd_row, 0), min(2 * r - odd_row + 2, nrows)):
                for j in range(max(2 * c - odd_col, 0), min(2 * c - odd_col + 2, ncols)):
                    if not np.isnan(surface[i, j]):
                        total += surface[i, j]
                        n += 1
            if n > 0:
                out[r, c] = total / n
    return out


@kernel
def _start_from(coarse, known, odd_row, odd_col, out):  # type: ignore[no-untyped-def]
    """Bilinear values of the coarse surface in the unknown cells of `out`."""
    nrows, ncols = out.shape
    last_r, last_c = coarse.shape[0] - 1, coarse.shape[1] - 1
    for r in range(nrows):
        r0 = (r + odd_row) // 2
        r1 = min(max(r0 + (1 if (r + odd_row) % 2 else -1), 0), last_r)
        for c in range(ncols):
            if known[r, c]:
                continue
            c0 = (c + odd_col) // 2
            c1 = min(max(c0 + (1 if (c + odd_col) % 2 else -1), 0), last_c)
            near = 0.75 * coarse[r0, c0] + 0.25 * coarse[r0, c1]
            far = 0.75 * coarse[r1, c0] + 0.25 * coarse[r1, c1]
            out[r, c] = 0.75 * near + 0.25 * far


@kernel
def _relax_rows(known, sweeps, omega, z):  # type: ignore[no-untyped-def]
    """As `_relax`, with the cells of one colour of a row side by side, so that many are reckoned at once.

    Row ``r`` of colour ``k`` holds the columns ``f, f + 2, …`` with ``f = (r + k) % 2``, the i-th at ``[k, r, i + 1]``.
    """
    nrows, ncols = z.shape
    cells, free = np.zeros((2, nrows, ncols // 2 + 3)), np.zeros((2, nrows, ncols // 2 + 3), np.bool_)
    for r in range(nrows):
        for c in range(ncols):
            colour, i = (r + c) % 2, c // 2 + 1
            cells[colour, r, i], free[colour, r, i] = z[r, c], not known[r, c]
    for _ in range(sweeps):
        for colour in range(2):
            for r in range(nrows):
                f = (r + colour) % 2
                own, wanted, beside = cells[colour, r], free[colour, r], cells[1 - colour, r]
                number = (ncols - f + 1) // 2
                if number < 1:
                    continue
                # beyond the ends of a row a cell sees itself
                if f == 0:
                    beside[0] = own[1]
                if f + 2 * number > ncols:
                    beside[f + number] = own[number]
                south = cells[1 - colour, r - 1] if r > 0 else own
                north = cells[1 - colour, r + 1] if r + 1 < nrows else own
                for i in range(number):
                    was = own[i + 1]
                    across, along = beside[i + f] + beside[i + f + 1], south[i + 1] + north[i + 1]
                    drawn = was + omega * (0.25 * (across + along) - was)
                    own[i + 1] = drawn if wanted[i + 1] else was
    for r in range(nrows):
        for c in range(ncols):
            z[r, c] = cells[(r + c) % 2, r, c // 2 + 1]


@kernel
def _relax(known, sweeps, omega, z):  # type: ignore[no-untyped-def]
    """Draw every unknown cell towards the mean of its four neighbours; a cell at the edge stands in for the missing.

    Cells of one colour of a chessboard do not see each other: all of one colour first, then the other, so that the
    processor need not wait for one cell before the next. Few unknown cells are visited one by one, many in whole rows;
    the answer is the same to the last bit.
    """
    nrows, ncols = z.shape
    unknown = nrows * ncols - np.sum(known)
    if unknown > MANY * nrows * ncols:
        _relax_rows(known, sweeps, omega, z)
        return
    rows, cols = np.empty(unknown, np.int32), np.empty(unknown, np.int32)
    n = 0
    for colour in range(2):
        for r in range(nrows):
            for c in range((r + colour) % 2, ncols, 2):
                if not known[r, c]:
                    rows[n], cols[n] = r, c
                    n += 1
    for _ in range(sweeps):
        for i in range(n):
            r, c = rows[i], cols[i]
            across = z[r, max(c - 1, 0)] + z[r, min(c + 1, ncols - 1)]
            along = z[max(r - 1, 0), c] + z[min(r + 1, nrows - 1), c]
            z[r, c] += omega * (0.25 * (across + along) - z[r, c])
