"""Digests of pieces of a table, so that who reads a piece needs not be made again when another piece changes."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import DamagedError
from fwclass.grid import Box, Window, millimetres
from fwclass.schema import Table
from fwclass.store.atomic import digest_of
from fwclass.store.receipts import Meta, Receipt
from fwclass.store.shapes import COUNT, POSITIVE, TEXT, WHOLE, misfit

CELL = 8.0
"""Edge of the squares of the global grid that have a digest of their own [m]: a halo is known to the next 8 m."""
MOST_SQUARES = 1 << 20
"""Of a rectangle, 16 MiB of text; of a wider one (8 km by 8 km, or one row that lies far off) the edge is doubled."""

ROW_DIGESTS = "cells"
"""Where a receipt's meta keeps them.

By square: ``{"size": m, "first": [column, row], "rows": n, "digests": text}`` with 16 characters for every square of a
rectangle, column by column, dots where nothing lies. By name: ``{"names": {name: 16 hex digits}}``.
"""

REMEMBERED = 8192
"""Digests of windows that are kept: every stage that reads a tile with its halo asks for the same ones."""

_windows: dict[tuple[str, int, int, int, int], str | None] = {}
"""By the receipt's digest, which counts its squares, first and last column and row. Not by the text of the squares, of
which each would be held, at 16 bytes a square."""
_guard = threading.Lock()

_WIDTH = 16
_NOTHING = "." * _WIDTH

Within = Box | str | None
"""What a part reads of others: the rows in a box, the piece of a name, or everything."""


def digests_by_square(table: Table, x: NDArray[np.float64], y: NDArray[np.float64]) -> dict[str, Any]:
    """For a receipt's meta: a digest of the rows in every square of `CELL`, or of 2, 4, 8… times that where these would
    be more than `MOST_SQUARES`; rows are at `x`, `y` [m]."""
    if not len(x):
        return {"size": CELL, "first": [0, 0], "rows": 0, "digests": ""}
    size, (column, row) = CELL, (millimetres(v) // round(CELL * 1000) for v in (x, y))
    while (int(np.ptp(column)) + 1) * (int(np.ptp(row)) + 1) > MOST_SQUARES:
        size, column, row = 2 * size, column // 2, row // 2
    order = np.lexsort((row, column))  # stable: rows of a square keep their order
    a, b = column[order], row[order]
    new = np.flatnonzero(np.concatenate([[True], (a[1:] != a[:-1]) | (b[1:] != b[:-1])]))
    arranged = table.take(order)
    left, low, rows = int(column.min()), int(row.min()), int(np.ptp(row)) + 1
    texts = [_NOTHING] * ((int(np.ptp(column)) + 1) * rows)
    for i, j in zip(new.tolist(), [*new[1:].tolist(), len(a)], strict=True):
        texts[(int(a[i]) - left) * rows + int(b[i]) - low] = _digest(arranged, i, j)
    return {"size": size, "first": [left, low], "rows": rows, "digests": "".join(texts)}


def digests_by_name(table: Table, names: Iterable[str], offsets: Iterable[int]) -> dict[str, Any]:
    """For a receipt's meta: a digest of every named run of rows ``offsets[k]:offsets[k + 1]``."""
    bounds = [int(o) for o in offsets]
    runs = zip(names, bounds[:-1], bounds[1:], strict=True)
    return {"names": {name: _digest(table, i, j) for name, i, j in runs}}


def _digest(table: Table, first: int, last: int) -> str:
    state = hashlib.blake2b(digest_size=8)
    for name in sorted(table):
        values = table[name]
        state.update(f"{name} {values.dtype.str} {last - first}\n".encode())
        state.update(np.ascontiguousarray(values[first:last]).tobytes())
    return state.hexdigest()


_SHAPE = {"size?": POSITIVE, "first?": (WHOLE, WHOLE), "rows?": COUNT, "digests?": TEXT, "names?": {TEXT: TEXT}}


def row_digests_of(meta: Mapping[str, Any], where: object) -> Mapping[str, Any] | None:
    """What a receipt keeps under `ROW_DIGESTS`, None where that are no digests of pieces; `DamagedError` for wrong
    ones."""
    kept = meta.get(ROW_DIGESTS)
    if kept is None or isinstance(kept, int):  # a count of cells, as stages of rasters tell it
        return None
    looked_at = meta.looked_at if isinstance(meta, Meta) else set[str]()
    if ROW_DIGESTS not in looked_at:  # every part that reads a strip's asks, and they are as many as its tiles
        _check(kept, where)
        looked_at.add(ROW_DIGESTS)
    return dict(kept)


def _check(kept: Any, where: object) -> None:
    wrong = misfit(kept, _SHAPE, f"meta.{ROW_DIGESTS}")
    if wrong or ("size" in kept and not {"first", "rows", "digests"} <= kept.keys()):
        raise DamagedError(
            "a receipt tells no digests of pieces",
            where=where,
            expected=f"{wrong.at}: {wrong.expected}" if wrong else "size, first, rows and digests",
            got=wrong.got if wrong else ", ".join(kept),
            do="remove the file; the part is made anew",
        )


def digest_within(receipt: Receipt, within: Within) -> str | None:
    """Digest of what is read of a part; None where that is nothing."""
    pieces = row_digests_of(receipt.meta, f"{receipt.stage}/{receipt.part}")
    if within is None or pieces is None:
        return receipt.digest
    if isinstance(within, str):
        names: Mapping[str, str] | None = pieces.get("names")
        return receipt.digest if names is None else names.get(within)
    if "size" not in pieces:
        return receipt.digest
    (column, row), rows, text = pieces["first"], int(pieces["rows"]), str(pieces["digests"])
    columns = len(text) // (_WIDTH * rows) if rows else 0
    whole = Window.covering(within, float(pieces["size"]))
    across = max(whole.col, column), min(whole.col + whole.ncols, column + columns)
    up = max(whole.row, row), min(whole.row + whole.nrows, row + rows)
    window = (receipt.digest, *across, *up)
    with _guard:
        if window not in _windows:
            while len(_windows) >= REMEMBERED:
                del _windows[next(iter(_windows))]
            _windows[window] = _digest_of_squares(text, rows, column, row, across, up)
        return _windows[window]


def _digest_of_squares(
    text: str, rows: int, column: int, row: int, across: tuple[int, int], up: tuple[int, int]
) -> str | None:
    """Digest of column, row and digest of every square in a window that something lies in; None where nothing does.

    `text`, `rows`: as in `ROW_DIGESTS`, from (`column`, `row`) on; `across`, `up`: first column and row, and those
    behind the last ones.
    """
    squares = []
    for c in range(*across):
        at = _WIDTH * (c - column) * rows
        for r in range(*up):
            digest = text[at + _WIDTH * (r - row) : at + _WIDTH * (r - row + 1)]
            if digest != _NOTHING:
                squares.append([c, r, digest])
    return digest_of(squares) if squares else None
