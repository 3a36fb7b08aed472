"""What is selected by polygon, brush, section and filters, against shapely and plain numpy; and what is none."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import shapely
from drawn import box, drawn

from fwclass.errors import InputError
from fwclass.view.selection import Selection

COUNT = 4000


def echoes(seed: int = 0, spread: float = 100.0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    place = rng.uniform(-spread, spread, (3, COUNT))
    height = rng.uniform(0, 30, COUNT).astype(np.float32)
    height[::50] = np.nan
    return {
        **dict(zip("xyz", place, strict=True)),
        "classification": rng.choice(np.array([2, 5, 6], np.uint8), COUNT),
        "confidence": rng.uniform(0.3, 1, COUNT).astype(np.float32),
        "height_above_ground": height,
    }


def ring(seed: int, corners: int = 40) -> np.ndarray:
    """A jagged polygon around the origin."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
    return np.c_[np.cos(angle), np.sin(angle)] * rng.uniform(10, 90, (corners, 1))


@pytest.mark.parametrize("seed", range(5))
def test_a_polygon_has_the_echoes_that_shapely_finds(seed: int) -> None:
    columns, corners = echoes(seed), ring(seed)
    inside = shapely.contains_xy(shapely.Polygon(corners), columns["x"], columns["y"])
    assert 0 < inside.sum() < COUNT
    assert np.array_equal(Selection.of(drawn(corners)).rows(columns), np.flatnonzero(inside))


def test_of_a_polygon_that_crosses_itself_the_inside_is_by_the_even_odd_rule() -> None:
    columns = echoes()
    turns = np.pi / 2 + np.arange(5) * 4 * np.pi / 5
    star = np.c_[np.cos(turns), np.sin(turns)] * 90
    rows = Selection.of(drawn(star)).rows(columns)
    near = np.hypot(columns["x"], columns["y"])
    pentagon = 90 * math.cos(2 * math.pi / 5)  # the radius of the circle inside the star's middle
    assert (near[rows] > pentagon * 0.999).all() and len(rows) > 100
    arms = shapely.make_valid(shapely.Polygon(star))  # the middle is wound around twice: outside
    assert np.array_equal(rows, np.flatnonzero(shapely.contains_xy(arms, columns["x"], columns["y"])))


@pytest.mark.parametrize("seed", range(5))
def test_a_brush_has_what_lies_near_its_stroke(seed: int) -> None:
    columns = echoes(seed)
    stroke = np.random.default_rng(seed).uniform(-80, 80, (1 + 6 * seed, 2))
    line = shapely.LineString(stroke) if len(stroke) > 1 else shapely.Point(stroke[0])
    near = shapely.distance(shapely.points(columns["x"], columns["y"]), line) <= 12
    assert np.array_equal(Selection.of(drawn(stroke, radius=12)).rows(columns), np.flatnonzero(near))


def test_a_view_in_perspective_selects_what_is_seen_within() -> None:
    """Nothing behind the eye, nothing beyond the depths; places far from the origin keep their millimetres."""
    columns = echoes()
    about = np.array([512_000.0, 5_403_000.0, 300.0])
    matrix = np.random.default_rng(1).normal(size=(3, 4))
    matrix[2] = [0.3, -0.2, 0.9, 20]
    p = matrix @ np.vstack([*(columns[a] for a in "xyz"), np.ones(COUNT)])
    inside = shapely.contains_xy(shapely.Polygon(ring(3) / 20), p[0] / p[2], p[1] / p[2])
    expected = np.flatnonzero(inside & (p[2] > 0) & (p[2] >= 5) & (p[2] <= 60))
    assert 20 < len(expected) < COUNT
    moved = columns | {a: columns[a] + about[k] for k, a in enumerate("xyz")}
    sent = drawn(ring(3) / 20, about, matrix=matrix.ravel().tolist(), depth=[5, 60])
    assert np.array_equal(Selection.of(sent).rows(moved), expected)


