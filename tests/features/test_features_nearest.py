"""The k nearest echoes against a k-d tree, and their features against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tolerances import ATTRIBUTE_STEP, FEATURE_RTOL

from fwclass import conf
from fwclass.columns import FEATURES
from fwclass.features.nearest import nearest_echoes
from fwclass.features.search import ROWS, Columns, nearest
from fwclass.grid import Box, Tile, TileGrid, millimetres
from fwclass.schema import Scale, Table
from fwclass.stage import Chunk

PARAMS = conf.section("features")
BASES = tuple(c.name for c in FEATURES if "k" in c.scales)


def table_of(points, seed=0):
    rng = np.random.default_rng(seed)
    n = len(points)
    x, y, z = np.asarray(points, float).T
    of = rng.integers(1, 4, n)
    amplitude = np.where(rng.random(n) < 0.2, np.nan, rng.uniform(0, 300, n))
    return Table(
        {
            "x": x.round(3),
            "y": y.round(3),
            "z": z.round(3),
            "number_of_echoes": of,
            "echo_number": np.minimum(rng.integers(1, 4, n), of),
            "amplitude": amplitude,
            "width": rng.uniform(2, 9, n),
            "intensity": rng.integers(0, 65536, n),
        }
    )


def chunk_of(table, core=None):
    return Chunk(table, np.arange(table.rows) if core is None else core, Tile(0, 0, 1e7))


def keys_of(table, k, reach):
    """Squared distances [mm2] and rows of the k nearest, by row; -1 where there are fewer."""
    columns = Columns.build(table["x"], table["y"], table["z"], k, reach)
    i = columns.index
    found, count = np.empty((table.rows, k), np.int64), np.empty(table.rows, np.int64)
    room = np.empty((2, table.rows), np.int64)
    nearest(
        columns.x,
        columns.y,
        columns.z,
        i.x,
        i.y,
        i.z,
        i.order,
        i.start,
        i.ncols,
        i.nrows,
        i.cell,
        np.arange(table.rows),
        k,
        round(reach * 1000),
        room[0],
        room[1],
        found,
        count,
    )
    squares, rows = np.full((table.rows, k), -1), np.full((table.rows, k), -1)
    for p, row in enumerate(i.order):
        key = found[p, : count[p]]
        squares[row, : count[p]], rows[row, : count[p]] = np.maximum((key >> ROWS) - 1, 0), key & (2**ROWS - 1)
    return squares, rows


def brute(table, k, reach):
    """The same by all pairs: the point itself, then by distance and row."""
    p = np.stack([millimetres(table[a]) for a in "xyz"], axis=1)
    squares, rows = np.full((len(p), k), -1), np.full((len(p), k), -1)
    for i in range(len(p)):
        d = ((p - p[i]) ** 2).sum(1)
        order = np.lexsort((np.arange(len(p)), d, np.arange(len(p)) != i))
        order = order[d[order] <= round(reach * 1000) ** 2][:k]
        squares[i, : len(order)], rows[i, : len(order)] = d[order], order
    return squares, rows


def random_cloud(rng, n):
    return rng.uniform(0, 8, (n, 3))


def surface(rng, n):
    xy = rng.uniform(0, 12, (n, 2))
    return np.column_stack([xy, 0.1 * xy[:, 0]])


def lattice(rng, n):
    """Nothing but ties."""
    return np.argwhere(np.ones((7, 7, 6))).astype(float) * 0.5


def places_taken_often(rng, n):
    return np.repeat(random_cloud(rng, n // 30), 30, axis=0)


def two_clusters(rng, n):
    """Far apart in plan and height, each dense; the grid's columns fit neither."""
    return np.concatenate([rng.normal(0, 0.05, (n - 40, 3)), rng.normal(0, 2, (40, 3)) + np.array([300, 40, 900])])


CLOUDS = [random_cloud, surface, lattice, places_taken_often, two_clusters]


@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda f: f.__name__)
@pytest.mark.parametrize(("k", "reach"), [(1, 5.0), (7, 0.6), (20, 5.0), (60, 100.0)])
def test_the_nearest_are_those_of_all_pairs_ties_by_row(cloud, k, reach):
    table = table_of(cloud(np.random.default_rng(3), 300) + np.array([500_000.0, 5_400_000.0, 200.0]))
    for got, expected in zip(keys_of(table, k, reach), brute(table, k, reach), strict=True):
        np.testing.assert_array_equal(got, expected)


