"""Polygons from well-known binary (OGC 06-103r4; ISO and extended dimension codes), as flat arrays of rings.

Every count is held against the bytes that are left before anything is made of it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import Box
from fwclass.units import LAND

LINE, MULTILINE = 2, 5
POLYGON, MULTIPOLYGON = 3, 6
NAMES = {
    1: "Point",
    2: "LineString",
    3: "Polygon",
    4: "MultiPoint",
    5: "MultiLineString",
    6: "MultiPolygon",
    7: "GeometryCollection",
    8: "CircularString",
    9: "CompoundCurve",
    10: "CurvePolygon",
    11: "MultiCurve",
    12: "MultiSurface",
    13: "Curve",
    14: "Surface",
    15: "PolyhedralSurface",
    16: "TIN",
    17: "Triangle",
}
_EWKB_Z, _EWKB_M, _EWKB_SRID, _EWKB_KIND = 0x80000000, 0x40000000, 0x20000000, 0x1FFFFFFF

_BOX = np.dtype([("order", "u1"), ("kind", "<u4"), ("rings", "<u4"), ("corners", "<u4"), ("xy", "<f8", (5, 2))])
"""A polygon of one ring of four sides."""

Ring = NDArray[np.float64]
"""(points, 2): x, y; the last point is the first again."""


class WkbError(ValueError):
    """Bytes that are no polygon; says why."""


@dataclass(frozen=True)
class Shapes:
    """Polygons of many features.

    Attributes
    ----------
    x, y : float64 (points,), all rings one after another, each closed.
    ring_start : int64 (rings + 1,), points ``ring_start[i]:ring_start[i + 1]`` are ring i.
    part_start : int64 (parts + 1,), rings ``part_start[i]:part_start[i + 1]`` are the outline of part i and its holes.
    feature : int64 (parts,), the feature that the part belongs to, from 0.
    empty : features without any polygon.
    invalid : parts left out because a ring of theirs is not closed, has fewer than four points, or a coordinate that
        is no number.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    ring_start: NDArray[np.int64]
    part_start: NDArray[np.int64]
    feature: NDArray[np.int64]
    empty: int
    invalid: int

    @property
    def parts(self) -> int:
        """Number of parts."""
        return len(self.feature)


