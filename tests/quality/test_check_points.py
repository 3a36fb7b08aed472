"""Check points: heights of the triangulated ground, the figures that standards ask for, and what is said of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from scipy.stats import chi2

from fwclass.graph import coverage
from fwclass.grid import Window
from fwclass.label.polygons import Polygons
from fwclass.quality.check_points import check_remarks, facts_of, ground_heights, height_facts

REACH = 5.0


def scattered(n=4000, size=60.0, seed=1):
    rng = np.random.default_rng(seed)
    x, y = np.round(rng.uniform(0, size, (2, n)), 3)
    return x + 512000.0, y + 5403000.0, np.round(300 + 0.1 * x - 0.05 * y + rng.normal(0, 0.03, n), 3)


def places(n=200, size=50.0, seed=2):
    rng = np.random.default_rng(seed)
    return tuple(np.round(rng.uniform(5, size, (2, n)), 3) + np.array([[512000.0], [5403000.0]]))


def test_a_plane_is_met():
    x, y, _ = scattered()
    z = 300 + 0.1 * (x - 512000) - 0.05 * (y - 5403000)
    px, py = places()
    height, near = ground_heights((px, py), (x, y, z), REACH)
    assert np.abs(height - (300 + 0.1 * (px - 512000) - 0.05 * (py - 5403000))).max() < 1e-6
    assert (near < 2.0).all()


def test_it_is_the_triangulation_of_all_echoes():
    ground, (px, py) = scattered(), places()
    whole = LinearNDInterpolator(np.stack([ground[0] - 512000, ground[1] - 5403000], axis=1), ground[2])
    height, _ = ground_heights((px, py), ground, REACH)
    assert np.abs(height - whole(px - 512000, py - 5403000)).max() < 1e-6


def test_neither_order_nor_what_lies_beyond_matters():
    ground, points = scattered(), places(50)
    height, near = ground_heights(points, ground, REACH)
    order = np.random.default_rng(3).permutation(len(ground[0]))
    again, there = ground_heights(points, tuple(c[order] for c in ground), REACH)
    assert (again == height).all() and (there == near).all()
    close = np.zeros(len(order), bool)
    for px, py in zip(*points, strict=True):
        close |= np.hypot(ground[0] - px, ground[1] - py) <= REACH + 0.001
    again, _ = ground_heights(points, tuple(c[close] for c in ground), REACH)
    assert (again == height).all() and not close.all()


def test_the_triangle_of_a_hole_is_found_beyond_the_nearest_echoes():
    """Nearest are the many of a strip beside the hole: their triangles do not hold the point."""
    rng = np.random.default_rng(7)
    near = np.c_[rng.uniform(1, 2, 400), rng.uniform(-3, 3, 400)]
    far = np.array([[-4.0, 0.5], [-3.9, -1.0], [-2.0, 4.0]])
    x, y = np.round(np.concatenate([near, far]), 3).T
    z = 2.0 * x - y + 50
    height, distance = ground_heights((np.array([0.0]), np.array([0.0])), (x, y, z), REACH)
    assert height[0] == pytest.approx(50.0, abs=1e-9) and 1.0 <= distance[0] < 1.2
    height, _ = ground_heights((np.array([0.0]), np.array([0.0])), (x[:400], y[:400], z[:400]), REACH)
    assert np.isnan(height[0])


def test_no_ground_around_is_no_height():
    one = (np.array([0.0]), np.array([0.0]))
    for x, y in (([], []), ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]), ([1.0, 2.0, 1.5], [1.0, 1.0, 2.0]), ([9.0], [9.0])):
        height, near = ground_heights(one, (np.array(x), np.array(y), np.zeros(len(x))), REACH)
        assert np.isnan(height[0]) and np.isnan(near[0]) == (x in ([], [9.0]))


def test_of_echoes_at_one_place_the_lowest_counts():
    one = (np.array([0.0]), np.array([0.0]))
    height, near = ground_heights(one, (np.zeros(3), np.zeros(3), np.array([5.0, 3.0, 4.0])), REACH)
    assert height[0] == 3.0 and near[0] == 0.0


def test_figures_are_those_of_the_standards():
    rng = np.random.default_rng(0)
    dz, code = rng.normal(0.02, 0.1, 80), np.repeat([-1, 2, 5, 4], 20)
    dz[3] = np.nan
    facts = height_facts(dz, code)
    assert [facts[k]["count"] for k in ("all", "open", "vegetated")] == [79, 39, 40]
    known = dz[np.isfinite(dz)]
    rmse = np.sqrt((known**2).mean())
    assert facts["all"]["rmse"] == pytest.approx(rmse) and facts["all"]["accuracy_95"] == pytest.approx(1.96 * rmse)
    assert facts["all"]["percentile_95"] == pytest.approx(np.percentile(np.abs(known), 95))
    low, high = facts["all"]["rmse_interval"]
    assert low == pytest.approx(rmse * np.sqrt(79 / chi2.ppf(0.975, 79))) and high > rmse > low
    assert height_facts(dz[:20], code[:20])["vegetated"] is None


@pytest.mark.statistics
def test_the_interval_holds_the_truth():
    rng, held = np.random.default_rng(4), 0
    for _ in range(2000):
        low, high = height_facts(rng.normal(0, 0.1, 25), np.full(25, -1))["all"]["rmse_interval"]
        held += low <= 0.1 <= high
    assert 0.93 < held / 2000 < 0.97


@pytest.mark.parametrize(
    ("dz", "words"),
    [
        (np.zeros(30), []),
        (np.zeros(12), ["12 check points tell little"]),
        (np.append(np.zeros(30), np.nan), ["1 of 31 check points are not compared"]),
        (np.full(40, np.nan), ["40 of 40 check points are not compared"]),
        (0.2 + 0.05 * np.sin(np.arange(40)), ["0.20 m above the check points on average, more than chance explains"]),
        (-47.0 + 0.05 * np.sin(np.arange(40)), ["are both heights of one kind"]),
        (0.05 * np.sin(np.arange(40)), []),
    ],
)
def test_what_is_said(dz, words):
    n = len(dz)
    facts = facts_of((np.arange(n, dtype=float), np.zeros(n), np.zeros(n)), dz, np.ones(n), np.full(n, -1))
    lines = check_remarks(facts, REACH)
    assert len(lines) == len(words) and all(w in line for w, line in zip(words, lines, strict=True)), lines


def test_wide_areas_are_asked_piece_by_piece(monkeypatch):
    """What lies in an area does not depend on how many cells are asked at once."""
    square = np.array([0, 40_300, 40_300, 0, 0]), np.array([0, 0, 20_100, 20_100, 0])
    none = np.zeros(1, np.uint8)
    area = Polygons(*square, np.array([0, 5]), np.array([0, 1]), none, none.astype(np.int16))
    window = Window(2.0, -3, -2, 30, 15)
    whole = coverage._inside(area, window)
    assert whole.sum() == 20 * 10 and whole.shape == window.shape
    monkeypatch.setattr(coverage, "COLUMNS", 7)
    assert (coverage._inside(area, window) == whole).all()


def test_blunders_and_repeated_points_are_told() -> None:
    rng = np.random.default_rng(8)
    x, y, z = rng.uniform(0, 100, (3, 40))
    dz = rng.normal(0.02, 0.03, 40)
    sound = facts_of((x, y, z), z + dz, np.ones(40), np.full(40, -1))
    assert sound["repeated"] == 0 and sound["blunders"] == {"count": 0, "points": []}
    assert not any("far off" in line or "twice" in line for line in check_remarks(sound, REACH))
    wrong = z.copy()
    wrong[[7, 30]] = -9999.0, z[30] + 2.0
    facts = facts_of((x, y, wrong), z + dz, np.ones(40), np.full(40, -1))
    assert facts["blunders"]["count"] == 2 and facts["blunders"]["points"][0][:3] == [x[7], y[7], -9999.0]
    (line,) = [t for t in check_remarks(facts, REACH) if "far off" in t]
    assert "2 check points" in line and f"at {x[7]:.3f}, {y[7]:.3f}" in line and "-9999 m" in line
    twice = [np.concatenate([v, v[:20]]) for v in (x, y, z, dz)]
    facts = facts_of((twice[0], twice[1], twice[2]), twice[2] + twice[3], np.ones(60), np.full(60, -1))
    assert facts["repeated"] == 20 and any(
        "20 of 60 check points are there twice" in t for t in check_remarks(facts, REACH)
    )
    rough = facts_of((x, y, z), z + rng.normal(0, 2.0, 40), np.ones(40), np.full(40, -1))
    assert rough["blunders"]["count"] == 0, "a rough survey has none"
