"""Outlines of cells: rings that are valid whatever the cells, and right angles where the walls have them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy
import shapely

from fwclass.vectors.outline import area, corners, cover, fill_holes, mask_of, rings, simplify, sound
from fwclass.vectors.outline_kernels import cells_around, crown_outline
from fwclass.vectors.regular import direction, middles, right_angled


def one_piece(seed: int, size: int = 24, share: float = 0.6) -> np.ndarray:
    """The largest piece of a random mask, by sides and corners, with its margin."""
    rng = np.random.default_rng(seed)
    labels, _ = scipy.ndimage.label(rng.random((size, size)) < share, np.ones((3, 3)))
    rows, cols = np.nonzero(labels == np.argmax(np.bincount(labels.ravel())[1:]) + 1)
    return mask_of(rows, cols)[0]


def polygon(parts) -> shapely.Polygon:
    return shapely.Polygon(parts[0], parts[1:])


@pytest.mark.parametrize("seed", range(30))
def test_rings_of_any_piece_are_a_valid_polygon_of_its_cells(seed):
    mask = fill_holes(one_piece(seed, share=0.45 + 0.01 * seed), 1)
    made = polygon([corners(ring).astype(float) for ring in rings(mask)])
    assert made.is_valid
    assert made.area == mask.sum()
    assert (cover([r.astype(float) for r in rings(mask)], mask.shape) == mask).all()


def test_small_holes_are_filled_and_large_ones_are_rings():
    mask = np.zeros((14, 14), bool)
    mask[1:13, 1:13] = True
    mask[3, 3] = mask[6:9, 6:9] = False
    outline, hole = rings(fill_holes(mask, 4))
    assert area(outline) == 144 and area(hole) == -9
    assert corners(hole).shape == (4, 2)


@pytest.mark.parametrize("seed", range(30))
def test_holes_and_corners_are_closed_as_another_program_does(seed):
    """Cells that touch by a corner alone are joined all at a time, until there are none."""
    mask = one_piece(seed, share=0.4 + 0.01 * seed)
    labels, number = scipy.ndimage.label(~mask)
    sizes = np.bincount(labels.ravel(), minlength=number + 1)
    expected = mask | np.isin(labels, [k for k in range(1, number + 1) if sizes[k] < 5 and k != labels[0, 0]])
    while True:
        a, b, c, d = expected[:-1, :-1], expected[:-1, 1:], expected[1:, :-1], expected[1:, 1:]
        rising, falling = a & d & ~b & ~c, b & c & ~a & ~d
        if not (rising | falling).any():
            break
        expected = expected.copy()
        expected[:-1, 1:] |= rising
        expected[:-1, :-1] |= falling
    before = mask.copy()
    assert (fill_holes(mask, 5) == expected).all() and (mask == before).all()


@pytest.mark.parametrize("seed", range(60))
def test_a_crowns_outline_is_simplified_where_that_is_sound(seed):
    """In one go what the functions for any polygon do one after the other."""
    rng = np.random.default_rng(seed)
    cells = np.argwhere(one_piece(seed, size=int(rng.integers(3, 30)), share=0.4 + 0.005 * seed)) + np.array([7, 400])
    mask, row, col = mask_of(*cells.T)
    ring = rings(fill_holes(mask, mask.size))[0].astype(float)
    plain = ring[simplify(ring, 1.0)]
    expected = plain if sound([plain]) else corners(ring)
    assert (crown_outline(cells) == expected + np.array([col, row])).all()
    some = fill_holes(mask, mask.size).astype(np.int32)
    labels, seen, met = np.pad(some, 3), np.zeros(np.add(some.shape, 6), bool), np.empty((some.size, 2), np.int64)
    number = cells_around(labels, seen, met, *(np.argwhere(labels)[-1]))
    assert number == some.sum() and (seen == (labels > 0)).all() and labels[tuple(met[:number].T)].all()


@pytest.mark.parametrize("seed", range(20))
def test_whether_a_polygon_is_sound_is_what_another_program_says(seed):
    rng = np.random.default_rng(seed)
    ring = rng.integers(0, 6, (rng.integers(3, 8), 2)).astype(float)
    ring = ring[(ring != np.roll(ring, 1, axis=0)).any(axis=1)]  # a corner twice is no corner
    ring = ring if area(ring) > 0 else ring[::-1]
    assert sound([ring]) == (shapely.Polygon(ring).is_valid and area(ring) > 0)


def test_holes_lie_inside_and_apart():
    outline = np.array([[0, 0], [9, 0], [9, 9], [0, 9]], float)
    hole = np.array([[2, 2], [2, 4], [4, 4], [4, 2]], float)

    def moved(by):
        return hole + np.array([by, by])

    assert sound([outline, hole]) and sound([outline, hole, moved(3)])
    assert not sound([outline, moved(20)]) and not sound([outline, moved(6)])
    assert not sound([outline, hole, moved(1)]) and not sound([outline[::-1], hole])


@pytest.mark.parametrize("seed", range(10))
def test_no_corner_lies_further_from_the_simplified_ring_than_the_tolerance(seed):
    ring = middles(rings(fill_holes(one_piece(seed), 1))[0])
    stays = simplify(ring, 1.5)
    line = shapely.LinearRing(ring[stays])
    assert max(shapely.Point(p).distance(line) for p in ring) <= 1.5 + 1e-9
    assert 3 <= len(stays) < len(ring)


def rastered(shape: shapely.Polygon) -> np.ndarray:
    """Cells of a metre whose middles lie in a shape, with a margin."""
    rows, cols = np.mgrid[0:120, 0:120]
    return shapely.contains_xy(shape, cols + 0.5, rows + 0.5)


L = shapely.Polygon([(20, 20), (90, 20), (90, 60), (55, 60), (55, 95), (20, 95)])


@pytest.mark.parametrize("degrees", [0, 7, 14, 31, 45, 60, 83])
def test_the_walls_of_a_turned_building_come_back_right_angled(degrees):
    shape = shapely.affinity.rotate(L, degrees, (60, 60))
    points = middles(rings(rastered(shape))[0])
    plain = points[simplify(points, 1.5)]
    angle = direction([plain])
    assert abs((math.degrees(angle) - degrees + 45) % 90 - 45) < 1.0
    ring = right_angled(points, angle, 1.5, 3.0)
    assert ring is not None and len(ring) == 6
    made = shapely.Polygon(ring)
    assert made.intersection(shape).area / made.union(shape).area > 0.97
    along = np.roll(ring, -1, axis=0) - ring
    turned = np.sum(along * np.roll(along, -1, axis=0), axis=1)
    assert np.abs(turned / np.prod(np.hypot(*along.T).mean())).max() < 1e-9


def test_a_round_thing_has_no_right_angles():
    points = middles(rings(rastered(shapely.Point(60, 60).buffer(40)))[0])
    ring = right_angled(points, 0.3, 1.5, 3.0)
    assert ring is not None  # steps; that it does not agree is who asks for it to tell
    assert right_angled(points[:2], 0.0, 1.5, 3.0) is None
