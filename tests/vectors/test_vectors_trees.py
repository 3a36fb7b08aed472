"""Trees of crowns with known tops: each found once, with its height and its ground, whatever the windows."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from fwclass import conf
from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.vectors.cells import count_cells
from fwclass.vectors.shapes import Shapes
from fwclass.vectors.trees import trees

CELL = 0.5
TREES = np.array([[12.2, 14.1, 9.0, 3.0], [17.9, 13.2, 12.0, 3.5], [31.4, 31.8, 15.0, 5.0], [50.0, 20.0, 6.0, 2.0]])
"""x, y, height, radius of the crown [m]."""


def params(**changed):
    return conf.section("vectors", tuple(f"vectors.trees.{k}={v}" for k, v in changed.items())).trees


def echoes(some=TREES, seed=0, density=8.0) -> Table:
    """Echoes of ellipsoids over flat ground, 64 m square."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 64, (2, int(density * 64**2)))
    height = np.zeros(len(x))
    for tx, ty, tall, reach in some:
        share = np.hypot(x - tx, y - ty) / reach
        inside = np.sqrt(np.clip(1 - share**2, 0, None))
        height = np.maximum(height, np.where(share < 1, tall * (0.5 + 0.5 * inside), 0.0))
    return Table(
        {
            "x": x,
            "y": y,
            "height_above_ground": height,
            "classification": np.where(height > 0, 5, 2),
            "confidence": np.full(len(x), 0.75),
        }
    )


def found(table: Table, edge: int = 128, settings=None) -> Shapes:
    """The trees of windows of `edge` cells, each read with its halo."""
    settings = settings or params()
    halo, parts = int(np.ceil(settings.halo(CELL) / CELL)), []
    for row in range(0, 128, edge):
        for col in range(0, 128, edge):
            core = Window(CELL, col, row, edge, edge)
            wide = core.grown(halo)
            parts.append(trees(count_cells(table, wide, settings.codes, 0.0), wide, core, settings))
    made = Shapes.together(parts)
    return made.ordered(np.lexsort((made.rows["x"], made.rows["y"])))


def test_every_tree_is_found_with_its_height_and_its_crown():
    made = found(echoes())
    assert made.rows.rows == len(TREES)
    for tx, ty, tall, reach in TREES:
        k = int(np.argmin(np.hypot(made.rows["x"] - tx, made.rows["y"] - ty)))
        assert np.hypot(made.rows["x"][k] - tx, made.rows["y"][k] - ty) < 1.2
        assert made.rows["object_height"][k] == pytest.approx(tall, abs=0.3)
        crown = shapely.Polygon(made.polygons()[k][0])
        assert crown.is_valid and crown.contains(shapely.Point(made.rows["x"][k], made.rows["y"][k]))
        assert 0.5 < crown.area / (np.pi * reach**2) < 1.3
    assert made.rows["confidence"] == pytest.approx(0.75)


@pytest.mark.parametrize("edge", [32, 64])
def test_windows_change_no_tree(edge):
    one, other = found(echoes()), found(echoes(), edge)
    assert all((one.rows[n] == other.rows[n]).all() for n in one.rows)
    assert all((one.corners[n] == other.corners[n]).all() for n in one.corners)


def test_crowns_of_neighbours_share_their_border_alone():
    made = found(echoes())
    one, other = (shapely.Polygon(made.polygons()[k][0]) for k in (0, 1))
    assert one.intersection(other).area < 0.1 * min(one.area, other.area)


def test_what_is_no_tree_is_none():
    low = TREES * [1, 1, 0.2, 1]
    assert found(echoes(low)).rows.rows == 0
    assert found(echoes(TREES[:0])).rows.rows == 0
    one = echoes()
    assert found(one.take(np.flatnonzero(one["height_above_ground"] > 5)[:1])).rows.rows == 0
    assert found(one.take(np.zeros(0, int))).rows.rows == 0
    nan = one.with_columns({"height_above_ground": np.full(one.rows, np.nan)})
    assert found(nan).rows.rows == 0


def test_the_order_of_the_echoes_changes_nothing():
    table = echoes()
    turned = table.take(np.random.default_rng(1).permutation(table.rows))
    one, other = found(table), found(turned)
    assert all((one.corners[n] == other.corners[n]).all() for n in one.corners)
