"""Trees of crowns with known tops: each found once, with its height and its ground, whatever the windows."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
import shapely

from fwclass import conf
from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.vectors.cells import Passage, count_cells, count_passage
from fwclass.vectors.shapes import Shapes
from fwclass.vectors.trees import _smoothed, bulge, canopy, depth, round_crowns, tops, tops_beside, trees, without_pits

CELL = 0.5
TREES = np.array([[12.2, 14.1, 9.0, 3.0], [17.9, 13.2, 12.0, 3.5], [31.4, 31.8, 15.0, 5.0], [50.0, 20.0, 6.0, 2.0]])
"""x, y, height, radius of the crown [m]."""


def params(**changed):
    return conf.section("vectors", tuple(f"vectors.trees.{k}={v}" for k, v in changed.items())).trees


def echoes(some=TREES, seed=0, density=8.0) -> Table:
    """Echoes of ellipsoids over flat ground, 64 m square."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 64, (2, int(density * 64**2)))
    height = np.zeros(len(x))
    for tx, ty, tall, reach in some:
        share = np.hypot(x - tx, y - ty) / reach
        inside = np.sqrt(np.clip(1 - share**2, 0, None))
        height = np.maximum(height, np.where(share < 1, tall * (0.5 + 0.5 * inside), 0.0))
    return Table(
        {
            "x": x,
            "y": y,
            "height_above_ground": height,
            "classification": np.where(height > 0, 5, 2),
            "confidence": np.full(len(x), 0.75),
        }
    )


def leafy(table: Table, depth: float, seed=1) -> Table:
    """The same echoes from leaves at an exponential depth below the outside of the crown, of `depth` [m] on average."""
    inside = np.random.default_rng(seed).exponential(depth, table.rows)
    height = table["height_above_ground"]
    return table.with_columns({"height_above_ground": np.where(height > 0, np.maximum(height - inside, 0.1), 0.0)})


def passage(table: Table, window: Window, settings, last=None) -> Passage:
    """Every echo is a pulse of its own, unless it is said which are the `last`."""
    last = np.ones(table.rows, bool) if last is None else last
    return count_passage(table, last, window, settings.codes, settings.clear)


def found(table: Table, edge: int = 128, settings=None, last=None) -> Shapes:
    """The trees of windows of `edge` cells, each read with its halo."""
    settings = settings or params()
    halo, parts = int(np.ceil(settings.halo(CELL) / CELL)), []
    for row in range(0, 128, edge):
        for col in range(0, 128, edge):
            core = Window(CELL, col, row, edge, edge)
            wide = core.grown(halo)
            counts = count_cells(table, wide, settings.codes, 0.0)
            parts.append(trees(table, counts, passage(table, wide, settings, last), wide, core, settings))
    made = Shapes.together(parts)
    return made.ordered(np.lexsort((made.rows["x"], made.rows["y"])))


def test_every_tree_is_found_with_its_height_and_its_crown():
    made = found(echoes())
    assert made.rows.rows == len(TREES)
    for tx, ty, tall, reach in TREES:
        k = int(np.argmin(np.hypot(made.rows["x"] - tx, made.rows["y"] - ty)))
        assert np.hypot(made.rows["x"][k] - tx, made.rows["y"][k] - ty) < 1.2
        assert made.rows["object_height"][k] == pytest.approx(tall, abs=0.3)
        crown = shapely.Polygon(made.polygons()[k][0])
        assert crown.is_valid and crown.contains(shapely.Point(made.rows["x"][k], made.rows["y"][k]))
        assert 0.5 < crown.area / (np.pi * reach**2) < 1.3
    assert made.rows["confidence"] == pytest.approx(0.75)


@pytest.mark.parametrize("edge", [32, 64])
def test_windows_change_no_tree(edge):
    one, other = found(echoes()), found(echoes(), edge)
    assert all((one.rows[n] == other.rows[n]).all() for n in one.rows)
    assert all((one.corners[n] == other.corners[n]).all() for n in one.corners)


