"""Planes of strips in cells: how far they lie apart, which ones count, and that order changes no bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fwclass.grid import Box, Window
from fwclass.quality.params import PlaneParams
from fwclass.quality.planes import PlanePairs, border_steps, low_steps, plane_pairs, planes_of
from fwclass.quality.strips import lifted_strips, stepped_borders

EAST, NORTH = 512_000.0, 5_403_008.0


@pytest.fixture
def params(base: dict[str, Any]) -> PlaneParams:
    return PlaneParams(**base["quality"]["planes"])


def echoes(rng: np.random.Generator, n: int, slope: float = 0.05, noise: float = 0.02, size: float = 64.0) -> Any:
    x, y = (np.round(a, 3) for a in rng.uniform(0, size - 0.001, (2, n)))
    z = np.round(100 + slope * x - 0.03 * y + rng.normal(0, noise, n), 3)
    return EAST + x, NORTH + y, z


def pairs(parts: list[Any], params: PlaneParams, size: float = 64.0) -> PlanePairs:
    x, y, z = (np.concatenate(c) for c in zip(*parts, strict=True))
    piece = np.repeat(np.arange(len(parts)), [len(p[0]) for p in parts])
    window = Window.covering(Box(EAST, NORTH, EAST + size, NORTH + size), params.cell)
    return plane_pairs(planes_of(x, y, z, piece, window, params))


def test_a_known_lift_comes_out_of_every_cell(params: PlaneParams) -> None:
    rng = np.random.default_rng(0)
    a, b = echoes(rng, 16_384), echoes(rng, 16_384)
    made = pairs([a, (b[0], b[1], b[2] - 0.15)], params)
    assert len(made.dz) == 256 and (made.first == 0).all() and (made.second == 1).all() and (made.weight == 1).all()
    error = 0.02 * np.sqrt(2 / 64)
    assert made.dz.mean() == pytest.approx(0.15, abs=4 * error / 16) and made.dz.std() < 2 * error
    assert sorted(zip(made.row.tolist(), made.col.tolist(), strict=True)) == [
        (r, c) for r in range(16) for c in range(16)
    ]


def test_a_slope_is_no_difference_though_the_echoes_lie_elsewhere(params: PlaneParams) -> None:
    rng = np.random.default_rng(1)
    a, b = echoes(rng, 30_000, slope=0.15, noise=0.0), echoes(rng, 30_000, slope=0.15, noise=0.0)
    left, right = a[0] % 4 < 2.5, b[0] % 4 > 1.5
    made = pairs([tuple(v[left] for v in a), tuple(v[right] for v in b)], params)
    assert len(made.dz) == 256 and np.abs(made.dz).max() < 0.0015


@pytest.mark.parametrize(
    ("slope", "noise", "number"),
    [(0.2, 0.02, 16_384), (0.05, 0.1, 16_384), (0.05, 0.02, 700)],
    ids=["steep", "rough", "few"],
)
def test_what_is_no_plane_counts_for_nothing(params: PlaneParams, slope: float, noise: float, number: int) -> None:
    rng = np.random.default_rng(2)
    made = pairs([echoes(rng, number, slope, noise), echoes(rng, number, slope, noise)], params)
    assert len(made.dz) <= 2


def test_a_single_scan_line_gives_no_slope(params: PlaneParams) -> None:
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 64, 2000)
    line = EAST + x, np.full(2000, NORTH + 6.0) + rng.normal(0, 0.05, 2000), np.full(2000, 100.0)
    assert not len(pairs([line, echoes(rng, 16_384)], params).dz)


def test_pairs_of_a_cell_that_three_strips_see_weigh_two_together(params: PlaneParams) -> None:
    rng = np.random.default_rng(4)
    made = pairs([echoes(rng, 16_384) for _ in range(3)], params)
    assert len(made.dz) == 3 * 256 and made.weight.sum() == pytest.approx(2 * 256)
    assert set(zip(made.first.tolist(), made.second.tolist(), strict=True)) == {(0, 1), (0, 2), (1, 2)}


def test_the_order_of_echoes_changes_no_bit(params: PlaneParams) -> None:
    rng = np.random.default_rng(5)
    x, y, z = (np.concatenate(c) for c in zip(echoes(rng, 9000), echoes(rng, 9000), strict=True))
    piece = np.repeat([0, 1], 9000)
    window = Window.covering(Box(EAST, NORTH, EAST + 64, NORTH + 64), params.cell)
    first = plane_pairs(planes_of(x, y, z, piece, window, params))
    order = rng.permutation(18_000)
    second = plane_pairs(planes_of(x[order], y[order], z[order], piece[order], window, params))
    for name in vars(first):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_no_echo_gives_no_pair(params: PlaneParams) -> None:
    nothing = np.empty(0)
    window = Window.covering(Box(EAST, NORTH, EAST + 64, NORTH + 64), params.cell)
    assert not len(plane_pairs(planes_of(nothing, nothing, nothing, np.empty(0, np.int64), window, params)).dz)


def test_files_beside_each_other_are_compared_across_their_border_alone(params: PlaneParams) -> None:
    """Three files of 21 m by 64 m, the last one 12 m higher; two pieces of the first see its cells."""
    rng = np.random.default_rng(5)
    x, y, z = echoes(rng, 30_000)
    file = np.minimum((x - EAST) // 20, 2).astype(np.int64)
    piece = np.where(file == 0, rng.integers(0, 2, len(x)), file + 1)
    z = z + np.where(file == 2, 12.0, 0.0)
    window = Window.covering(Box(EAST, NORTH, EAST + 64, NORTH + 64), params.cell)
    first, second, step = border_steps(planes_of(x, y, z, piece, window, params), np.array([7, 7, 3, 5]))
    assert (first < second).all() and len(step) == 32
    high = (first == 3) & (second == 5)
    assert high.sum() == 16 and step[high] == pytest.approx(-12.0, abs=0.1), "5 lies 12 m above 3"
    assert step[(first == 3) & (second == 7)] == pytest.approx(0.0, abs=0.1)
    facts = stepped_borders(first, second, step, {3: "c", 5: "e", 7: "g"}, 1.0)
    (one,) = facts["stepped"]
    assert (one["first"], one["second"], one["places"]) == ("c", "e", 16) and one["step"] == pytest.approx(-12, abs=0.1)
    assert facts["places"] == 32 and facts["borders"] == 2


def test_a_border_that_is_a_wall_in_part_is_no_step() -> None:
    first, second, walls = np.zeros(8, np.int64), np.ones(8, np.int64), np.array([3.0] * 5 + [0.1] * 3)
    assert not stepped_borders(first, second, walls, {}, 1.0)["stepped"]
    assert not stepped_borders(first[:4], second[:4], walls[:4], {}, 1.0)["stepped"], "too few places"
    assert not stepped_borders(first, second, np.array([3.0, -3.0] * 4), {}, 1.0)["stepped"]
    none = np.zeros(0, np.int64)
    assert stepped_borders(none, none, np.zeros(0), {}, 1.0) == {"places": 0, "borders": 0, "stepped": []}


def lows(parts: list[Any], order: np.ndarray | None = None) -> Any:
    x, y, z = (np.concatenate(c) for c in zip(*parts, strict=True))
    piece = np.repeat(np.arange(len(parts)), [len(p[0]) for p in parts])
    window = Window.covering(Box(EAST, NORTH, EAST + 64, NORTH + 64), 4.0)
    some = slice(None) if order is None else order
    return low_steps(x[some], y[some], z[some], piece[some], window, 6)


def test_a_strip_in_feet_shows_though_nothing_in_it_is_flat(params: PlaneParams) -> None:
    rng = np.random.default_rng(5)
    a, b = echoes(rng, 16_384, noise=0.03), echoes(rng, 16_384, noise=0.03)
    feet = (b[0], b[1], b[2] / 0.3048)
    assert not len(pairs([a, feet], params).dz), "roughness in feet is above max_residual: no planes"
    steps = lows([a, feet])
    (one,) = lifted_strips([steps], [np.array([4, 2])])
    assert (one["first"], one["second"], one["places"]) == (2, 4, 256) and 220 < one["step"] < 240
    assert not lifted_strips([lows([a, b])], [np.array([0, 1])])
    assert not lifted_strips([steps], [np.array([3, 3])]), "pieces of one strip"
    order = rng.permutation(2 * 16_384)
    assert all((p == q).all() for p, q in zip(steps, lows([a, feet], order), strict=True))


def test_crowns_that_hide_the_ground_are_no_step() -> None:
    rng = np.random.default_rng(6)
    parts = []
    for _ in range(2):
        x, y, z = echoes(rng, 3000)
        parts.append((x, y, z + rng.uniform(5, 25, len(z)) * (rng.random(len(z)) < 0.95)))
    steps = lows(parts)
    assert (np.abs(steps[2]) > 5).mean() > 0.1, "some cells are far apart"
    assert not lifted_strips([steps], [np.array([0, 1])])
    none = np.zeros(0, np.int64)
    assert not lifted_strips([(none, none, np.zeros(0))], [none])
