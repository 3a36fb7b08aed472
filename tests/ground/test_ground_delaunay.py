"""The Delaunay kernel against its own law, against scipy, and against itself in another order."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from tolerances import COORDINATE, SMALL_COORDINATE

from fwclass.errors import InputError
from fwclass.grid import Window
from fwclass.ground.tin.delaunay import GHOST, empty_mesh, insert_all, spatial_order, triangles
from fwclass.ground.tin.predicates import SPAN, circle_sign
from fwclass.ground.tin.tin import tin_heights, tin_of, tin_raster, unique_points

RNG = np.random.default_rng(4)


def mesh_of(x, y):
    order, px, py, _ = unique_points(np.asarray(x) / 1e3, np.asarray(y) / 1e3, np.zeros(len(x)))
    mesh = empty_mesh(px, py)
    insert_all(mesh, np.arange(len(order)))
    return mesh


def corners(mesh):
    """The triangles by their corners' coordinates, in an order of their own."""
    found = triangles(mesh)
    return sorted(tuple(sorted((mesh.x[v], mesh.y[v]) for v in t)) for t in found)


def turn(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def circle(a, b, c, p):
    """The in-circle determinant in Python's whole numbers."""
    rows = [(q[0] - p[0], q[1] - p[1]) for q in (a, b, c)]
    lift = [u * u + v * v for u, v in rows]
    cross = [rows[i][0] * rows[j][1] - rows[i][1] * rows[j][0] for i, j in ((1, 2), (2, 0), (0, 1))]
    return sum(f * g for f, g in zip(lift, cross, strict=True))


def hull_area(points):
    """Twice the area of the convex hull (monotone chain)."""
    points = sorted(set(points))
    chain = []
    for line in (points, points[::-1]):
        half = []
        for p in line:
            while len(half) > 1 and turn(half[-2], half[-1], p) <= 0:
                half.pop()
            half.append(p)
        chain += half[:-1]
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(chain, [*chain[1:], *chain[:1]], strict=True))


def check_law(x, y):
    """Every triangle turns left, no point lies inside a circle, the triangles fill the hull, twins agree."""
    mesh = mesh_of(x, y)
    points = [(int(a), int(b)) for a, b in zip(mesh.x, mesh.y, strict=True)]
    found = triangles(mesh)
    area = 0
    for a, b, c in ((points[i], points[j], points[k]) for i, j, k in found):
        assert turn(a, b, c) > 0
        area += turn(a, b, c)
        assert all(circle(a, b, c, p) <= 0 for p in points)
    assert area == hull_area(points)
    edges = np.arange(3 * int(mesh.state[0]))
    np.testing.assert_array_equal(mesh.twin[mesh.twin[edges]], edges)
    following = edges - edges % 3 + (edges % 3 + 1) % 3
    np.testing.assert_array_equal(mesh.vertex[mesh.twin[edges]], mesh.vertex[following])
    if len(found):
        assert set(found.ravel().tolist()) == set(range(len(points)))
        assert int(mesh.state[0]) == 2 * len(points) - 2


CLOUDS = {
    "random": RNG.integers(0, 100_000, (2, 150)),
    "grid": np.stack(np.meshgrid(np.arange(12) * 500, np.arange(11) * 500)).reshape(2, -1),
    "circle": np.array([(a, b) for a in range(-65, 66) for b in range(-65, 66) if a * a + b * b == 65 * 65]).T,
    "clusters": (RNG.integers(0, 4, (2, 150)) * (SPAN // 4) + RNG.integers(0, 9, (2, 150))),
    "duplicates": RNG.integers(0, 6, (2, 300)),
    "nearly a line": np.stack([np.arange(100) * 1000, np.r_[np.zeros(99, int), 1]]),
    "vertical wall": np.stack([np.r_[np.full(60, 77), 78], np.r_[np.arange(60) * 13, 5]]),
    "far corners": np.array([(0, 0), (SPAN, 0), (0, SPAN), (SPAN, SPAN), (SPAN // 2, 1), (SPAN // 2 + 1, SPAN - 1)]).T,
}


@pytest.mark.parametrize("name", CLOUDS)
def test_the_law_of_the_empty_circle(name):
    check_law(*CLOUDS[name])


@settings(deadline=None, max_examples=150)
@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), min_size=1, max_size=40))
def test_the_law_on_small_grids(points):
    check_law(*np.array(points).T)


@settings(deadline=None, max_examples=100)
@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=3, max_size=30, unique=True),
    st.randoms(use_true_random=False),
    st.integers(-4_000_000_000, 4_000_000_000),
)
def test_neither_order_nor_origin_nor_later_insertion_matters(points, random, shift):
    ix, iy = np.array(points).T
    usual = corners(mesh_of(ix, iy))
    order = list(range(len(ix)))
    random.shuffle(order)
    mesh = empty_mesh(ix.astype(float), iy.astype(float))
    half = len(order) // 2
    insert_all(mesh, np.array(order[:half], int))
    insert_all(mesh, np.array(order if mesh.state[0] == 0 else order[half:], int))
    low = int(ix.min()), int(iy.min())
    assert [tuple((a - low[0], b - low[1]) for a, b in t) for t in corners(mesh)] == usual
    assert corners(mesh_of(ix + shift, iy)) == usual


