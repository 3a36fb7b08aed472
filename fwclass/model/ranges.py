"""The usual values of every feature in a model's training rows, and how many values of other data lie outside."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

RANGES = "ranges"
"""Key of a model's card: least and greatest usual value by feature, null for one without any."""

QUANTILES = (0.01, 0.99)
"""What is usual: 2 % of the training rows themselves lie outside."""


def ranges_of(X: NDArray[np.float32], names: Sequence[str]) -> dict[str, list[float] | None]:
    """Usual values of training rows.

    Parameters
    ----------
    X : float32 (rows, features), NaN where a feature has no value.
    names : of the features, in order.

    Returns
    -------
    By name [least, greatest]; None for a feature without any value.
    """
    ranges: dict[str, list[float] | None] = {}
    for k, name in enumerate(names):
        values = X[:, k][np.isfinite(X[:, k])]
        ranges[name] = [float(v) for v in np.quantile(values, QUANTILES)] if len(values) else None
    return ranges


def check_ranges(card: Mapping[str, Any]) -> None:
    """`ValueError` where a card has usual values that are none; one without any says nothing of them."""
    ranges = card.get(RANGES)
    if ranges is None:
        return
    if not isinstance(ranges, Mapping):
        raise ValueError(f"its {RANGES} are no values by feature")
    for name in card["features"]:
        pair = ranges.get(name)
        if pair is None and name in ranges:
            continue
        if not (isinstance(pair, list) and len(pair) == 2 and all(type(v) in (int, float) for v in pair)):
            raise ValueError(f"its {RANGES} of {str(name)[:80]!r} are no pair of numbers")
        if any(abs(v) > sys.float_info.max for v in pair):
            raise ValueError(f"its {RANGES} of {str(name)[:80]!r} are beyond what a number holds")
        if not pair[0] <= pair[1]:
            raise ValueError(f"its {RANGES} of {str(name)[:80]!r} do not rise")


@dataclass
class RangeCounter:
    """How many values of every feature lie outside of the model's usual ones (`QUANTILES`), `outside`, and how many
    were counted, `seen`: int64 (features,), in the order of `names`. Values that are missing count as neither."""

    names: tuple[str, ...]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    outside: NDArray[np.int64]
    seen: NDArray[np.int64]

    @classmethod
    def of(cls, card: Mapping[str, Any], names: Sequence[str]) -> RangeCounter | None:
        """To count with; None where the card does not say what was seen, or says it wrongly."""
        ranges = card.get(RANGES)
        if not isinstance(ranges, Mapping):
            return None
        ends = np.full((2, len(names)), [[-np.inf], [np.inf]])
        for k, name in enumerate(names):
            pair = ranges.get(name)
            if isinstance(pair, Sequence) and len(pair) == 2 and all(isinstance(v, int | float) for v in pair):
                ends[:, k] = pair
        zeros = np.zeros((2, len(names)), np.int64)
        return cls(tuple(names), ends[0], ends[1], zeros[0], zeros[1])

    def add(self, X: NDArray[np.float32]) -> None:
        """Count the rows of `X`, float32 (rows, features)."""
        self.outside += (np.less(X, self.low) | np.greater(X, self.high)).sum(axis=0)
        self.seen += np.isfinite(X).sum(axis=0)

    def counts(self) -> dict[str, list[int]]:
        """[outside, seen] by feature: plain data for a receipt."""
        pairs = zip(self.outside.tolist(), self.seen.tolist(), strict=True)
        return dict(zip(self.names, map(list, pairs), strict=True))


def shares(counts: Sequence[Mapping[str, Sequence[int]]]) -> dict[str, float]:
    """The share of the values outside, 0 to 1, by feature, over all `counts` (`RangeCounter.counts`); the largest
    first."""
    total: dict[str, NDArray[np.int64]] = {}
    for one in counts:
        for name, pair in one.items():
            total[name] = total.get(name, np.zeros(2, np.int64)) + np.asarray(pair, np.int64)
    outside = {name: float(n[0] / n[1]) for name, n in total.items() if n[1]}
    return dict(sorted(outside.items(), key=lambda item: (-item[1], item[0])))
