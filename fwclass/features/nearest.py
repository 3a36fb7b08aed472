"""Features of the k nearest echoes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.features.attributes import Attributes, add_attributes, add_spread
from fwclass.features.eigen import NX, NY, NZ, SHAPES, along_normal, shapes
from fwclass.features.measures import CODE, measure, needs
from fwclass.features.moments import FAR, HIGH, LOW, MOMENTS, NEAR, REACH, add_places
from fwclass.features.percentiles import BUCKETS, percentiles
from fwclass.features.search import ROWS, Columns, nearest
from fwclass.grid import whole_millimetres
from fwclass.kernel import kernel
from fwclass.schema import Scale
from fwclass.stage import Chunk

BATCH = 1024
"""Echoes that are worked on together."""


def nearest_echoes(
    chunk: Chunk, scale: Scale, bases: tuple[str, ...], nearest_reach: float
) -> dict[str, NDArray[np.float32]]:
    """Features `bases` of the core rows, by base, over the ``scale.size`` nearest rows of the chunk, itself included.

    Distances are those of whole millimetres in space. Of rows at the same distance the earlier one is nearer, and as
    rows stand in canonical order, tiles do not matter. No row beyond `nearest_reach` [m] is looked for: then there
    are fewer.
    """
    features = {base: np.empty(len(chunk.core), np.float32) for base in bases}
    if len(chunk.core) == 0:
        return features
    table, k, needed = chunk.table, scale.size, needs(bases)
    reach = whole_millimetres(nearest_reach, "features.nearest_reach")
    columns = Columns.build(table["x"], table["y"], table["z"], k, nearest_reach)
    index = columns.index
    attributes = Attributes.of(table, needed)
    places = np.empty((table.rows, 3), np.int64)
    places[index.order] = np.stack([index.x, index.y, index.z], axis=1)
    wanted, rows = _in_order(index.order, chunk.core)
    neighbours, count = np.empty((BATCH, k), np.int64), np.empty(BATCH, np.int64)
    room = np.empty((2, table.rows), np.int64)
    for first in range(0, len(wanted), BATCH):
        part = wanted[first : first + BATCH]
        keys, number = neighbours[: len(part)], count[: len(part)]
        nearest(
            columns.x,
            columns.y,
            columns.z,
            index.x,
            index.y,
            index.z,
            index.order,
            index.start,
            index.ncols,
            index.nrows,
            index.cell,
            part,
            k,
            reach,
            room[0],
            room[1],
            keys,
            number,
        )
        moments, shape = np.zeros((MOMENTS, len(part))), np.empty((SHAPES, len(part)))
        _fill(places, keys, number, *attributes, needed.powers, needed.percentiles, moments)
        if needed.shape or needed.extent:
            shapes(moments, shape)
        if needed.extent:
            _extents(places, keys, number, shape, moments)
        values = np.empty(len(part), np.float32)
        for base in bases:
            measure(CODE[base], moments, shape, values)
            features[base][rows[first : first + BATCH]] = values
    return features


def _in_order(order: NDArray[np.int64], core: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sorted points that are core rows, in the order of the columns, and their places among the core rows."""
    place = np.full(len(order), -1, np.int64)
    place[core] = np.arange(len(core))
    own = place[order]
    wanted = np.flatnonzero(own >= 0)
    return wanted, own[wanted]


@kernel
def _relative(places, keys, n, at, x, y, z):  # type: ignore[no-untyped-def]
    """Rows of the first `n` keys to `at`, and their places relative to the first, which is the point itself."""
    mask = (np.int64(1) << ROWS) - 1
    i = keys[0] & mask
    for e in range(n):
        j = keys[e] & mask
        at[e] = j
        x[e] = float(places[j, 0] - places[i, 0])
        y[e] = float(places[j, 1] - places[i, 1])
        z[e] = float(places[j, 2] - places[i, 2])


@kernel
def _fill(places, keys, count, kinds, amplitude, width, intensity, powers, ranks, moments):  # type: ignore[no-untyped-def]
    """Moments of the neighbourhoods whose keys are `keys`."""
    k = keys.shape[1]
    at, x, y, z, m = np.empty(k, np.int64), np.empty(k), np.empty(k), np.empty(k), np.empty(MOMENTS)
    ranked, buckets = np.empty(k, np.int32), np.empty(BUCKETS + 1, np.int64)
    for b in range(len(keys)):
        n = count[b]
        _relative(places, keys[b], n, at, x, y, z)
        m[:] = 0.0
        add_places(x[:n], y[:n], z[:n], m)
        add_spread(z[:n], powers, m)
        m[REACH] = math.sqrt(float((keys[b, n - 1] >> ROWS) - 1)) if n > 1 else 0.0
        add_attributes(kinds, amplitude, width, intensity, at[:n], m)
        if ranks:
            percentiles(z[:n], np.int64(m[LOW]), np.int64(m[HIGH]), ranked, buckets, m)
        moments[:, b] = m


@kernel
def _extents(places, keys, count, shape, moments):  # type: ignore[no-untyped-def]
    """NEAR and FAR along the normals of `shape`."""
    k = keys.shape[1]
    at, x, y, z = np.empty(k, np.int64), np.empty(k), np.empty(k), np.empty(k)
    for b in range(len(keys)):
        if shape[NZ, b] == shape[NZ, b]:
            n = count[b]
            _relative(places, keys[b], n, at, x, y, z)
            low, high = along_normal(x[:n], y[:n], z[:n], shape[NX, b], shape[NY, b], shape[NZ, b])
            moments[NEAR, b], moments[FAR, b] = low, high
