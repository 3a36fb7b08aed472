"""Kernels that tie a pulse's returns and its echoes together."""

from __future__ import annotations

import numpy as np

from fwclass.kernel import kernel


@kernel
def nearest_of_pulse(from_pulse, from_xyz, to_pulse, to_xyz, nearest):  # type: ignore[no-untyped-def]
    """For every row the nearest row of the other list in the same pulse, the first on a tie; -1 if the pulse has none.

    Both lists are sorted by pulse: `from_pulse`, `to_pulse` int64 (rows,), places (rows, 3) [m]. `nearest` int64
    (rows,) is filled in. Distances are in space, which along one beam is the distance along the beam.
    """
    start = 0
    m = len(to_pulse)
    for i in range(len(from_pulse)):
        while start < m and to_pulse[start] < from_pulse[i]:
            start += 1
        best, at = np.inf, -1
        j = start
        while j < m and to_pulse[j] == from_pulse[i]:
            d = 0.0
            for c in range(3):
                d += (to_xyz[j, c] - from_xyz[i, c]) ** 2
            if d < best or at < 0:
                best, at = d, j
            j += 1
        nearest[i] = at


@kernel
def rank_in_pulse(pulse, rank, size):  # type: ignore[no-untyped-def]
    """Fills in `rank` (rows,), the place of every row in its pulse, from 1, and `size` (rows,), how many rows the pulse
    has; `pulse` int64 (rows,) rises."""
    n = len(pulse)
    a = 0
    while a < n:
        b = a + 1
        while b < n and pulse[b] == pulse[a]:
            b += 1
        for k in range(a, b):
            rank[k] = k - a + 1
            size[k] = b - a
        a = b