def test_a_section_and_filters_hold_besides() -> None:
    columns = echoes()
    start, end, half = np.array([-60.0, -20.0]), np.array([50.0, 70.0]), 4.0
    along = (end - start) / np.hypot(*(end - start))
    u = np.c_[columns["x"], columns["y"]] - start
    s, t = u @ along, u @ [along[1], -along[0]]
    within = (s >= 0) & (s <= np.hypot(*(end - start))) & (abs(t) <= half) & (columns["z"] > -10)
    sent = drawn(
        box(0, -10, 1000, 1e6),
        about=[*start, 0],
        matrix=[along[0], along[1], 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        slab=[*start, *end, half],
        classes=[2, 6],
        confidence=[0.4, 0.8],
        height=[2, 20],
    )
    within &= np.isin(columns["classification"], [2, 6])
    within &= (columns["confidence"] >= 0.4) & (columns["confidence"] <= 0.8)
    within &= (columns["height_above_ground"] >= 2) & (columns["height_above_ground"] <= 20)
    assert within.sum() > 10
    assert np.array_equal(Selection.of(sent).rows(columns), np.flatnonzero(within))


@pytest.mark.parametrize("seed", range(20))
def test_no_tile_with_selected_echoes_is_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = echoes(seed)
    matrix = rng.normal(size=(3, 4))
    matrix[2, 3] += 50 * (seed % 3)
    sent = drawn(ring(seed) / 30, matrix=matrix.ravel().tolist(), depth=[1, 80])
    if seed % 2:
        sent |= {"slab": [*rng.uniform(-80, 80, 4), 5.0]}
    selection = Selection.of(sent)
    rows = selection.rows(columns)
    for i in range(-100, 100, 25):
        for j in range(-100, 100, 25):
            mine = (columns["x"][rows] // 25 * 25 == i) & (columns["y"][rows] // 25 * 25 == j)
            assert selection.touches((i, j, -100, i + 25, j + 25, 100)) or not mine.any()
    assert not Selection.of(drawn(box(0, 0, 1, 1))).touches((10, 10, 0, 20, 20, 5))


NESTED = json.loads("[" * 500 + "]" * 500)


@pytest.mark.parametrize(
    "wrong",
    [
        {"points": []},
        {"points": [[0, 0], [1, 1]]},
        {"points": [[0, 0]] * 2001},
        {"points": [[0, 0, 0]] * 3},
        {"points": [[float("nan"), 0]] * 3},
        {"points": [[float("inf"), 0]] * 3},
        {"points": [["0", 0]] * 3},
        {"points": [[True, 0]] * 3},
        {"points": [[10**400, 0]] * 3},
        {"points": NESTED},
        {"points": [NESTED] * 3},
        {"points": "x" * 1000},
        {"radius": -1},
        {"radius": None},
        {"matrix": [1] * 11},
        {"matrix": {}},
        {"about": [1e30, 0, 0]},
        {"depth": [5, 1]},
        {"confidence": [1, 0]},
        {"height": ["low", "high"]},
        {"slab": [0, 0, 0, 0, 1]},
        {"slab": [0, 0, 1, 0, 0]},
        {"classes": [256]},
        {"classes": [-1]},
        {"classes": [2.0]},
        {"classes": [2] * 257},
        {"classes": None},
        {"more": 1},
        {"<img src=x>": 1},
    ],
    ids=lambda wrong: str(wrong)[:30],
)
def test_what_is_no_selection_is_refused_in_words(wrong: dict) -> None:
    with pytest.raises(InputError) as told:
        Selection.of(drawn(box(0, 0, 1, 1)) | wrong)
    assert len(str(told.value)) < 1000


@pytest.mark.parametrize("plain", [None, [], "", 3, NESTED, {}, {"points": 1}])
def test_other_json_is_no_selection(plain: object) -> None:
    with pytest.raises(InputError):
        Selection.of(plain)
