"""Two runs of a place side by side: whether they are, what they are called, and which of their tiles meet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery
from fwclass.errors import InputError
from fwclass.schema import IDENTITY, MOVED, lie_apart
from fwclass.store.run_location import address_of

TOLD = ("classification", "confidence")
"""Of an echo, beside the other run's."""


def check_same_place(one: Delivery, other: Delivery) -> None:
    """`InputError` for runs whose boxes do not meet: nothing of them would be seen side by side."""
    a, b = (np.array([t["bounds"] for t in d.tiles]).reshape(-1, 6) for d in (one, other))
    if not len(a) or not len(b):
        return
    (low, high), (left, right) = ((box[:, :2].min(axis=0), box[:, 3:5].max(axis=0)) for box in (a, b))
    if (low > right).any() or (left > high).any():
        raise InputError(
            "the two runs are of places that do not meet",
            where=f"{address_of(one.root)} and {address_of(other.root)}",
            expected="two runs of one survey",
            got=" and ".join(
                f"x {p[0]:.0f} to {q[0]:.0f}, y {p[1]:.0f} to {q[1]:.0f}" for p, q in ((low, high), (left, right))
            ),
            do="name another run with --against, or look at each alone",
        )


def tiles_of(other: Delivery, tile: Mapping[str, Any]) -> list[str]:
    """Tiles of another run, whatever their size, that have echoes where `tile` has."""
    low, high = tile["bounds"][:2], tile["bounds"][3:5]
    return [
        str(t["tile"])
        for t in other.tiles
        if all(t["bounds"][k] <= high[k] and low[k] <= t["bounds"][3 + k] for k in (0, 1))
    ]


def same_echo(other: Delivery, values: Mapping[str, Any]) -> dict[str, Any] | None:
    """Class and confidence in another run of the echo with the identity and, within `MOVED`, the place of `values`.

    None where it has none; a confidence that it does not know is NaN.
    """
    x, y = values["x"], values["y"]
    near = {"bounds": [x - MOVED, y - MOVED, 0.0, x + MOVED, y + MOVED, 0.0]}
    for tile in tiles_of(other, near):
        columns = table_columns(other.table(tile), (*IDENTITY, *"xyz", *TOLD))
        rows = np.flatnonzero(np.logical_and.reduce([columns[n] == values[n] for n in IDENTITY]))
        own = {axis: np.array([values[axis]]) for axis in "xyz"}
        rows = rows[~lie_apart(columns, rows, own, np.zeros(len(rows), np.int64))]
        if len(rows):
            return {n: columns[n][rows[0]] if n in columns else np.nan for n in TOLD}
    return None


def known_by(one: Delivery, other: Delivery) -> str:
    """The end of a run's address by which it is known from another's."""
    mine, others = (str(address_of(d.root)).replace("\\", "/").split("/") for d in (one, other))
    length = 1
    while mine != others and mine[-length:] == others[-length:]:
        length += 1
    return "/".join(mine[-length:])
