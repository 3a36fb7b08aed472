"""Outlines that cross themselves are found, and those that only touch are not."""

from itertools import combinations
from unittest import mock

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from fwclass.formats.wkb import shapes
from fwclass.label import crossings
from fwclass.label.crossings import crossing_parts
from fwclass.label.polygons import Polygons

BOW_TIE = [(0, 0), (10, 10), (10, 0), (0, 10)]
STAR = [(np.cos(k * 0.8 * np.pi), np.sin(k * 0.8 * np.pi)) for k in range(5)]
SQUARE = [(0, 0), (10, 0), (10, 10), (0, 10)]


def polygons(*outlines, holes=()):
    made = [shapely.to_wkb(shapely.Polygon(outline, holes)) for outline in outlines]
    one = np.ones(len(outlines), np.int16)
    return Polygons.of(shapes(made, "test"), one, one, "test")


def test_those_that_cross_are_found_among_others():
    touches = [(0, 0), (10, 0), (5, 5), (10, 10), (0, 10), (5, 5)]
    twice = [*SQUARE, *SQUARE]  # along itself, which encircles nothing else
    assert crossing_parts(polygons(BOW_TIE, SQUARE, STAR, touches, twice)).tolist() == [True, False, True, False, False]


def test_a_hole_that_reaches_out_of_its_outline_crosses_it():
    hole = [(2, 2), (4, 2), (4, 4), (2, 4)]
    assert not crossing_parts(polygons(SQUARE, holes=[hole])).any()
    assert crossing_parts(polygons(SQUARE, holes=[[(x + 7, y) for x, y in hole]])).all()


def across(a, b, c, d):
    def side(p, q, r):
        return np.sign((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=4, max_size=12), st.integers(1, 40))
def test_against_every_pair_of_edges(corners, at_once):
    ring = [*corners, corners[0]]
    edges = [(ring[k], ring[k + 1]) for k in range(len(corners))]
    expected = any(across(*one, *other) for one, other in combinations(edges, 2))
    with mock.patch.object(crossings, "AT_ONCE", at_once):
        assert crossing_parts(polygons(corners)).tolist() == [expected]


def test_an_outline_of_many_corners_is_looked_into():
    angle = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    ring = np.c_[np.cos(angle), np.sin(angle)] * (100 + np.cos(300 * angle))[:, None]
    assert not crossing_parts(polygons(ring)).any()
    ring[[7000, 7005]] = ring[[7005, 7000]]
    assert crossing_parts(polygons(ring)).all()
