"""Percentiles of whole numbers by nearest rank, without sorting what is not needed."""

from __future__ import annotations

import numpy as np

from fwclass.features.moments import PERCENTILE, PERCENTILES
from fwclass.features.quickselect import lowest_first
from fwclass.kernel import kernel

FEW = 48
"""So many values are sorted by insertion; more are first thrown into buckets."""

BUCKETS = 512


@kernel
def percentiles(z, low, high, values, count, moments):  # type: ignore[no-untyped-def]
    """Set PERCENTILE … of `moments`: the values of rank ceil(p/100 · N), at least 1, of the whole numbers `z`.

    `low` and `high` are the least and greatest of `z`; `values` int32 (len(z),) and `count` int64 (BUCKETS + 1,) are
    scratch.
    """
    n = len(z)
    if n <= FEW:
        _insert(z, values)
        for p in range(len(PERCENTILES)):
            moments[PERCENTILE + p] = values[_rank(PERCENTILES[p], n)]
        return
    shift = 0
    while (high - low) >> shift >= BUCKETS:
        shift += 1
    _throw(z, low, shift, values, count)
    bucket = 0
    for p in range(len(PERCENTILES)):
        rank = _rank(PERCENTILES[p], n)
        while count[bucket] <= rank:
            bucket += 1
        if shift > 0:
            begin = count[bucket - 1] if bucket > 0 else 0
            lowest_first(values[begin : count[bucket]], count[bucket] - begin, rank - begin + 1)
            moments[PERCENTILE + p] = values[rank]
        else:
            moments[PERCENTILE + p] = low + bucket


@kernel
def _throw(z, low, shift, values, count):  # type: ignore[no-untyped-def]
    """Put `z` to `values` by buckets of 2^shift from `low`; `count` gets the place behind each bucket.

    Buckets of one value (`shift` 0) are counted and no more.
    """
    count[:] = 0
    for k in range(len(z)):
        count[np.uint64((np.int64(z[k]) - low) >> shift) + np.uint64(1)] += 1
    for b in range(BUCKETS):
        count[b + 1] += count[b]
    if shift == 0:
        for b in range(BUCKETS):
            count[b] = count[b + 1]
        return
    for k in range(len(z)):
        value = np.int32(z[k])
        own = np.uint64((np.int64(value) - low) >> shift)
        values[np.uint64(count[own])] = value
        count[own] += 1


@kernel
def _rank(p, n):  # type: ignore[no-untyped-def]
    """Place of percentile `p` among `n` sorted values, from 0."""
    return max((p * n + 99) // 100, 1) - 1


@kernel
def _insert(z, values):  # type: ignore[no-untyped-def]
    for k in range(len(z)):
        value = np.int32(z[k])
        at = k
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value
