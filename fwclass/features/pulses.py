"""Features of a pulse: how much the echoes of one beam differ."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.features.params import FeaturesParams
from fwclass.grid import millimetres, whole_millimetres
from fwclass.kernel import kernel
from fwclass.schema import Table
from fwclass.stage import Chunk

MEASURED = {"pulse_intensity_variance": "intensity", "pulse_amplitude_variance": "amplitude"}
"""Feature and the column that it is the variance of."""


def pulse_variances(chunk: Chunk, names: tuple[str, ...], params: FeaturesParams) -> dict[str, NDArray[np.float32]]:
    """Features `names` (keys of `MEASURED`) of the core rows.

    The variance (divided by N) over the echoes of the same strip and pulse that lie within ``params.pulse_reach`` in
    plan: an oblique beam may leave its tile, and where its echoes end must not depend on the tiles. An echo that
    measured nothing (NaN) is left out; 0 for a single echo, NaN without any value.

    Source: Shi 2019, PV.
    """
    order, first = _pulses(chunk.table)
    x, y = (millimetres(chunk.table[axis])[order] for axis in "xy")
    limit = whole_millimetres(params.pulse_reach, "features.pulse_reach")
    made = {}
    for name in names:
        values = chunk.table[MEASURED[name]][order].astype(np.float64)
        out = np.empty(chunk.table.rows, np.float32)
        out[order] = _variances(x, y, values, first, limit)
        made[name] = out[chunk.core]
    return made


def _pulses(table: Table) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows by strip and pulse, and the first of every pulse, one more at the end."""
    pulse = table["strip"].astype(np.uint64) << np.uint64(32) | table["pulse"].astype(np.uint64)
    order = np.argsort(pulse, kind="stable")
    ends = np.flatnonzero(np.diff(pulse[order]) != 0) + 1
    return order, np.concatenate([[0], ends, [table.rows]]).astype(np.int64)


@kernel
def _variances(x, y, values, first, limit):  # type: ignore[no-untyped-def]
    """Variance around every row: rows `first[p]` up to `first[p + 1]` are pulse p; float32 in order of rows."""
    out = np.empty(len(x), np.float32)
    for p in range(len(first) - 1):
        for i in range(first[p], first[p + 1]):
            n, total = 0, 0.0
            for j in range(first[p], first[p + 1]):
                if _beside(x, y, values, i, j, limit):
                    n += 1
                    total += values[j]
            mean, square = total / n if n > 0 else math.nan, 0.0
            for j in range(first[p], first[p + 1]):
                if _beside(x, y, values, i, j, limit):
                    square += (values[j] - mean) ** 2
            out[i] = square / n if n > 0 else math.nan
    return out


@kernel
def _beside(x, y, values, i, j, limit):  # type: ignore[no-untyped-def]
    dx, dy = x[j] - x[i], y[j] - y[i]
    return dx * dx + dy * dy <= limit * limit and not math.isnan(values[j])
