"""Smooth random fields."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel

_SPLINE_GAIN = 0.479
"""Variance that cubic B-spline interpolation of white noise keeps, averaged over the cell, per axis."""


@kernel
def _weights(fraction, out):  # type: ignore[no-untyped-def]
    rest = 1.0 - fraction
    out[0] = rest**3 / 6.0
    out[1] = (3.0 * fraction**3 - 6.0 * fraction**2 + 4.0) / 6.0
    out[2] = (3.0 * rest**3 - 6.0 * rest**2 + 4.0) / 6.0
    out[3] = fraction**3 / 6.0


@kernel
def _spread(lattice, ratio, scale, rows, out):  # type: ignore[no-untyped-def]
    """Add the cubic B-spline through `lattice` (one node per `ratio` cells) times `scale` to `out`."""
    n = out.shape[1]
    weight = np.empty(4)
    along = np.empty((n, 4))
    first = np.empty(n, np.int64)
    for j in range(n):
        first[j] = int(j * ratio)
        _weights(j * ratio - first[j], along[j])
    line = np.empty(lattice.shape[1])
    for i in range(rows):
        r = int(i * ratio)
        _weights(i * ratio - r, weight)
        for c in range(lattice.shape[1]):
            line[c] = (
                weight[0] * lattice[r, c]
                + weight[1] * lattice[r + 1, c]
                + weight[2] * lattice[r + 2, c]
                + weight[3] * lattice[r + 3, c]
            )
        for j in range(n):
            f = first[j]
            value = (
                along[j, 0] * line[f]
                + along[j, 1] * line[f + 1]
                + along[j, 2] * line[f + 2]
                + along[j, 3] * line[f + 3]
            )
            out[i, j] += scale * value


def add_waves(
    out: NDArray[np.float32], step: float, wavelength: float, deviation: float, random: np.random.Generator
) -> None:
    """Add a smooth random field of this correlation length [m] and standard deviation to `out`, in place."""
    ratio = step / wavelength
    side = int(max(out.shape) * ratio) + 5
    lattice = random.standard_normal((side, side))
    _spread(lattice, ratio, deviation / _SPLINE_GAIN, out.shape[0], out)