def test_distances_are_those_of_a_kd_tree():
    rng = np.random.default_rng(4)
    points = np.concatenate([surface(rng, 15_000) * [5, 5, 1], rng.uniform(0, 60, (5_000, 3)) * [1, 1, 0.3]])
    table = table_of(points)
    squares, _ = keys_of(table, 20, 50.0)
    places = np.stack([millimetres(table[a]) for a in "xyz"], axis=1)
    expected, _ = cKDTree(places).query(places, k=20)
    np.testing.assert_array_equal(squares, np.rint(expected**2).astype(np.int64))


@pytest.mark.slow
def test_distances_beyond_what_float32_holds():
    """Points 20 km apart in one part: coordinates no longer fit float32."""
    rng, far = np.random.default_rng(6), np.array([20_000.0, 9_000.0, 17_000.0])
    points = np.concatenate([rng.uniform(0, 3, (150, 3)), rng.uniform(0, 3, (150, 3)) + far])
    table = table_of(points)
    for got, expected in zip(keys_of(table, 9, 5.0), brute(table, 9, 5.0), strict=True):
        np.testing.assert_array_equal(got, expected)


def reference(table, k, reach):
    """Every base by numpy."""
    _, rows = brute(table, k, reach)
    p = np.stack([table[a] for a in "xyz"], axis=1)
    out = {base: np.full(table.rows, np.nan) for base in BASES}
    for i in range(table.rows):
        at = rows[i][rows[i] >= 0]
        near = p[at] - p[i]
        z, number, of = near[:, 2], table["echo_number"][at], table["number_of_echoes"][at]
        off = z - z.mean()
        row = {
            "reach": np.linalg.norm(near, axis=1).max(),
            "height_range": np.ptp(z),
            "height_std": z.std(),
            "height_variance": z.var(),
            "height_skewness": (off**3).mean() / z.var() ** 1.5 if np.ptp(z) > 0 else 0.0,
            "height_kurtosis": (off**4).mean() / z.var() ** 2 if np.ptp(z) > 0 else 0.0,
            "height_above_mean": -z.mean(),
            "height_above_lowest": -z.min(),
            "height_below_highest": z.max(),
        }
        for q in (5, 10, 25, 50, 75, 90, 95):
            row[f"height_above_p{q:02d}"] = -np.percentile(z, q, method="inverted_cdf")
        kind = {"single": of == 1, "first": (of > 1) & (number == 1), "last": (of > 1) & (number == of)}
        share = {name: np.mean(mask) for name, mask in kind.items()}
        share["intermediate"] = 1 - sum(share.values())
        row |= {f"{name}_share": value for name, value in share.items()}
        row["egi"], row["ebi"] = share["single"] + share["last"], share["single"] + share["first"]
        row["evi"] = share["first"] + share["intermediate"]
        for name in ("amplitude", "width", "intensity"):
            v = table[name][at].astype(float)
            v = v[np.isfinite(v)]
            row[f"{name}_mean"], row[f"{name}_std"] = (v.mean(), v.std()) if len(v) else (np.nan, np.nan)
        row |= shape(near)
        for base in BASES:
            out[base][i] = row.get(base, np.nan)
    return out


