"""Contour lines against contourpy, across blocks, and what a map must never show: lines that cross, or lie far off."""

from __future__ import annotations

import contourpy
import numpy as np
import pytest
import shapely
from pydantic import ValidationError
from scipy.spatial import cKDTree

from fwclass.contours import lines as lines_module
from fwclass.contours.chains import chains
from fwclass.contours.join import LinePieces, join_lines
from fwclass.contours.lines import lines
from fwclass.contours.params import STEP, ContourParams
from fwclass.contours.smooth import NO_HEIGHT, margin, smooth_terrain
from fwclass.grid import Window

WINDOW = Window(0.5, 1_024_000, 10_806_400, 61, 47)
PARAMS = ContourParams(enabled=True, interval=0.5, index=5, smooth=1.0, most=0.25, shortest=0.0)
STEPS = PARAMS.steps


def relief(shape=WINDOW.shape, noise=0.0, seed=0):
    row, col = np.indices(shape)
    rough = np.random.default_rng(seed).normal(0, noise, shape) if noise else 0.0
    return (300 + 3 * np.sin(col / 9) * np.cos(row / 7) + 0.02 * row + rough).astype(np.float32)


def whole(heights):
    return np.rint(heights.astype(np.float64) / STEP).astype(np.int64)


def segments(made):
    """Every straight piece with its level, its ends in one order [mm, as bits]."""
    first = np.append(0, np.cumsum(made.count))
    rows = [k for a, b in zip(first[:-1], first[1:], strict=True) for k in range(a, b - 1)]
    level = np.repeat(made.level, np.maximum(made.count - 1, 0))
    ends = [tuple(sorted((tuple(made.vertices[k]), tuple(made.vertices[k + 1])))) for k in rows]
    return {(int(v), *e) for v, e in zip(level, ends, strict=True)}


def theirs(heights, window, level):
    x = (window.col + np.arange(window.ncols) + 0.5) * window.cell
    y = (window.row + np.arange(window.nrows) + 0.5) * window.cell
    z = np.ma.masked_equal(heights, NO_HEIGHT) * STEP
    made = contourpy.contour_generator(x, y, z, name="serial", corner_mask=False).lines((level * STEPS + 0.5) * STEP)
    return np.array([[*a, *b] for line in made for a, b in zip(line[:-1], line[1:], strict=True)])


