"""How a feature is distributed within a class: histograms that add up over tiles, and their quantiles.

The bins are the numbers' own: every power of two is cut into 128 equal steps, so one set of bins serves any
unit and range, nothing has to be known beforehand, and a quantile is right to 0.4 % of its value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.model import ClassDef, class_index
from fwclass.schema import Table, column

_MANTISSA = 7
_LOWEST, _HIGHEST = -12, 40
_SIDE = (_HIGHEST - _LOWEST) << _MANTISSA
BINS = 2 * _SIDE + 2
"""Bins of a histogram: negative values, 0 (below 2^-12 in size), positive values (all above 2^40 in the
last), and at the end the rows without a value."""

_INFINITE = 0x7F800000
"""Bits of a float32 from which on there is no finite value."""
_BELOW = ((_LOWEST + 127) << _MANTISSA) - 1
"""Leading bits of the values that count as 0."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def distribution(
    features: Table, reference: NDArray[np.uint8], classes: Sequence[ClassDef]
) -> dict[str, NDArray[np.int64]]:
    """For every column of `features` a histogram (classes, BINS); those of tiles add up to the survey's.

    Rows without a reference class do not count.
    """
    index = class_index(reference, classes).astype(np.int64)
    return {name: _histogram(values, index, len(classes)) for name, values in features.items()}


def pack(
    features: Table, reference: NDArray[np.uint8], classes: Sequence[ClassDef]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The histograms of `distribution`, one after another, without their empty bins: places and counts, int64 (bins
    with an echo,) each. `reference` is uint8 (echoes,).

    A tile fills few of the bins: 127 features in five classes have 8.5 million.
    """
    index, size = class_index(reference, classes).astype(np.int64), len(classes) * BINS
    places, counts = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for k, values in enumerate(features.values()):
        histogram = _histogram(values, index, len(classes)).reshape(-1)
        filled = np.flatnonzero(histogram)
        places.append(filled + k * size)
        counts.append(histogram[filled])
    return np.concatenate(places), np.concatenate(counts)


class Histograms:
    """The sum of histograms that `pack` gave, of the columns `names` by `classes`; one part after another is added."""

    def __init__(self, names: Sequence[str], classes: int) -> None:
        self._names, self._classes = tuple(names), classes
        self._total = np.zeros(len(self._names) * classes * BINS, np.int64)

    def add(self, places: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        """Those of one part more, int64 (bins with an echo,) each."""
        self._total[places] += counts

    def by_column(self) -> dict[str, NDArray[np.int64]]:
        """Of every column a histogram int64 (classes, BINS)."""
        total = self._total.reshape(len(self._names), self._classes, BINS)
        return dict(zip(self._names, total, strict=True))


def _histogram(values: NDArray, index: NDArray[np.int64], classes: int) -> NDArray[np.int64]:
    counts = np.zeros((classes, BINS), np.int64)
    _count(np.ascontiguousarray(values, np.float32).view(np.int32), index, counts)
    return counts


@kernel
def _count(bits, index, counts):  # type: ignore[no-untyped-def]
    """Add float32 values, given by their bits, to the histogram of their row's class; the bin is the exponent and the
    seven leading bits of the mantissa."""
    for i in range(len(bits)):
        if index[i] < 0:
            continue
        size = bits[i] & 0x7FFFFFFF
        if size >= _INFINITE:
            place = BINS - 1
        else:
            step = min(max((size >> (23 - _MANTISSA)) - _BELOW, 0), _SIDE)
            place = _SIDE - step if bits[i] < 0 else _SIDE + step
        counts[index[i], place] += 1


def _edges() -> NDArray[np.float64]:
    """Lower edge of the size of steps 1 .. _SIDE, and the upper edge of the last."""
    step = np.arange(_SIDE + 1)
    return np.ldexp(1.0 + (step & ((1 << _MANTISSA) - 1)) / (1 << _MANTISSA), _LOWEST + (step >> _MANTISSA))


def quantiles(
    histogram: NDArray[np.int64], shares: Sequence[float] = QUANTILES, whole: bool = False
) -> NDArray[np.float64]:
    """Quantiles (classes, shares) of a histogram (classes, BINS); NaN for a class without a value.

    A quantile is the middle of the bin that holds the value of that rank: the smallest value that at least
    this share of the values does not exceed. `whole` says that the feature is a whole number (an echo
    number): the bin's own whole number is given, exact up to 256.
    """
    edges = _edges()
    size = edges[:-1] if whole else 0.5 * (edges[:-1] + edges[1:])
    value = np.concatenate([-size[::-1], [0.0], size])
    running = np.cumsum(histogram[:, :-1], axis=1)
    values = np.full((len(histogram), len(shares)), np.nan)
    for c, line in enumerate(running):
        if line[-1] > 0:
            rank = np.maximum(np.ceil(np.asarray(shares) * line[-1]), 1)
            values[c] = value[np.searchsorted(line, rank)]
    return values


def summary(
    histograms: dict[str, NDArray[np.int64]], names: Sequence[str], shares: Sequence[float] = QUANTILES
) -> dict[str, Any]:
    """Quantiles of every feature and class as plain data for JSON, beside Fan 2013's Table 1.

    ``{"shares": [...], "features": {feature: {class: {"rows", "without_value", "quantiles"}}}}``; quantiles
    are None for a class without values.
    """
    return {
        "shares": list(shares),
        "features": {feature: _by_class(feature, h, names, shares) for feature, h in histograms.items()},
    }


def _by_class(
    feature: str, histogram: NDArray[np.int64], names: Sequence[str], shares: Sequence[float]
) -> dict[str, Any]:
    values = quantiles(histogram, shares, whole=np.dtype(column(feature).dtype).kind in "biu")
    return {
        name: {
            "rows": int(histogram[c].sum()),
            "without_value": int(histogram[c, -1]),
            "quantiles": [None if np.isnan(q) else float(q) for q in values[c]],
        }
        for c, name in enumerate(names)
    }
