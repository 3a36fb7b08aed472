"""Neighbourhood features against a k-d tree and numpy's eigenvectors, and the laws of shape."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fwclass.features.eigen import LINE, TIE, eigenvalues, normal
from fwclass.features.stage import neighbourhoods
from fwclass.features.walk import SHAPE
from fwclass.grid import TileGrid, millimetres
from fwclass.schema import Table
from fwclass.stage import Chunk

AT = {name: k for k, name in enumerate(SHAPE)}


def chunk_of(x, y, z, number=None, of=None):
    one = np.ones(len(x), np.uint8)
    number, of = (one, one) if number is None else (number, of)
    table = Table({"x": x, "y": y, "z": z, "echo_number": number, "number_of_echoes": of})
    return Chunk(table, np.arange(len(x)), TileGrid(1000.0).tile("0_0"))


def reference(x, y, z, number, of, radius):
    """The same features by a k-d tree over millimetres and `numpy.linalg.eigh`."""
    points = np.stack([millimetres(v) for v in (x, y, z)], axis=1).astype(float)
    limit = radius * 1000.0
    out = np.full((len(x), len(SHAPE) + 3), np.nan)
    spheres = cKDTree(points).query_ball_point(points, limit)
    cylinders = cKDTree(points[:, :2]).query_ball_point(points[:, :2], limit)
    for i, (sphere, cylinder) in enumerate(zip(spheres, cylinders, strict=True)):
        near = points[sphere] - points[i]
        row = dict.fromkeys(SHAPE, np.nan)
        row["echo_ratio"] = len(sphere) / len(cylinder)
        row["height_std"] = near[:, 2].std() / 1000.0
        row["height_range"] = np.ptp(near[:, 2]) / 1000.0
        row["height_above_lowest"] = (points[i, 2] - points[cylinder, 2].min()) / 1000.0
        row["density"] = len(cylinder) / (np.pi * radius**2)
        row["first_share"] = np.mean(number[sphere] == 1)
        row["last_share"] = np.mean(number[sphere] == of[sphere])
        l, v = np.linalg.eigh(np.cov(near.T, bias=True))
        l3, l2, l1 = np.maximum(l, 0.0)
        if len(sphere) >= 3 and l1 > 1e-9:
            row["linearity"], row["planarity"] = (l1 - l2) / l1, (l2 - l3) / l1
            row["sphericity"], row["roughness"] = l3 / l1, np.sqrt(l3) / 1000.0
            if l2 > LINE * l1 and l2 - l3 > TIE * l1:
                up = v[:, 0] * np.sign(v[2, 0] or 1.0)
                row["inclination"] = np.degrees(np.arccos(min(1.0, up[2])))
                out[i, -3:] = up
        out[i, : len(SHAPE)] = list(row.values())
    return out


def random_cloud(rng, n):
    return rng.uniform(0, 6, (n, 3)).round(3)


def sloping_plane(rng, n):
    xy = rng.uniform(0, 6, (n, 2)).round(3)
    return np.column_stack([xy, (0.3 * xy[:, 0] - 0.2 * xy[:, 1]).round(3)])


def wall(rng, n):
    return np.column_stack([rng.uniform(0, 6, n).round(3), np.full(n, 2.5), rng.uniform(0, 6, n).round(3)])


def exact_line(rng, n):
    t = rng.integers(0, 3000, n) / 1000.0
    return np.column_stack([t, 2.0 * t, t])


def places_taken_twice(rng, n):
    return np.repeat(random_cloud(rng, n // 2), 2, axis=0)


def lattice(rng, n):
    """Many neighbours at exactly the radius."""
    return np.argwhere(np.ones((8, 8, 4))).astype(float) * 0.5


CLOUDS = [random_cloud, sloping_plane, wall, exact_line, places_taken_twice, lattice]


@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("radius", [0.5, 1.0, 2.5])
def test_features_agree_with_a_kd_tree_and_eigh(cloud, radius):
    rng = np.random.default_rng(17)
    points = cloud(rng, 300) + np.array([500_000.0, 5_400_000.0, 300.0])
    x, y, z = points.T
    of = rng.integers(1, 4, len(x)).astype(np.uint8)
    number = np.minimum(rng.integers(1, 4, len(x)), of).astype(np.uint8)
    got = neighbourhoods(chunk_of(x, y, z, number, of), radius)
    expected = reference(x, y, z, number, of, radius)
    # eigenvalues by the closed form are good to ~1e-8 of the largest where two coincide, a square root of
    # float64's step
    for name, tolerance in [("inclination", 2e-3), ("roughness", 2e-4)]:
        np.testing.assert_allclose(got[:, AT[name]], expected[:, AT[name]], atol=tolerance, err_msg=name)
    for name in set(SHAPE) - {"inclination", "roughness"}:
        np.testing.assert_allclose(got[:, AT[name]], expected[:, AT[name]], atol=2e-6, rtol=1e-6, err_msg=name)
    upright = np.abs(expected[:, -1]) > 1e-6  # the sign of a level normal is a toss
    np.testing.assert_allclose(got[upright, -3:], expected[upright, -3:], atol=1e-5)


def test_shape_shares_sum_to_one_and_stay_in_range():
    x, y, z = random_cloud(np.random.default_rng(19), 800).T
    got = neighbourhoods(chunk_of(x, y, z), 1.0)
    shares = got[:, [AT["linearity"], AT["planarity"], AT["sphericity"]]]
    valid = ~np.isnan(shares[:, 0])
    assert valid.mean() > 0.9
    np.testing.assert_allclose(shares[valid].sum(1), 1.0, atol=1e-6)
    assert (shares[valid] >= 0).all()
    assert (got[:, AT["echo_ratio"]] > 0).all()
    assert (got[:, AT["echo_ratio"]] <= 1).all()


def test_inclination_of_planes_is_their_slope():
    rng = np.random.default_rng(23)
    for slope in (0.0, 15.0, 45.0, 80.0):
        x, y = rng.uniform(0, 5, (2, 2000)).round(3)
        z = (np.tan(np.radians(slope)) * x).round(3)
        got = neighbourhoods(chunk_of(x, y, z), 1.0)[:, AT["inclination"]]
        # rounding to 1 mm over 1 m is 0.03 degrees at most, once there is a handful of neighbours
        assert np.nanpercentile(np.abs(got - slope), 99) < 0.1


def test_quarter_turns_and_order_leave_shape_alone():
    rng = np.random.default_rng(29)
    x, y, z = random_cloud(rng, 500).T
    base = neighbourhoods(chunk_of(x, y, z), 1.0)
    turned = neighbourhoods(chunk_of(-y, x, z), 1.0)
    np.testing.assert_allclose(turned[:, : len(SHAPE)], base[:, : len(SHAPE)], atol=2e-4)
    mixed = rng.permutation(500)
    np.testing.assert_array_equal(neighbourhoods(chunk_of(x[mixed], y[mixed], z[mixed]), 1.0), base[mixed])


def test_few_or_coincident_neighbours_have_no_shape():
    shape = [AT[name] for name in ("linearity", "planarity", "sphericity", "roughness", "inclination")]
    for x in ([0.0], [0.0, 0.4], [0.0, 0.0, 0.0]):
        zero = np.zeros(len(x))
        got = neighbourhoods(chunk_of(np.array(x), zero, zero), 1.0)
        assert np.isnan(got[:, shape]).all()
        assert np.isnan(got[:, -3:]).all()
        np.testing.assert_array_equal(got[:, AT["echo_ratio"]], 1.0)
        np.testing.assert_array_equal(got[:, AT["height_std"]], 0.0)
    x = np.array([0.0, 0.3, 0.7])
    got = neighbourhoods(chunk_of(x, np.zeros(3), np.zeros(3)), 1.0)
    np.testing.assert_allclose(got[:, AT["linearity"]], 1.0, atol=1e-6)
    assert np.isnan(got[:, AT["inclination"]]).all()
    assert neighbourhoods(chunk_of(x[:0], x[:0], x[:0]), 1.0).shape == (0, len(SHAPE) + 3)


def test_eigenvalues_agree_with_numpy_for_spectra_of_every_kind():
    rng = np.random.default_rng(31)
    for spectrum in (
        [3, 2, 1],
        [1, 1, 1],
        [1, 1, 0],
        [1, 0, 0],
        [0, 0, 0],
        [1, 1, 1e-9],
        [1, 1e-9, 1e-9],
        [1e6, 1, 1e-3],
    ):
        for _ in range(20):
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            m = turn @ np.diag(spectrum).astype(float) @ turn.T
            args = (m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2])
            got = eigenvalues(*args)
            np.testing.assert_allclose(got, spectrum, atol=3e-8 * max(spectrum[0], 1e-30))
            assert got[0] >= got[1] >= got[2] >= 0
            n = normal(*args, *got)
            if spectrum[1] > 1e-5 * spectrum[0] and spectrum[1] - spectrum[2] > 1e-3 * spectrum[1]:
                np.testing.assert_allclose(abs(np.dot(n, turn[:, 2])), 1.0, atol=1e-6)
                assert n[2] >= 0
