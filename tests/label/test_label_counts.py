"""Counts of labels against a plain count, and the remarks that they call for."""

import numpy as np
import pytest

from fwclass.grid import Box
from fwclass.label.counts import count_labelled, count_training, label_remarks, nearest_box, total, total_training
from fwclass.model import ClassDef
from fwclass.schema import Table

CLASSES = (ClassDef("ground", 2, (2,)), ClassDef("vegetation", 5, (3, 4, 5)))
TRAIN = (Box(0, 0, 10, 10), Box(5, 0, 20, 10), Box(60, 60, 61, 61))
TWO = (Box(0, 0, 10, 10), Box(20, 0, 30, 10))
TEST = (Box(40, 0, 50, 50),)


def table(n=4000, seed=0):
    r = np.random.default_rng(seed)
    x, y = np.round(r.uniform(0, 50, (2, n)), 3)
    return Table({"x": x, "y": y, "reference": r.choice([0, 2, 3, 5, 9], n).astype(np.uint8)})


def in_test(t):
    return TEST[0].contains(t["x"], t["y"])


def test_counts_are_those_of_a_loop():
    t = table()
    found = count_labelled(t, in_test(t), TRAIN, CLASSES)
    rows = list(zip(t["x"].tolist(), t["y"].tolist(), t["reference"].tolist(), strict=True))
    of = {2: 0, 3: 1, 5: 1}
    counts = {k: [0, 0] for k in ("labelled", "train", "test")}
    boxes = [[0, 0] for _ in TRAIN]
    for x, y, code in rows:
        if code not in of:
            continue
        k = of[code]
        inside = [b.xmin <= x < b.xmax and b.ymin <= y < b.ymax for b in TRAIN]
        counts["labelled"][k] += 1
        counts["train"][k] += any(inside)
        counts["test"][k] += TEST[0].xmin <= x < TEST[0].xmax and TEST[0].ymin <= y < TEST[0].ymax
        for b, here in enumerate(inside):
            boxes[b][k] += here
    assert {k: found[k] for k in counts} == counts and found["boxes"] == boxes
    assert found["echoes"] == len(rows)
    assert found["unlabelled"] == sum(code == 0 for *_, code in rows)
    assert found["other"] == {"9": sum(code == 9 for *_, code in rows)}


def test_tiles_add_up():
    t = table()
    parts = [t.take(t["x"] // 7 == k) for k in range(8)]
    whole = total([count_labelled(p, in_test(p), TRAIN, CLASSES) for p in parts], len(TRAIN), len(CLASSES))
    assert whole == count_labelled(t, in_test(t), TRAIN, CLASSES)
    drawn = np.random.default_rng(1).random(t.rows) < 0.1
    drawn &= TRAIN[0].contains(t["x"], t["y"])
    some = [count_training(t.take(t["x"] // 7 == k), drawn[t["x"] // 7 == k], TRAIN, CLASSES) for k in range(8)]
    assert total_training(some, len(TRAIN), len(CLASSES)) == count_training(t, drawn, TRAIN, CLASSES)
    assert total([], 2, 2)["boxes"] == [[0, 0], [0, 0]]


def test_the_nearest_tested_echo_is_as_far_as_pythagoras_says():
    boxes = (Box(0, 0, 10, 10), Box(100, 0, 110, 10))
    assert nearest_box(np.array([13.0]), np.array([14.0]), boxes) == 5.0
    assert nearest_box(np.array([97.5, 50.0]), np.array([5.0, 5.0]), boxes) == 2.5
    assert nearest_box(np.array([5.0]), np.array([5.0]), boxes) == 0.0
    assert nearest_box(np.zeros(0), np.zeros(0), boxes) is None


def counted(**changes):
    base = {
        "echoes": 10_000,
        "unlabelled": 0,
        "other": {},
        "labelled": [5000, 5000],
        "train": [1000, 1000],
        "boxes": [[500, 500], [500, 500]],
        "test": [900, 900],
        "nearest": 16.0,
    }
    return {**base, **changes}


def told(whole, rows=None, tiles=None, test=()):
    rows = {"train": [1000, 1000], "boxes": []} if rows is None else rows
    tiles = {"0_0": {"train": [500, 500]}, "0_1": {"train": [500, 500]}} if tiles is None else tiles
    return label_remarks(whole, rows, tiles, CLASSES, TWO, test, 15.0)


def test_nothing_is_said_where_nothing_is_wrong():
    assert told(counted()) == []
    assert told(counted(nearest=None)) == [], "echoes are tested though no area trains"


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"whole": counted(boxes=[[500, 500], [0, 0]])}, "Training area [20, 0, 30, 10] has no labelled echo"),
        ({"whole": counted(test=[0, 0], nearest=None)}, "the accuracy is unknown"),
        ({"whole": counted(nearest=3.0)}, "lies 3.000 m from a training area"),
        ({"whole": counted(test=[900, 0])}, "'vegetation' does not occur in the test areas"),
        ({"whole": counted(labelled=[5000, 0], other={"6": 7})}, "5); the reference also has the codes 6 (7"),
        ({"rows": {"train": [1000, 0]}}, "'vegetation' occurs in the test areas (900) and has no training row"),
        ({"rows": {"train": [1000, 1]}}, "'vegetation' has 1 training row:"),
        ({"rows": {"train": [20000, 199]}}, "20000 training rows and 'vegetation' 199, more than 100 to 1"),
        ({"tiles": {"0_0": {"train": [9, 0]}, "0_1": {"train": [9, 5]}}}, "'vegetation' come from one tile, 0_1"),
        ({"test": (Box(5, 5, 50, 50),)}, "Test area [5, 5, 50, 50] overlaps training area [0, 0, 10, 10]"),
    ],
)
def test_what_is_wrong_is_said(changes, words):
    whole = changes.pop("whole", counted())
    found = told(whole, **changes)
    assert any(words in text for text in found), found


def test_one_tile_is_no_remark_where_there_is_only_one():
    assert told(counted(), tiles={"0_0": {"train": [500, 500]}}) == []
