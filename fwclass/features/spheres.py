"""Features of spheres, vertical cylinders and spheres of the optimal radius around the core rows of a chunk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fwclass.cores import share_out
from fwclass.features.attributes import Attributes
from fwclass.features.eigen import SHAPES
from fwclass.features.gather import LANES, Points, most_in_window, slices, window
from fwclass.features.measures import CODE, needs
from fwclass.features.moments import AREA, MOMENTS
from fwclass.features.neighbourhoods import BATCH, STRIDE, Batch, Grid, NeighbourhoodRequest, Scratch, measure_around
from fwclass.features.params import LINEAR, NORMAL, FeaturesParams
from fwclass.features.percentiles import BUCKETS
from fwclass.schema import Scale
from fwclass.stage import Chunk

Columns = dict[str, NDArray[np.float32]]

WIDEST_RATIO = 4.0
"""Radii of one pass over the grid differ by at most this factor: a small sphere is not looked for among a large
cylinder's echoes."""

MOST_OVER_AGAIN = 2.0
"""Radii are taken one by one, each with its sums at once, where that meets at most so many times the candidates of the
largest: to put neighbours into the order of their shells costs more."""

AT_A_TIME = 20_000_000
"""Candidates that one call of a kernel meets, some tenths of a second: then an interrupt is heeded."""

POOL = 1 << 14
"""At least so many neighbours are kept for the sums of a batch and its second pass."""


def spheres(chunk: Chunk, request: Mapping[Scale, Sequence[str]], params: FeaturesParams) -> Columns:
    """Features `request` (bases, which are measures without scale, by scale of kind r or c) and the normals of the core
    rows, by name."""
    columns: Columns = {}
    normals = Scale("r", round(params.normal_radius * 100))
    plain = {scale: tuple(bases) for scale, bases in request.items()}
    plain[normals] = tuple(dict.fromkeys((*plain.get(normals, ()), LINEAR, *NORMAL)))
    for kind in "rc":
        for scales in scale_groups({scale: bases for scale, bases in plain.items() if scale.kind == kind}):
            columns |= _by_scale(chunk, {scale: plain[scale] for scale in scales})
    return columns


def optimal(chunk: Chunk, bases: Sequence[str], wants_radius: bool, params: FeaturesParams) -> Columns:
    """`bases` of the sphere of the optimal radius of each core row, and that radius itself (``optimal_radius``) [m].

    It is the one of `params.optimal_radii` with the lowest eigenentropy, the smaller on a tie; those with fewer than
    three echoes or all at one place do not count. NaN where none counts.

    Source: Weinmann 2015.
    """
    radii = [round(radius * 1000) for radius in params.optimal_radii]
    names = [f"{base}_opt" for base in bases]
    out, chosen = _run(chunk, radii, "r", [(0, base) for base in bases], optimal=True)
    values = dict(zip(names, out, strict=True))
    return {**values, "optimal_radius": chosen} if wants_radius else values


def scale_groups(request: Mapping[Scale, Sequence[str]]) -> list[list[Scale]]:
    """Scales in groups that one pass over the grid takes, each of rising size."""
    groups: list[list[Scale]] = []
    for scale in sorted(request, key=lambda s: s.size):
        if groups and scale.size <= WIDEST_RATIO * groups[-1][0].size:
            groups[-1].append(scale)
        else:
            groups.append([scale])
    return [part for scales in groups for part in _apart(scales, request)]


def _apart(scales: list[Scale], request: Mapping[Scale, Sequence[str]]) -> list[list[Scale]]:
    """`scales` one by one where all sums can be taken at once and few echoes are met twice."""
    at_once = all(_at_once(request[scale]) for scale in scales)
    met = sum(scale.size**2 for scale in scales)
    return [[scale] for scale in scales] if at_once and met <= MOST_OVER_AGAIN * scales[-1].size ** 2 else [scales]


def _at_once(bases: Iterable[str]) -> bool:
    need = needs(bases)
    return not (need.extent or need.percentiles)