class _Cursor:
    """A place in the bytes of one geometry."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    @property
    def left(self) -> int:
        return len(self.data) - self.at

    def order(self) -> str:
        if self.left < 1:
            raise WkbError("the geometry ends before its byte order")
        flag = self.data[self.at]
        self.at += 1
        if flag > 1:
            raise WkbError(f"byte order {flag}, where 0 or 1 is wanted")
        return "<" if flag else ">"

    def count(self, order: str, least: int, what: str) -> int:
        """A number of things of at least `least` bytes each."""
        if self.left < 4:
            raise WkbError(f"the geometry ends before its number of {what}")
        (n,) = struct.unpack_from(order + "I", self.data, self.at)
        self.at += 4
        if n * least > self.left:
            raise WkbError(f"{n} {what} are promised and {self.left} bytes are left")
        return int(n)

    def points(self, order: str, n: int, dimensions: int) -> Ring:
        values = np.frombuffer(self.data, order + "f8", n * dimensions, self.at)
        self.at += 8 * n * dimensions
        return values.reshape(n, dimensions)[:, :2].astype(np.float64)


def parse(data: bytes) -> list[list[Ring]]:
    """The polygons of one geometry, each as its rings, the outline first; heights and measures are left out.

    `WkbError`: another kind of geometry, or bytes that are none.
    """
    cursor = _Cursor(data)
    order, kind, dimensions = _head(cursor)
    if kind == POLYGON:
        polygons = [_rings(cursor, order, dimensions)]
    elif kind == MULTIPOLYGON:
        polygons = []
        for _ in range(cursor.count(order, 9, "polygons")):
            own_order, own_kind, own_dimensions = _head(cursor)
            if own_kind != POLYGON:
                raise WkbError(f"a {NAMES.get(own_kind, own_kind)} inside a MultiPolygon")
            polygons.append(_rings(cursor, own_order, own_dimensions))
    else:
        raise WkbError(f"a geometry of kind {NAMES.get(kind, kind)}")
    if cursor.left:
        raise WkbError(f"{cursor.left} bytes too many")
    return [rings for rings in polygons if rings]


def _head(cursor: _Cursor) -> tuple[str, int, int]:
    """Byte order, kind and dimensions of a geometry."""
    order = cursor.order()
    code = cursor.count(order, 0, "kind")
    extended = bool(code & _EWKB_Z) + bool(code & _EWKB_M)
    if code & _EWKB_SRID:
        cursor.count(order, 0, "reference system")
    code &= _EWKB_KIND
    iso, kind = divmod(code, 1000)
    if iso > 3 or (iso and extended):
        raise WkbError(f"a geometry of unknown kind {code}")
    return order, kind, 2 + extended + (0, 1, 1, 2)[iso]


def _rings(cursor: _Cursor, order: str, dimensions: int) -> list[Ring]:
    rings = cursor.count(order, 4, "rings")
    return [cursor.points(order, cursor.count(order, 8 * dimensions, "points"), dimensions) for _ in range(rings)]


def sound(ring: Ring) -> bool:
    """The ring is closed, has at least four points, and all of them are numbers."""
    return len(ring) >= 4 and bool(np.isfinite(ring).all()) and bool((ring[0] == ring[-1]).all())


def shapes(geometries: Iterable[bytes | None], where: object, first: int = 1) -> Shapes:
    """Polygons of all features, in their order.

    `geometries`: well-known binary of every feature, None for a feature without geometry. `where`: the file, for
    messages. `first`: number of the first feature, in messages.

    `InputError`: a geometry that is no polygon or no well-known binary; the message names the feature.
    """
    rings: list[Ring] = []
    parts, feature, empty, invalid = [0], [], 0, 0
    for number, data in enumerate(geometries):
        polygons = _polygons(data, where, number + first)
        empty += not polygons
        for polygon in polygons:
            if all(map(sound, polygon)):
                rings += polygon
                parts.append(len(rings))
                feature.append(number)
            else:
                invalid += 1
    points = np.concatenate(rings) if rings else np.zeros((0, 2))
    lengths = np.array([len(r) for r in rings], np.int64)
    return Shapes(
        np.ascontiguousarray(points[:, 0]),
        np.ascontiguousarray(points[:, 1]),
        np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths)]),
        np.array(parts, np.int64),
        np.array(feature, np.int64),
        empty,
        invalid,
    )


def _polygons(data: bytes | None, where: object, number: int) -> list[list[Ring]]:
    if data is None:
        return []
    try:
        return parse(bytes(data))
    except WkbError as fault:
        raise InputError(
            "a feature of the polygon file is no polygon",
            where=f"{where}: feature {number}",
            expected="Polygon or MultiPolygon, with or without holes",
            got=str(fault),
            do="remove the feature, or convert it to polygons (for example QGIS: Convert geometry type)",
        ) from fault


def lines(geometries: Iterable[bytes | None], where: object) -> tuple[Shapes, NDArray[np.float64]]:
    """Lines of all features, in their order, each a ring that is not closed, and the heights of their points.

    `InputError`: a geometry that is no line, has no heights, or a point that is no number; the message names the
    feature.
    """
    parts: list[Ring] = []
    feature, empty = [], 0
    for number, data in enumerate(geometries):
        some = [] if data is None else _lines(bytes(data), where, number + 1)
        empty += not some
        parts += some
        feature += [number] * len(some)
    points = np.concatenate(parts) if parts else np.zeros((0, 3))
    start = np.concatenate([np.zeros(1, np.int64), np.cumsum([len(p) for p in parts], dtype=np.int64)])
    x, y, z = (np.ascontiguousarray(v) for v in points.T)
    return Shapes(x, y, start, np.arange(len(parts) + 1), np.array(feature, np.int64), empty, 0), z


def _lines(data: bytes, where: object, number: int) -> list[Ring]:
    try:
        cursor = _Cursor(data)
        order, kind, _ = _head(cursor)
        if kind == MULTILINE:
            lines = [_line(cursor) for _ in range(cursor.count(order, 9, "lines"))]
        else:
            cursor.at = 0
            lines = [_line(cursor)]
        if cursor.left:
            raise WkbError(f"{cursor.left} bytes too many")
        return lines
    except WkbError as fault:
        raise InputError(
            "a feature of the breaklines is no line with heights",
            where=f"{where}: feature {number}",
            expected="LineString Z or MultiLineString Z, in metres of the survey's heights",
            got=str(fault),
            do="give lines their heights (for example QGIS: Drape, from a raster), or leave the feature out",
        ) from fault


def _line(cursor: _Cursor) -> Ring:
    """x, y and height of a line's points."""
    start = cursor.at
    order, kind, dimensions = _head(cursor)
    if kind != LINE:
        raise WkbError(f"a geometry of kind {NAMES.get(kind, kind)}")
    (code,) = struct.unpack_from(order + "I", cursor.data, start + 1)
    if not (code & _EWKB_Z or (code & _EWKB_KIND) // 1000 in (1, 3)):  # a third coordinate may be a measure
        raise WkbError("a line without heights")
    n = cursor.count(order, 8 * dimensions, "points")
    values = np.frombuffer(cursor.data, order + "f8", n * dimensions, cursor.at).reshape(n, dimensions)[:, :3]
    cursor.at += 8 * n * dimensions
    if n < 2 or not np.isfinite(values).all():
        raise WkbError("a line of fewer than two points, or with a coordinate that is no number")
    for height in (values[:, 2].min(), values[:, 2].max()):
        if not LAND[0] <= height <= LAND[1]:
            raise WkbError(f"a height of {height:g} m, where no land is: a number for no data, or another unit")
    return values.astype(np.float64)


def polygon_wkb(polygon: Iterable[Ring]) -> bytes:
    """A polygon of rings (corners, 2), the outline first, as little-endian well-known binary; rings that are open are
    closed."""
    rings = [r if len(r) and (r[0] == r[-1]).all() else np.concatenate([r, r[:1]]) for r in polygon]
    parts = [struct.pack("<BII", 1, POLYGON, len(rings))]
    for ring in rings:
        parts += [struct.pack("<I", len(ring)), ring.astype("<f8").tobytes()]
    return b"".join(parts)


def box_wkb(boxes: Sequence[Box]) -> list[bytes]:
    """Boxes as polygons, little-endian well-known binary."""
    out = np.zeros(len(boxes), _BOX)
    out["order"], out["kind"], out["rings"], out["corners"] = 1, POLYGON, 1, 5
    for k, b in enumerate(boxes):
        out["xy"][k] = [(b.xmin, b.ymin), (b.xmax, b.ymin), (b.xmax, b.ymax), (b.xmin, b.ymax), (b.xmin, b.ymin)]
    return [row.tobytes() for row in out]


def point_wkb(x: NDArray[np.float64], y: NDArray[np.float64]) -> list[bytes]:
    """Points as little-endian well-known binary."""
    return [struct.pack("<BIdd", 1, 1, a, b) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
