"""What is done once for a whole block of neighbourhoods: shapes, the optimal radius, extents, measures."""

from __future__ import annotations

import numpy as np

from fwclass.features.eigen import L1, L2, L3, NX, NY, NZ, first_shapes
from fwclass.features.gather import LANES
from fwclass.features.measures import entropy, measure
from fwclass.features.moments import FAR, NEAR
from fwclass.kernel import kernel


@kernel
def settle(task, block, filled, out, chosen):  # type: ignore[no-untyped-def]
    """Write the measures of the first `filled` echoes of the block to `out` (measures, echoes); see `walk.Task` and
    `walk.Block`."""
    if filled == 0:
        return
    for q in range(len(task.radii)):
        if task.shape[q]:
            first_shapes(block.moments[q], filled, block.shape[q])
    if task.optimal:
        choose(task, block, filled, chosen)
    for q in range(len(task.radii)):
        if task.extent[q]:
            _extents(block, filled, q)
    jobs, rows = task.jobs, block.rows
    for j in range(len(jobs)):
        q, code, row = jobs[j, 0], jobs[j, 1], jobs[j, 2]
        measured = block.measured[:filled]
        measure(code, block.moments[q], block.shape[q], measured)
        for p in range(filled):
            out[row, rows[p]] = measured[p]


@kernel
def choose(task, block, filled, chosen):  # type: ignore[no-untyped-def]
    """Bring every echo's radius of lowest eigenentropy, the smaller on a tie, to place 0; NaN in `chosen` (echoes,)
    where none counts."""
    for p in range(filled):
        best, lowest = -1, np.inf
        for q in range(len(task.radii)):
            shape = block.shape[q]
            value = entropy(shape[L1, p], shape[L2, p], shape[L3, p])
            if value < lowest:
                best, lowest = q, value
        if best >= 0:
            block.moments[0, :, p] = block.moments[best, :, p]
            block.shape[0, :, p] = block.shape[best, :, p]
            block.ends[p, 0] = block.ends[p, best]
            chosen[block.rows[p]] = task.radii[best] * 0.001
        else:
            block.moments[0, :, p] = np.nan
            block.shape[0, :, p] = np.nan
            chosen[block.rows[p]] = np.nan


@kernel
def _extents(block, filled, q):  # type: ignore[no-untyped-def]
    """NEAR and FAR of radius number `q`, as `eigen.along_normal`, a whole vector at a time.

    The echo itself, at zero, is always among its neighbours, so zero stands for what lies behind the last of them.
    """
    x, y, z, begin, ends = block.x, block.y, block.z, block.begin, block.ends
    shape, moments = block.shape[q], block.moments[q]
    for p in range(filled):
        n, base = ends[p, q], np.uint64(begin[p])
        u, v, w = np.float32(128.0 * shape[NX, p]), np.float32(128.0 * shape[NY, p]), np.float32(128.0 * shape[NZ, p])
        low = high = np.int32(0)
        held = np.int32(n)
        for step in range((n + LANES - 1) // LANES * LANES):
            k = base + np.uint64(step)
            place = np.int32(x[k] * u + y[k] * v + z[k] * w)
            place = place if np.int32(step) < held else np.int32(0)
            low = min(low, place)
            high = max(high, place)
        moments[NEAR, p], moments[FAR, p] = low / 128.0, high / 128.0
