"""Voids by area: those that are cut out come out, whatever the stripes; the outside is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import label

from fwclass.grid import Box, Window
from fwclass.quality.voids import BESIDE, PIECE, CellGroups, Void, piece_remarks, void_facts

WINDOW = Window(2.0, 1000, 2000, 40, 30)


def voids(empty: np.ndarray, rows: int, least: float = 0.0) -> list[Void]:
    made = CellGroups(WINDOW)
    top = WINDOW.nrows
    while top > 0:
        low = max(0, top - rows)
        made.add(Window(2.0, WINDOW.col, WINDOW.row + low, WINDOW.ncols, top - low), empty[low:top])
        top = low
    return made.voids(least)


@pytest.mark.parametrize("rows", [1, 4, 7, 30])
def test_voids_come_out_whatever_the_stripes(rows: int) -> None:
    empty = np.zeros(WINDOW.shape, bool)
    empty[3:20, 10:12] = empty[18:20, 10:30] = empty[3:20, 28:30] = True  # a U, which stripes see as two at first
    empty[5, 15] = True
    empty[20:, 35:] = True  # the outside
    found = voids(empty, rows)
    assert [v.area for v in found] == [4.0 * (17 * 4 + 2 * 16), 4.0]
    assert found[0].box.bounds == (2020.0, 4006.0, 2060.0, 4040.0)
    assert voids(empty, rows, least=5.0) == found[:1]


@pytest.mark.parametrize("seed", range(5))
def test_they_are_those_of_scipy_over_the_whole(seed: int) -> None:
    empty = np.random.default_rng(seed).random(WINDOW.shape) < 0.5
    labels, n = label(empty)
    edge = set(np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])).tolist())
    inside = sorted((4.0 * (labels == k).sum() for k in range(1, n + 1) if k not in edge), reverse=True)
    for rows in (1, 3, 30):
        assert [v.area for v in voids(empty, rows)] == inside
    assert voids(empty, 1) == voids(empty, 30)


def test_full_and_empty_have_none() -> None:
    assert not voids(np.zeros(WINDOW.shape, bool), 7) and not voids(np.ones(WINDOW.shape, bool), 7)
    assert CellGroups(WINDOW).voids(0.0) == [] and void_facts([], 16.0, 0.0)["share"] is None


@pytest.mark.parametrize("seed", range(5))
def test_pieces_hang_together_by_corners_whatever_the_stripes(seed: int) -> None:
    full = np.random.default_rng(seed).random(WINDOW.shape) < 0.3
    labels, n = label(full, np.ones((3, 3)))
    expected = sorted((4.0 * (labels == k).sum() for k in range(1, n + 1)), reverse=True)
    made = [pieces(full, rows, 0.0) for rows in (1, 3, 30)]
    assert [p.area for p in made[0]] == expected and made[0] == made[1] == made[2]


def pieces(full: np.ndarray, rows: int, share: float = PIECE) -> list[Void]:
    made = CellGroups(WINDOW, corners=True)
    for top in range(WINDOW.nrows, 0, -rows):
        low = max(0, top - rows)
        made.add(Window(2.0, WINDOW.col, WINDOW.row + low, WINDOW.ncols, top - low), full[low:top])
    assert made.area == 4.0 * full.sum()
    return made.pieces(share)


def remarks(full: np.ndarray) -> list[str]:
    return piece_remarks(pieces(full, 7), 4.0 * full.sum())


def test_a_strip_that_is_missing_is_told_though_it_is_no_void() -> None:
    full = np.ones(WINDOW.shape, bool)
    assert remarks(full) == [] == piece_remarks([], 0.0)
    full[10:12] = False
    (told,) = remarks(full)
    assert "2 pieces beside each other (64 % and 36 % of the area)" in told and not voids(~full, 7)
    full[1:12] = full[0, 20:] = False
    assert remarks(full) == [], "a few echoes at the rim"
    far = [Void(100.0, Box(0, 0, 10, 10)), Void(100.0, Box(10 + BESIDE, 0, 30 + BESIDE, 10))]
    assert piece_remarks(far, 200.0) == []
