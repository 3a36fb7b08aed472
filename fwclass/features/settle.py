"""What is done once for a whole batch of neighbourhoods: shapes, the optimal radius, extents, measures."""

from __future__ import annotations

import numpy as np

from fwclass.features.eigen import L1, L2, L3, NX, NY, NZ, first_shapes
from fwclass.features.gather import LANES
from fwclass.features.measures import entropy, measure
from fwclass.features.moments import FAR, NEAR
from fwclass.kernel import kernel


@kernel
def settle(asked, batch, filled, out, chosen):  # type: ignore[no-untyped-def]
    """Write the jobs of the first `filled` core rows of the batch to `out` (jobs, core rows); see
    `neighbourhoods.NeighbourhoodRequest` and `neighbourhoods.Batch`."""
    if filled == 0:
        return
    for q in range(len(asked.radii)):
        if asked.shape[q]:
            first_shapes(batch.moments[q], filled, batch.shape[q])
    if asked.optimal:
        choose(asked, batch, filled, chosen)
    for q in range(len(asked.radii)):
        if asked.extent[q]:
            _extents(batch, filled, q)
    jobs, rows = asked.jobs, batch.rows
    for j in range(len(jobs)):
        q, code, row = jobs[j, 0], jobs[j, 1], jobs[j, 2]
        measured = batch.measured[:filled]
        measure(code, batch.moments[q], batch.shape[q], measured)
        for p in range(filled):
            out[row, rows[p]] = measured[p]


@kernel
def choose(asked, batch, filled, chosen):  # type: ignore[no-untyped-def]
    """Bring the radius of lowest eigenentropy, the smaller on a tie, of every core row to place 0; NaN in `chosen`
    (core rows,) where none counts."""
    for p in range(filled):
        best, lowest = -1, np.inf
        for q in range(len(asked.radii)):
            shape = batch.shape[q]
            value = entropy(shape[L1, p], shape[L2, p], shape[L3, p])
            if value < lowest:
                best, lowest = q, value
        if best >= 0:
            batch.moments[0, :, p] = batch.moments[best, :, p]
            batch.shape[0, :, p] = batch.shape[best, :, p]
            batch.ends[p, 0] = batch.ends[p, best]
            chosen[batch.rows[p]] = asked.radii[best] * 0.001
        else:
            batch.moments[0, :, p] = np.nan
            batch.shape[0, :, p] = np.nan
            chosen[batch.rows[p]] = np.nan


@kernel
def _extents(batch, filled, q):  # type: ignore[no-untyped-def]
    """NEAR and FAR of radius number `q`, as `eigen.along_normal`, a whole vector at a time.

    The echo itself, at zero, is always among its neighbours, so zero stands for what lies behind the last of them.
    """
    x, y, z, begin, ends = batch.x, batch.y, batch.z, batch.begin, batch.ends
    shape, moments = batch.shape[q], batch.moments[q]
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
