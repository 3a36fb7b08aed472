"""What the colours of a column span: all but the hundredth of its values at either end, where the strays are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns
from fwclass.delivery.opened import Delivery

ENDS = (0.01, 0.99)
"""Quantiles between which values have colours of their own."""

SAMPLED = 8
"""Tiles, about, that are looked at."""


@dataclass(frozen=True)
class ColourSpan:
    """From `low` to `high` colours tell values apart; `least` and `most` are the ends of what was looked at.

    All are NaN where there is no value.
    """

    low: float
    high: float
    least: float
    most: float

    @classmethod
    def over(cls, values: NDArray) -> ColourSpan:
        """Of finite values; from end to end where nearly all are one, as flags are."""
        if not len(values):
            return cls(math.nan, math.nan, math.nan, math.nan)
        least, most = float(values.min()), float(values.max())
        low, high = np.quantile(values, ENDS, method="nearest").tolist()
        return cls(low, high, least, most) if low < high else cls(least, most, least, most)

    @classmethod
    def joined(cls, spans: Sequence[ColourSpan]) -> ColourSpan:
        """The narrowest that holds all."""
        least, most = (
            [float(end.reduce([getattr(s, name) for s in spans])) for name in names]
            for end, names in ((np.fmin, ("low", "least")), (np.fmax, ("high", "most")))
        )
        return cls(least[0], most[0], least[1], most[1])


def finite(values: NDArray) -> NDArray[np.float64]:
    """Those that are numbers."""
    return np.asarray(values[np.isfinite(values)], np.float64)


def span_of(delivery: Delivery, name: str) -> ColourSpan:
    """Of a column in some tiles, in the first with any value where those have none."""
    keys = [str(t["tile"]) for t in delivery.tiles]
    values = np.concatenate([_finite(delivery, key, name) for key in keys[:: max(1, len(keys) // SAMPLED)]])
    for key in keys if not len(values) else ():
        if len(values := _finite(delivery, key, name)):
            break
    return ColourSpan.over(values)


def _finite(delivery: Delivery, key: str, name: str) -> NDArray[np.float64]:
    """Nothing where the run has no such column."""
    return finite(table_columns(delivery.table(key), (name,)).get(name, np.empty(0)))
