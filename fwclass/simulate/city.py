"""The plan of the town: what stands in every block between the streets, and the finished scene.

Every block draws from its own random stream, so it does not depend on its neighbours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # its parts are loaded when they are used

from fwclass.simulate.houses import Builder
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.plants import Gardener
from fwclass.simulate.relief import BLOCK_U, BLOCK_V, MARGIN, STREET, Relief, Town, relief, town
from fwclass.simulate.scene import Scene, index, terrain
from fwclass.simulate.shapes import Place, Things

_VERGE = 3.0
"""Kept free between a street and what stands in a block [m]."""

_BANK = 7.0
"""Of the river's shore, on which nothing stands [m]; bridges span it too."""

_KINDS = ("homes", "rows", "flats", "halls", "wood", "meadow")
_SHARES = (0.46, 0.18, 0.12, 0.14, 0.07, 0.03)
"""Of the blocks, kind by kind: no measured town's; most are homes, and every kind is there."""


@dataclass(frozen=True)
class Planner:
    """Fills blocks; `i`, `j` number the blocks of the town's frame."""

    params: SimulateParams
    plan: Town
    builder: Builder
    gardener: Gardener

    def place(self, u: float, v: float, turn: float = 0.0) -> Place:
        """The place (u, v) [m] of the town's frame, its direction turned by `turn` [rad] from the streets'."""
        x, y = self.plan.ground(u, v)
        return Place(x, y, self.plan.angle + turn)

    def free(self, place: Place, reach: float) -> bool:
        """Whether a thing of this radius `reach` [m] stands in the survey area and off the river's banks."""
        size = self.params.size
        if not (2.0 < place.x < size - 2.0 and 2.0 < place.y < size - 2.0):
            return False
        u, v = self.plan.frame(place.x, place.y)
        return float(self.plan.shore(u, v)) > _BANK + reach

    def block(self, i: int, j: int) -> None:
        """Fill block (i, j) of the town's frame with what its random stream draws."""
        random = np.random.default_rng([self.params.seed, 2, i + 4096, j + 4096])
        u0, v0 = i * BLOCK_U + STREET + _VERGE, j * BLOCK_V + STREET + _VERGE
        long, deep = BLOCK_U - 2 * (STREET + _VERGE), BLOCK_V - 2 * (STREET + _VERGE)
        kind = _KINDS[int(np.searchsorted(np.cumsum(_SHARES), random.random()))]
        middle = self.place(u0 + long / 2, v0 + deep / 2)
        if kind == "homes":
            self.homes(random, u0, v0, long, deep)
        elif kind == "rows":
            self.rows(random, u0, v0, long, deep)
        elif kind == "flats":
            self.flats(random, middle, long, deep)
        elif kind == "halls":
            self.halls(random, middle, long, deep)
        elif kind == "wood":
            self.scatter_wood(random, middle, long, deep)
        else:
            self.loose(random, middle, long, deep, trees=12, shrubs=90)
        self.streets(random, i, j)

    def homes(self, random: np.random.Generator, u0: float, v0: float, long: float, deep: float) -> None:
        """Detached houses in gardens, back to back, in a block from (u0, v0), `long` by `deep` [m]."""
        lots = int(random.integers(5, 7))
        for k in range(lots):
            for back in (False, True):
                turn = math.pi if back else 0.0
                v = v0 + (0.75 if back else 0.25) * deep
                lot = self.place(u0 + (k + 0.5) * long / lots, v, turn)
                if self.free(lot, 8.0):
                    self.lot(random, lot, long / lots, deep / 2)

    def lot(self, random: np.random.Generator, lot: Place, wide: float, deep: float) -> None:
        """A house in its garden, `wide` by `deep` [m]; the lot's street is at negative v."""
        kind = str(random.choice(["gabled", "hipped", "flat"], p=[0.5, 0.27, 0.23]))
        length, width = random.uniform(0.68, 0.9) * wide, random.uniform(9, 14)
        house = lot.at(random.uniform(-1, 1), random.uniform(-5, -1) * deep / 26)
        house = house.turned(random.normal(0, 0.03))
        self.builder.house(random, house, length, width, random.uniform(3.0, 6.5), kind)
        if kind != "flat" and random.random() < 0.3:
            wing = house.at(0.3 * length, 0.5 * width).turned(math.pi / 2)
            self.builder.house(random, wing, 8.0, 0.6 * width, random.uniform(2.8, 4.5), kind)
        if random.random() < 0.3:
            garage = lot.at(0.5 * wide - 2.2, random.uniform(-4, 3))
            self.builder.house(random, garage.turned(math.pi / 2), 6.2, 3.4, 2.6, "flat")
        if random.random() < 0.35:
            self.builder.car(random, lot.at(0.5 * wide - 2.2, -0.5 * deep + 3.0).turned(math.pi / 2))
        self.garden(random, lot, wide, deep, (length, width))

    def garden(
        self, random: np.random.Generator, lot: Place, wide: float, deep: float, house: tuple[float, float]
    ) -> None:
        """Trees, shrubs, thickets and hedges, fences or walls of a lot `wide` by `deep` [m] around a `house` of this
        size [m]."""
        share = self.params.scene.tree_share
        for _ in range(int(random.poisson(2.6 * share))):
            at = lot.at(random.uniform(-0.5, 0.5) * wide, random.uniform(0.05, 0.5) * deep)
            self.gardener.tree(random, at.x, at.y, float(np.clip(random.gamma(5.0, 1.75), 3.0, 18.0)))
        for _ in range(int(random.poisson(1.5 * share))):
            side = 1.0 if random.random() < 0.5 else -1.0
            at = lot.at(side * (0.5 * house[0] + random.uniform(0.6, 2.0)), random.uniform(-6, 4))
            self.gardener.tree(random, at.x, at.y, random.uniform(5, 12))
        for _ in range(int(random.poisson(9))):
            at = lot.at(random.uniform(-0.5, 0.5) * wide, random.uniform(-0.5, 0.5) * deep)
            self.gardener.shrub(random, at.x, at.y)
        for _ in range(int(random.poisson(2.6))):
            at = lot.at(random.uniform(-0.5, 0.5) * wide, random.uniform(-0.5, 0.5) * deep)
            self.gardener.thicket(random, at)
        edges = (
            (lot.at(0.0, -0.5 * deep), wide - 5.0),
            (lot.at(-0.5 * wide, 0.1 * deep).turned(math.pi / 2), 0.8 * deep),
            (lot.at(0.0, 0.49 * deep), wide),
        )
        for edge, length in edges:
            what = random.random()
            if what < 0.36:
                self.gardener.hedge(random, edge, length)
            elif what < 0.58:
                self.builder.fence(random, edge, length)
            elif what < 0.76:
                self.builder.wall(random, edge, length)

    def rows(self, random: np.random.Generator, u0: float, v0: float, long: float, deep: float) -> None:
        """Two rows of terraced houses with their gardens, in a block from (u0, v0), `long` by `deep` [m]."""
        for part, turn in ((0.16, 0.0), (0.84, math.pi)):
            row = self.place(u0 + long / 2, v0 + part * deep, turn)
            length = random.uniform(0.7, 0.98) * long
            if not self.free(row, length / 2):
                continue
            kind = "gabled" if random.random() < 0.7 else "flat"
            self.builder.house(random, row, length, random.uniform(11, 14), random.uniform(4.5, 7.5), kind)
            for k in range(int(length / 7.0)):
                at = row.at((k + 0.5) * 7.0 - length / 2, 15.0)
                what = random.random()
                if what < 0.4:
                    self.builder.fence(random, at.at(3.5, -4.0).turned(math.pi / 2), 11.0)
                elif what < 0.7:
                    self.gardener.hedge(random, at.at(3.5, -4.0).turned(math.pi / 2), 11.0)
                if random.random() < 0.55 * self.params.scene.tree_share:
                    tall = float(np.clip(random.gamma(5.0, 1.2), 2.5, 11.0))
                    self.gardener.tree(random, at.x, at.y, tall)

    def flats(self, random: np.random.Generator, middle: Place, long: float, deep: float) -> None:
        """Three blocks of flats among loose trees, `long` by `deep` [m]."""
        for u in (-0.4, 0.0, 0.4):
            at = middle.at(u * long, random.uniform(-0.15, 0.15) * deep).turned(math.pi / 2)
            if self.free(at, 20.0):
                kind = "flat" if random.random() < 0.6 else "hipped"
                self.builder.house(
                    random, at, random.uniform(26, 44), random.uniform(11, 15), random.uniform(8, 13), kind
                )
        self.loose(random, middle, long, deep, trees=10, shrubs=44)
        self.parking(random, middle.at(0.0, -0.42 * deep), 0.3 * long)

    def halls(self, random: np.random.Generator, middle: Place, long: float, deep: float) -> None:
        """A hall with its car parks, `long` by `deep` [m]."""
        at = middle.at(-0.2 * long, 0.0)
        if self.free(at, 24.0):
            self.builder.hall(random, at, random.uniform(0.5, 0.58) * long, random.uniform(0.7, 0.95) * deep)
        for v in (-0.3, -0.05, 0.2):
            self.parking(random, middle.at(0.28 * long, v * deep), 0.36 * long)
        self.loose(random, middle.at(0.3 * long, 0.4 * deep), 0.35 * long, 0.2 * deep, trees=8, shrubs=20)

    def parking(self, random: np.random.Generator, middle: Place, length: float) -> None:
        """Two facing rows of bays, `length` [m] long."""
        for v in (-2.6, 2.6):
            for k in range(int(length / 2.6)):
                at = middle.at((k + 0.5) * 2.6 - length / 2, v)
                if random.random() < 0.6 and self.free(at, 2.0):
                    self.builder.car(random, at.turned(math.pi / 2 + random.normal(0, 0.03)))

    def scatter_wood(self, random: np.random.Generator, middle: Place, long: float, deep: float) -> None:
        """A wood of at most `long` by `deep` [m]; loose trees where the river or the edge of the survey takes its
        place."""
        if self.free(middle, 0.5 * math.hypot(long, deep)):
            self.gardener.wood(random, middle, random.uniform(0.6, 1.0) * long, random.uniform(0.6, 1.0) * deep)
        else:
            self.loose(random, middle, long, deep, trees=70, shrubs=90)

    def loose(
        self, random: np.random.Generator, middle: Place, long: float, deep: float, trees: int, shrubs: int
    ) -> None:
        """Trees and shrubs at random places of an area of `long` by `deep` [m]; half of the shrubs are thickets."""
        for k in range(round(trees * self.params.scene.tree_share) + shrubs):
            at = middle.at(random.uniform(-0.5, 0.5) * long, random.uniform(-0.5, 0.5) * deep)
            if not self.free(at, -5.0):
                continue
            if k < shrubs // 2:
                self.gardener.thicket(random, at)
            elif k < shrubs:
                self.gardener.shrub(random, at.x, at.y)
            else:
                self.gardener.tree(random, at.x, at.y, float(np.clip(random.gamma(6.0, 1.8), 3.0, 20.0)))

    def streets(self, random: np.random.Generator, i: int, j: int) -> None:
        """Cars, lamps and trees along the southern and western street of block (i, j)."""
        tall = random.uniform(6, 14) if random.random() < 0.5 * self.params.scene.tree_share else 0.0
        for turn, length in ((0.0, BLOCK_U), (math.pi / 2, BLOCK_V)):
            corner = self.place(i * BLOCK_U, j * BLOCK_V, turn)
            for side in (-1.0, 1.0):
                for k in range(2, int(length / 6.0) - 1):
                    at = corner.at(6.0 * k, side * (STREET - 1.1))
                    if random.random() < 0.3 and self.free(at, 2.0):
                        self.builder.car(random, at.turned(random.normal(0, 0.02)))
                for k in range(1, int(length / 11.0)):
                    at = corner.at(11.0 * k, side * (STREET + 1.2))
                    if tall and self.free(at, 2.0):
                        self.gardener.tree(random, at.x, at.y, tall * random.uniform(0.7, 1.2), conifer=0.0)
            for k in range(1, int(length / 30.0)):
                at = corner.at(30.0 * k, STREET + 0.6)
                if self.free(at, 1.0):
                    self.builder.lamp(at.turned(math.pi))

    def bridges(self) -> None:
        """Every second street across the river has one."""
        reach = int(2.0 * self.params.size / BLOCK_V) + 1
        for j in range(-reach, reach, 2):
            u, v = float(self.plan.course(j * BLOCK_V)), j * BLOCK_V
            at = self.place(u, v)
            if not (0.0 < at.x < self.params.size and 0.0 < at.y < self.params.size):
                continue
            length = 2.0 * (self.plan.half_river + _BANK) + 9.0
            ends = [at.at(k * length / 2, 0.0) for k in (-1.0, 1.0)]
            deck = max(self.builder.height(e.x, e.y) for e in ends) + 0.35
            self.builder.bridge(at, length, 2.0 * STREET + 1.5, deck)


