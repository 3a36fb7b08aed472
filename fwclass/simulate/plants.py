"""Trees, shrubs and hedges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fwclass.simulate.params import SceneParams
from fwclass.simulate.scene import BOX, CONE, ELLIPSOID, HIGH
from fwclass.simulate.shapes import Place, Things

Height = Callable[[float, float], float]


@dataclass(frozen=True)
class Gardener:
    """Plants into `things` on the terrain `height`."""

    things: Things
    height: Height
    params: SceneParams

    def _leaf(self, random: np.random.Generator) -> tuple[float, float]:
        density = self.params.leaf_density * random.uniform(0.45, 1.6)
        return density, random.uniform(*self.params.leaf_albedo)

    def tree(self, random: np.random.Generator, x: float, y: float, tall: float, conifer: float = 0.15) -> None:
        """A tree of about `tall` [m] at (x, y) [m]: trunk, and a crown with its foliage; `conifer` is the chance [0 to
        1] of a cone."""
        z = self.height(x, y)
        density, albedo = self._leaf(random)
        place = Place(x, y, random.uniform(0, math.pi))
        base = random.uniform(0.12, 0.35) * tall
        thick = 0.1 + 0.018 * tall
        self.things.block(place, thick, thick, z - 0.3, z + 0.6 * tall, HIGH, 0.35)
        if random.random() < conifer:
            reach = random.uniform(0.28, 0.40) * tall
            self.things.crown(place, CONE, reach, reach, z + 0.6 * base, z + tall, 1.7 * density, albedo)
            return
        reach = random.uniform(0.5, 0.9) * tall
        self.things.crown(place, ELLIPSOID, reach, reach, z + base, z + tall, density, albedo)

    def shrub(self, random: np.random.Generator, x: float, y: float) -> None:
        """A shrub of some 0.3 to 4 m at (x, y) [m]."""
        z = self.height(x, y)
        density, albedo = self._leaf(random)
        tall = random.gamma(2.2, 0.5) + 0.25
        reach = tall * random.uniform(0.8, 1.8) + 0.3
        place = Place(x, y, 0.0)
        self.things.crown(place, ELLIPSOID, reach, reach, z - 0.5 * tall, z + tall, 4.0 * density, albedo)

    def thicket(self, random: np.random.Generator, place: Place) -> None:
        """Tall herbs, brambles, ground cover: a low patch some metres across, in pieces that follow the terrain."""
        density, albedo = self._leaf(random)
        tall = random.gamma(2.5, 0.24) + 0.3
        for _ in range(int(random.integers(4, 14))):
            part = place.at(random.normal(0, 2.2), random.normal(0, 2.2))
            z, reach = self.height(part.x, part.y), random.uniform(1.2, 3.5)
            top = z + tall * random.uniform(0.6, 1.3)
            bottom = z - 0.6 * tall
            self.things.crown(part, ELLIPSOID, reach, reach, bottom, top, 5.0 * density, albedo)

    def hedge(self, random: np.random.Generator, place: Place, length: float) -> None:
        """A hedge of `length` [m] along the place's direction, in pieces that follow the terrain."""
        density, albedo = self._leaf(random)
        tall, wide = random.uniform(0.7, 2.2), random.uniform(0.5, 1.3)
        pieces = max(1, round(length / 4.0))
        for k in range(pieces):
            part = place.at((k + 0.5) / pieces * length - length / 2.0, 0.0)
            z = self.height(part.x, part.y)
            self.things.crown(part, BOX, length / pieces, wide, z - 0.3, z + tall, 4.0 * density, albedo)

    def wood(self, random: np.random.Generator, place: Place, length: float, width: float) -> None:
        """A stand of trees of all ages with an understorey, `length` by `width` [m]."""
        area = length * width
        for _ in range(int(area / 24.0 * self.params.tree_share)):
            at = place.at(random.uniform(-0.5, 0.5) * length, random.uniform(-0.5, 0.5) * width)
            self.tree(random, at.x, at.y, float(np.clip(random.gamma(7.0, 1.7), 3.5, 22.0)), conifer=0.3)
        for _ in range(int(area / 35.0)):
            self.thicket(random, place.at(random.uniform(-0.5, 0.5) * length, random.uniform(-0.5, 0.5) * width))
        for _ in range(int(area / 14.0)):
            at = place.at(random.uniform(-0.5, 0.5) * length, random.uniform(-0.5, 0.5) * width)
            self.shrub(random, at.x, at.y)