@pytest.mark.statistics
def test_windows_change_no_tree_beside_another():
    table, last = through_both(beside_each_other(1.1))
    one, other = found(table, last=last), found(table, 16, last=last)
    assert one.rows.rows == 2
    assert all((one.rows[n] == other.rows[n]).all() for n in one.rows)
    assert all((one.corners[n] == other.corners[n]).all() for n in one.corners)


def test_crowns_of_neighbours_share_their_border_alone():
    made = found(echoes())
    one, other = (shapely.Polygon(made.polygons()[k][0]) for k in (0, 1))
    assert one.intersection(other).area < 0.1 * min(one.area, other.area)


def test_what_is_no_tree_is_none():
    low = TREES * [1, 1, 0.2, 1]
    assert found(echoes(low)).rows.rows == 0
    assert found(echoes(TREES[:0])).rows.rows == 0
    one = echoes()
    assert found(one.take(np.flatnonzero(one["height_above_ground"] > 5)[:1])).rows.rows == 0
    assert found(one.take(np.zeros(0, int))).rows.rows == 0
    nan = one.with_columns({"height_above_ground": np.full(one.rows, np.nan)})
    assert found(nan).rows.rows == 0


def test_the_height_is_of_the_highest_echo_within_a_metre_of_the_top():
    """It was of a square of cells: of an echo up to 1.77 m away, as a taller neighbour's."""
    beside = np.array(
        [[30.0, 30.0, 14.0, 4.5], [35.5, 32.0, 9.0, 3.0], [12.0, 40.0, 8.0, 2.5], [13.9, 43.5, 13.0, 2.5]]
    )
    table = leafy(echoes(beside), 0.5)
    made, high = found(table), np.flatnonzero(table["classification"] == 5)
    assert made.rows.rows >= 4
    away = np.hypot(*(table[n][high] - made.rows[n][:, None] for n in "xy"))
    for reach, same in ((1.0, True), (1.25 * np.sqrt(2), False)):
        heights = np.where(away <= reach, table["height_above_ground"][high], 0.0).max(axis=1)
        assert np.allclose(heights, made.rows["object_height"], atol=1e-4) == same


def test_no_crown_is_smaller_than_is_said():
    for least in (1.0, 3.0, 30.0):
        made = found(leafy(echoes(), 0.8), settings=params(least_area=least))
        assert (made.rows["object_area"] >= least).all() and (made.rows["object_echoes"] >= 2).all()
        assert [shapely.Polygon(p[0]).area for p in made.polygons()] == pytest.approx(made.rows["object_area"].tolist())


def test_the_order_of_the_echoes_changes_nothing():
    table = echoes()
    turned = table.take(np.random.default_rng(1).permutation(table.rows))
    one, other = found(table), found(turned)
    assert all((one.corners[n] == other.corners[n]).all() for n in one.corners)


def test_leaves_below_the_outside_of_a_crown_make_no_tops():
    big = np.array([[15.0, 15.0, 12.0, 4.5], [45.0, 18.0, 14.0, 5.0], [20.0, 45.0, 10.0, 4.0], [48.0, 46.0, 16.0, 5.5]])
    made = found(leafy(echoes(big, density=4.0), 0.8))
    assert made.rows.rows == len(big)
    for tx, ty, tall, _ in big:
        k = int(np.argmin(np.hypot(made.rows["x"] - tx, made.rows["y"] - ty)))
        assert np.hypot(made.rows["x"][k] - tx, made.rows["y"][k] - ty) < 1.5
        assert made.rows["object_height"][k] == pytest.approx(tall, abs=1.0)


