"""Houses, sheds, halls; walls, fences, cars, lamps and bridges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fwclass.simulate.params import SceneParams
from fwclass.simulate.plants import Height
from fwclass.simulate.scene import ARTIFICIAL, BUILDING
from fwclass.simulate.shapes import Place, Things


@dataclass(frozen=True)
class Builder:
    """Builds into `things` on the terrain `height`."""

    things: Things
    height: Height
    params: SceneParams

    def _around(self, place: Place, length: float, width: float) -> tuple[float, float]:
        """Lowest and highest terrain under the corners of a rectangle [m]."""
        corners = [place.at(u * length / 2, v * width / 2) for u in (-1, 1) for v in (-1, 1)]
        levels = [self.height(c.x, c.y) for c in corners]
        return min(levels), max(levels)

    def house(
        self, random: np.random.Generator, place: Place, length: float, width: float, tall: float, kind: str
    ) -> None:
        """Walls of about `tall` under a `flat`, `gabled` or `hipped` roof with an overhang; `tall`, `length`, `width`
        [m]."""
        low, high = self._around(place, length, width)
        floor = 0.7 * high + 0.3 * low
        albedo = random.uniform(*self.params.house_albedo)
        over = random.uniform(0.25, 0.8)
        wide, long = width + 2 * over, length + 2 * random.uniform(0.2, 0.6)
        plaster = random.uniform(0.25, 0.55)
        if kind == "flat":
            top = floor + tall
            self.things.block(place, long, wide, top - 0.3, top, BUILDING, albedo)
            self.things.block(place, length, width, low - 1.0, top - 0.25, BUILDING, plaster)
            return
        steep = random.random() < 0.38
        pitch = random.uniform(24, 45) if steep else random.uniform(10, 22)
        rise = math.tan(math.radians(pitch))
        eave = floor + tall - over * rise
        ridge = self.things.roof(place, long, wide, eave, rise, kind == "hipped", albedo)
        self.things.block(place, length, width, low - 1.0, eave - 0.1, BUILDING, plaster)
        self._on_roof(random, place, (length, wide), (eave, ridge, rise), albedo)

    def _on_roof(
        self,
        random: np.random.Generator,
        place: Place,
        extent: tuple[float, float],
        roof: tuple[float, float, float],
        albedo: float,
    ) -> None:
        length, wide = extent
        eave, ridge, rise = roof
        if random.random() < 0.65:
            at = place.at(random.uniform(-0.3, 0.3) * length, random.uniform(-0.15, 0.15) * wide)
            size = random.uniform(0.5, 0.9)
            self.things.block(at, size, size, eave, ridge + random.uniform(0.3, 1.1), BUILDING, 0.3)
        if rise > 0.4 and random.random() < 0.6:
            for k in range(int(random.integers(1, 4))):
                side = 1.0 if random.random() < 0.5 else -1.0
                at = place.at((k - 1) * 0.27 * length, side * 0.25 * wide)
                self.things.block(
                    at, random.uniform(1.3, 2.2), 0.3 * wide, eave, eave + 0.42 * wide * rise, BUILDING, albedo
                )

    def hall(self, random: np.random.Generator, place: Place, length: float, width: float) -> None:
        """A large flat building of `length` by `width` [m] with a parapet and machines on its roof."""
        tall = random.uniform(4.5, 10.0)
        low, high = self._around(place, length, width)
        top = 0.5 * (low + high) + tall
        albedo = random.uniform(*self.params.house_albedo)
        self.things.block(place, length, width, low - 1.0, top, BUILDING, albedo)
        for u, v, long, angle in (
            (0.0, 0.5, length, 0.0),
            (0.0, -0.5, length, 0.0),
            (0.5, 0.0, width, 0.5),
            (-0.5, 0.0, width, 0.5),
        ):
            rim = place.at(u * length, v * width).turned(angle * math.pi)
            self.things.block(rim, long, 0.3, top - 0.1, top + 0.5, BUILDING, 0.35)
        for _ in range(int(random.integers(1, 5))):
            at = place.at(random.uniform(-0.4, 0.4) * length, random.uniform(-0.4, 0.4) * width)
            self.things.block(
                at, random.uniform(1, 5), random.uniform(1, 3), top, top + random.uniform(0.6, 2.2), BUILDING, 0.45
            )

    def car(self, random: np.random.Generator, place: Place) -> None:
        """A car or a van at `place`, along its direction; 3.7 to 5.4 m long."""
        z = self.height(place.x, place.y)
        paint = random.uniform(0.08, 0.75)
        van = random.random() < 0.15
        length, wide = (5.4, 2.0) if van else (random.uniform(3.7, 4.8), random.uniform(1.65, 1.85))
        shoulder = 1.5 if van else random.uniform(0.8, 1.0)
        self.things.block(place, length, wide, z + 0.2, z + shoulder, ARTIFICIAL, paint)
        roof = 2.2 if van else random.uniform(1.4, 1.75)
        cabin = place.at(-0.06 * length, 0.0)
        self.things.block(cabin, 0.52 * length, 0.86 * wide, z + shoulder, z + roof, ARTIFICIAL, paint)

    def wall(self, random: np.random.Generator, place: Place, length: float) -> None:
        """A garden wall of `length` [m] along the place's direction, stepping with the terrain."""
        tall, thick = random.uniform(0.6, 2.3), random.uniform(0.2, 0.45)
        self._along(place, length, 5.0, thick, tall, random.uniform(0.25, 0.5), 0.0)

    def fence(self, random: np.random.Generator, place: Place, length: float) -> None:
        """A fence of `length` [m] that lets a share of the rays through."""
        tall = random.uniform(0.9, 2.0)
        self._along(place, length, 6.0, 0.08, tall, random.uniform(0.3, 0.5), random.uniform(0.25, 0.7))

    def _along(
        self, place: Place, length: float, piece: float, thick: float, tall: float, albedo: float, passing: float
    ) -> None:
        pieces = max(1, round(length / piece))
        for k in range(pieces):
            part = place.at((k + 0.5) / pieces * length - length / 2.0, 0.0)
            low, high = self._around(part, length / pieces, thick)
            self.things.block(part, length / pieces, thick, low - 0.3, high + tall, ARTIFICIAL, albedo, passing=passing)

    def lamp(self, place: Place) -> None:
        """A street lamp with an arm, 6.6 m above the terrain."""
        z = self.height(place.x, place.y)
        self.things.block(place, 0.16, 0.16, z - 0.2, z + 6.5, ARTIFICIAL, 0.4)
        self.things.block(place.at(0.0, 0.6), 0.3, 1.3, z + 6.4, z + 6.6, ARTIFICIAL, 0.4)

    def bridge(self, place: Place, length: float, width: float, deck: float) -> None:
        """A deck that one can see under, with parapets and two piers; `length`, `width` and the height `deck` [m]."""
        self.things.block(place, length, width, deck - 0.7, deck, ARTIFICIAL, 0.22)
        for v in (-0.5, 0.5):
            rail = place.at(0.0, v * (width - 0.3))
            self.things.block(rail, length, 0.25, deck - 0.1, deck + 1.0, ARTIFICIAL, 0.4)
        for u in (-0.25, 0.25):
            self.things.block(place.at(u * length, 0.0), 1.0, width - 1.0, deck - 8.0, deck - 0.6, ARTIFICIAL, 0.35)