def shape(near):
    """Bases of the covariance by `numpy.linalg.eigh`."""
    l, v = np.linalg.eigh(np.cov(near.T, bias=True)) if len(near) > 1 else (np.zeros(3), np.eye(3))
    l3, l2, l1 = np.maximum(l, 0)
    if len(near) < 3 or l1 < 1e-12:
        return {}
    s = np.array([l1, l2, l3]) / (l1 + l2 + l3)
    row = dict(zip(("eigenvalue_1", "eigenvalue_2", "eigenvalue_3"), s, strict=True))
    row |= {
        "eigenvalue_sum": l1 + l2 + l3,
        "linearity": (l1 - l2) / l1,
        "planarity": (l2 - l3) / l1,
        "sphericity": l3 / l1,
        "anisotropy": (l1 - l3) / l1,
        "omnivariance": (l1 * l2 * l3) ** (1 / 3),
        "eigenentropy": -sum(a * np.log(a) for a in s if a > 0),
        "surface_variation": s[2],
        "plane_std": np.sqrt(l3),
    }
    if l2 > 1e-6 * l1 and l2 - l3 > 1e-7 * l1:
        normal = v[:, 0]
        row["verticality"] = 1 - abs(normal[2])
        row["inclination"] = np.degrees(np.arccos(min(1.0, abs(normal[2]))))
        row["roughness"] = abs(near.mean(0) @ normal)
        row["plane_range"] = np.ptp(near @ normal)
    return row


@pytest.mark.parametrize(("k", "reach"), [(5, 5.0), (20, 5.0), (20, 0.7)])
def test_features_are_numpys(k, reach):
    table = table_of(np.concatenate([random_cloud(np.random.default_rng(8), 200), [[40, 40, 0], [40.1, 40, 0]]]))
    params = PARAMS.model_copy(update={"nearest_reach": reach})
    got = nearest_echoes(chunk_of(table), Scale("k", k), BASES, params.nearest_reach)
    expected = reference(table, k, reach)
    assert set(got) == set(BASES) == set(expected)
    for base in BASES:
        # square roots of an eigenvalue that float64 knows to 1e-8 of the largest; steps of 1/1024 DN and ns
        loose = {"plane_std": 2e-4, "inclination": 2e-3, "omnivariance": 1e-4}.get(base, 2e-5)
        loose = ATTRIBUTE_STEP if base.startswith(("amplitude", "width", "intensity")) else loose
        np.testing.assert_allclose(got[base], expected[base], atol=loose, rtol=FEATURE_RTOL, err_msg=base)


def test_tiles_of_any_size_give_the_same_bits():
    """Ties and a thin wood, where the reach and not the number decides; the halo is the reach."""
    rng = np.random.default_rng(9)
    points = np.concatenate([lattice(rng, 0) * 2, rng.uniform(0, 30, (250, 3))])
    table = table_of(points.round(1))
    params = PARAMS.model_copy(update={"nearest_reach": 3.0})
    whole = nearest_echoes(chunk_of(table), Scale("k", 12), BASES, params.nearest_reach)
    for size in (20.0, 7.0):
        for tile in TileGrid(size).touching(Box(0, 0, 30.001, 30.001)):
            near = np.flatnonzero(tile.box.grown(3.0).contains(table["x"], table["y"]))
            core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
            got = nearest_echoes(Chunk(table.take(near), core, tile), Scale("k", 12), BASES, params.nearest_reach)
            for base in BASES:
                np.testing.assert_array_equal(got[base], whole[base][near[core]], err_msg=base)


def test_without_the_reach_a_tile_would_see_other_neighbours():
    """The test above can fail: with half the halo the border differs."""
    table = table_of(np.random.default_rng(9).uniform(0, 30, (250, 3)))
    whole = nearest_echoes(chunk_of(table), Scale("k", 12), ("reach",), PARAMS.nearest_reach)["reach"]
    tile = Tile(0, 0, 10.0)
    near = np.flatnonzero(tile.box.grown(1.0).contains(table["x"], table["y"]))
    core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
    got = nearest_echoes(Chunk(table.take(near), core, tile), Scale("k", 12), ("reach",), PARAMS.nearest_reach)["reach"]
    assert (got != whole[near[core]]).any()


def test_alone_and_no_rows():
    lone = table_of(np.array([[0.0, 0, 0], [50, 0, 0]]))
    got = nearest_echoes(chunk_of(lone), Scale("k", 20), BASES, PARAMS.nearest_reach)
    assert (got["reach"] == 0).all() and (got["height_std"] == 0).all() and (got["height_skewness"] == 0).all()
    assert np.isnan(got["planarity"]).all() and np.isnan(got["plane_range"]).all()
    none = nearest_echoes(chunk_of(lone, np.empty(0, np.int64)), Scale("k", 20), BASES, PARAMS.nearest_reach)
    assert all(len(v) == 0 for v in none.values())