def _by_scale(chunk: Chunk, request: Mapping[Scale, Sequence[str]]) -> Columns:
    scales = list(request)
    jobs = [(q, base) for q, scale in enumerate(scales) for base in request[scale]]
    out, _ = _run(chunk, [scale.millimetres for scale in scales], scales[0].kind, jobs, optimal=False)
    names = [base if base in NORMAL else f"{base}_{scales[q].suffix}" for q, base in jobs]
    return dict(zip(names, out, strict=True))


def _run(
    chunk: Chunk, radii: Sequence[int], kind: str, jobs: Sequence[tuple[int, str]], optimal: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """float32 (jobs, core rows) of the jobs (radius number, measure), and the optimal radii [m]."""
    out = np.full((len(jobs), len(chunk.core)), np.nan, np.float32)
    chosen = np.full(len(chunk.core) if optimal else 0, np.nan, np.float32)
    if len(chunk.core) == 0:
        return out, chosen
    asked = _request(radii, kind, jobs, optimal)
    points = Points.of(chunk.table, radii[-1])
    half = window(points.cell, radii[-1])
    most = int(most_in_window(points.start, points.ncols, points.nrows, half))
    wanted = np.full(chunk.table.rows, -1, np.int32)
    wanted[chunk.core] = np.arange(len(chunk.core), dtype=np.int32)
    grid = Grid(
        points.x, points.y, points.z, points.start, points.ncols, points.nrows, points.cell, half, wanted[points.order]
    )
    values = Attributes.of(chunk.table, needs(base for _, base in jobs)).take(points.order)
    cuts = slices(points.start, points.ncols, points.nrows, half, AT_A_TIME)

    def with_room() -> Callable[[tuple[int, int]], None]:
        scratch = Scratch.of(most, asked, BUCKETS, values)
        batch = _batch(asked, max(2 * most, POOL) + 2 * LANES, values)
        return lambda span: measure_around(grid, values, asked, scratch, batch, *span, out, chosen)

    share_out(list(pairwise(cuts.tolist())), with_room)
    return out, chosen


def _request(radii: Sequence[int], kind: str, jobs: Sequence[tuple[int, str]], optimal: bool) -> NeighbourhoodRequest:
    every = needs(base for _, base in jobs)
    own = [needs(base for q, base in jobs if q == at) for at in range(len(radii))]
    size = np.array(radii, np.int64)
    return NeighbourhoodRequest(
        radii=size,
        limits=(size * size).astype(np.float64),
        bounds=np.append((size[:-1] * size[:-1]).astype(np.float64), np.full(-(len(size) - 1) % 4, np.inf)),
        cylinder=kind == "c",
        optimal=optimal,
        shape=np.array([optimal or need.shape for need in own]),
        extent=np.array([need.extent for need in own]),
        powers=every.powers,
        among=every.cylinder,
        ranks=every.percentiles,
        at_once=len(radii) == 1 and not optimal and _at_once(base for _, base in jobs),
        jobs=np.array([(q, CODE[base], row) for row, (q, base) in enumerate(jobs)], np.int64).reshape(-1, 3),
    )


def _batch(asked: NeighbourhoodRequest, room: int, values: Attributes) -> Batch:
    """Room for the neighbourhoods of a batch of core rows, `room` neighbours in all."""
    count = len(asked.radii)
    moments = np.zeros((count, MOMENTS, STRIDE))
    moments[:, AREA] = (np.pi * (asked.radii * 0.001) ** 2)[:, None]
    x, y, z = (np.empty(room, np.float32) for _ in range(3))
    return Batch(
        x,
        y,
        z,
        values.room(room),
        np.zeros(BATCH, np.int64),
        np.zeros((BATCH, count), np.int64),
        np.zeros(BATCH, np.uint64),
        moments,
        np.full((count, SHAPES, STRIDE), np.nan),
        np.empty(BATCH, np.float32),
    )
