"""How far strips lie apart in plan: roofs of all aspects tell it to centimetres, slopes of one aspect tell nothing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from fwclass.grid import Box, Window
from fwclass.quality.offsets import MOST, Offsets, slope_pairs
from fwclass.quality.params import PlaneParams
from fwclass.quality.planes import planes_of
from fwclass.quality.strips import farthest_pair, offset_remarks, unsound_strips

SIZE = 96.0


def roofs(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of hipped roofs, 16 m across each, at four slopes."""
    u, v = x % 16 - 8, y % 16 - 8
    return (8 - np.maximum(np.abs(u), np.abs(v))) * np.array([0.3, 0.5, 0.7, 0.9])[(x // 16 + y // 16).astype(int) % 4]


def one_side(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.5 * x + 0.0 * y


def strip(seed: int, surface: Any, east: float = 0.0, north: float = 0.0, up: float = 0.0, per_m2: float = 6.0) -> Any:
    """Echoes of a surface that the strip sees so far beside where it is."""
    r = np.random.default_rng(seed)
    x, y = r.uniform(2, SIZE - 2, (2, int(per_m2 * (SIZE - 4) ** 2)))
    return x + east, y + north, surface(x, y) + up + r.normal(0, 0.02, len(x))


@pytest.fixture
def params(base: dict[str, Any]) -> PlaneParams:
    planes = base["quality"]["planes"]
    return PlaneParams(**{**planes, "max_slope": planes["steepest"]})


def pairs(strips: list[Any], params: PlaneParams, order: np.ndarray | None = None) -> Any:
    x, y, z = (np.concatenate(axis) for axis in zip(*strips, strict=True))
    piece = np.repeat(np.arange(len(strips)), [len(s[0]) for s in strips])
    order = np.arange(len(x)) if order is None else order
    window = Window.covering(Box(0.0, 0.0, SIZE, SIZE), params.slope_cell)
    return slope_pairs(planes_of(x[order], y[order], z[order], piece[order], window, params), 10.0)


def facts(strips: list[Any], params: PlaneParams, lift: float = 0.0, number: tuple[int, ...] = (0, 1)) -> Any:
    offsets = Offsets()
    offsets.add(pairs(strips, params), np.array(number))
    return offsets.facts(0, 1, lift, 100)


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (0.25, -0.1, 0.0), (1.4, 0.0, 0.15), (-0.6, 0.8, -0.2)])
def test_the_offset_comes_out(params: PlaneParams, moved: tuple[float, float, float]) -> None:
    east, north, up = moved
    offset = facts([strip(1, roofs, east, north, up), strip(2, roofs)], params, lift=up)
    assert offset["slopes"] > 100 and offset["error"] < 0.02
    assert abs(offset["east"] - east) < 4 * offset["error"] and abs(offset["north"] - north) < 4 * offset["error"]
    assert offset["distance"] == pytest.approx(math.hypot(offset["east"], offset["north"]))


def test_the_other_strip_first_is_the_other_way(params: PlaneParams) -> None:
    strips = [strip(1, roofs, 0.5, 0.2), strip(2, roofs)]
    one, other = facts(strips, params), facts(strips, params, number=(1, 0))
    assert other["east"] == pytest.approx(-one["east"]) and other["north"] == pytest.approx(-one["north"])


def test_errors_are_what_draws_scatter_by(params: PlaneParams) -> None:
    found = [facts([strip(k, roofs, 0.3), strip(k + 100, roofs)], params) for k in range(12)]
    standardised = np.array([(f["east"] - 0.3) / f["error"] for f in found])
    assert np.sqrt((standardised**2).mean()) < 2.0


def test_slopes_of_one_aspect_and_a_plain_tell_nothing(params: PlaneParams) -> None:
    assert facts([strip(1, one_side, 0.5), strip(2, one_side)], params) is None
    assert facts([strip(1, lambda x, y: 0 * x), strip(2, lambda x, y: 0 * x)], params) is None


def test_the_order_of_echoes_changes_no_bit_and_a_block_keeps_so_many(params: PlaneParams) -> None:
    strips = [strip(1, roofs, 0.5), strip(2, roofs)]
    n = sum(len(s[0]) for s in strips)
    one, other = pairs(strips, params), pairs(strips, params, np.random.default_rng(0).permutation(n))
    assert len(one.dz) == MOST
    for name in ("first", "second", "east", "north", "dz"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


def test_what_is_far_is_unsound_and_what_is_unsure_is_not() -> None:
    def told(distance: float, error: float) -> list[str]:
        offset = {"east": distance, "north": 0.0, "distance": distance, "error": error, "slopes": 40}
        between = [{"first": 0, "second": 1, "offset": offset}, {"first": 0, "second": 2, "offset": None}]
        names = [{"name": n} for n in ("a.laz", "b.laz", "c.laz")]
        strips = {"apart": 0, "pairs": 100, "between": between, "strips": names}
        assert farthest_pair(strips)["second"] == 1
        return unsound_strips(strips)

    assert "a.laz lies 1.50 m east of b.laz (standard error 0.020 m" in told(1.5, 0.02)[0]
    assert told(0.6, 0.02) == [] and told(1.1, 0.24) == []


@pytest.mark.parametrize(("distance", "told"), [(0.29, False), (0.3, True)])
def test_it_is_told_from_some_footprints_on(distance: float, told: bool) -> None:
    offset = {"east": 0.0, "north": -distance, "distance": distance, "error": 0.02, "slopes": 40}
    strips = {"between": [{"first": 0, "second": 1, "offset": offset}], "strips": [{"name": "a"}, {"name": "b"}]}
    said = offset_remarks(strips)
    assert bool(said) == told and all(text.startswith("a lies 0.30 m south of b") for text in said)