def test_same_triangles_as_scipy():
    ix, iy = RNG.integers(0, 1_000_000, (2, 20_000))
    mesh = mesh_of(ix, iy)
    ours, theirs = np.sort(triangles(mesh), 1), np.sort(Delaunay(np.c_[mesh.x, mesh.y]).simplices, 1)
    np.testing.assert_array_equal(ours[np.lexsort(ours.T)], theirs[np.lexsort(theirs.T)])


@settings(deadline=None, max_examples=300)
@given(st.lists(st.integers(0, SPAN), min_size=8, max_size=8), st.integers(-2, 2), st.booleans())
def test_the_circle_is_decided_exactly(v, off, symmetric):
    a, b, c, p = (v[0], v[1]), (v[2], v[3]), (v[4], v[5]), (v[6], v[7])
    if symmetric:  # three corners of a rectangle, and a point within 2 mm of the fourth
        a, b, c, p = (v[0], v[1]), (v[2], v[1]), (v[2], v[3]), (v[0] + off, v[3])
    if turn(a, b, c) < 0:
        b, c = c, b
    expected = circle(a, b, c, p)
    found = circle_sign(*(float(u) for q in (a, b, c, p) for u in q))
    assert found == (expected > 0) - (expected < 0)


@pytest.mark.parametrize(
    ("x", "y"),
    [([], []), ([5], [5]), ([5, 5], [5, 5]), ([1, 2], [3, 4]), (range(50), range(50)), ([7] * 50, range(50))],
)
def test_points_on_one_line_have_no_triangles(x, y):
    x, y = np.array(x, float), np.array(y, float)
    tin = tin_of(x, y, np.zeros(len(x)))
    assert tin.empty
    assert triangles(tin.mesh).shape == (0, 3)
    assert np.isnan(tin_heights(tin, np.array([5.0, 1.5]), np.array([5.0, 3.5]))).all()
    assert np.isnan(tin_raster(tin, Window(1.0, 0, 0, 4, 3))).all()


def test_too_large_a_span_is_refused():
    with pytest.raises(InputError, match="too far apart"):
        tin_of(np.array([0.0, 40_000.0, 1.0]), np.array([0.0, 1.0, 5.0]), np.zeros(3))


def test_ghosts_stay_outside():
    mesh = mesh_of(*CLOUDS["random"])
    used = mesh.vertex[: 3 * int(mesh.state[0])]
    assert (used.reshape(-1, 3) == GHOST).sum(axis=1).max() == 1


def test_two_rows_far_apart_do_not_take_for_ever():
    """In plain Morton order every point of the second row would see the whole first one: minutes."""
    along = np.arange(20_000.0) * 0.01
    x, y = np.r_[along, along], np.repeat([0.0, 300.0], 20_000)
    tin = tin_of(x, y, np.zeros(40_000))
    start = time.process_time()
    tin_of(x, y, np.zeros(40_000))
    assert time.process_time() - start < 3.0
    assert len(triangles(tin.mesh)) == 2 * 19_999


def test_morton_order_depends_on_coordinates_alone():
    ix, iy = RNG.integers(0, 50, (2, 400))
    shuffled = RNG.permutation(400)
    one, other = spatial_order(ix, iy), shuffled[spatial_order(ix[shuffled], iy[shuffled])]
    np.testing.assert_array_equal(ix[one], ix[other])
    np.testing.assert_array_equal(iy[one], iy[other])


