"""Digests of pieces of a table, so that who reads a piece needs not be made again when another piece changes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box, TileGrid, millimetres
from fwclass.schema import Table
from fwclass.store.atomic import digest_of
from fwclass.store.receipts import Receipt

CELL = 8.0
"""Edge of the squares of the global grid that have a digest of their own [m]: a halo is known to the next 8 m."""

CELLS = "cells"
"""Where a receipt's meta keeps them: ``{"size": m or 0, "digests": {name: 16 hex digits}}``."""

Within = Box | str | None
"""What a part reads of others: the rows in a box, the piece of a name, or everything."""


def by_place(table: Table, x: NDArray[np.float64], y: NDArray[np.float64]) -> dict[str, Any]:
    """For a receipt's meta: a digest of the rows in every square of `CELL`; rows are at `x`, `y` [m]."""
    mm = round(CELL * 1000)
    column, row = millimetres(x) // mm, millimetres(y) // mm
    order = np.lexsort((row, column))  # stable: rows of a square keep their order
    a, b = column[order], row[order]
    new = np.flatnonzero(np.concatenate([[True], (a[1:] != a[:-1]) | (b[1:] != b[:-1])])) if len(a) else order
    ends = np.append(new[1:], len(a))
    arranged = table.take(order)
    digests = {f"{a[i]}_{b[i]}": _digest(arranged, i, j) for i, j in zip(new, ends, strict=True)}
    return {"size": CELL, "digests": digests}


def by_name(table: Table, names: Iterable[str], offsets: Iterable[int]) -> dict[str, Any]:
    """For a receipt's meta: a digest of every named run of rows ``offsets[k]:offsets[k + 1]``."""
    bounds = [int(o) for o in offsets]
    runs = zip(names, bounds[:-1], bounds[1:], strict=True)
    return {"size": 0, "digests": {name: _digest(table, i, j) for name, i, j in runs}}


def _digest(table: Table, first: int, last: int) -> str:
    state = hashlib.blake2b(digest_size=8)
    for name in sorted(table):
        values = table[name]
        state.update(f"{name} {values.dtype.str} {last - first}\n".encode())
        state.update(np.ascontiguousarray(values[first:last]).tobytes())
    return state.hexdigest()


def digest_within(receipt: Receipt, within: Within) -> str | None:
    """Digest of what is read of a part; None where that is nothing."""
    cells: Mapping[str, Any] | None = receipt.meta.get(CELLS)
    if within is None or cells is None or (cells["size"] > 0) != isinstance(within, Box):
        return receipt.digest
    digests: Mapping[str, str] = cells["digests"]
    if isinstance(within, str):
        return digests.get(within)
    squares = {t.key for t in TileGrid(float(cells["size"])).touching(within)}
    read = {name: digest for name, digest in digests.items() if name in squares}
    return digest_of(read) if read else None
