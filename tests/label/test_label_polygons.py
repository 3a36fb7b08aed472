"""Polygon labels: exact on edges, one owner for touching polygons, the same for any cut and order."""

import time
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.errors import InputError
from fwclass.formats.wkb import shapes
from fwclass.graph import label
from fwclass.graph.stage_work import StageInputs
from fwclass.grid import Box, Tile
from fwclass.label import polygons as room
from fwclass.label.polygons import AMBIGUOUS, NONE, WIDEST, Polygons, from_polygons, owners
from fwclass.schema import Table
from fwclass.stage import Chunk
from fwclass.waveforms import IMPLAUSIBLE


def polygons(geometries, codes, groups=None):
    codes = np.asarray(codes, np.int16)
    found = shapes([shapely.to_wkb(g) for g in geometries], "test")
    return Polygons.of(found, codes, codes if groups is None else np.asarray(groups, np.int16), "test")


def labels(points, made):
    x, y = np.asarray(points, float).T
    chunk = Chunk(Table({"x": x, "y": y}), np.arange(len(x)), Tile(0, 0, 100.0))
    table, ambiguous = from_polygons(chunk, made)
    return table["reference"].tolist(), ambiguous


def test_an_edge_belongs_to_the_polygon_east_or_north_of_it():
    made = polygons([shapely.box(0, 0, 10, 10)], [6])
    on = [(0, 5), (5, 0), (0, 0), (10, 5), (5, 10), (10, 10), (0, 10), (10, 0), (9.999, 9.999)]
    assert labels(on, made)[0] == [6, 6, 6, 0, 0, 0, 0, 0, 6]


def test_a_hole_is_no_part_and_an_island_in_it_is_another():
    holed = shapely.Polygon([(0, 0), (30, 0), (30, 30), (0, 30)], [[(10, 10), (20, 10), (20, 20), (10, 20)]])
    made = polygons([holed, shapely.box(10, 10, 20, 20)], [2, 9])
    at = [(5, 5), (15, 15), (10, 15), (20, 15), (15, 10), (15, 20)]
    assert labels(at, made) == ([2, 9, 9, 2, 9, 2], 0)


def test_different_classes_are_no_label_and_counted_codes_of_one_class_are_not():
    boxes = [shapely.box(0, 0, 10, 10), shapely.box(5, 0, 15, 10)]
    at = [(2, 5), (7, 5), (12, 5)]
    assert labels(at, polygons(boxes, [2, 6])) == ([2, 0, 6], 1)
    assert labels(at, polygons(boxes, [5, 3], groups=[1, 1])) == ([5, 3, 3], 0)
    assert labels(at, polygons([*boxes, boxes[0]], [2, 6, 2])) == ([2, 0, 6], 1)


def test_a_feature_without_code_labels_nothing_and_hides_nothing():
    made = polygons([shapely.box(0, 0, 10, 10), shapely.box(0, 0, 5, 5)], [2, -1])
    assert labels([(2, 2), (7, 7)], made) == ([2, 2], 0)


@pytest.mark.parametrize("seed", range(4))
def test_a_tessellation_gives_every_point_exactly_one_owner(seed):
    """Whole metres, exact in floats too; points on the corners and on edges: none is owned twice, none is lost."""
    r = np.random.default_rng(seed)
    corners = np.unique(r.integers(0, 400, (60, 2)), axis=0)
    cells = shapely.get_parts(shapely.delaunay_triangles(shapely.multipoints(corners)))
    made = polygons(cells, np.full(len(cells), 2), groups=np.arange(len(cells)))
    whole = shapely.union_all(cells)
    x, y = (v.ravel() for v in np.meshgrid(np.arange(400), np.arange(400)))
    _, group = owners(1000 * x, 1000 * y, made)
    inside = shapely.contains_xy(whole, x, y)
    assert (group != AMBIGUOUS).all()
    assert (group[inside] >= 0).all()
    outside = ~shapely.intersects_xy(whole, x, y)
    assert (group[outside] == NONE).all()


def even_odd(px, py, made, part):
    """The rule in fractions: crossings east of the point."""
    odd = False
    for r in range(made.part_start[part], made.part_start[part + 1]):
        for k in range(made.ring_start[r], made.ring_start[r + 1] - 1):
            (x1, y1), (x2, y2) = ((int(made.x[i]), int(made.y[i])) for i in (k, k + 1))
            if (y1 > py) != (y2 > py) and x1 + Fraction((x2 - x1) * (py - y1), y2 - y1) > px:
                odd = not odd
    return odd


