"""Which corners of a line stay where it is simplified."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel


@kernel
def mark_corners(line, stays, tolerance):  # type: ignore[no-untyped-def]
    """Mark the corners of a line that no more than `tolerance` is lost of without the others.

    Parameters
    ----------
    line : float64 (corners, 2), in some unit.
    stays : bool (corners,); the corners between two that stay are looked at, and more are set.
    tolerance : distance of a corner from the line through those that stay, in the same unit.

    Source: Douglas and Peucker 1973.
    """
    pending = np.empty((len(line) + 1, 2), np.int64)
    count, last = 0, 0
    for k in range(1, len(line)):
        if stays[k]:
            pending[count] = last, k
            count += 1
            last = k
    while count:
        count -= 1
        a, b = pending[count]
        ax, ay = line[b, 0] - line[a, 0], line[b, 1] - line[a, 1]
        length = math.hypot(ax, ay)
        worst, most = -1, tolerance
        for k in range(a + 1, b):
            x, y = line[k, 0] - line[a, 0], line[k, 1] - line[a, 1]
            if length > 0.0:
                share = min(max((x * ax + y * ay) / (length * length), 0.0), 1.0)
                x -= share * ax
                y -= share * ay
            off = math.hypot(x, y)
            if off > most:
                worst, most = k, off
        if worst >= 0:
            stays[worst] = True
            pending[count] = a, worst
            pending[count + 1] = worst, b
            count += 2
