"""Reference classes from polygons: exact in whole millimetres, half-open, one answer where polygons touch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import FURTHEST, Box, millimetres
from fwclass.kernel import kernel
from fwclass.schema import Table
from fwclass.stage import Chunk

BAND = 1_000
"""Height of the bands that points and edges are sorted into [mm]; only the time depends on it."""

WIDEST = 1 << 31
"""Largest extent of a polygon [mm] with which products of two differences fit 64 bits."""

MOST_TESTS, MOST_EDGES = 3 * 10**10, 5 * 10**7
"""Points that are held to an edge of their band, of all bands together (two minutes of the processor), and edges of a
polygon, counted in every band that they cross (400 MB). Forests of a hundred thousand corners come to a tenth of it."""

TESTS = 2 * 10**8
"""Such tests between which Ctrl-C is heeded, about a second."""

NONE, AMBIGUOUS = -1, -2
"""Groups of a point in no polygon, and of one in polygons of different classes."""


def check_reach(reach: float, where: object) -> None:
    """`InputError` for a coordinate of `reach` [m] beyond `FURTHEST`, whose whole millimetres are other numbers."""
    if not reach <= FURTHEST:
        raise InputError(
            "a polygon has a corner that is nowhere on Earth",
            where=where,
            expected=f"coordinates of at most {FURTHEST / 1000:,.0f} km",
            got=f"{reach / 1000:.3g} km",
            do="check the file and its coordinate system",
        )


@dataclass(frozen=True)
class Polygons:
    """Polygons with reference codes.

    Attributes
    ----------
    x, y : int64 (points,) [mm], rings one after another, each closed.
    ring_start : int64 (rings + 1,), points of every ring.
    part_start : int64 (parts + 1,), rings of every part: outline and holes.
    code : uint8 (parts,), reference class code.
    group : int16 (parts,), the class; parts of one group never contradict each other.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    ring_start: NDArray[np.int64]
    part_start: NDArray[np.int64]
    code: NDArray[np.uint8]
    group: NDArray[np.int16]

    @property
    def parts(self) -> int:
        """Number of parts."""
        return len(self.code)

    def arrays(self) -> dict[str, NDArray]:
        """What a store keeps, by name: x, y [mm], offsets of rings and parts, codes, groups; `from_arrays` makes the
        same again."""
        return {n: getattr(self, n) for n in ("x", "y", "ring_start", "part_start", "code", "group")}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Polygons:
        """The polygons whose `arrays` these are: x, y [mm], offsets of rings and parts, codes, groups."""
        return cls(*(arrays[n] for n in ("x", "y", "ring_start", "part_start", "code", "group")))

    @classmethod
    def of(cls, shapes: Any, code: NDArray[np.int16], group: NDArray[np.int16], where: object) -> Polygons:
        """Shapes (`x, y` [m], `ring_start, part_start, feature`) whose feature has a code.

        `InputError` where a polygon is too large to be one.
        """
        reach = max(float(np.abs(v).max(initial=0.0)) for v in (shapes.x, shapes.y))
        check_reach(reach, where)
        part_code = code[shapes.feature]
        polygons = cls(
            millimetres(shapes.x),
            millimetres(shapes.y),
            shapes.ring_start,
            shapes.part_start,
            part_code.astype(np.uint8),
            group[shapes.feature],
        )
        polygons = polygons.take(part_code >= 0)
        low_x, low_y, high_x, high_y = polygons.bounds
        wide = np.flatnonzero(np.maximum(high_x - low_x, high_y - low_y) > WIDEST)
        if len(wide):
            raise InputError(
                "a polygon is too large",
                where=where,
                expected=f"at most {WIDEST / 1e6:.0f} km across",
                got=f"{(high_x - low_x)[wide[0]] / 1e6:.0f} x {(high_y - low_y)[wide[0]] / 1e6:.0f} km",
                do="check the coordinate system of the polygons",
            )
        return polygons

    @property
    def bounds(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Least x, least y, greatest x, greatest y of every part [mm]."""
        if not self.parts:
            none = np.zeros(0, np.int64)
            return none, none, none, none
        first = self.ring_start[self.part_start[:-1]]
        return (
            np.minimum.reduceat(self.x, first),
            np.minimum.reduceat(self.y, first),
            np.maximum.reduceat(self.x, first),
            np.maximum.reduceat(self.y, first),
        )

    def take(self, parts: NDArray) -> Polygons:
        """Only `parts` (index or mask, (parts,)), in the order given."""
        chosen = np.arange(self.parts)[parts]
        rings = _spread(self.part_start[chosen], self.part_start[chosen + 1])
        points = _spread(self.ring_start[rings], self.ring_start[rings + 1])
        return Polygons(
            self.x[points],
            self.y[points],
            _starts(np.diff(self.ring_start)[rings]),
            _starts(np.diff(self.part_start)[chosen]),
            self.code[chosen],
            self.group[chosen],
        )

    def within(self, box: Box) -> Polygons:
        """Those that may own a point of `box` [m]."""
        low_x, low_y, high_x, high_y = self.bounds
        x0, y0, x1, y1 = (int(v) for v in millimetres(np.array(box.bounds)))
        return self.take((low_x <= x1) & (high_x >= x0) & (low_y <= y1) & (high_y >= y0))

    @classmethod
    def joined(cls, several: Sequence[Polygons]) -> Polygons:
        """All parts of `several`, in their order."""
        points, rings = (
            np.cumsum([0, *(len(p.x) for p in several)]),
            np.cumsum([0, *(len(p.ring_start) - 1 for p in several)]),
        )
        return cls(
            np.concatenate([p.x for p in several]),
            np.concatenate([p.y for p in several]),
            np.concatenate([*(p.ring_start[:-1] + n for p, n in zip(several, points, strict=False)), points[-1:]]),
            np.concatenate([*(p.part_start[:-1] + n for p, n in zip(several, rings, strict=False)), rings[-1:]]),
            np.concatenate([p.code for p in several]),
            np.concatenate([p.group for p in several]),
        )


def _starts(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths, dtype=np.int64)])


def _spread(first: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.int64]:
    """All numbers of the ranges [first, last), one range after another."""
    length = last - first
    start = _starts(length)
    return np.repeat(first - start[:-1], length) + np.arange(start[-1])


def from_polygons(chunk: Chunk, polygons: Polygons) -> tuple[Table, int]:
    """Code of the polygon that every core echo lies in, and how many lie in polygons of different classes.

    A polygon owns the points on its western and southern edges and not those on the eastern and northern ones, so that
    of two that touch only one owns a point. A hole is no part of it. Echoes in no polygon, and echoes in polygons of
    different classes, get 0; of several codes of one class the smallest. The order of the polygons does not matter.

    Parameters
    ----------
    chunk : core echoes with x, y [m].
    """
    x, y = (millimetres(chunk.table[n][chunk.core]) for n in "xy")
    code, group = owners(x, y, polygons)
    return Table({"reference": np.where(group >= 0, code, 0).astype(np.uint8)}), int((group == AMBIGUOUS).sum())


def owners(
    x: NDArray[np.int64], y: NDArray[np.int64], polygons: Polygons
) -> tuple[NDArray[np.uint8], NDArray[np.int16]]:
    """Code and group of the polygon that every point [mm] lies in; the group may be `NONE` or `AMBIGUOUS`.

    `InputError` where polygons have so many edges beside so many points that it would take hours.
    """
    code, group = np.zeros(len(x), np.uint8), np.full(len(x), NONE, np.int16)
    if not len(x) or not polygons.parts:
        return code, group
    south = int(y.min())
    band = (y - south) // BAND
    order = np.lexsort((x, band))
    start = np.searchsorted(band[order], np.arange(int(band.max()) + 2))
    sorted_code, sorted_group = code[order], group[order]
    low_x, low_y, high_x, high_y = polygons.bounds
    bands = len(start) - 1
    room = _most_edges(polygons.y, polygons.ring_start, polygons.part_start, south, bands)
    few = room <= MOST_EDGES
    edges, edge_start, at = (np.empty(n, np.int64) for n in (room if few else 0, bands + 2, 3))
    given = (
        x[order],
        y[order],
        start,
        south,
        polygons.x,
        polygons.y,
        polygons.ring_start,
        polygons.part_start,
        low_x,
        low_y,
        high_x,
        high_y,
        polygons.code,
        polygons.group,
        sorted_code,
        sorted_group,
        edges,
        edge_start,
        at,
    )
    at[:] = 0
    if not few or (len(polygons.x) * len(x) > MOST_TESTS and _mark(*given, MOST_TESTS, True) < 0):
        raise InputError(
            "polygons have too many edges side by side",
            where=f"around {x.min() / 1000:.0f}, {y.min() / 1000:.0f}",
            expected=f"at most {MOST_TESTS:.0e} pairs of an edge and a point between its ends from south to north, and "
            f"{MOST_EDGES:.0e} edges, each counted in every metre that it crosses",
            got=f"{len(polygons.x):,} corners beside {len(x):,} points",
            do="simplify the polygons, or cut them into smaller ones",
        )
    at[:] = 0
    while at[0] < polygons.parts:  # Python heeds Ctrl-C in between
        _mark(*given, TESTS, False)
    code[order], group[order] = sorted_code, sorted_group
    return code, group


@kernel
def _most_edges(y, ring_start, part_start, south, bands):  # type: ignore[no-untyped-def]
    """Room that the part with the most edges needs: its edges, counted in every band of `bands` that they cross."""
    most = 0
    for p in range(len(part_start) - 1):
        n = 0
        for r in range(part_start[p], part_start[p + 1]):
            for k in range(ring_start[r], ring_start[r + 1] - 1):
                low, high = min(y[k], y[k + 1]), max(y[k], y[k + 1])
                first, last = max((low - south) // BAND, 0), min((high - 1 - south) // BAND, bands - 1)
                if low < high and first <= last:
                    n += last - first + 1
        most = max(most, n)
    return most


@kernel
def _edges_by_band(y, ring_start, rings, south, base, bands, start, edges):  # type: ignore[no-untyped-def]
    """Edges of one part, counted into the bands [base, base + bands) that they cross.

    An edge is the number of its first point. Band b holds ``edges[start[b]:start[b + 1]]``.
    """
    start[: bands + 2] = 0
    for fill in range(2):
        for r in range(rings[0], rings[1]):
            for k in range(ring_start[r], ring_start[r + 1] - 1):
                low, high = min(y[k], y[k + 1]), max(y[k], y[k + 1])
                if low == high:
                    continue
                first = max((low - south) // BAND - base, 0)
                last = min((high - 1 - south) // BAND - base, bands - 1)
                for b in range(first, last + 1):
                    if fill == 0:
                        start[b + 2] += 1
                    else:
                        edges[start[b + 1]] = k
                        start[b + 1] += 1
        if fill == 0:
            for b in range(bands):
                start[b + 2] += start[b + 1]


@kernel
def _inside(px, py, x, y, edges, first, last):  # type: ignore[no-untyped-def]
    """Whether a ray to the east crosses an odd number of edges; whole numbers, so that every answer is exact."""
    odd = False
    for e in range(first, last):
        a = edges[e]
        b = a + 1
        if y[a] > y[b]:
            a, b = b, a
        if y[a] <= py < y[b] and (px - x[a]) * (y[b] - y[a]) < (x[b] - x[a]) * (py - y[a]):
            odd = not odd
    return odd


@kernel
def _mark(  # type: ignore[no-untyped-def]
    px,
    py,
    band_start,
    south,
    x,
    y,
    ring_start,
    part_start,
    low_x,
    low_y,
    high_x,
    high_y,
    code,
    group,
    out_code,
    out_group,
    edges,
    start,
    at,
    tests,
    counted,
):
    """Every polygon marks its points, which are sorted by band, then x, from polygon, band and point `at` on, for as
    many `tests` of a point against an edge; what is left of these. `counted`: tests are only counted."""
    n_bands = len(band_start) - 1
    for p in range(at[0], len(code)):
        if tests < 0:
            at[0] = p
            return tests
        base = max((low_y[p] - south) // BAND, 0)
        bands = min((high_y[p] - south) // BAND, n_bands - 1) - base + 1
        if bands > 0:
            rings = (part_start[p], part_start[p + 1])
            _edges_by_band(y, ring_start, rings, south, base, bands, start, edges)
        for b in range(at[1], bands):
            i = band_start[base + b]
            end = band_start[base + b + 1]
            here = start[b + 1] - start[b]
            if i == end or here == 0:
                continue
            end = i + np.searchsorted(px[i:end], high_x[p], side="right")
            i = max(i + np.searchsorted(px[i:end], low_x[p]), at[2])
            at[2] = 0
            if counted:
                tests -= (end - i) * here
                if tests < 0:
                    return tests
                continue
            while i < end:
                if tests < 0:
                    at[0], at[1], at[2] = p, b, i
                    return tests
                tests -= here
                if _inside(px[i], py[i], x, y, edges, start[b], start[b + 1]):
                    if out_group[i] == NONE:
                        out_group[i] = group[p]
                        out_code[i] = code[p]
                    elif out_group[i] == group[p]:
                        out_code[i] = min(out_code[i], code[p])
                    else:
                        out_group[i] = AMBIGUOUS
                i += 1
        at[1] = 0
        if bands > 0 and not counted:
            tests -= start[bands]  # edges take time too where no point lies beside them
    at[0] = len(code)
    return tests