coordinate = st.integers(0, 40)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=7), min_size=1, max_size=4),
    st.sampled_from([(0, 0), (699_000_000, 6_200_000_000), (-512_345_678, -5_400_000_001)]),
    st.sampled_from([1, 137, 90_001]),
)
def test_any_rings_are_what_fractions_say(rings, origin, unit):
    """Also rings that cross themselves, far from the origin and hundreds of kilometres wide."""
    closed = [np.array([*ring, ring[0]], np.int64) * unit + origin for ring in rings]
    lengths = np.cumsum([0, *map(len, closed)])
    points = np.concatenate(closed)
    n = len(rings)
    made = Polygons(
        points[:, 0].copy(),
        points[:, 1].copy(),
        lengths,
        np.arange(n + 1),
        np.full(n, 2, np.uint8),
        np.arange(n).astype(np.int16),
    )
    at = np.array([(x, y) for x in range(0, 41, 4) for y in range(0, 41, 4)], np.int64) * unit + origin
    at = np.concatenate([at, points[:20]])
    _, group = owners(at[:, 0].copy(), at[:, 1].copy(), made)
    for (px, py), got in zip(at.tolist(), group.tolist(), strict=True):
        own = [p for p in range(n) if even_odd(px, py, made, p)]
        assert got == (NONE if not own else own[0] if len(own) == 1 else AMBIGUOUS)


def scattered(n=300, seed=5):
    r = np.random.default_rng(seed)
    at = shapely.points(r.uniform(0, 200, (n, 2)))
    return shapely.buffer(at, r.uniform(1, 15, n), quad_segs=4), r.integers(2, 7, n)


def test_a_library_says_the_same_away_from_edges():
    geometries, codes = scattered()
    made = polygons(geometries, codes)
    r = np.random.default_rng(1)
    x, y = np.round(r.uniform(-5, 205, (2, 20_000)), 3)
    code, group = owners(np.rint(x * 1000).astype(np.int64), np.rint(y * 1000).astype(np.int64), made)
    edges = shapely.STRtree(shapely.boundary(geometries))
    near = np.zeros(len(x), bool)
    near[edges.query(shapely.points(x, y), predicate="dwithin", distance=0.002)[0]] = True
    rows, which = shapely.STRtree(geometries).query(shapely.points(x, y), predicate="within")
    seen = [set(codes[which[a:b]].tolist()) for a, b in _runs(rows, len(x))]
    for i in np.flatnonzero(~near):
        expected = NONE if not seen[i] else seen[i].pop() if len(seen[i]) == 1 else AMBIGUOUS
        assert group[i] == expected
        assert expected < 0 or code[i] == expected
    assert (~near).mean() > 0.9 and (group == AMBIGUOUS).any() and (group == NONE).any()


def _runs(rows, n):
    order = np.sort(rows)
    return zip(np.searchsorted(order, np.arange(n)), np.searchsorted(order, np.arange(n), "right"), strict=True)


