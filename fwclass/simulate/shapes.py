"""Convex solids and crowns, one call each, collected into arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fwclass.simulate.scene import BOX, BUILDING

Plane = tuple[float, float, float, float]


@dataclass(frozen=True)
class Place:
    """Where an oriented thing stands: centre [m] and the direction of its length [rad, from east]."""

    x: float
    y: float
    angle: float

    @property
    def axes(self) -> tuple[float, float]:
        """(cos, sin) of the direction: the unit vector along it."""
        return math.cos(self.angle), math.sin(self.angle)

    def at(self, u: float, v: float) -> Place:
        """The place `u` [m] along and `v` [m] across from here, with the same direction."""
        c, s = self.axes
        return Place(self.x + u * c - v * s, self.y + u * s + v * c, self.angle)

    def turned(self, by: float) -> Place:
        """The same place with its direction turned by `by` [rad], counterclockwise."""
        return Place(self.x, self.y, self.angle + by)

    def side(self, u: float, v: float, z: float, reach: float, rise: float = 0.0) -> Plane:
        """Half-space whose outward normal is (u, v) in the place's axes, `reach` from the centre at height `z`
        and falling outward by `rise` metres per metre (a roof); without rise it is a wall."""
        c, s = self.axes
        nx, ny, nz = u * c - v * s, u * s + v * c, 0.0
        if rise > 0.0:
            length = math.hypot(rise, 1.0)
            nx, ny, nz = nx * rise / length, ny * rise / length, 1.0 / length
            reach = reach * rise / length
        return nx, ny, nz, nx * self.x + ny * self.y + nz * z + reach


@dataclass
class Things:
    """Collects solids and crowns; `arrays` gives them as a `Scene` holds them."""

    planes: list[Plane] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    solids: list[tuple[int, float, float]] = field(default_factory=list)
    boxes: list[tuple[float, ...]] = field(default_factory=list)
    crowns: list[tuple[float, ...]] = field(default_factory=list)
    crown_albedo: list[float] = field(default_factory=list)
    crown_boxes: list[tuple[float, ...]] = field(default_factory=list)

    def block(
        self,
        place: Place,
        length: float,
        width: float,
        bottom: float,
        top: float,
        code: int,
        albedo: float,
        extra: tuple[Plane, ...] = (),
        passing: float = 0.0,
    ) -> None:
        """An upright box [m], cut by `extra` half-spaces (a, b, c, d: a x + b y + c z <= d); `passing` is the share [0
        to 1] of rays that go through it."""
        sides = [place.side(u, v, 0.0, r) for u, v, r in _four(length, width)]
        self.planes += [*sides, (0.0, 0.0, -1.0, -bottom), (0.0, 0.0, 1.0, top), *extra]
        self.counts.append(6 + len(extra))
        self.solids.append((code, albedo, passing))
        self.boxes.append(_bounds(place, length, width, bottom, top))

    def roof(
        self,
        place: Place,
        length: float,
        width: float,
        eave: float,
        rise: float,
        hipped: bool,
        albedo: float,
        thickness: float = 0.18,
    ) -> float:
        """A gabled or hipped attic over (length × width), overhang included; `eave` is the height of its upper
        edge and `rise` the tangent of the pitch. Returns the height of the ridge [m]."""
        half = width / 2.0
        ridge = eave + half * rise
        cuts = [place.side(0.0, v, eave, half, rise) for v in (1.0, -1.0)]
        if hipped:
            cuts += [place.side(u, 0.0, eave, length / 2.0, rise) for u in (1.0, -1.0)]
        self.block(place, length, width, eave - thickness, ridge, BUILDING, albedo, tuple(cuts))
        return ridge

    def crown(
        self,
        place: Place,
        shape: int,
        length: float,
        width: float,
        bottom: float,
        top: float,
        density: float,
        albedo: float,
    ) -> None:
        """Foliage of a leaf area density [m²/m³] within an ellipsoid, a cone or (a hedge) an upright box."""
        c, s = place.axes
        self.crowns.append((shape, place.x, place.y, bottom, top, length / 2.0, width / 2.0, c, s, density))
        self.crown_albedo.append(albedo)
        turned = place if shape == BOX else Place(place.x, place.y, 0.0)
        self.crown_boxes.append(_bounds(turned, length, width, bottom, top))

    def arrays(self) -> dict[str, NDArray]:
        """What `Scene` holds of all things: planes (planes, 4) with offsets by solid, class, albedo and openness of
        every solid, crowns (crowns, 10) with albedo, boxes (things, 6) [m]."""
        start = np.concatenate([[0], np.cumsum(np.array(self.counts, np.int64))]).astype(np.int64)
        solids = np.array(self.solids, np.float64).reshape(-1, 3)
        return {
            "plane_start": start,
            "planes": np.array(self.planes, np.float64).reshape(-1, 4),
            "solid_class": solids[:, 0].astype(np.uint8),
            "solid_albedo": np.ascontiguousarray(solids[:, 1]),
            "solid_open": np.ascontiguousarray(solids[:, 2]),
            "crown": np.array(self.crowns, np.float64).reshape(-1, 10),
            "crown_albedo": np.array(self.crown_albedo, np.float64),
            "box": np.array(self.boxes + self.crown_boxes, np.float64).reshape(-1, 6),
        }


def _four(length: float, width: float) -> tuple[tuple[float, float, float], ...]:
    a, b = length / 2.0, width / 2.0
    return (1.0, 0.0, a), (-1.0, 0.0, a), (0.0, 1.0, b), (0.0, -1.0, b)


def _bounds(place: Place, length: float, width: float, bottom: float, top: float) -> tuple[float, ...]:
    c, s = (abs(v) for v in place.axes)
    rx, ry = (length * c + width * s) / 2.0, (length * s + width * c) / 2.0
    return place.x - rx, place.y - ry, bottom, place.x + rx, place.y + ry, top
