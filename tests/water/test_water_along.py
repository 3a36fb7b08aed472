"""Places along lines, and those alone that lie near the survey."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from fwclass.errors import InputError
from fwclass.water.along import knots_along
from fwclass.water.shore import shoreline

BOX = (-20.0, -10.0, 30.0, 15.0)


def inside(x, y):
    return (x >= BOX[0]) & (x <= BOX[2]) & (y >= BOX[1]) & (y <= BOX[3])


def test_places_near_the_survey_are_those_of_all_of_the_line():
    """Lines in, across, beside and along the rim of the box, and points that are there twice."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        n = int(rng.integers(2, 9))
        x, y, z = rng.uniform(-90, 90, (3, n)).round(int(rng.integers(0, 3)))
        x[rng.random(n) < 0.2], y[rng.random(n) < 0.2] = BOX[0], BOX[3]
        rings = np.array([0, n])
        whole, near = (np.stack(knots_along(x, y, z, rings, 0.7, box)) for box in (None, BOX))
        wanted = whole[:, inside(whole[0], whole[1])]
        assert np.array_equal(wanted, near[:, inside(near[0], near[1])])
        assert near.shape[1] <= wanted.shape[1] + 4 * n


def test_a_shore_is_the_same_near_the_survey():
    rng = np.random.default_rng(2)
    for _ in range(100):
        corners = rng.integers(-60_000, 60_000, (4, 2))
        x, y = np.concatenate([corners, corners[:1]]).T
        rings, parts = np.array([0, 5]), np.array([0, 1])
        whole, near = (shoreline(x, y, rings, parts, 0.5, 20.0, box) for box in (None, BOX))
        for name in ("x", "y", "body", "stretch"):
            all_of, some = (getattr(line, name)[inside(line.x, line.y)] for line in (whole, near))
            assert np.array_equal(all_of, some)


def test_a_line_around_the_earth_costs_what_lies_near():
    """It took a gigabyte, or was refused."""
    x, y, z = np.array([-1.9e7, 1.9e7, 1.9e7]), np.array([0.0, 0.0, 9e6]), np.zeros(3)
    tracemalloc.start()
    try:
        knots = knots_along(x, y, z, np.array([0, 3]), 0.5, BOX)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20 and 100 <= len(knots[0]) < 110
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("far", [1e308, 1e200])
def test_a_line_whose_length_is_no_number_is_refused(far):
    ends = np.array([-far, far])
    with pytest.raises(InputError, match="too long"):
        knots_along(ends, ends, np.zeros(2), np.array([0, 2]), 0.5)