@pytest.mark.parametrize("edge", [7, 25, 110])
def test_tiles_and_the_order_of_polygons_change_nothing(edge):
    geometries, codes = scattered()
    made = polygons(geometries, codes)
    r = np.random.default_rng(2)
    x, y = r.integers(0, 200_000, (2, 30_000))
    x[:500] = x[:500] // 1000 * 1000
    whole = owners(x, y, made)
    turned = made.take(np.arange(made.parts)[::-1])
    np.testing.assert_array_equal(owners(x, y, turned)[1], whole[1])
    for tile in np.unique(x // (1000 * edge)):
        for other in np.unique(y // (1000 * edge)):
            mine = (x // (1000 * edge) == tile) & (y // (1000 * edge) == other)
            box = Box(tile * edge, other * edge, (tile + 1) * edge, (other + 1) * edge)
            code, group = owners(x[mine], y[mine], made.within(box))
            np.testing.assert_array_equal(group, whole[1][mine])
            np.testing.assert_array_equal(code, whole[0][mine])


def test_parts_can_be_taken_joined_and_stored():
    geometries, codes = scattered(20)
    made = polygons([*geometries, shapely.box(0, 0, 1, 1)], [*codes, 2])
    halves = [made.take(np.arange(8)), made.take(np.arange(8, made.parts))]
    joined = Polygons.from_arrays(Polygons.joined(halves).arrays())
    for name, array in made.arrays().items():
        np.testing.assert_array_equal(array, getattr(joined, name))
    nothing = made.take(np.zeros(made.parts, bool))
    assert nothing.parts == 0 and Polygons.joined([nothing, nothing]).parts == 0
    assert owners(np.array([5]), np.array([5]), nothing)[1].tolist() == [NONE]
    assert owners(np.zeros(0, np.int64), np.zeros(0, np.int64), made)[0].tolist() == []


def test_a_polygon_as_wide_as_a_continent_is_refused():
    wide = WIDEST / 1000 + 10
    with pytest.raises(InputError, match="too large") as fault:
        polygons([shapely.box(0, 0, wide, 10)], [2])
    assert "coordinate system of the polygons" in str(fault.value)


def test_implausible_echoes_have_no_label_whatever_polygon_is_above(tmp_path, monkeypatch):
    table = Table({"x": [1.0, 1.0], "y": [1.0, 1.0], "fit_flags": np.array([0, IMPLAUSIBLE], np.uint8)})
    chunk = Chunk(table, np.arange(2), Tile(0, 0, 100.0))
    monkeypatch.setattr(label, "from_polygons", lambda *_: (Table({"reference": [6, 6]}), 0))
    monkeypatch.setattr(label, "polygons_at", lambda *_: SimpleNamespace(within=lambda box: None))
    inputs = SimpleNamespace(chunk=lambda tile, halo, columns, present: chunk)
    table, facts = label.label_by_polygons(StageInputs(inputs, tmp_path, chunk.tile.key, square=chunk.tile))
    assert table["reference"].tolist() == [6, 0] and facts == {"codes": {"0": 1, "6": 1}, "ambiguous": 0}


@pytest.mark.parametrize("far", [1e300, 1e16])
def test_a_polygon_that_whole_millimetres_do_not_hold_is_refused(far):
    """All of its corners became one number, and what it held had no label: nobody was told."""
    square = shapely.box(-far, -far, far, far)
    one = np.zeros(1, np.int16)
    with pytest.raises(InputError, match="nowhere on Earth"):
        Polygons.of(shapes([shapely.to_wkb(square)], "a.gpkg"), one, one, "a.gpkg")


def zigzag(teeth, height):
    """One polygon of edges side by side [mm], as wide as high."""
    x = np.linspace(0, height, teeth).astype(np.int64)
    y = np.where(np.arange(teeth) % 2, height, 0).astype(np.int64)
    x, y = np.concatenate([x, [height, 0, 0]]), np.concatenate([y, [2 * height, 2 * height, 0]])
    one = np.zeros(1, np.int16)
    return Polygons(x, y, np.array([0, len(x)]), np.array([0, 1]), np.array([2], np.uint8), one)


@pytest.mark.parametrize(("teeth", "height", "points"), [(200_000, 100_000, 200_000), (60_000, 1_000_000, 1000)])
def test_edges_side_by_side_beside_many_points_are_refused_before_any_is_tried(teeth, height, points):
    """200,000 edges and as many echoes took some two minutes of the processor, ten times the echoes ten times that."""
    x, y = np.random.default_rng(1).integers(0, height, (2, points))
    owners(x[:3], y[:3], zigzag(10, height))  # compiled
    began = time.process_time()
    with pytest.raises(InputError, match="too many edges side by side"):
        owners(x, y, zigzag(teeth, height))
    assert time.process_time() - began < 5


def test_counting_edges_beforehand_changes_no_answer(monkeypatch):
    x, y = np.random.default_rng(2).integers(0, 100_000, (2, 5000))
    one = zigzag(100, 100_000)
    known = owners(x, y, one)
    for most in (103 * 5000, 103 * 5000 - 1):  # the first passes without counting
        monkeypatch.setattr("fwclass.label.polygons.MOST_TESTS", most)
        for answer, other in zip(known, owners(x, y, one), strict=True):
            np.testing.assert_array_equal(answer, other)
    for tests in (0, 1, 7_001):  # in slices
        monkeypatch.setattr("fwclass.label.polygons.TESTS", tests)
        for answer, other in zip(known, owners(x, y, one), strict=True):
            np.testing.assert_array_equal(answer, other)
    monkeypatch.setattr("fwclass.label.polygons.MOST_TESTS", 100_000)
    with pytest.raises(InputError, match="side by side"):
        owners(x, y, one)


def test_answers_in_slices_are_those_of_many_polygons_at_once(monkeypatch):
    """Polygons that overlap, side by side and far away, with holes and none, cut anywhere."""
    rng = np.random.default_rng(3)
    discs = [shapely.Point(*rng.uniform(0, 40, 2)).buffer(r) for r in rng.uniform(0.5, 9, 40)]
    discs += [d.difference(d.centroid.buffer(0.3)) for d in discs[:9]] + [shapely.box(900, 900, 901, 901)]
    found = shapes(list(shapely.to_wkb(np.array(discs))), "a.gpkg")
    code = (np.arange(len(discs)) % 3 + 2).astype(np.int16)
    several = Polygons.of(found, code, code, "a.gpkg")
    x, y = rng.integers(0, 40_000, (2, 2000))
    known = owners(x, y, several)
    assert set(known[1].tolist()) > {NONE, AMBIGUOUS}
    for tests in (0, 13, 997, 100_000):
        monkeypatch.setattr("fwclass.label.polygons.TESTS", tests)
        for answer, other in zip(known, owners(x, y, several), strict=True):
            np.testing.assert_array_equal(answer, other)


@pytest.mark.statistics
def test_ctrl_c_is_heeded_while_polygons_are_tried(monkeypatch):
    """Two minutes of the processor went by in one piece."""
    x, y = np.random.default_rng(1).integers(0, 100_000, (2, 6000))
    pieces, tried = [], room._mark

    def timed(*given):
        began = time.process_time()
        made = tried(*given)
        pieces.append(time.process_time() - began)
        return made

    owners(x[:3], y[:3], zigzag(10, 100_000))  # compiled
    monkeypatch.setattr(room, "_mark", timed)
    owners(x, y, zigzag(35_000, 100_000))
    assert len(pieces) > 1 and max(pieces) < 3, pieces