def test_a_tree_on_the_shoulder_of_a_taller_one_is_found():
    """The surface between them is hardly lower: that it bends tells the smaller one."""
    pair = np.array([[30.0, 30.0, 14.0, 4.5], [34.7, 30.0, 10.0, 3.5]])
    along = np.linspace(30.0, 34.7, 100)
    share = np.abs(along[:, None] - pair[:, 0]) / pair[:, 3]
    outside = pair[:, 2] * (0.5 + 0.5 * np.sqrt(np.clip(1 - share**2, 0, None)))
    assert np.where(share < 1, outside, 0.0).max(axis=1).min() > 0.98 * pair[1, 2]
    made = found(echoes(pair))
    near = np.hypot(made.rows["x"][:, None] - pair[:, 0], made.rows["y"][:, None] - pair[:, 1])
    assert made.rows.rows == 2 and (near.min(axis=0) < 2.0).all()


def beside_each_other(turn: float) -> np.ndarray:
    """A tree that grew into a taller one: the two bulge as one."""
    return np.array([[30.0, 30.0, 14.0, 4.5], [30.0 + 3.5 * np.cos(turn), 30.0 + 3.5 * np.sin(turn), 11.0, 3.0]])


def through_both(pair: np.ndarray) -> tuple[Table, np.ndarray]:
    """Echoes of pulses that end in the lower one of two crowns where they stand over each other; which are the last."""
    upper, parts = echoes(pair), [echoes(pair[k : k + 1]) for k in (0, 1)]
    lower = np.minimum(parts[0]["height_above_ground"], parts[1]["height_above_ground"])
    under = np.flatnonzero(lower > 0)
    second = upper.take(under).with_columns({"height_above_ground": lower[under]})
    return Table.concat([upper, second]), np.r_[~(lower > 0), np.ones(len(under), bool)]


@pytest.mark.parametrize("turn", [0.0, 1.1, 2.5])
def test_a_tree_that_grew_into_a_taller_one_is_told_by_the_depth_of_both(turn):
    """The surface sticks out of a round crown; that pulses meet two crowns there makes that a tree."""
    pair, window, settings = beside_each_other(turn), Window(CELL, 0, 0, 128, 128), params()
    both, last = through_both(pair)
    surface = canopy(count_cells(both, window, settings.codes, 0.0), CELL, settings)
    highest = tops(surface, CELL, settings)
    assert len(highest) == 1
    deep = count_passage(both, last, window, settings.codes, settings.clear)
    (found,) = tops_beside(surface, deep, highest, CELL, settings)
    assert np.hypot(*((found[::-1] + 0.5) * CELL - pair[1, :2])) < 2.5
    upper = passage(echoes(pair), window, settings)
    assert not len(tops_beside(surface, upper, highest, CELL, settings))
    none = Passage(*(np.zeros(window.shape, np.int64) for _ in range(3)))
    assert not len(tops_beside(surface, none, highest, CELL, settings))


def test_pulses_that_come_through_and_those_that_meet_two_echoes_differ_in_depth():
    window, settings = Window(CELL, 0, 0, 60, 60), params()
    pulses = np.full(window.shape, 4)
    for through, met, deep in ((0, 4, 1.0), (4, 0, 0.0), (2, 4, 0.5), (0, 8, 2.0), (0, 80, 3.0)):
        counted = Passage(pulses, np.full(window.shape, through), np.full(window.shape, met))
        assert depth(counted, CELL, settings)[30, 30] == pytest.approx(deep)


def test_the_ends_of_pulses_are_counted_by_their_height():
    table = Table(
        {
            "x": np.array([0.1, 0.2, 0.3, 0.4, 0.7, 9.0]),
            "y": np.full(6, 0.1),
            "height_above_ground": np.array([8.0, 5.0, 0.1, np.nan, 6.0, 7.0]),
            "classification": np.array([5, 5, 2, 5, 6, 5]),
        }
    )
    counted = count_passage(table, np.array([False, True, True, True, True, True]), Window(CELL, 0, 0, 2, 1), (5,), 2.0)
    assert counted.pulses.tolist() == [[2, 1]]
    assert counted.through.tolist() == [[1, 0]]
    assert counted.echoes.tolist() == [[2, 0]]


