"""A street to drive along: everything that a side-looking scanner confuses with crowns, and crowns that touch it.

Solids are rows of `PART` numbers: what it is, its class, its extent along the road, and its shape; see `trace_kernels`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.street.params import StreetSceneParams
from fwclass.street.trace_kernels import BOX, CAPSULE, CLUMP, PART, PILLAR

CROWN, ROAD, GROUND, BUILDING, SHRUB = 5, 11, 2, 6, 4
TRUNK, FURNITURE, VEHICLE, PERSON = 70, 71, 64, 65
"""Class codes of simulated returns; ASPRS's where it has one."""

SHINE = {
    CROWN: (0.4, 0.55),
    SHRUB: (0.35, 0.55),
    TRUNK: (0.2, 0.35),
    BUILDING: (0.2, 0.6),
    FURNITURE: (0.1, 0.5),
    VEHICLE: (0.05, 0.6),
    PERSON: (0.1, 0.5),
}
"""Reflectances, least and most, about, in the near infrared: leaves are bright, bark is not, paint and cloth may be
anything."""

KERB = 3.6
"""m, from the track to the kerb."""

OPPOSITE = 2.5
"""m, by which all that stands on the left is further away: there is another lane."""

KERB_HEIGHT = 0.12


@dataclass(frozen=True)
class Street:
    """`solids`: float64 (n, PART), sorted by where they begin along the road. `leaning`: rise over run of the ground
    across the road, a value a metre along it."""

    solids: NDArray[np.float64]
    leaning: NDArray[np.float64]


