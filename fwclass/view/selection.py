"""Echoes inside what was drawn: a polygon or a stroke of a brush on a projection, and the filters that hold besides."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError

MOST_POINTS = 2000
"""Of what is drawn; a page sends fewer."""

FAR = 1e9
"""Larger numbers are no places of a survey, or of a screen."""

Bounds = Sequence[float]
"""xmin, ymin, zmin, xmax, ymax, zmax [m]."""


@dataclass(frozen=True)
class Slab:
    """Echoes along a section: from `start` to `end` (x, y) [m], at most `half` [m] beside it."""

    start: tuple[float, float]
    end: tuple[float, float]
    half: float

    def contains(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """bool (rows,), of places [m]; the edges are inside."""
        dx, dy = self.end[0] - self.start[0], self.end[1] - self.start[1]
        length = math.hypot(dx, dy)
        u, v = x - self.start[0], y - self.start[1]
        along, beside = u * (dx / length) + v * (dy / length), u * (dy / length) - v * (dx / length)
        return np.asarray((along >= 0) & (along <= length) & (np.abs(beside) <= self.half))

    def touches(self, bounds: Bounds) -> bool:
        """Whether the slab may reach into bounds."""
        xs, ys = zip(self.start, self.end, strict=True)
        h = self.half
        return bool(
            min(xs) - h <= bounds[3]
            and max(xs) + h >= bounds[0]
            and min(ys) - h <= bounds[4]
            and max(ys) + h >= bounds[1]
        )


@dataclass(frozen=True)
class Selection:
    """What is selected.

    Attributes
    ----------
    about : place that the projection counts from [m].
    matrix : (3, 4): of (x, y, z, 1) relative to `about` it makes (a, b, w); an echo is seen at (a / w, b / w), on a
        screen in pixels, in a section in metres.
    depth : nearest and farthest w that is seen.
    points : (n, 2), corners of a polygon (inside by the even-odd rule), or places of a brush.
    radius : of the brush, in units of the projection; 0 for a polygon.
    slab : of a section, None for none.
    classes : bool (256,), codes that are chosen.
    confidence, height : lowest and highest value, None for any; echoes without a value are chosen only by None.
    """

    about: NDArray[np.float64]
    matrix: NDArray[np.float64]
    depth: tuple[float, float]
    points: NDArray[np.float64]
    radius: float
    slab: Slab | None
    classes: NDArray[np.bool_]
    confidence: tuple[float, float] | None
    height: tuple[float, float] | None

    @classmethod
    def of(cls, plain: Any) -> Selection:
        """From JSON; `InputError` for what is no selection."""
        names = {"about", "matrix", "depth", "points", "radius", "slab", "classes", "confidence", "height"}
        if not isinstance(plain, dict) or set(plain) != names:
            raise _no("a selection", ", ".join(sorted(names)), plain)
        points = plain["points"]
        if not isinstance(points, list) or not 0 < len(points) <= MOST_POINTS:
            raise _no("points", f"1 to {MOST_POINTS} pairs", "another number of them")
        radius = _numbers([plain["radius"]], 1, "radius")[0]
        if radius < 0 or (radius == 0 and len(points) < 3):
            raise _no("points", "three corners, or a radius", len(points))
        matrix = np.array(_numbers(plain["matrix"], 12, "matrix")).reshape(3, 4)
        return cls(
            np.array(_numbers(plain["about"], 3, "about")),
            matrix,
            _range(plain["depth"], "depth") or (-math.inf, math.inf),
            np.array([_numbers(p, 2, "points") for p in points]),
            radius,
            _slab(plain["slab"]),
            _classes(plain["classes"]),
            _range(plain["confidence"], "confidence"),
            _range(plain["height"], "height"),
        )

    @property
    def box(self) -> tuple[float, float, float, float]:
        """What is drawn lies within: lowest and highest of both coordinates."""
        (a, b), (c, d) = self.points.min(axis=0) - self.radius, self.points.max(axis=0) + self.radius
        return float(a), float(b), float(c), float(d)

    def touches(self, bounds: Bounds) -> bool:
        """Whether an echo within `bounds` may be selected."""
        if self.slab is not None and not self.slab.touches(bounds):
            return False
        corners = np.array([[bounds[i], bounds[j], bounds[k]] for i in (0, 3) for j in (1, 4) for k in (2, 5)])
        a, b, w = self._projected(*corners.T)
        if w.max() < self.depth[0] or w.min() > self.depth[1]:
            return False
        if w.min() <= 0:
            return True
        a, b, box = a / w, b / w, self.box
        return bool(a.max() >= box[0] and b.max() >= box[1] and a.min() <= box[2] and b.min() <= box[3])

    def rows(self, columns: Mapping[str, NDArray]) -> NDArray[np.int64]:
        """Rows of the echoes that are selected, ascending.

        `columns`: x, y, z [m], classification, confidence, height_above_ground [m].
        """
        x, y = columns["x"], columns["y"]
        rows = np.flatnonzero(self.classes[columns["classification"]])
        for name, span in (("confidence", self.confidence), ("height_above_ground", self.height)):
            if span is not None:
                value = columns[name][rows]
                rows = rows[(value >= span[0]) & (value <= span[1])]
        if self.slab is not None:
            rows = rows[self.slab.contains(x[rows], y[rows])]
        a, b, w = self._projected(x[rows], y[rows], columns["z"][rows])
        visible = (w > 0) & (w >= self.depth[0]) & (w <= self.depth[1])
        rows, a, b = rows[visible], a[visible] / w[visible], b[visible] / w[visible]
        box = self.box
        near = (a >= box[0]) & (a <= box[2]) & (b >= box[1]) & (b <= box[3])
        rows, places = rows[near], np.stack([a[near], b[near]], axis=1)
        inside = in_polygon(places, self.points) if self.radius == 0 else in_stroke(places, self.points, self.radius)
        return rows[inside]

    def _projected(self, x: NDArray, y: NDArray, z: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        u, v, t = x - self.about[0], y - self.about[1], z - self.about[2]
        a, b, w = (m[0] * u + m[1] * v + m[2] * t + m[3] for m in self.matrix)
        return a, b, w


def in_polygon(places: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """bool (rows,): inside by the even-odd rule.

    Of every edge only places between its ends are looked at, so the work follows from how often a line crosses the
    polygon, not from its number of corners.

    `places`, `corners`: (rows, 2), (n, 2); the last corner joins the first.
    """
    order = np.argsort(places[:, 1], kind="stable")
    a, b = places[order, 0], places[order, 1]
    odd = np.zeros(len(a), bool)
    for (a0, b0), (a1, b1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        first, last = np.searchsorted(b, sorted((b0, b1)))
        if first < last:
            at = a0 + (b[first:last] - b0) * ((a1 - a0) / (b1 - b0))
            odd[first:last] ^= a[first:last] < at
    out = np.empty(len(a), bool)
    out[order] = odd
    return out


def in_stroke(places: NDArray[np.float64], points: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
    """bool (rows,): within `radius` of the line through `points`.

    `places`, `points`: (rows, 2), (n, 2).
    """
    order = np.argsort(places[:, 1], kind="stable")
    a, b = places[order, 0], places[order, 1]
    near = np.zeros(len(a), bool)
    for (a0, b0), (a1, b1) in zip(points, np.r_[points[1:], points[-1:]], strict=True):
        first = np.searchsorted(b, min(b0, b1) - radius, "left")
        last = np.searchsorted(b, max(b0, b1) + radius, "right")
        u, v, du, dv = a[first:last] - a0, b[first:last] - b0, a1 - a0, b1 - b0
        t = np.clip((u * du + v * dv) / (du * du + dv * dv or 1.0), 0.0, 1.0)
        near[first:last] |= (u - t * du) ** 2 + (v - t * dv) ** 2 <= radius * radius
    out = np.empty(len(a), bool)
    out[order] = near
    return out


def _no(what: str, expected: object, got: object) -> InputError:
    return InputError(
        f"{what}: not as the page sends it",
        where="the page's request",
        expected=expected,
        got=got if isinstance(got, str | int) else reprlib.repr(got),
        do="reload the page",
    )


def _numbers(plain: Any, count: int, name: str) -> list[float]:
    good = isinstance(plain, list) and len(plain) == count
    if not good or not all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) <= FAR for v in plain):
        raise _no(name, f"{count} numbers up to {FAR:.0e}", plain)
    return [float(v) for v in plain]


def _range(plain: Any, name: str) -> tuple[float, float] | None:
    if plain is None:
        return None
    low, high = _numbers(plain, 2, name)
    if low > high:
        raise InputError(
            f"the range of {name} has its ends the wrong way round",
            where="the filter",
            expected="the lower value first",
            got=f"{low:g} to {high:g}",
            do="exchange them",
        )
    return low, high


def _slab(plain: Any) -> Slab | None:
    if plain is None:
        return None
    xa, ya, xb, yb, half = _numbers(plain, 5, "slab")
    if half <= 0 or math.hypot(xb - xa, yb - ya) == 0:
        raise _no("slab", "a section with length and width", plain)
    return Slab((xa, ya), (xb, yb), half)


def _classes(plain: Any) -> NDArray[np.bool_]:
    table = np.zeros(256, bool)
    good = isinstance(plain, list) and len(plain) <= 256
    if not good or not all(isinstance(c, int) and not isinstance(c, bool) and 0 <= c <= 255 for c in plain):
        raise _no("classes", "codes from 0 to 255", plain)
    table[plain] = True
    return table