@pytest.mark.parametrize("noise", [0.0, 0.6])
def test_another_program_draws_the_same_lines(noise):
    heights = whole(relief(noise=noise))
    heights[10:14, 20:30] = NO_HEIGHT
    ours = segments(lines(heights, WINDOW, STEPS, 5))
    levels = {s[0] for s in ours}
    known = heights[heights != NO_HEIGHT]
    assert levels == set(range((known.min() - 1) // STEPS + 1, (known.max() - 1) // STEPS + 1))
    for level in levels:
        mine = np.array([[*s[1], *s[2]] for s in ours if s[0] == level])
        other = theirs(heights, WINDOW, level)
        either_way = cKDTree(np.concatenate([other, other[:, [2, 3, 0, 1]]]))
        distance, row = either_way.query(mine)
        assert distance.max() < 1e-6 and sorted(row % len(other)) == list(range(len(other)))


def blocks_of(heights, size):
    """The squares of `WINDOW` in blocks of `size` cells of the global grid."""
    for col in range(WINDOW.col // size * size, WINDOW.col + WINDOW.ncols, size):
        for row in range(WINDOW.row // size * size, WINDOW.row + WINDOW.nrows, size):
            part = Window(WINDOW.cell, col, row, size + 1, size + 1).common(WINDOW)
            if part is not None:
                yield lines(heights[part.within(WINDOW)], part, STEPS, 5)


@pytest.mark.parametrize("size", [7, 16, 40])
def test_blocks_join_to_the_lines_of_the_whole(size):
    heights = whole(relief(noise=0.4))
    heights[30:33, 5:9] = NO_HEIGHT
    alone = lines(heights, WINDOW, STEPS, 5)
    several = list(blocks_of(heights, size))
    assert set().union(*(segments(part) for part in several)) == segments(alone)  # the same bits
    pieces = [LinePieces.of(part) for part in several]
    made = join_lines(LinePieces(*(np.concatenate([getattr(p, n) for p in pieces]) for n in ("ends", "measures"))))
    one = join_lines(LinePieces.of(alone))
    assert len(made.level) == len(one.level) < sum(len(p.ends) for p in pieces)
    for level in np.unique(one.level):
        mine, other = made.level == level, one.level == level
        np.testing.assert_allclose(np.sort(made.length[mine]), np.sort(one.length[other]))
        assert made.depression[mine].sum() == one.depression[other].sum()
    assert one.depression.any() and not one.depression.all()


def test_lines_of_no_two_levels_meet_however_wild_the_land():
    heights = whole(relief((25, 25), noise=1.5))
    made = lines(heights, Window(1.0, 0, 0, 25, 25), STEPS, 5)
    parts = np.split(made.vertices, np.cumsum(made.count)[:-1])
    shapes = shapely.linestrings([v for p in parts for v in p], indices=np.repeat(np.arange(len(parts)), made.count))
    assert len(shapes) > 100 and shapely.is_simple(shapes).all()
    a, b = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    assert (a == b).all()


def test_higher_land_lies_on_the_left():
    heights = whole(relief())
    made = lines(heights, WINDOW, STEPS, 5)
    step = np.diff(made.vertices, axis=0)
    inner = np.ones(len(step), bool)
    inner[np.cumsum(made.count)[:-1] - 1] = False
    middle = (made.vertices[:-1] + made.vertices[1:])[inner] / 2
    left = np.c_[-step[:, 1], step[:, 0]][inner]
    slope_y, slope_x = np.gradient(relief().astype(float))
    col, row = (np.rint(middle / 0.5 - 0.5) - [WINDOW.col, WINDOW.row]).astype(int).T
    upward = left[:, 0] * slope_x[row, col] + left[:, 1] * slope_y[row, col]
    assert (upward > 0).mean() > 0.98  # where the land is flat its direction is anything


def test_a_hollow_is_a_depression_and_a_hill_is_none():
    row, col = np.indices((41, 41)) - 20
    window, bowl = Window(1.0, 0, 0, 41, 41), 0.01 * (row**2 + col**2)
    for sign, expected in ((1, True), (-1, False)):
        made = join_lines(LinePieces.of(lines(whole(100 + sign * bowl), window, STEPS, 5)))
        closed = made.length > 10
        inner = np.abs(made.level * PARAMS.interval - 100) < 3.9  # others end at the border
        assert (made.depression[closed & inner] == expected).all() and (closed & inner).sum() > 5
    radius = 2 * np.pi * np.sqrt(2.0 / 0.01)
    assert made.length[made.level == 196][0] == pytest.approx(radius, rel=0.01)


def test_no_line_has_an_end_on_land_that_is_missing():
    heights = whole(relief(noise=0.3))
    missing = np.random.default_rng(3).random(heights.shape) < 0.1
    made = lines(np.where(missing, NO_HEIGHT, heights), WINDOW, STEPS, 5)
    col, row = (made.vertices / WINDOW.cell - 0.5 - [WINDOW.col, WINDOW.row]).T
    for side in (np.floor, np.ceil):
        assert not missing[side(row.round(6)).astype(int), side(col.round(6)).astype(int)].any()
    assert len(lines(np.full((9, 9), NO_HEIGHT), Window(1.0, 0, 0, 9, 9), STEPS, 5).level) == 0


def test_level_land_on_a_level_has_no_line_on_it():
    heights = whole(np.full(WINDOW.shape, 300.0))
    assert len(lines(heights, WINDOW, STEPS, 5).level) == 0
    heights[20:25, 20:25] += 1
    made = lines(heights, WINDOW, STEPS, 5)
    assert len(made.level) == 1 and made.level[0] == 600


def test_wild_blocks_have_coarser_lines_and_say_so(monkeypatch):
    heights = whole(relief(noise=3.0))
    full = lines(heights, WINDOW, STEPS, 5)
    monkeypatch.setattr(lines_module, "MOST", 10_000)
    made = lines(heights, WINDOW, STEPS, 5)
    assert full.every == 1 and made.every == 5 and 0 < len(made.level) < len(full.level)
    assert (made.level % 5 == 0).all() and segments(made) == {s for s in segments(full) if s[0] % 5 == 0}


def test_smoothed_land_is_near_the_land_and_the_same_in_any_window():
    cell, edge = 0.5, margin(PARAMS, 0.5)
    dtm = relief((90, 80), noise=0.4)
    dtm[40:44, 30:60] = np.nan
    made, inner = smooth_terrain(dtm, cell, PARAMS), dtm[edge:-edge, edge:-edge]
    known = np.isfinite(inner)
    assert ((made == NO_HEIGHT) == ~known).all()
    off = np.abs(made[known] * STEP - inner[known])
    assert off.max() <= PARAMS.most * PARAMS.interval + STEP and off.max() > 0.9 * PARAMS.most * PARAMS.interval
    part = smooth_terrain(dtm[10:70, 5:75], cell, PARAMS)
    np.testing.assert_array_equal(part, made[10 : 10 + part.shape[0], 5 : 5 + part.shape[1]])
    flat = relief((90, 80), noise=0.05) - relief((90, 80)) + 300
    calm = smooth_terrain(flat, cell, PARAMS) * STEP
    assert calm.std() < 0.4 * flat.std() and calm.mean() == pytest.approx(300, abs=0.01)
    plain = PARAMS.model_copy(update={"smooth": 0.0})
    assert margin(plain, cell) == 0 and (smooth_terrain(dtm, cell, plain)[0] == whole(dtm[0])).all()


def test_the_weights_have_the_width_that_is_asked_for():
    for cell, smooth in ((1.0, 2.0), (0.5, 2.0), (0.25, 1.0)):
        params = PARAMS.model_copy(update={"smooth": smooth, "most": 1.0, "interval": 1000.0})
        edge = margin(params, cell)
        dtm = np.zeros((4 * edge + 1, 1 + 2 * edge), np.float32)
        dtm[2 * edge] = 1000.0
        weight = smooth_terrain(dtm, cell, params)[:, 0].astype(float)
        place = (np.arange(len(weight)) - edge) * cell
        assert np.sqrt((weight * place**2).sum() / weight.sum()) == pytest.approx(smooth, rel=0.25)  # whole cells


@pytest.mark.parametrize("seed", range(5))
def test_chains_are_whole_and_in_order(seed):
    rng = np.random.default_rng(seed)
    after = rng.permutation(200)
    after[rng.random(200) < [0.0, 0.02, 0.1, 0.5, 1.0][seed]] = -1
    made = chains(after)
    assert sorted(made.order) == list(range(200))
    for a, b, closed in zip(made.first[:-1], made.first[1:], made.closed, strict=True):
        chain = made.order[a:b]
        assert (after[chain[:-1]] == chain[1:]).all()
        assert after[chain[-1]] == (chain[0] if closed else -1)
        assert not closed or chain[0] == chain.min()
    assert len(chains(np.zeros(0, np.int64)).closed) == 0


@pytest.mark.parametrize("change", [{"interval": 0.0}, {"interval": 0.33333}, {"index": 0}, {"most": 1.5}])
def test_settings_that_make_no_sense_are_refused(change):
    with pytest.raises(ValidationError):
        ContourParams(**{**PARAMS.model_dump(), **change})