class _Builder:
    def __init__(self, params: StreetSceneParams) -> None:
        self.params = params
        self.random = np.random.default_rng([params.seed, 1])
        self.rows: list[list[float]] = []

    def between(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def box(
        self, label: int, x: float, y: float, z: float, dx: float, dy: float, dz: float, solid: float = 1.0
    ) -> None:
        """A box with a corner at (x, y, z), `dx`, `dy`, `dz` long; a share `solid` of the beams stops at it."""
        y, dy = (y + dy, -dy) if dy < 0 else (y, dy)
        self.rows.append([BOX, label, x, x + dx, y, y + dy, z, z + dz, solid, 0.0])

    def pillar(self, label: int, x: float, y: float, radius: float, low: float, high: float) -> None:
        self.rows.append([PILLAR, label, x - radius, x + radius, x, y, radius, low, high, 0.0])

    def clump(self, label: int, x: float, y: float, z: float, radius: float, free: float) -> None:
        """Leaves in a ball: a beam goes `free` metres through them on average."""
        self.rows.append([CLUMP, label, x - radius, x + radius, x, y, z, radius, free, 0.0])

    def capsule(self, label: int, a: tuple[float, float, float], b: tuple[float, float, float], radius: float) -> None:
        low, high = sorted((a[0], b[0]))
        self.rows.append([CAPSULE, label, low - radius, high + radius, *a, *b])
        self.rows[-1].append(radius)

    def street(self) -> Street:
        for side in (-1.0, 1.0):
            begun = len(self.rows)
            self._facades(side)
            self._trees(side)
            self._furniture(side)
            self._hedges(side)
            self._kerbside(side)
            if side > 0:
                self._further(begun)
        self._traffic()
        rows = np.zeros((len(self.rows), PART))
        for k, row in enumerate(self.rows):
            rows[k, : len(row)] = row
        rows = rows[np.argsort(rows[:, 2], kind="stable")]
        rows[:, -1] = _reflectances(rows, np.random.default_rng([self.params.seed, 3]))
        knots = np.arange(-20.0, self.params.length + 40.0, 20.0)
        lean = self.random.normal(0, 0.5 * self.params.slope, len(knots))
        metres = np.arange(-20.0, self.params.length + 21.0)
        return Street(rows, np.interp(metres, knots, lean))

    def _further(self, first: int) -> None:
        """Move what was built from row `first` on to the left by another lane."""
        places = {BOX: (4, 5), PILLAR: (5,), CLUMP: (5,), CAPSULE: (5, 8)}
        for row in self.rows[first:]:
            for k in places[int(row[0])]:
                row[k] += OPPOSITE

    def _facades(self, side: float) -> None:
        x, end = -15.0, self.params.length + 15.0
        while x < end:
            wide, tall = self.between(7, 16), self.between(7, 18)
            depth = self.params.facade_depth + self.between(-0.8, 1.5)
            if self.chance(0.12):
                x += self.between(3, 8)  # a gap between houses
                continue
            self.box(BUILDING, x, side * depth, 0.0, wide, side * 8.0, tall)
            self._storeys(side, x, wide, tall, depth)
            if self.chance(0.35):
                self._climber(side, x + self.between(0, wide - 3), depth)
            x += wide

    def _storeys(self, side: float, x: float, wide: float, tall: float, depth: float) -> None:
        """Pillars between windows, balconies, awnings."""
        for z in np.arange(3.2, tall - 2.0, 3.0):
            for at in np.arange(x + 0.8, x + wide - 1.6, 2.4):
                self.box(BUILDING, at, side * (depth - 0.12), z, 0.9, side * 0.12, 1.6)
                if self.chance(0.22):
                    self.box(BUILDING, at - 0.3, side * (depth - 1.2), z - 0.25, 2.0, side * 1.2, 0.15)
                    self.box(BUILDING, at - 0.3, side * (depth - 1.2), z - 0.1, 2.0, side * 0.04, 0.95, 0.5)
                    if self.chance(0.4):  # plants on it
                        for _ in range(6):
                            self.clump(SHRUB, at + self.between(0, 1.4), side * (depth - 1.1), z + 0.9, 0.22, 0.12)
        if self.chance(0.4):
            for step in range(6):
                out = 0.3 * (step + 1)
                self.box(BUILDING, x + 1, side * (depth - out), 3.0 - 0.09 * step, wide - 3, side * 0.3, 0.03)

    def _climber(self, side: float, x: float, depth: float) -> None:
        wide, tall = self.between(2, 4), self.between(3, 7)
        for _ in range(int(wide * tall * 3)):
            place = (x + self.between(0, wide), side * (depth - self.between(0.02, 0.2)), self.between(0.3, tall))
            self.clump(SHRUB, *place, self.between(0.15, 0.3), 0.1)

    def _trees(self, side: float) -> None:
        x = self.between(-8, -2)
        while x < self.params.length + 8:
            if not self.chance(0.12):  # a missing tree
                self._tree(side, x)
            x += self.params.tree_spacing * self.between(0.75, 1.25)

    def _tree(self, side: float, x: float) -> None:
        y = side * (self.params.tree_depth + self.between(-0.4, 0.6))
        radius, tall = self.between(1.8, 3.6), self.between(3.5, 6.5)
        base = self.between(1.7, 2.8)
        middle = base + 0.5 * tall
        self.pillar(TRUNK, x, y, self.between(0.1, 0.2), 0.0, base + 0.3)
        free = self.between(0.15, 0.45) * (1.0 if self.params.leaves else 8.0)
        for _ in range(int(self.between(5, 9))):  # limbs, into the crown
            turn, up = self.between(0, 2 * math.pi), self.between(-0.25, 0.5) * tall
            end = (x + 0.8 * radius * math.cos(turn), y + 0.8 * radius * math.sin(turn), middle + up)
            self.capsule(CROWN, (x, y, base + self.between(0, 0.4)), end, self.between(0.02, 0.05))
            if not self.params.leaves:
                self._twigs(end)
        for _ in range(int(28 * radius * tall)):
            self._foliage(x, y, middle, radius, 0.5 * tall, free)
        if self.chance(0.35):  # a low branch
            turn = self.between(0, 2 * math.pi)
            for k in range(4):
                out = 0.4 * (k + 1)
                place = (x + out * math.cos(turn), y + out * math.sin(turn), base - 0.12 * k)
                self.clump(CROWN, *place, self.between(0.15, 0.3), free)

    def _twigs(self, end: tuple[float, float, float]) -> None:
        for _ in range(5):
            tip = tuple(float(v + d) for v, d in zip(end, self.random.normal(0, 0.5, 3), strict=True))
            self.capsule(CROWN, end, (tip[0], tip[1], tip[2]), 0.012)

    def _foliage(self, x: float, y: float, z: float, radius: float, half: float, free: float) -> None:
        """A clump near the surface of the crown more often than inside: gaps and ragged edges."""
        way = self.random.normal(size=3)
        way /= np.linalg.norm(way)
        out = self.random.random() ** 0.45
        place = np.array([x, y, z]) + out * way * np.array([radius, radius, half])
        if self.chance(0.12):
            place += self.random.normal(0, 0.35, 3)
        x, y, z = map(float, place)
        self.clump(CROWN, x, y, z, self.between(0.08, 0.35), free)

    def _furniture(self, side: float) -> None:
        for x in np.arange(self.between(0, 8), self.params.length, 22.0):
            y = side * (KERB + self.between(0.4, 2.0))
            self.pillar(FURNITURE, x, y, 0.08, 0.0, 6.5)
            self.capsule(FURNITURE, (x, y, 6.4), (x, y - side * 1.5, 6.7), 0.05)
            self.box(FURNITURE, x - 0.15, y - side * 1.9, 6.6, 0.3, side * 0.5, 0.12)
        for x in np.arange(self.between(0, 6), self.params.length, 13.0):
            y = side * (KERB + self.between(0.3, 0.6))
            self.pillar(FURNITURE, x, y, 0.035, 0.0, 2.6)
            self.box(FURNITURE, x - 0.02, y - side * 0.3, 2.0, 0.04, side * 0.6, 0.6)
        for height in (5.2, 6.1):
            y = side * (self.params.tree_depth + 1.0)
            for x in np.arange(-10.0, self.params.length + 10.0, 20.0):  # wires sag
                a, b, c = (x, y, height), (x + 10.0, y, height - 0.25), (x + 20.0, y, height)
                self.capsule(FURNITURE, a, b, 0.012)
                self.capsule(FURNITURE, b, c, 0.012)

    def _hedges(self, side: float) -> None:
        x = self.between(0, 10)
        while x < self.params.length:
            long, tall = self.between(2, 6), self.between(0.6, 2.1)
            y = self.params.tree_depth + self.between(-0.6, 1.8)
            if self.chance(0.5):
                for _ in range(int(18 * long * tall)):
                    place = (x + self.between(0, long), side * (y + self.between(-0.3, 0.3)), self.between(0.15, tall))
                    self.clump(SHRUB, *place, self.between(0.15, 0.3), 0.1)
            else:  # a shrub
                for _ in range(30):
                    way = self.random.normal(0, [0.45, 0.45, 0.4])
                    place = (x + float(way[0]), side * y + float(way[1]), 0.9 + float(way[2]))
                    self.clump(SHRUB, *place, 0.25, 0.2)
            x += long + self.between(4, 14)

    def _kerbside(self, side: float) -> None:
        x = self.between(0, 5)
        while x < self.params.length:
            kind = self.random.random()
            if kind < 0.4:
                self._car(x, side * (KERB - self.between(0.3, 0.6)), side)
                x += 5.5
            elif kind < 0.75:
                for _ in range(3):
                    self._person(x + self.between(0, 1.5), side)
            else:
                y = side * (KERB + self.between(0.2, 0.8))
                for k in range(int(self.between(1, 5))):
                    self.box(PERSON, x + 0.6 * k, y, 0.25, 0.06, side * 1.7, 0.85, 0.3)
            x += self.between(1, 5)

    def _person(self, x: float, side: float) -> None:
        y = side * (KERB + self.between(0.6, 3.5))
        self.pillar(PERSON, x, y, 0.22, 0.0, 1.45)
        self.pillar(PERSON, x + 0.05, y, 0.11, 1.45, 1.75)

    def _car(self, x: float, y: float, side: float, stretch: float = 1.0) -> None:
        self.box(VEHICLE, x, y, 0.25, 4.3 * stretch, side * -1.75, 0.6)
        self.box(VEHICLE, x + 1.0 * stretch, y - side * 0.15, 0.85, 2.4 * stretch, side * -1.45, 0.6)

    def _traffic(self) -> None:
        """Vehicles that pass: by their speed they are as short as few frames."""
        for _ in range(int(self.params.length / 15)):
            x = self.between(0, self.params.length)
            if self.chance(0.2):
                self.box(VEHICLE, x, 1.6, 0.4, 1.6, 2.4, 3.0)  # a van or bus, near
            else:
                self._car(x, 3.4, 1.0, self.params.speed / (self.params.speed + self.between(5, 12)))


def _reflectances(rows: NDArray[np.float64], random: np.random.Generator) -> NDArray[np.float64]:
    """Of every solid, drawn from what `SHINE` has for its class; limbs and twigs of crowns are bark."""
    of = np.where((rows[:, 0] == CAPSULE) & (rows[:, 1] == CROWN), TRUNK, rows[:, 1]).astype(int)
    low, high = np.array([SHINE[k] for k in of.tolist()]).reshape(-1, 2).T
    return low + (high - low) * random.random(len(rows))


def build(params: StreetSceneParams) -> Street:
    """The street of these parameters; the same for the same seed."""
    return _Builder(params).street()
