"""Digests of a table by place: those of far places cost no memory, and say of every box what lies in it."""

import numpy as np

from fwclass.grid import Box
from fwclass.schema import Table
from fwclass.store.cells import CELL, CELLS, MOST_SQUARES, by_place, digest_within
from fwclass.store.receipts import Receipt


def receipt(x, y, values):
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    cells = by_place(Table({"label_code": np.asarray(values, np.uint8)}), x, y)
    return Receipt("corrections", "all", "k", {}, {}, "d", "store", {CELLS: cells})


def test_one_row_that_lies_far_off_takes_no_square_for_every_place_between() -> None:
    near = Box(500_000.0, 5_400_000.0, 500_010.0, 5_400_010.0)
    far = receipt([500_001.0, 500_100.0, 99_999_999.0], [5_400_001.0, 5_400_001.0, -99_999_999.0], [2, 5, 5])
    cells = far.meta[CELLS]
    assert len(cells["digests"]) <= 16 * MOST_SQUARES
    assert cells["digests"].count(".") < len(cells["digests"])
    assert digest_within(far, Box(0.0, 0.0, 1000.0, 1000.0)) is None
    changed = receipt([500_001.0, 500_100.0, 99_999_999.0], [5_400_001.0, 5_400_001.0, -99_999_999.0], [6, 5, 5])
    assert digest_within(far, near) != digest_within(changed, near)


def test_rows_that_lie_together_keep_squares_of_eight_metres() -> None:
    cells = receipt([1.0, 7.9, 8.0, 24.0], [-1.0, -1.0, 0.0, 0.0], [1, 2, 3, 4]).meta[CELLS]
    assert (cells["size"], cells["first"], cells["rows"]) == (CELL, [0, -1], 2)
    squares = [cells["digests"][k : k + 16] for k in range(0, len(cells["digests"]), 16)]
    assert [set(s) != {"."} for s in squares] == [True, False, False, True, False, False, False, True]
