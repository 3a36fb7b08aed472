"""Objects by cells: against a raster labelled at once, whatever the tiles; what is split, merged, missed and false."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.ndimage

from fwclass import conf
from fwclass.assess.blocks import BlockCounts
from fwclass.assess.objects import (
    COUNTED,
    ObjectCells,
    cells_across,
    count_objects,
    describe_objects,
    object_classes,
    object_figures,
)
from fwclass.graph.objects import objects_of_tiles
from fwclass.grid import TileGrid, millimetres, quantise
from fwclass.model import ClassDef

CLASSES = (ClassDef("ground", 2, (2,)), ClassDef("building", 6, (6,)), ClassDef("car", 64, (64,)))
PARAMS = conf.section("assess").objects
EDGE = 40.0


def scene(seed: int = 3, n: int = 9000):
    """Echoes of blobs of both classes, answered wrong here and there."""
    r = np.random.default_rng(seed)
    x, y = quantise(r.uniform(-10.0, EDGE - 10.0, n)), quantise(r.uniform(995.0, 995.0 + EDGE, n))
    field = scipy.ndimage.gaussian_filter(r.normal(size=(90, 90)), 2.5)
    other = scipy.ndimage.gaussian_filter(r.normal(size=(90, 90)), 2.0)
    at = (2.0 * (y - 995.0)).astype(int), (2.0 * (x + 10.0)).astype(int)
    truth = np.where(field[at] > 0.08, 6, np.where(other[at] > 0.12, 64, 2)).astype(np.uint8)
    answer = np.where(other[at] > 0.05, r.choice([2, 6, 64], n), truth).astype(np.uint8)
    truth[r.random(n) < 0.02] = 0  # no reference
    return x, y, truth, answer


def cells_of(x, y, truth, answer, cell=PARAMS.step):
    return ObjectCells.of((x, y), truth, answer, CLASSES, object_classes(CLASSES, None), cell)


def by_raster(x, y, truth, answer, code, cell):
    """Counts of one class by dense labelling and plain loops."""
    known = truth > 0
    col, row = (millimetres(v) // round(1000 * cell) for v in (x, y))
    col, row = col - col.min(), row - row.min()
    said = {}
    for kind, mask in (("so", known & (truth == code)), ("said", known & (answer == code))):
        raster = np.zeros((row.max() + 1, col.max() + 1), int)
        raster[row[mask], col[mask]] = 1
        labels, number = scipy.ndimage.label(raster, np.ones((3, 3)))
        said[kind] = labels, number, mask
    both = said["so"][2] & said["said"][2]

    def large(kind, k):
        labels, _, mask = said[kind]
        return (labels == k).sum() * cell**2 >= PARAMS.sizes[0] and (
            mask & (labels[row, col] == k)
        ).sum() >= PARAMS.echoes

    told = dict.fromkeys(COUNTED, 0)
    objects = {kind: [k for k in range(1, said[kind][1] + 1) if large(kind, k)] for kind in said}
    held = np.zeros((said["so"][1] + 1, said["said"][1] + 1), bool)
    for i, j in itertools.product(objects["so"], objects["said"]):
        mine = said["so"][2] & (said["so"][0][row, col] == i)
        held[i, j] = (mine & both & (said["said"][0][row, col] == j)).sum() >= PARAMS.piece * mine.sum()
    for kind, names, more in (("so", COUNTED[:3], held.sum(axis=1)), ("said", COUNTED[3:], held.sum(axis=0))):
        for k in objects[kind]:
            mine = said[kind][2] & (said[kind][0][row, col] == k)
            told[names[0]] += 1
            told[names[1]] += bool((mine & both).sum() >= 0.5 * mine.sum())
            told[names[2]] += bool(more[k] > 1)
    return told


@pytest.mark.parametrize("across", [2, 4, 6])
def test_counts_are_those_of_a_raster_that_is_labelled_at_once(across):
    x, y, truth, answer = scene()
    cell = across * PARAMS.step
    counts = count_objects(cells_of(x, y, truth, answer).coarser(across), 3, cell, PARAMS)
    assert not counts[0].any()
    for k in (1, 2):
        made = dict(zip(COUNTED, counts[k].sum(axis=0).tolist(), strict=True))
        assert made == by_raster(x, y, truth, answer, CLASSES[k].code, cell)
    split, merged = (counts[:, :, COUNTED.index(n)].sum() for n in ("split", "merged"))
    assert split if across == 2 else merged, "the scene has some"


@pytest.mark.parametrize("size", [3.0, 7.1, 10.0, 11.75, 100.0])
@pytest.mark.parametrize("across", [2, 5])
def test_tiles_change_nothing(size, across):
    x, y, truth, answer = scene()
    cell = across * PARAMS.step
    whole = count_objects(cells_of(x, y, truth, answer).coarser(across), 3, cell, PARAMS)
    grid = TileGrid(size)
    keys = np.array([f"{a}_{b}" for a, b in zip(*(v.tolist() for v in grid.indices(x, y)), strict=True)])
    counts, beyond = np.zeros_like(whole), []
    for key in sorted(set(keys), reverse=True):
        own = np.flatnonzero(keys == key)[::-1]
        part = cells_of(x[own], y[own], truth[own], answer[own]).coarser(across)
        inside, rest = part.parted(grid.tile(key).box, cell)
        assert len(inside.place) + len(rest.place) == len(part.place)
        counts += count_objects(inside, 3, cell, PARAMS)
        beyond.append(rest)
    counts += count_objects(ObjectCells.merged(beyond), 3, cell, PARAMS)
    assert (counts == whole).all()


@pytest.mark.parametrize("size", [3.0, 7.1, 11.75, 100.0])
def test_a_survey_of_many_tiles_has_the_objects_of_the_whole(size):
    """And holds no more of them than the borders of squares of tiles: all that touched a tile's border were held, 1.9
    GiB for 52 million echoes."""
    x, y, truth, answer = scene()
    grid, names = TileGrid(size), [c.name for c in CLASSES]
    blocks = BlockCounts.of(x, y, truth, answer, CLASSES, 25.0).counts
    cell = cells_across(blocks, 25.0, PARAMS) * PARAMS.step
    whole = cells_of(x, y, truth, answer).coarser(round(cell / PARAMS.step))
    keys = np.array([f"{a}_{b}" for a, b in zip(*(v.tolist() for v in grid.indices(x, y)), strict=True)])
    parts = {key: cells_of(*(v[keys == key] for v in (x, y, truth, answer))) for key in sorted(set(keys))}
    inputs = SimpleNamespace(
        arrays=lambda stage, key, name: ({"place": parts[key].place, "counts": parts[key].counts}, {})
    )
    here = SimpleNamespace(parts=lambda stage: tuple(parts), inputs=inputs)
    judged = objects_of_tiles(here, "confusion", blocks, 25.0, names, {"params": PARAMS, "tile": size})
    assert judged == object_figures(count_objects(whole, 3, cell, PARAMS), names, cell, PARAMS)


def squares(*boxes, step=0.25):
    """Places of a point every `step` metres in boxes (xmin, ymin, xmax, ymax)."""
    some = [
        np.stack(np.meshgrid(np.arange(a, c, step), np.arange(b, d, step)), -1).reshape(-1, 2) for a, b, c, d in boxes
    ]
    return np.concatenate(some).T


def counted(reference, predicted):
    """Of points that are buildings in boxes, and said to be in others."""
    x, y = squares((-50.0, -50.0, 50.0, 50.0), step=0.5)
    x, y = x + 0.1, y + 0.1

    def inside(boxes):
        return np.any([(x > a) & (x < c) & (y > b) & (y < d) for a, b, c, d in boxes], axis=0)

    truth, answer = (np.where(inside(boxes), 6, 2).astype(np.uint8) for boxes in (reference, predicted))
    counts = count_objects(cells_of(x, y, truth, answer).coarser(2), 3, PARAMS.cell, PARAMS)
    return dict(zip(COUNTED, counts[1].sum(axis=0).tolist(), strict=True))


A, B = (0.0, 0.0, 10.0, 10.0), (12.0, 0.0, 22.0, 10.0)


@pytest.mark.parametrize(
    ("reference", "predicted", "expected"),
    [
        ((A, B), (A, B), (2, 2, 0, 2, 2, 0)),
        ((A, B), (A,), (2, 1, 0, 1, 1, 0)),
        ((A,), (A, B), (1, 1, 0, 2, 1, 0)),
        ((A, B), ((0.0, 0.0, 22.0, 10.0),), (2, 2, 0, 1, 1, 1)),
        ((A,), ((0.0, 0.0, 4.0, 10.0), (6.0, 0.0, 10.0, 10.0)), (1, 1, 1, 2, 2, 0)),
        ((A,), ((0.0, 0.0, 4.0, 10.0),), (1, 0, 0, 1, 1, 0)),
        ((A,), (A, (9.9, 9.9, 11.0, 11.0)), (1, 1, 0, 1, 1, 0)),
        ((A,), (A, (30.0, 30.0, 31.0, 31.0)), (1, 1, 0, 1, 1, 0)),
    ],
    ids=["same", "missed", "false", "merged", "split", "less than half", "by a corner", "too small to be one"],
)
def test_what_is_made_of_two_houses(reference, predicted, expected):
    assert tuple(counted(reference, predicted).values()) == expected


def test_figures_are_those_of_the_paper_and_nothing_where_there_is_no_object():
    counts = np.zeros((3, 3, 6), np.int64)
    counts[1, 1], counts[1, 2] = (3, 1, 0, 4, 2, 0), (5, 5, 1, 6, 6, 1)
    told = object_figures(counts, ["ground", "building", "car"], 0.5, PARAMS)
    (one,) = told["classes"]
    assert one["name"] == "building" and one["completeness"] == 6 / 8 and one["correctness"] == 8 / 10
    # Rutzinger et al. 2009 give quality also as comp corr / (comp + corr - comp corr)
    assert one["quality"] == pytest.approx(0.75 * 0.8 / (0.75 + 0.8 - 0.75 * 0.8))
    assert [row["completeness"] for row in one["sizes"]] == [None, 1 / 3, 1.0]
    assert one["sizes"][0] == {
        "from": 2.0,
        **dict.fromkeys(COUNTED, 0),
        **dict.fromkeys(one["sizes"][0].keys() & {"completeness", "correctness", "quality"}),
    }
    table = describe_objects(told)
    assert "building" in table and "10+" in table and "2+" not in table
    assert describe_objects(object_figures(0 * counts, ["a", "b", "c"], 0.5, PARAMS)) == describe_objects(None) == ""


def test_cells_are_as_wide_as_the_tested_echoes_lie_apart():
    r = np.random.default_rng(1)
    for density, expected in ((25.0, 2), (3.0, 3), (1.0, 5), (0.2, 11)):
        side = 100 if density > 10 else 200
        n = int(density * side**2)
        x, y, code = r.uniform(0, side, n), r.uniform(0, side, n), np.full(n, 6, np.uint8)
        blocks = BlockCounts.of(x, y, code, code, CLASSES, 25.0)
        assert cells_across(blocks.counts, 25.0, PARAMS) == expected
    assert cells_across(np.zeros((0, 3, 4), np.int64), 25.0, PARAMS) == 2


def test_things_are_judged_and_what_covers_the_land_is_not():
    wire, other = ClassDef("wire", 14, (14,)), ClassDef("other", 1, (1,))
    assert object_classes((*CLASSES, wire, other), None) == (1, 2, 3)
    assert object_classes((*CLASSES, wire, other), ("other", "car")) == (2, 4)
    assert object_classes(CLASSES, ()) == ()


def test_no_echo_gives_no_object():
    none = np.empty(0)
    cells = cells_of(none, none, none.astype(np.uint8), none.astype(np.uint8))
    assert cells.place.shape == cells.counts.shape == (0, 3)
    assert not count_objects(cells.coarser(2), 3, 1.0, PARAMS).any()
