"""Two runs of a place side by side: whether they are, what they are called, and which of their tiles meet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery
from fwclass.errors import InputError
from fwclass.store.run_location import address_of

SAMPLED = 8
"""Tiles, about, whose values span the colours of a column."""


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


def known_by(one: Delivery, other: Delivery) -> str:
    """The end of a run's address by which it is known from another's."""
    mine, others = (str(address_of(d.root)).replace("\\", "/").split("/") for d in (one, other))
    length = 1
    while mine != others and mine[-length:] == others[-length:]:
        length += 1
    return "/".join(mine[-length:])


def span_of(delivery: Delivery, name: str) -> tuple[float, float]:
    """From one hundredth to 99 of a column's values in some tiles, in the first with any where those have none; NaN for
    none at all."""
    keys = [str(t["tile"]) for t in delivery.tiles]
    finite = np.concatenate([_finite(delivery, key, name) for key in keys[:: max(1, len(keys) // SAMPLED)]])
    for key in keys if not len(finite) else ():
        if len(finite := _finite(delivery, key, name)):
            break
    low, high = np.quantile(finite, (0.01, 0.99)).tolist() if len(finite) else (math.nan, math.nan)
    return low, high


def _finite(delivery: Delivery, key: str, name: str) -> NDArray[np.float64]:
    """Nothing where the run has no such column."""
    values = table_columns(delivery.table(key), (name,)).get(name, np.empty(0)).astype(np.float64)
    return values[np.isfinite(values)]