def test_of_a_round_crown_nothing_sticks_out():
    y, x = CELL * np.mgrid[-30:31, -30:31]
    crown = np.maximum(12.0 - 0.3 * (x**2 + y**2), 0.0)
    middle = np.array([[30, 30]])
    assert np.abs(crown - round_crowns(crown, middle, CELL, params())).max() < 1.0  # places are cells: a cell's slope
    beside = np.maximum(crown, np.where((x > 2.0) & (np.abs(y) < 2.0), 8.0, 0.0))
    assert round_crowns(beside, middle, CELL, params()) == pytest.approx(round_crowns(crown, middle, CELL, params()))


def test_a_paraboloid_bulges_by_its_curvature_and_the_scale():
    """Of h - r² / 2R the Laplacian is -2 / R everywhere, and smoothing does not change that."""
    y, x = CELL * np.mgrid[-60:61, -60:61]
    settings, radius = params(), 40.0
    surface = 60.0 - (x**2 + y**2) / (2.0 * radius)
    middle = bulge(surface, surface, CELL, settings)[60, 60]
    assert middle == pytest.approx(2.0 * settings.widest**2 / radius, rel=0.05)  # a Gaussian that ends at 3 deviations


def test_a_ball_closes_what_is_narrower_and_nothing_else():
    surface = np.full((60, 60), 9.0)
    surface[20, 20], surface[30:40, 30:40] = 0.0, 1.0
    closed = without_pits(surface, CELL, 0.9)
    assert closed[20, 20] > 8.8 and closed[35, 35] == 1.0
    assert (closed >= surface).all() and closed == pytest.approx(without_pits(closed, CELL, 0.9))


@pytest.mark.parametrize("deviation", [0.8, 1.0, 2.3, 6.0])
def test_surfaces_are_smoothed_as_another_program_does(deviation):
    """To the last bit, also where the Gaussian is wider than the surface."""
    some = np.random.default_rng(3).uniform(0, 30, (40, 27))
    for surface in (some, some[:9, :5], some[:1, :1]):
        theirs = scipy.ndimage.gaussian_filter(surface, deviation, mode="constant", truncate=3.0)
        assert (_smoothed(surface, deviation) == theirs).all()


def test_a_bulge_is_the_laplacian_of_the_scale_of_the_height():
    """Held against scipy's Gaussians and Laplacians of all scales, which were taken before; round crowns likewise."""
    surface, settings = np.random.default_rng(4).uniform(0, 30, (70, 60)), params()
    smooth = scipy.ndimage.gaussian_filter(surface, 2.0)
    scales = np.linspace(CELL, settings.widest, 8)
    level, bent = np.interp(settings.scale * smooth, scales, np.arange(8)), np.zeros_like(surface)
    for k, scale in enumerate(scales.tolist()):
        after = scipy.ndimage.gaussian_filter(surface, scale / CELL, mode="constant", truncate=3.0)
        laplacian = scipy.ndimage.laplace(after, mode="constant")
        bent -= np.maximum(0.0, 1.0 - np.abs(level - k)) * (scale / CELL) ** 2 * laplacian
    assert (bulge(surface, smooth, CELL, settings) == bent).all()


def test_a_round_crown_is_by_distance_what_most_directions_are():
    surface, settings, (row, col) = np.random.default_rng(5).uniform(5, 9, (30, 40)), params(), (3, 20)
    wide = int(min(settings.reach, settings.spread * surface[row, col]) / CELL)
    turn, away = 2.0 * np.pi * np.arange(16)[:, None] / 16, np.arange(wide + 1)
    r, c = (np.rint(away * ratio).astype(int) + wide for ratio in (np.sin(turn), np.cos(turn)))
    seen = np.sort(np.pad(surface, wide)[r + row, c + col], axis=0)[int(settings.round * 15)]
    far = np.hypot(*(np.indices(surface.shape) - np.array([row, col])[:, None, None]))
    expected = np.interp(far, away, np.minimum.accumulate(seen), right=0.0)
    assert (round_crowns(surface, np.array([[row, col]]), CELL, settings) == expected).all()
