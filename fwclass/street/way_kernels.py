"""What frames show of the vehicle's way: how far things go on along the road and upwards, and how their edges lean."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel

SIZES = np.geomspace(0.2, 2.0, 9)
"""m, edges of the bins of how far two returns are apart, along the road or upwards."""

LEANS = 15
"""Bins of how an edge leans to each side, of `LEAN` degrees."""

LEAN = 2.0

SAME = 0.15
"""m, within which two returns of one edge are equally deep."""

LOW, HIGH = 0.6, 1.5
"""m upwards, between two returns of one edge."""


@kernel
def add_upwards(depth, z, change, counts):  # type: ignore[no-untyped-def]
    """Add how often the depth changes between the beams of one frame, by how far these are apart upwards.

    Parameters
    ----------
    depth, z : float32 (beams,) [m]; NaN in depth where nothing counts. change : of the depth [m] that is one.
    counts : float64 (bins of `SIZES`, 2), changed and all; added to.
    """
    apart = 1
    while apart < len(depth):
        for j in range(len(depth) - apart):
            by = abs(depth[j + apart] - depth[j])
            if not by >= 0.0 or depth[j] * depth[j + apart] < 0.0:
                continue
            size = abs(z[j + apart] - z[j])
            if SIZES[0] <= size < SIZES[-1]:
                k = np.searchsorted(SIZES, size, side="right") - 1
                counts[k, 0] += by > change
                counts[k, 1] += 1.0
        apart += 1 + apart // 5


@kernel
def add_along(depth, other, change, counts):  # type: ignore[no-untyped-def]
    """Add how often the depth changes between the same beams of two frames; `counts` (2,) is their bin's."""
    for j in range(len(depth)):
        by = abs(depth[j] - other[j])
        if by >= 0.0:
            counts[0] += by > change
            counts[1] += 1.0


@kernel
def add_leans(edges, first, counts):  # type: ignore[no-untyped-def]
    """Add how the edges from row `first` on lean against those before them.

    Parameters
    ----------
    edges : float64 (n, 4): x along the road, z, depth [m], and whether something begins or ends there.
    counts : int64 (2 LEANS,), of the angle from upright, forwards above 0; added to.
    """
    for i in range(first, len(edges)):
        for j in range(i):
            along, up = edges[i, 0] - edges[j, 0], edges[i, 1] - edges[j, 1]
            if up < 0.0:
                along, up = -along, -up
            if up < LOW or up > HIGH or edges[i, 3] != edges[j, 3]:
                continue
            if abs(edges[i, 2] - edges[j, 2]) > SAME:
                continue
            k = int(math.floor(math.degrees(math.atan2(along, up)) / LEAN)) + LEANS
            if 0 <= k < len(counts):
                counts[k] += 1
