"""Counts by blocks: they add up to the confusion matrix, and tiles that cut a block change nothing."""

from __future__ import annotations

import numpy as np

from fwclass.assess.blocks import BlockCounts
from fwclass.assess.confusion import confusion, count_unclassified
from fwclass.model import ClassDef

CLASSES = (ClassDef("ground", 2, (2,)), ClassDef("vegetation", 5, (3, 4, 5)), ClassDef("building", 6, (6,)))


def echoes(n=4000):
    r = np.random.default_rng(1)
    x, y = r.uniform(5000.0, 5090.0, n), r.uniform(-70.0, 30.0, n)
    return x, y, r.choice([0, 2, 3, 4, 5, 6], n).astype(np.uint8), r.choice([0, 2, 5, 6], n).astype(np.uint8)


def test_blocks_add_up_to_the_whole():
    x, y, truth, answer = echoes()
    made = BlockCounts.of(x, y, truth, answer, CLASSES, 25.0)
    assert (made.counts[:, :, :3].sum(axis=0) == confusion(truth, answer, CLASSES)).all()
    assert (made.counts[:, :, 3].sum(axis=0) == count_unclassified(truth, answer, CLASSES)).all()


def test_a_block_holds_its_own_echoes():
    x, y, truth, answer = echoes()
    made = BlockCounts.of(x, y, truth, answer, CLASSES, 25.0)
    for place, counts in zip(made.place, made.counts, strict=True):
        own = (np.floor(x / 25.0) == place[0]) & (np.floor(y / 25.0) == place[1])
        assert (counts[:, :3] == confusion(truth[own], answer[own], CLASSES)).all()


def test_tiles_that_cut_blocks_change_nothing():
    x, y, truth, answer = echoes()
    whole = BlockCounts.of(x, y, truth, answer, CLASSES, 25.0)
    pieces = [
        BlockCounts.of(x[own], y[own], truth[own], answer[own], CLASSES, 25.0)
        for own in (x < 5030.0, (x >= 5030.0) & (y < 0.0), (x >= 5030.0) & (y >= 0.0))
    ]
    made = BlockCounts.merged(reversed(pieces), 3)
    assert (made.place == whole.place).all()
    assert (made.counts == whole.counts).all()


def test_no_echo_gives_no_block():
    none = np.empty(0)
    made = BlockCounts.of(none, none, none.astype(np.uint8), none.astype(np.uint8), CLASSES, 25.0)
    assert made.place.shape == (0, 2)
    assert made.counts.shape == (0, 3, 4)
    assert BlockCounts.merged([], 3).counts.shape == (0, 3, 4)
    assert BlockCounts.merged([made, made], 3).counts.shape == (0, 3, 4)
