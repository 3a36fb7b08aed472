"""Digests of a table by place: those of far places cost no memory, and say of every box what lies in it."""

import numpy as np
import pytest

from fwclass.errors import DamagedError
from fwclass.grid import Box
from fwclass.schema import Table
from fwclass.store import row_digests
from fwclass.store.atomic import digest_of
from fwclass.store.receipts import Meta, Receipt
from fwclass.store.row_digests import CELL, MOST_SQUARES, ROW_DIGESTS, digest_within, digests_by_square
from fwclass.store.shapes import misfit


def receipt(x, y, values):
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    digests = digests_by_square(Table({"label_code": np.asarray(values, np.uint8)}), x, y)
    return Receipt("corrections", "all", "k", {}, {}, digest_of(digests), "store", {ROW_DIGESTS: digests})


def test_one_row_that_lies_far_off_takes_no_square_for_every_place_between() -> None:
    near = Box(500_000.0, 5_400_000.0, 500_010.0, 5_400_010.0)
    far = receipt([500_001.0, 500_100.0, 99_999_999.0], [5_400_001.0, 5_400_001.0, -99_999_999.0], [2, 5, 5])
    digests = far.meta[ROW_DIGESTS]
    assert len(digests["digests"]) <= 16 * MOST_SQUARES
    assert digests["digests"].count(".") < len(digests["digests"])
    assert digest_within(far, Box(0.0, 0.0, 1000.0, 1000.0)) is None
    changed = receipt([500_001.0, 500_100.0, 99_999_999.0], [5_400_001.0, 5_400_001.0, -99_999_999.0], [6, 5, 5])
    assert digest_within(far, near) != digest_within(changed, near)


def test_rows_that_lie_together_keep_squares_of_eight_metres() -> None:
    digests = receipt([1.0, 7.9, 8.0, 24.0], [-1.0, -1.0, 0.0, 0.0], [1, 2, 3, 4]).meta[ROW_DIGESTS]
    assert (digests["size"], digests["first"], digests["rows"]) == (CELL, [0, -1], 2)
    squares = [digests["digests"][k : k + 16] for k in range(0, len(digests["digests"]), 16)]
    assert [set(s) != {"."} for s in squares] == [True, False, False, True, False, False, False, True]


def test_what_is_remembered_of_windows_is_bounded_and_holds_no_text_of_a_receipt(monkeypatch) -> None:
    monkeypatch.setattr(row_digests, "REMEMBERED", 3)
    monkeypatch.setattr(row_digests, "_windows", {})
    seen = receipt([1.0, 90.0], [1.0, 90.0], [1, 2])
    boxes = [Box(0.0, 0.0, edge, edge) for edge in (8.0, 16.0, 24.0, 32.0, 96.0)]
    first = [digest_within(seen, box) for box in boxes]
    assert len(row_digests._windows) == 3
    assert [digest_within(seen, box) for box in boxes] == first
    assert not any(len(part) > 64 for window in row_digests._windows for part in window if isinstance(part, str))


def test_names_of_a_strips_pieces_are_looked_at_once_however_many_tiles_ask(monkeypatch) -> None:
    """Every tile of a strip asks for its piece: each of 2 000 names was looked at by each of 2 000 tiles."""
    looks = []
    monkeypatch.setattr(row_digests, "misfit", lambda *words: looks.append(words) or misfit(*words))
    names = {f"{k}_0": f"{k:016x}" for k in range(2000)}
    made = Receipt("split", "a", "k", {}, {}, "d", "store", Meta({ROW_DIGESTS: {"names": names}}, "own", "here"))
    assert [digest_within(made, name) for name in (*names, "9_9")] == [*names.values(), None]
    assert len(looks) == 1
    forged = Receipt("split", "a", "k", {}, {}, "d", "store", Meta({ROW_DIGESTS: {"names": [1]}}, "own", "here"))
    for _ in range(2):
        with pytest.raises(DamagedError, match="no digests of pieces"):
            digest_within(forged, "0_0")
