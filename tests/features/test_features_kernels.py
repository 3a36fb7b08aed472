"""Every measure of spheres, cylinders and the optimal sphere against a k-d tree and plain numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from defaults import BASE
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from tolerances import ATTRIBUTE_STEP, FEATURE_RTOL, FLOAT32_RTOL

from fwclass.columns.features import FEATURES
from fwclass.features.eigen import LINE, TIE, shapes
from fwclass.features.moments import MOMENTS, XX, XY, XZ, YY, YZ, ZZ, N
from fwclass.features.params import NORMAL, FeaturesParams
from fwclass.features.spheres import optimal, spheres
from fwclass.grid import TileGrid, millimetres
from fwclass.schema import Scale, Table
from fwclass.stage import Chunk

PARAMS = FeaturesParams(**BASE["features"])
PERCENTILES = (5, 10, 25, 50, 75, 90, 95)


def bases(kind):
    return tuple(f.name for f in FEATURES if kind in f.scales and f.name != "oriented_inclination")


ASKED = {
    Scale("r", 40): bases("r"),
    Scale("r", 100): bases("r"),
    Scale("c", 150): bases("c"),
    Scale("c", 250): bases("c"),
}


def cloud_of(points, seed=5):
    rng = np.random.default_rng(seed)
    n = len(points)
    of = rng.integers(1, 5, n)
    width = rng.uniform(3, 7, n)
    width[rng.random(n) < 0.3] = np.nan
    columns = dict(zip("xyz", (points + np.array([500_000.0, 5_400_000.0, 300.0])).T, strict=True))
    return Table(
        columns
        | {
            "number_of_echoes": of,
            "echo_number": np.minimum(rng.integers(1, 5, n), of),
            "amplitude": rng.uniform(5, 4000, n),
            "width": width,
            "intensity": rng.integers(0, 65536, n),
        }
    )


def chunk_of(table, core=None):
    return Chunk(table, np.arange(table.rows) if core is None else core, TileGrid(1000.0).tile("0_0"))


def neighbours(table, scale):
    places = np.stack([millimetres(table[v]) for v in "xyz"], axis=1).astype(float)
    places = places[:, :2] if scale.kind == "c" else places
    return cKDTree(places).query_ball_point(places, scale.size * 10.0)


def heights(z):
    """Measures of heights relative to the echo [mm]."""
    flat, off = np.ptp(z) == 0, z - z.mean()
    second = (off**2).mean()
    made = {
        "count": len(z),
        "height_range": np.ptp(z) / 1e3,
        "height_std": z.std() / 1e3,
        "height_variance": z.var() / 1e6,
        "height_skewness": 0.0 if flat else (off**3).mean() / second**1.5,
        "height_kurtosis": 0.0 if flat else (off**4).mean() / second**2,
        "height_above_mean": -z.mean() / 1e3,
        "height_above_lowest": -z.min() / 1e3,
        "height_below_highest": z.max() / 1e3,
    }
    ranks = np.percentile(z, PERCENTILES, method="inverted_cdf")
    return made | {f"height_above_p{p:02d}": -v / 1e3 for p, v in zip(PERCENTILES, ranks, strict=True)}


def echoes(table, near):
    of, number = table["number_of_echoes"][near].astype(int), table["echo_number"][near].astype(int)
    single, first = np.mean(of == 1), np.mean((of > 1) & (number == 1))
    last = np.mean((of > 1) & (number == of))
    between = 1.0 - single - first - last
    made = {"single_share": single, "first_share": first, "intermediate_share": between, "last_share": last}
    made |= {"egi": single + last, "ebi": single + first, "evi": first + between}
    for name in ("amplitude", "width", "intensity"):
        seen = table[name][near].astype(float)
        seen = seen[~np.isnan(seen)]
        made[f"{name}_mean"] = seen.mean() if len(seen) else np.nan
        made[f"{name}_std"] = seen.std() if len(seen) else np.nan
    return made


def shape(places):
    """Measures of shape and the normal from places relative to the echo [mm]; what has no value is left out."""
    l, v = np.linalg.eigh(np.cov(places.T, bias=True))
    l3, l2, l1 = np.maximum(l, 0.0)
    if len(places) < 3 or (np.ptp(places, axis=0) == 0).all():
        return {}
    s = np.array([l1, l2, l3]) / (l1 + l2 + l3)
    some = s[s > 1e-15]
    made = {
        "eigenvalue_1": s[0],
        "eigenvalue_2": s[1],
        "eigenvalue_3": s[2],
        "surface_variation": s[2],
        "eigenvalue_sum": (l1 + l2 + l3) / 1e6,
        "linearity": (l1 - l2) / l1,
        "planarity": (l2 - l3) / l1,
        "sphericity": l3 / l1,
        "anisotropy": (l1 - l3) / l1,
        "omnivariance": np.cbrt(l1 * l2 * l3) / 1e6,
        "eigenentropy": -np.sum(some * np.log(some)),
        "plane_std": np.sqrt(l3) / 1e3,
    }
    if l2 > LINE * l1 and l2 - l3 > TIE * l1:
        up = v[:, 0] * (np.sign(v[2, 0]) or 1.0)
        along = places @ up
        made |= {
            "verticality": 1.0 - abs(up[2]),
            "inclination": np.degrees(np.arccos(min(1.0, up[2]))),
            "roughness": abs(along.mean()) / 1e3,
            "plane_range": np.ptp(along) / 1e3,
        }
        made |= dict(zip(NORMAL, up, strict=True))
    return made


def reference(table, near, i, scale):
    """Measures of one neighbourhood; those without a value are missing."""
    places = np.stack([millimetres(table[v])[near] - millimetres(table[v])[i] for v in "xyz"], axis=1).astype(float)
    made = heights(places[:, 2]) | echoes(table, near)
    return made | (shape(places) if scale.kind == "r" else {"density": len(near) / (np.pi * scale.metres**2)})


TOLERANCE = {"inclination": 2e-3, "plane_range": 3e-5, "plane_std": 2e-6, "roughness": 2e-6, "omnivariance": 1e-5}
"""Absolute; float32's step elsewhere. The angle of a near-vertical normal is a square root of it,
the omnivariance of a plane a cube root of float64's; places along the
normal are taken in 1/128 mm."""


def check(table, got, scale, sets, suffix):
    expected = [reference(table, np.array(near), i, scale) for i, near in enumerate(sets)]
    for base in bases(scale.kind if suffix != "_opt" else "o"):
        if base == "echo_ratio":
            continue
        want = [one.get(base, np.nan) for one in expected]
        # amplitude and width are taken in steps of 1/1024
        loose = ATTRIBUTE_STEP if base[:5] in ("ampli", "width") else TOLERANCE.get(base, 2e-6)
        np.testing.assert_allclose(got[base + suffix], want, rtol=FEATURE_RTOL, atol=loose, err_msg=base + suffix)


def random_cloud(rng, n):
    return rng.uniform(0, 4, (n, 3)).round(3)


def sloping_ground(rng, n):
    xy = rng.uniform(0, 5, (n, 2)).round(3)
    return np.column_stack([xy, (0.3 * xy[:, 0] - 0.2 * xy[:, 1] + rng.normal(0, 0.02, n)).round(3)])


def wall(rng, n):
    return np.column_stack([rng.uniform(0, 5, n).round(3), np.full(n, 2.5), rng.uniform(0, 5, n).round(3)])


def exact_line(rng, n):
    t = rng.integers(0, 3000, n) / 1000.0
    return np.column_stack([t, 2.0 * t, t])


def places_taken_twice(rng, n):
    return np.repeat(random_cloud(rng, n // 2), 2, axis=0)


def few_and_alone(rng, n):
    """Neighbourhoods of one, two and three echoes, some of them at one place."""
    return np.array(
        [
            [0, 0, 0],
            [9, 0, 0],
            [9.2, 0, 0],
            [20, 0, 0],
            [20, 0, 0],
            [20, 0, 0],
            [30, 0, 0],
            [30.1, 0, 0.2],
            [30, 0.2, 0],
        ]
    )


def towers(rng, n):
    """Heights far apart in one cylinder: the fourth powers pass the bound of exact sums."""
    return np.column_stack(
        [rng.uniform(0, 3, (n, 2)).round(3), rng.choice([0.0, 150.0, 3000.0], n) + rng.normal(0, 1, n).round(3)]
    )


CLOUDS = (random_cloud, sloping_ground, wall, exact_line, places_taken_twice, few_and_alone, towers)


@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda f: f.__name__)
def test_every_measure_agrees_with_numpy_and_scipy(cloud):
    table = cloud_of(cloud(np.random.default_rng(17), 100))
    got = spheres(chunk_of(table), ASKED, PARAMS)
    for scale in ASKED:
        sets = neighbours(table, scale)
        check(table, got, scale, sets, f"_{scale.suffix}")
        if scale.kind == "r":
            flat = neighbours(table, Scale("c", scale.size))
            ratio = [len(s) / len(c) for s, c in zip(sets, flat, strict=True)]
            np.testing.assert_allclose(got[f"echo_ratio_{scale.suffix}"], ratio, rtol=FLOAT32_RTOL)
    normals = np.stack([got[name] for name in NORMAL], axis=1)
    for i, near in enumerate(neighbours(table, Scale("r", round(PARAMS.normal_radius * 100)))):
        want = reference(table, np.array(near), i, Scale("r", 100))
        want = np.array([want.get(name, np.nan) for name in NORMAL])
        sign = 1.0 if not abs(want[2]) < 1e-6 else np.sign(np.dot(want, normals[i]))  # a level normal's sign is a toss
        np.testing.assert_allclose(normals[i], want * sign, atol=2e-5)


@pytest.mark.parametrize("cloud", (random_cloud, sloping_ground, exact_line, few_and_alone), ids=lambda f: f.__name__)
def test_the_optimal_sphere_is_that_of_lowest_eigenentropy(cloud):
    table = cloud_of(cloud(np.random.default_rng(19), 80))
    got = optimal(chunk_of(table), bases("o"), True, PARAMS)
    radii = PARAMS.optimal_radii
    entropy = np.full((len(radii), table.rows), np.inf)
    every = [neighbours(table, Scale("r", round(radius * 100))) for radius in radii]
    for q, sets in enumerate(every):
        for i, near in enumerate(sets):
            entropy[q, i] = reference(table, np.array(near), i, Scale("r", 1)).get("eigenentropy", np.inf)
    for i in range(table.rows):
        if np.isinf(entropy[:, i]).all():
            assert np.isnan(got["optimal_radius"][i])
            assert np.isnan([got[f"{base}_opt"][i] for base in bases("o")]).all()
            continue
        q = int(np.argmin(np.abs(np.array(radii) - got["optimal_radius"][i])))
        assert entropy[q, i] <= entropy[:, i].min() + 1e-7
    if cloud is random_cloud:
        q = np.argmin(np.abs(np.array(radii)[:, None] - got["optimal_radius"]), axis=0)
        seen = np.flatnonzero(~np.isnan(got["optimal_radius"]))
        part = table.take(np.arange(table.rows))
        for i in seen:
            want = reference(part, np.array(every[q[i]][i]), i, Scale("r", 1))
            for base in ("count", "linearity", "height_std", "plane_range", "egi", "width_mean"):
                np.testing.assert_allclose(
                    got[f"{base}_opt"][i], want[base], rtol=FEATURE_RTOL, atol=1e-3, err_msg=base
                )


PLACES = st.lists(st.tuples(*[st.integers(0, 24)] * 3), min_size=1, max_size=60)


@pytest.mark.statistics
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(PLACES, st.sampled_from([1, 137, 250]), st.integers(0, 3))
def test_neighbour_sets_are_those_of_a_kd_tree(places, step, seed):
    """Lattices, so that many echoes are at one place or at exactly the radius."""
    points = np.array(places, float) * step / 1000.0
    table = cloud_of(points + np.array([-1.0, 3.0, 0.0]) * seed)
    asked = {Scale(kind, size): ("count",) for kind in "rc" for size in (25, 50, 100, 125, 500)}
    core = np.random.default_rng(seed).permutation(len(points))[: 1 + len(points) // 2]
    got = spheres(chunk_of(table, core), asked, PARAMS)
    for scale in asked:
        sets = neighbours(table, scale)
        np.testing.assert_array_equal(got[f"count_{scale.suffix}"], [len(sets[i]) for i in core], err_msg=str(scale))


def test_no_bit_depends_on_order_halo_or_the_other_radii():
    rng = np.random.default_rng(23)
    table = cloud_of(np.column_stack([rng.uniform(0, 30, (3000, 2)), rng.uniform(0, 6, 3000)]).round(3))
    one = spheres(chunk_of(table), ASKED, PARAMS)
    mixed = rng.permutation(table.rows)
    other = spheres(chunk_of(table.take(mixed)), ASKED, PARAMS)
    x = table["x"] - table["x"].min()
    inside = np.flatnonzero((x > 10.0) & (x < 17.3))
    near = np.flatnonzero((x > 10.0 - 2.5) & (x < 17.3 + 2.5))
    part = spheres(chunk_of(table.take(near), np.searchsorted(near, inside)), ASKED, PARAMS)
    for name in one:
        np.testing.assert_array_equal(other[name], one[name][mixed], err_msg=name)
        np.testing.assert_array_equal(part[name], one[name][inside], err_msg=name)
    for scale in ASKED:
        alone = spheres(chunk_of(table), {scale: ASKED[scale]}, PARAMS)
        for base in ASKED[scale]:
            np.testing.assert_array_equal(alone[f"{base}_{scale.suffix}"], one[f"{base}_{scale.suffix}"])


@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda f: f.__name__)
def test_no_bit_depends_on_the_way_sums_are_taken(cloud):
    """A radius whose neighbours nothing needs again is summed straight from the candidates, others are not."""
    places = cloud(np.random.default_rng(29), 300)
    table = cloud_of(np.concatenate([places + np.array([0.0, 9.0 * k, 0.0]) for k in range(3)]))
    twice = {"plane_range"} | {f"height_above_p{p:02d}" for p in PERCENTILES}
    others = spheres(chunk_of(table), ASKED, PARAMS)
    once = {scale: tuple(b for b in names if b not in twice) for scale, names in ASKED.items()}
    assert all(len(once[scale]) < len(ASKED[scale]) for scale in ASKED)
    for asked in (once, *({scale: names} for scale, names in once.items())):
        got = spheres(chunk_of(table), asked, PARAMS)
        for scale in asked:
            for base in asked[scale]:
                name = f"{base}_{scale.suffix}"
                np.testing.assert_array_equal(got[name], others[name], err_msg=name)


def test_no_core_rows_give_empty_columns():
    table = cloud_of(random_cloud(np.random.default_rng(3), 20))
    for chunk in (chunk_of(table, np.empty(0, np.int64)), chunk_of(table.take(np.empty(0, np.int64)))):
        assert {len(v) for v in spheres(chunk, ASKED, PARAMS).values()} == {0}


@pytest.mark.parametrize(
    "spectrum", [(3, 2, 1), (1, 1, 1), (1, 1, 0), (1, 0, 0), (1, 1, 1e-9), (1, 1e-9, 1e-9), (1e6, 1, 1e-3)]
)
def test_eigenvalues_agree_with_numpy_for_spectra_of_every_kind(spectrum):
    rng = np.random.default_rng(31)
    moments, out = np.zeros((MOMENTS, 30)), np.empty((6, 30))
    turns = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(30)]
    for k, turn in enumerate(turns):
        m = 100.0 * turn @ np.diag(spectrum).astype(float) @ turn.T  # of 100 echoes about their mean
        moments[N, k] = 100.0
        moments[[XX, XY, XZ, YY, YZ, ZZ], k] = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    shapes(moments, out)
    np.testing.assert_allclose(out[:3].T, np.tile(spectrum, (30, 1)), atol=3e-8 * spectrum[0])
    assert (out[0] >= out[1]).all() and (out[1] >= out[2]).all() and (out[2] >= 0).all()
    if spectrum[1] > 1e-5 * spectrum[0] and spectrum[1] - spectrum[2] > 1e-3 * spectrum[1]:
        for k, turn in enumerate(turns):
            assert abs(np.dot(out[3:, k], turn[:, 2])) == pytest.approx(1.0, abs=1e-9)
            assert out[5, k] >= 0
