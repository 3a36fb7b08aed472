"""Features of a pulse: how much the echoes of one beam differ."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import millimetres, whole_millimetres
from fwclass.kernel import kernel
from fwclass.schema import Table
from fwclass.stage import Chunk

MEASURED = {"pulse_intensity_variance": "intensity", "pulse_amplitude_variance": "amplitude"}
"""Feature and the column that it is the variance of."""


def pulse_variances(chunk: Chunk, names: tuple[str, ...], reach: float) -> dict[str, NDArray[np.float32]]:
    """Features `names` (keys of `MEASURED`) of the core rows.

    The variance (divided by N) over the echoes of the same strip and pulse that lie within `reach` [m] in
    plan: an oblique beam may leave its tile, and where its echoes end must not depend on the tiles. An echo that
    measured nothing (NaN) is left out; 0 for a single echo, NaN without any value.

    Sources without waveforms do not tell pulses: there the echoes of one strip, time and number of echoes belong
    together. Where two of them within reach have the same echo number, the time tells no pulse, and the value is NaN.

    Source: Shi 2019, PV.
    """
    order, first = _pulses(chunk.table)
    lone, firsts = _alone(chunk.table, order, first)
    limit = whole_millimetres(reach, "features.pulse_reach")
    x, y = (millimetres(chunk.table[axis]) for axis in "xy")
    number = chunk.table["echo_number"].astype(np.int64)
    variances = {}
    for name in names:
        values = chunk.table[MEASURED[name]].astype(np.float64)
        out = np.empty(chunk.table.rows, np.float32)
        out[order] = _variances(x[order], y[order], values[order], first, limit)
        out[lone] = _variances_by_x(x[lone], y[lone], number[lone], values[lone], firsts, limit)
        variances[name] = out[chunk.core]
    return variances


def _pulses(table: Table) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows by strip and pulse, and the first of every pulse, one more at the end."""
    pulse = table["strip"].astype(np.uint64) << np.uint64(32) | table["pulse"].astype(np.uint64)
    order = np.argsort(pulse, kind="stable")
    ends = np.flatnonzero(np.diff(pulse[order]) != 0) + 1
    return order, np.concatenate([[0], ends, [table.rows]]).astype(np.int64)


def _alone(
    table: Table, order: NDArray[np.int64], first: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of several echoes whose pulse has no other row here, by strip, time, number of echoes and x; the first of
    every such group, one more at the end."""
    single = np.diff(first) == 1
    rows = order[first[:-1][single]]
    rows = rows[(table["number_of_echoes"][rows] > 1) & np.isfinite(table["gps_time"][rows])]
    keys = (table["number_of_echoes"][rows], table["gps_time"][rows], table["strip"][rows])
    by = np.lexsort((table["x"][rows], *keys))
    new = np.zeros(max(len(rows) - 1, 0), bool)
    for key in keys:
        new |= np.diff(key[by].astype(np.float64)) != 0
    ends = np.flatnonzero(new) + 1
    return rows[by], np.concatenate([[0], ends, [len(rows)]]).astype(np.int64)


@kernel
def _variances_by_x(x, y, number, values, first, limit):  # type: ignore[no-untyped-def]
    """As `_variances`, of groups in order of x; NaN where an echo number occurs twice within reach."""
    out, numbers = np.empty(len(x), np.float32), np.zeros(4, np.uint64)
    for p in range(len(first) - 1):
        low = first[p]
        for i in range(first[p], first[p + 1]):
            while x[i] - x[low] > limit:
                low += 1
            numbers[:] = 0
            n, total, squares, twice = 0, 0.0, 0.0, False
            j = low
            while j < first[p + 1] and x[j] - x[i] <= limit and not twice:
                dx, dy = x[j] - x[i], y[j] - y[i]
                if dx * dx + dy * dy <= limit * limit:
                    field, bit = (number[j] >> 6) & 3, np.uint64(1) << np.uint64(number[j] & 63)
                    twice = (numbers[field] & bit) != 0
                    numbers[field] |= bit
                    if not math.isnan(values[j]):
                        apart = values[j] - values[i] if not math.isnan(values[i]) else values[j]
                        n += 1
                        total += apart
                        squares += apart * apart
                j += 1
            mean = total / n if n > 0 else math.nan
            out[i] = math.nan if twice or n == 0 else max(squares / n - mean * mean, 0.0)
    return out


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
