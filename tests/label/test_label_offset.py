"""Labels that lie elsewhere: how far is measured exactly, and nothing is said where nothing can be."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.label.offset import measure_offset


def ground_and_blocks(seed: int, density: float, edge: float = 120.0):
    """Heights and classes of flat ground with boxes of 6 to 14 m, as a function of place; x and y [m]."""
    r = np.random.default_rng(seed)
    x, y = r.uniform(0, edge, (2, int(density * edge**2)))
    boxes = [(*r.uniform(0, edge, 2), *r.uniform(6, 14, 2), r.uniform(3, 12)) for _ in range(60)]

    def inside(px, py):
        height = np.zeros(len(px))
        for west, south, wide, deep, high in boxes:
            height[(px >= west) & (px < west + wide) & (py >= south) & (py < south + deep)] = high
        return height

    noise = r.normal(0, 0.3, len(x))
    values = np.column_stack([inside(x, y) + noise, r.normal(size=(len(x), 3))]).astype(np.float32)
    values[r.random(values.shape) < 0.1] = np.nan
    return x, y, values, lambda dx, dy: (inside(x - dx, y - dy) > 0).astype(np.uint8)


def millimetres(x, y):
    return np.rint(np.column_stack([x + 652_000, y + 6_862_000]) * 1000).astype(np.int64)


@pytest.mark.parametrize("moved", [(0, 0), (2, 0), (-3, 4), (1, -7), (9, 9)])
def test_the_offset_is_what_the_labels_were_moved_by(moved) -> None:
    x, y, values, label = ground_and_blocks(1, 3.0)
    offset = measure_offset(values, label(*moved), millimetres(x, y), 2)
    assert (offset.x, offset.y) == (-moved[0], -moved[1])
    assert offset.explained > 0.15
    assert offset.unmoved == offset.explained if moved == (0, 0) else offset.unmoved < 0.7 * offset.explained


@pytest.mark.statistics
@pytest.mark.parametrize(("size", "gap"), [(6, 14), (10, 4), (20, 15)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_boxes_that_were_drawn_apart_are_where_they_are(size: int, gap: int, seed: int) -> None:
    """Of boxes with the class of most of their echoes some cells are hard to tell, and others are when they are moved:
    shares of different cells told offsets of up to 0.3."""
    x, y, values, label = ground_and_blocks(seed, 6.0, 240.0)
    inside = (x % (size + gap) < size) & (y % (size + gap) < size)
    box = (x // (size + gap) * 1000 + y // (size + gap)).astype(int)[inside]
    high = np.bincount(box, label(0, 0)[inside]) / np.maximum(np.bincount(box), 1)
    offset = measure_offset(values[inside], (high[box] > 0.5).astype(np.uint8), millimetres(x, y)[inside], 2)
    assert offset is None or offset.explained - offset.unmoved < 0.03


def test_sparse_labels_are_judged_in_larger_cells() -> None:
    x, y, values, label = ground_and_blocks(2, 0.15)
    offset = measure_offset(values, label(6, 0), millimetres(x, y), 2)
    assert offset.cell == 2.0 and (offset.x, offset.y) == (-6, 0)


@pytest.mark.statistics
def test_rows_in_another_order_say_the_same() -> None:
    x, y, values, label = ground_and_blocks(3, 2.0)
    place, index = millimetres(x, y), label(3, 0)
    order = np.random.default_rng(0).permutation(len(x))
    assert measure_offset(values[order], index[order], place[order], 2) == measure_offset(values, index, place, 2)


def test_few_rows_apart_from_each_other_say_nothing() -> None:
    x, y, values, label = ground_and_blocks(4, 0.01)
    assert measure_offset(values, label(0, 0), millimetres(x, y), 2) is None
    assert measure_offset(values[:0], label(0, 0)[:0], millimetres(x, y)[:0], 2) is None


def test_labels_of_one_class_explain_nothing_anywhere() -> None:
    x, y, values, _ = ground_and_blocks(5, 2.0)
    offset = measure_offset(values, np.zeros(len(x), np.uint8), millimetres(x, y), 2)
    assert offset.explained == offset.unmoved == 0.0 and (offset.x, offset.y) == (0, 0)
