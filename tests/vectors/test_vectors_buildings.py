"""Buildings of echoes: the same in any windows, apart from each other, with height and confidence."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from fwclass import conf
from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.vectors.buildings import OF_CELLS, RIGHT_ANGLED, SIMPLIFIED, footprints
from fwclass.vectors.cells import (
    MARGIN,
    by_piece,
    cell_of,
    count_cells,
    join_cells,
    median_density,
    pieces,
    pulses_by_square,
    roofs,
)

CELL = 0.5


def params(**changed):
    return conf.section("vectors", tuple(f"vectors.{k}={v}" for k, v in changed.items()))


def echoes(roof, seed=0, density=4.0, size=64.0, height=6.0, sure=0.9) -> Table:
    """Echoes of a flat square of `size` [m], on roofs where `roof` covers them."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, size, (2, int(density * size**2)))
    on = shapely.contains_xy(roof, x, y)
    return Table(
        {
            "x": x,
            "y": y,
            "height_above_ground": np.where(on, height, 0.0),
            "classification": np.where(on, 6, 2),
            "confidence": np.full(len(x), sure),
        }
    )


def found(table: Table, windows, made=None):
    made = made or params().buildings
    whole, beyond = [], []
    for window in windows:
        wide = window.grown(MARGIN)
        counts = count_cells(table, wide, (6,), 1.0)
        inner = window.within(wide)
        some, others = pieces(roofs(counts)[inner], counts.within(inner), window)
        whole += by_piece(some)
        beyond.append(others)
    across = by_piece(join_cells(Table.concat(beyond)))
    shapes = footprints([*whole, *across], CELL, made)
    return shapes.rows, [shapely.Polygon(p[0], p[1:]) for p in shapes.polygons()]


def quarters(edge: int) -> list[Window]:
    return [Window(CELL, c, r, edge, edge) for r in range(0, 128, edge) for c in range(0, 128, edge)]


WHOLE = [Window(CELL, 0, 0, 128, 128)]
HOUSE = shapely.affinity.rotate(shapely.box(10, 10, 22, 20), 20)
LONG = shapely.affinity.rotate(shapely.box(4, 36, 60, 47), 8)  # crosses windows of 16 m, four times
ROOFS = shapely.MultiPolygon([HOUSE, LONG])


@pytest.mark.parametrize("edge", [16, 32, 64, 128])
def test_a_building_comes_once_and_whole_whatever_the_windows(edge):
    table = echoes(ROOFS)
    rows, shapes = found(table, quarters(edge))
    once, same = found(table, WHOLE)
    assert rows.rows == 2 and all(a.equals_exact(b, 0.0) for a, b in zip(shapes, same, strict=True))
    assert all((rows[n] == once[n]).all() for n in rows)


def test_the_order_of_the_echoes_changes_nothing():
    table = echoes(ROOFS)
    turned = table.take(np.random.default_rng(1).permutation(table.rows))
    assert all(a.equals_exact(b, 0) for a, b in zip(found(table, WHOLE)[1], found(turned, WHOLE)[1], strict=True))


def test_outline_height_and_confidence_are_those_of_the_building():
    rows, (house, long) = found(echoes(ROOFS), WHOLE)
    for made, true in ((house, HOUSE), (long, LONG)):
        assert made.intersection(true).area / made.union(true).area > 0.9
        assert len(made.exterior.coords) == 5 and made.is_valid
    assert (rows["outline"] == RIGHT_ANGLED).all()
    assert rows["object_height"] == pytest.approx([6.0, 6.0]) and rows["confidence"] == pytest.approx([0.9, 0.9])
    assert rows["object_area"] == pytest.approx([house.area, long.area])
    assert rows["object_echoes"].sum() <= (echoes(ROOFS)["classification"] == 6).sum()


def test_houses_an_alley_apart_are_two():
    gap = shapely.MultiPolygon([shapely.box(10, 10, 20, 22), shapely.box(21.5, 10, 31, 22)])
    assert found(echoes(gap), WHOLE)[0].rows == 2
    assert found(echoes(shapely.box(10, 10, 31, 22)), WHOLE)[0].rows == 1


def test_a_narrow_shed_is_a_building():
    shed = shapely.affinity.rotate(shapely.box(30, 30, 41, 32.8), 25)
    _, (made,) = found(echoes(shed), WHOLE)
    assert made.intersection(shed).area / made.union(shed).area > 0.75


def test_a_courtyard_is_a_hole():
    yard = shapely.box(10, 10, 40, 40).difference(shapely.box(20, 20, 30, 30))
    _, (made,) = found(echoes(yard), WHOLE)
    assert len(made.interiors) == 1 and made.is_valid
    assert made.intersection(yard).area / made.union(yard).area > 0.9


def test_a_round_building_is_simplified():
    rows, (made,) = found(echoes(shapely.Point(30, 30).buffer(14)), WHOLE, params().buildings)
    assert made.is_valid and rows["outline"][0] in (RIGHT_ANGLED, SIMPLIFIED)
    strict = params().buildings.model_copy(update={"agreement": 0.99})
    rows, (made,) = found(echoes(shapely.Point(30, 30).buffer(14)), WHOLE, strict)
    assert made.is_valid and rows["outline"][0] in (SIMPLIFIED, OF_CELLS)


def test_what_is_no_building_is_none():
    assert found(echoes(shapely.box(10, 10, 12, 12)), WHOLE)[0].rows == 0  # too small
    assert found(echoes(HOUSE, height=1.5), WHOLE)[0].rows == 0  # too low
    assert found(echoes(HOUSE, height=np.nan), WHOLE)[0].rows == 0  # no terrain below
    assert found(echoes(shapely.Polygon()), WHOLE)[0].rows == 0
    one = echoes(HOUSE)
    assert found(one.take(np.flatnonzero(one["classification"] == 6)[:1]), quarters(32))[0].rows == 0
    assert found(one.take(np.zeros(0, int)), WHOLE)[0].rows == 0


def test_without_confidences_there_is_none():
    rows, _ = found(echoes(HOUSE, sure=np.nan), WHOLE)
    assert np.isnan(rows["confidence"]).all()


@pytest.mark.parametrize("density, cell", [(0.3, 2.0), (1.0, 1.0), (3.3, 0.5), (16.0, 0.25), (100.0, 0.25), (0.0, 2.0)])
def test_cells_are_not_finer_than_the_spacing(density, cell):
    assert cell_of(density, params()) == cell


def test_the_density_is_that_of_where_pulses_are():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.01, 39.99, (2, 8000))
    window = Window(4.0, 0, 0, 100, 100)
    counts = pulses_by_square(x, y, window)
    assert sum(n * k for n, k in counts.items()) == 8000 and sum(counts.values()) == 100
    assert median_density(counts, 4.0) == pytest.approx(5.0, rel=0.1)
    assert median_density({}, 4.0) == 0.0
