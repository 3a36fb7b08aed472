"""Quadratic surfaces through the lowest points of cells."""

from __future__ import annotations

import numpy as np

from fwclass.kernel import kernel


@kernel
def choose_seeds(flat, x, y, z, seed):  # type: ignore[no-untyped-def]
    """Fills in `seed` int64 (cells,), -1 before: the lowest of the points x, y, z (points,) [m] in each cell, of
    several the most western, then southern one; `flat` int64 (points,) is the cell of each."""
    for i in range(len(flat)):
        j = seed[flat[i]]
        if j < 0 or z[i] < z[j] or (z[i] == z[j] and (x[i] < x[j] or (x[i] == x[j] and y[i] < y[j]))):
            seed[flat[i]] = i


@kernel
def fit_surfaces(u, v, low, neighbours, limit, rounds, stiffness, surface):  # type: ignore[no-untyped-def]
    """Height in the middle of every cell of the surface through the seeds around; cells without enough stay.

    A seed r above the surface weighs 1 / (1 + (2 r / limit)²)², one r below it as one r / 4 above it; all of them
    times (1 − d² / D²)² for the distance d [cells] from the middle, D = neighbours + 1.
    """
    nrows, ncols = low.shape
    most = (2 * neighbours + 1) ** 2
    basis, height, near = np.empty((most, 6)), np.empty(most), np.empty(most)
    normal, right, terms = np.empty((6, 6)), np.empty(6), np.empty(6)
    for r in range(nrows):
        for c in range(ncols):
            n = 0
            for row in range(max(r - neighbours, 0), min(r + neighbours + 1, nrows)):
                for col in range(max(c - neighbours, 0), min(c + neighbours + 1, ncols)):
                    a, b = u[row, col] + (col - c), v[row, col] + (row - r)
                    weight = 1.0 - (a * a + b * b) / (neighbours + 1.0) ** 2
                    if np.isnan(low[row, col]) or weight <= 0.0:
                        continue
                    basis[n, 0], basis[n, 1], basis[n, 2] = 1.0, a, b
                    basis[n, 3], basis[n, 4], basis[n, 5] = a * a, a * b, b * b
                    height[n], near[n] = low[row, col], weight * weight
                    n += 1
            if n < 4:
                continue
            base = height[:n].min()
            for k in range(rounds):
                normal[:] = 0.0
                right[:] = 0.0
                for i in range(n):
                    weight = near[i]
                    if k > 0:
                        rest = height[i] - base
                        for p in range(6):
                            rest -= basis[i, p] * terms[p]
                        scale = 2.0 * rest / limit if rest > 0.0 else 0.5 * rest / limit
                        weight /= (1.0 + scale * scale) ** 2
                    for p in range(6):
                        for q in range(p + 1):
                            normal[p, q] += weight * basis[i, p] * basis[i, q]
                        right[p] += weight * basis[i, p] * (height[i] - base)
                for p in range(1, 6):
                    normal[p, p] += stiffness if p > 2 else 0.01 * stiffness
                _solve(normal, right, terms)
            surface[r, c] = base + terms[0]


@kernel
def _solve(a, b, x):  # type: ignore[no-untyped-def]
    """Solution of a x = b for a positive definite matrix given by its lower triangle, which is overwritten."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = np.sqrt(s) if i == j else s / a[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * x[k]
        x[i] = s / a[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= a[k, i] * x[k]
        x[i] = s / a[i, i]