@lru_cache(maxsize=2)
def build_scene(params: SimulateParams) -> Scene:
    """The scene of these parameters, in metres of the survey's own frame; built once per process."""
    plan = town(params)
    land = relief(params, plan)
    step = params.scene.terrain_step
    things = Things()

    def level(x: float, y: float) -> float:
        return float(terrain(land.height, MARGIN, step, x, y))

    planner = Planner(params, plan, Builder(things, level, params.scene), Gardener(things, level, params.scene))
    corners = [plan.frame(x, y) for x in (0.0, params.size) for y in (0.0, params.size)]
    us, vs = [float(u) for u, _ in corners], [float(v) for _, v in corners]
    for i in range(math.floor(min(us) / BLOCK_U) - 1, math.ceil(max(us) / BLOCK_U) + 1):
        for j in range(math.floor(min(vs) / BLOCK_V) - 1, math.ceil(max(vs) / BLOCK_V) + 1):
            planner.block(i, j)
    planner.bridges()
    return _scene(params, things, land)


def _scene(params: SimulateParams, things: Things, land: Relief) -> Scene:
    arrays = things.arrays()
    start, item, ceiling = index(arrays["box"], params.size, params.scene.index_cell)
    clump = np.zeros(256)
    clump[200:] = scipy.special.gammaincinv(2.5, (np.arange(56) + 0.5) / 56)
    gap = params.scene
    turn = math.radians(31.0)
    return Scene(
        size=params.size,
        margin=MARGIN,
        step=params.scene.terrain_step,
        height=land.height,
        cover=land.cover,
        albedo=land.albedo,
        herbs=land.herbs,
        roughness=np.array([0.06, 0.01, 0.035, 0.0]),
        cell=params.scene.index_cell,
        start=start,
        item=item,
        ceiling=ceiling,
        clump=clump / clump.mean(),
        gap=np.array(
            [
                0.24 * params.size,
                0.71 * params.size,
                math.cos(turn),
                math.sin(turn),
                gap.gap_length / 2,
                gap.gap_width / 2,
            ]
        ),
        key=np.uint64((params.seed * 0x9E3779B97F4A7C15 + 77) % 2**64),
        **arrays,
    )
