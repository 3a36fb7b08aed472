"""Split rules over codes: values by their rank, so that a node sorts or counts small whole numbers.

`exact` gives every distinct value its own code, `histogram` every quantile bin of the whole sample. A threshold stands
between two codes that a node holds; "missing" is the greatest code, so that a node may also tell known from missing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import inlined, kernel
from fwclass.sorting import sort_few
from fwclass.train.gain import score, term

COUNTED = 1024
"""Features of at most so many codes are counted in large nodes, not sorted."""

SPARSE = 8
"""A node with fewer rows than one for so many codes is sorted."""

_WEIGHT, _CODE = np.uint64(8), np.uint64(32)
_BYTE, _TIMES = np.uint64(0xFF), np.uint64(0xFFFFFF)


class Ranks(NamedTuple):
    """What the codes of the features mean; edges of feature f are ``edge[offsets[f]:offsets[f + 1]]``.

    exact : code k is value edge[k]; its threshold is halfway to the next value in the node.
    histogram : code k is edge[k - 1] <= value < edge[k]; its threshold is edge[k].
    """

    edge: NDArray[np.float32]  # (edges,), ascending within a feature
    offsets: NDArray[np.int64]  # (features + 1,)
    missing: NDArray[np.int64]  # (features,), the code of NaN
    exact: bool


def _between(low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.float32]:
    """float32 t with low < t <= high, halfway but for rounding."""
    middle = ((low.astype(np.float64) + high) / 2).astype(np.float32)
    return np.where(middle > low, middle, high)


def rank(columns: NDArray[np.float32], bins: int | None) -> tuple[NDArray, Ranks]:
    """Codes (features, rows) of float32 `columns`, and their meaning; `bins` at most of a feature, None for `exact`.

    Codes are uint32, or uint8 for up to 255 bins. A bin holds about as many rows as another, and all of a value.
    """
    codes = np.empty(columns.shape, np.uint32 if bins is None else np.uint8)
    edges, missing = [], []
    for column, code in zip(columns, codes, strict=True):
        known = np.sort(column[~np.isnan(column)])
        value = np.unique(known)
        edge = value
        if bins is not None:
            upper = np.arange(1, len(value))
            if len(value) > bins:
                at = known[np.arange(1, bins) * len(known) // bins]
                upper = np.setdiff1d(np.searchsorted(value, at), [0])
            edge = _between(value[upper - 1], value[upper])
        bin_of = np.searchsorted(edge, column, "right" if bins is not None else "left")
        missing.append(len(edge) + (bins is not None))
        code[:] = np.where(np.isnan(column), missing[-1], bin_of)
        edges.append(edge)
    offsets = np.zeros(len(edges) + 1, np.int64)
    np.cumsum([len(e) for e in edges], out=offsets[1:])
    return codes, Ranks(np.concatenate(edges), offsets, np.array(missing, np.int64), bins is None)


@kernel
def threshold(ranks, feature, low, high):  # type: ignore[no-untyped-def]
    """float32 (), a threshold in the feature's own unit between codes (index of a bin) `low` < `high` that follow each
    other in a node; infinite before "missing"."""
    if high == ranks.missing[feature]:
        return np.float32(np.inf)
    a = ranks.edge[ranks.offsets[feature] + low]
    if not ranks.exact:
        return a
    b = ranks.edge[ranks.offsets[feature] + high]
    middle = np.float32((np.float64(a) + np.float64(b)) / 2)
    return middle if middle > a else b


@kernel
def _best_counted(histogram, label, weight, class_weight, total, left, rows, codes, n_codes, whole, table):  # type: ignore[no-untyped-def]
    """(gain, low, high) by counting draws per (code, class)."""
    histogram[:n_codes] = 0
    for i in range(len(rows)):
        histogram[np.uint64(codes[rows[i]]), np.uint64(label[i])] += weight[i]
    best, low, high, last = -(1 << 62), 0, 0, -1
    left[:] = 0
    n_left = 0
    for k in range(n_codes):
        added = 0
        for c in range(len(total)):
            added += histogram[k, c]
        if added == 0:
            continue
        if last >= 0:
            below, above = 0, 0
            for c in range(len(total)):
                below += term(table, left[c])
                above += term(table, total[c] - left[c])
            gain = score(table, below, above, n_left, whole - n_left)
            if gain > best:
                best, low, high = gain, last, k
        for c in range(len(total)):
            h = histogram[k, c] * class_weight[c]
            left[c] += h
            n_left += h
        last = k
    return best, low, high


RADIX = 96
"""Nodes of at least so many rows are sorted digit by digit."""


@kernel
def _by_digits(packed, other, bucket, n_codes):  # type: ignore[no-untyped-def]
    """Sort by the code, least digit first; returns the one of the two buffers that holds the result."""
    digit = np.uint64(8 if len(packed) < 2048 else 11)
    size = np.int64(1) << np.int64(digit)
    mask, shift = np.uint64(size - 1), _CODE
    while np.int64(n_codes - 1) >> np.int64(shift - _CODE) > 0:
        bucket[:size] = 0
        for i in range(len(packed)):
            bucket[packed[i] >> shift & mask] += 1
        at = 0
        for d in range(size):
            n = bucket[d]
            bucket[d] = at
            at += n
        for i in range(len(packed)):
            d = packed[i] >> shift & mask
            other[bucket[d]] = packed[i]
            bucket[d] += 1
        packed, other = other, packed
        shift += digit
    return packed


@kernel
def _best_sorted(packed, other, bucket, label, weight, class_weight, total, left, rows, codes, n_codes, whole, table):  # type: ignore[no-untyped-def]
    """The same by sorting the rows."""
    packed, other = packed[: len(rows)], other[: len(rows)]
    for i in range(len(rows)):
        packed[i] = np.uint64(codes[rows[i]]) << _CODE | np.uint64(weight[i]) << _WEIGHT | np.uint64(label[i])
    if len(rows) < RADIX:
        sort_few(packed)
    else:
        packed = _by_digits(packed, other, bucket, n_codes)
    best, low, high = -(1 << 62), np.int64(0), np.int64(0)
    if packed[0] >> _CODE == packed[-1] >> _CODE:
        return best, low, high
    left[:] = 0
    below, above, n_left = 0, 0, 0
    for c in range(len(total)):
        above += term(table, total[c])
    for i in range(len(packed) - 1):
        c = packed[i] & _BYTE
        w = np.int64((packed[i] >> _WEIGHT) & _TIMES) * class_weight[c]
        l, r = left[c], total[c] - left[c]
        below += term(table, l + w) - term(table, l)
        above += term(table, r - w) - term(table, r)
        left[c] = l + w
        n_left += w
        code, following = packed[i] >> _CODE, packed[i + 1] >> _CODE
        if code != following:
            gain = score(table, below, above, n_left, whole - n_left)
            if gain > best:
                best, low, high = gain, np.int64(code), np.int64(following)
    return best, low, high


@inlined
def best_rank(node, rows, codes, n_codes, whole, table):  # type: ignore[no-untyped-def]
    """(divides, gain, low, high): the best threshold of a feature at a node stands between codes `low` and `high`."""
    label, weight, class_weight, total, left = node.label, node.weight, node.class_weight, node.total, node.left
    if n_codes <= len(node.histogram) and n_codes <= SPARSE * len(rows):
        gain, low, high = _best_counted(
            node.histogram, label, weight, class_weight, total, left, rows, codes, n_codes, whole, table
        )
    else:
        gain, low, high = _best_sorted(
            node.packed,
            node.other,
            node.bucket,
            label,
            weight,
            class_weight,
            total,
            left,
            rows,
            codes,
            n_codes,
            whole,
            table,
        )
    return high > 0, gain, low, high
