"""The terrain and what covers it: hills, a terrace, streets, a river and micro-relief, as rasters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.simulate.params import SimulateParams
from fwclass.simulate.random_field import add_waves
from fwclass.simulate.scene import ASPHALT, GRASS, SOIL, WATER

BLOCK_U, BLOCK_V = 96.0, 68.0
"""Pitch of the streets [m]."""

STREET = 4.5
"""Half-width of the asphalt [m]."""

MARGIN = 16.0
"""Terrain around the survey area [m]."""


@dataclass(frozen=True)
class Town:
    """The plan's frame: u along the long side of the blocks, v across; and the river in it."""

    angle: float
    river: float
    half_river: float

    def frame(self, x: NDArray | float, y: NDArray | float) -> tuple[NDArray, NDArray]:
        """(x, y) [m] in the town's frame: u [m] along the streets, v [m] across; any shape."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.asarray(x * c + y * s), np.asarray(y * c - x * s)

    def ground(self, u: float, v: float) -> tuple[float, float]:
        """A place (u, v) [m] of the town's frame in survey coordinates (x, y) [m]."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return u * c - v * s, u * s + v * c

    def course(self, v: NDArray | float) -> NDArray:
        """u of the river's middle at v [m]."""
        return self.river + 14.0 * np.sin(np.asarray(v) / 61.0) + 6.0 * np.sin(np.asarray(v) / 23.0)

    def shore(self, u: NDArray | float, v: NDArray | float) -> NDArray:
        """Distance from the water's edge [m], negative in the water."""
        return np.asarray(np.abs(u - self.course(v)) - self.half_river)

    def street(self, u: NDArray | float, v: NDArray | float) -> NDArray:
        """Distance from the middle of the nearest street [m]."""
        du = np.abs((np.asarray(u) / BLOCK_U + 0.5) % 1.0 - 0.5) * BLOCK_U
        dv = np.abs((np.asarray(v) / BLOCK_V + 0.5) % 1.0 - 0.5) * BLOCK_V
        return np.minimum(du, dv)


def town(params: SimulateParams) -> Town:
    """Where streets and river of a survey lie [m]; the river passes two thirds of the way to the east."""
    angle = math.radians(params.scene.street_angle)
    plan = Town(angle, 0.0, params.scene.river_width / 2.0)
    u, v = plan.frame(0.66 * params.size, 0.5 * params.size)
    return Town(angle, float(u) - float(plan.course(float(v))), plan.half_river)


def _smooth(t: NDArray) -> NDArray:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@dataclass(frozen=True)
class Relief:
    """Heights at the nodes [m]; covers, reflectances and herb heights [m] of one-metre cells. Row 0 is the
    southern margin."""

    height: NDArray[np.float32]
    cover: NDArray[np.uint8]
    albedo: NDArray[np.float32]
    herbs: NDArray[np.float32]


def relief(params: SimulateParams, plan: Town) -> Relief:
    """The terrain of a survey: heights float32 (rows, columns) [m] every ``terrain_step`` [m]."""
    random = np.random.default_rng([params.seed, 1])
    step = params.scene.terrain_step
    axis = (np.arange(int((params.size + 2 * MARGIN) / step) + 1) * step - MARGIN).astype(np.float32)
    u, v = plan.frame(axis[None, :], axis[:, None])
    height = np.zeros((len(axis), len(axis)), np.float32)
    hills = params.scene.hill_height
    for wavelength, deviation in ((260.0, 0.42), (90.0, 0.18), (28.0, 0.05)):
        add_waves(height, step, wavelength, deviation * hills, random)
    height += (0.018 * u + 0.006 * v).astype(np.float32)
    terrace = 0.3 * params.size + 18.0 * np.sin(u / 47.0) - v
    height += (3.6 * _smooth(terrace / 4.5)).astype(np.float32)
    shore = plan.shore(u, v)
    valley = float(np.median(height[shore < 4.0])) if np.any(shore < 4.0) else 0.0
    near = _smooth(1.0 - (shore - 8.0) / 70.0)
    height += ((valley + 0.001 * v - height) * near).astype(np.float32)
    height -= (3.2 * _smooth(1.0 - shore / 6.0)).astype(np.float32)
    rough = np.zeros_like(height)
    for wavelength, deviation in ((9.0, 0.13), (4.0, 0.06), (1.6, 0.035), (0.7, 0.02)):
        add_waves(rough, step, wavelength, deviation, random)
    height += rough * np.where(plan.street(u, v) < STREET + 0.5, 0.2, 1.0).astype(np.float32)
    return Relief(height, *_cover(params, plan, random))


def _cover(
    params: SimulateParams, plan: Town, random: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
    axis = (np.arange(int(params.size + 2 * MARGIN)) + 0.5 - MARGIN).astype(np.float32)
    u, v = plan.frame(axis[None, :], axis[:, None])
    shape = (len(axis), len(axis))
    patches = np.zeros(shape, np.float32)
    add_waves(patches, 1.0, 14.0, 1.0, random)
    cover = np.where(patches > 1.1, SOIL, GRASS).astype(np.uint8)
    street = plan.street(u, v)
    cover[street < STREET + 2.0] = SOIL
    cover[street < STREET] = ASPHALT
    cover[plan.shore(u, v) < 6.0] = GRASS
    cover[plan.shore(u, v) < 0.0] = WATER
    albedo = np.array([0.40, 0.20, 0.33, 0.0], np.float32)[cover]
    for wavelength, deviation in ((40.0, 0.12), (3.0, 0.16)):
        field = np.ones(shape, np.float32)
        add_waves(field, 1.0, wavelength, deviation, random)
        albedo *= np.clip(field, 0.5, 1.6)
    tall = np.full(shape, -params.scene.herb_threshold, np.float32)
    for wavelength, deviation in ((45.0, 0.6), (5.0, 0.8)):
        add_waves(tall, 1.0, wavelength, deviation, random)
    herbs = np.where((tall > 0.0) & (cover == GRASS), 0.15 + 0.45 * tall, 0.0).astype(np.float32)
    return cover, np.clip(albedo, 0.0, 0.85).astype(np.float32), herbs
