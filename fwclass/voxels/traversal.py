"""The kernel that leads beams through voxels (Amanatides and Woo 1987)."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel


@kernel
def follow(start, end, last, shares, share_start, size, low, passes, occluded, entering, path):  # type: ignore[no-untyped-def]
    """Lead every beam through the voxels from `start` to `end`.

    Parameters
    ----------
    start, end : (n, 3) [m, counted from the lattice's corner].
    last : (n,) length from `start` to the beam's last echo [m].
    shares, share_start : distance of every echo from `start` [m] and its share of the pulse's light, (echoes, 2) by
        beam and distance; those of beam i are ``shares[share_start[i]:share_start[i + 1]]``.
    size : of a voxel [m]; low : not used below this length.
    passes, occluded, entering, path : (layers, rows, columns), added to.
    """
    nz, ny, nx = passes.shape
    cell, step = np.empty(3, np.int64), np.empty(3, np.int64)
    reach, stride = np.empty(3), np.empty(3)
    for i in range(len(start)):
        length = 0.0
        for c in range(3):
            length += (end[i, c] - start[i, c]) ** 2
        length = math.sqrt(length)
        if not low < length < 1e7:
            continue
        for c in range(3):
            way = (end[i, c] - start[i, c]) / length
            cell[c] = int(math.floor(start[i, c] / size))
            if way > 0.0:
                step[c], stride[c] = 1, size / way
                reach[c] = ((cell[c] + 1) * size - start[i, c]) / way
            elif way < 0.0:
                step[c], stride[c] = -1, -size / way
                reach[c] = (cell[c] * size - start[i, c]) / way
            else:
                step[c], stride[c], reach[c] = 0, 1e300, 1e300
        at, left, echo = 0.0, 1.0, share_start[i]
        while at < length:
            nearest = 0
            for c in range(1, 3):
                if reach[c] < reach[nearest]:
                    nearest = c
            leave = min(reach[nearest], length)
            if 0 <= cell[0] < nx and 0 <= cell[1] < ny and 0 <= cell[2] < nz:
                if at <= last[i]:
                    passes[cell[2], cell[1], cell[0]] += 1
                    entering[cell[2], cell[1], cell[0]] += max(left, 0.0)
                    path[cell[2], cell[1], cell[0]] += min(leave, last[i]) - at
                else:
                    occluded[cell[2], cell[1], cell[0]] += 1
            while echo < share_start[i + 1] and shares[echo, 0] <= leave:
                left -= shares[echo, 1]
                echo += 1
            at = leave
            cell[nearest] += step[nearest]
            reach[nearest] += stride[nearest]