# --- heights ---------------------------------------------------------------------------------------------------------


def survey_like(n=4000, size=60.0):
    x = np.round(RNG.uniform(512_000, 512_000 + size, n), 3)
    y = np.round(RNG.uniform(5_403_000, 5_403_000 + size, n), 3)
    return x, y


def test_a_plane_is_met_exactly_everywhere():
    x, y = survey_like()

    def plane(a, b):
        return 300.0 + 0.25 * (a - 512_000) - 0.125 * (b - 5_403_000)

    qx, qy = survey_like()
    heights = tin_heights(tin_of(x, y, plane(x, y)), qx, qy)
    inside = ~np.isnan(heights)
    assert inside.mean() > 0.9
    np.testing.assert_allclose(heights[inside], plane(qx, qy)[inside], atol=SMALL_COORDINATE)


def test_heights_are_scipys_linear_interpolation():
    from scipy.interpolate import LinearNDInterpolator

    x, y = survey_like(1000)
    z = RNG.normal(300, 5, len(x))
    qx, qy = survey_like(1000)
    theirs = LinearNDInterpolator(np.c_[x - 512_000, y - 5_403_000], z)(qx - 512_000, qy - 5_403_000)
    ours = tin_heights(tin_of(x, y, z), qx, qy)
    np.testing.assert_allclose(ours, theirs, atol=COORDINATE)


def test_a_point_has_its_own_height_and_of_two_the_lower():
    x, y = survey_like(500)
    z = RNG.normal(300, 5, len(x))
    again = np.r_[z + 1.0, z]
    tin = tin_of(np.r_[x, x], np.r_[y, y], again)
    np.testing.assert_array_equal(tin_heights(tin, x, y), z)


def test_the_raster_is_the_heights_bit_for_bit():
    gx, gy = (v.ravel() for v in np.meshgrid(np.arange(0, 40, 0.5) - 20.25, np.arange(0, 30, 0.5) + 1e6))
    for x, y in ((gx, gy), survey_like()):
        tin = tin_of(x, y, RNG.normal(300, 5, len(x)))
        for cell in (0.25, 0.5, 1.0, 0.7, 0.001 * 333):
            window = Window(cell, int(x.min() // cell) - 3, int(y.min() // cell) - 3, 90, 80)
            mm = round(cell * 1000)
            cx = ((np.arange(90) + window.col) * mm + mm / 2) / 1000
            cy = ((np.arange(80) + window.row) * mm + mm / 2) / 1000
            xx, yy = np.meshgrid(cx, cy)
            expected = tin_heights(tin, xx.ravel(), yy.ravel()).reshape(80, 90)
            np.testing.assert_array_equal(tin_raster(tin, window), expected)


def test_the_hull_bounds_the_heights():
    x, y = np.array([0.0, 4.0, 0.0, 4.0, 20.0]), np.array([0.0, 0.0, 4.0, 4.0, 2.0])
    tin = tin_of(x, y, np.arange(5.0))
    qx, qy = np.array([2.0, 10.0, -0.001, 0.0, 20.0, np.nan, 9e9]), np.array([1.0, 2.0, 2.0, 2.0, 2.0, 1.0, 1.0])
    np.testing.assert_array_equal(np.isnan(tin_heights(tin, qx, qy)), [0, 0, 1, 0, 0, 1, 1])


def test_the_order_of_points_does_not_matter_to_heights():
    gx, gy = (v.ravel() for v in np.meshgrid(np.arange(0, 20, 0.5), np.arange(0, 20, 0.5)))
    z = RNG.normal(0, 1, len(gx))
    shuffled = RNG.permutation(len(gx))
    qx, qy = RNG.uniform(-1, 21, (2, 3000))
    one = tin_heights(tin_of(gx, gy, z), qx, qy)
    np.testing.assert_array_equal(one, tin_heights(tin_of(gx[shuffled], gy[shuffled], z[shuffled]), qx, qy))
    asked = RNG.permutation(3000)
    np.testing.assert_array_equal(one[asked], tin_heights(tin_of(gx, gy, z), qx[asked], qy[asked]))


def test_pairs_of_every_kind():
    """Every set of four points on a 3 x 3 grid: the smallest geometry in which anything can go wrong."""
    places = list(itertools.product(range(3), range(3)))
    for chosen in itertools.combinations(places, 4):
        check_law(*np.array(chosen).T)
