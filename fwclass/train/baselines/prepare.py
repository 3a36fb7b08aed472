"""What a support vector machine needs of its sample: fewer rows, no gaps, features of one size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.model import Preparation
from fwclass.train.sample import Sample


def preparation(X: NDArray[np.float32], scaling: str) -> Preparation:
    """Medians that stand for missing values, and shift and scale, one of every feature, of the training rows `X`.

    X is (rows, features). A feature without any value gets 0 for its median; one that does not vary keeps its scale."""
    fill = np.array([_median(column) for column in X.T])
    wide = np.where(np.isnan(X), fill, X).astype(np.float64)
    if scaling == "standard":
        shift, scale = wide.mean(axis=0), wide.std(axis=0)
    else:
        shift, scale = wide.min(axis=0), np.ptp(wide, axis=0)
    return Preparation(fill, shift, np.where(scale > 0, scale, 1.0))


def _median(column: NDArray[np.float32]) -> float:
    finite = column[~np.isnan(column)]
    return float(np.median(finite.astype(np.float64))) if len(finite) else 0.0


def fewer(sample: Sample, rows: int, edge: float = 0.0) -> Sample:
    """At most `rows` rows: of every class those with the smallest hashes, all classes alike as far as they reach.

    With `edge`, and where the sample knows its places, all squares of that edge [m] alike, too, as far as they reach.
    """
    if sample.rows <= rows:
        return sample
    counts = np.sort(sample.counts[sample.counts > 0])
    left, each = rows, 0
    for k, count in enumerate(counts):
        each = left // (len(counts) - k)
        if count > each:
            break
        left -= int(count)
    keep = []
    for c in range(len(sample.eligible)):
        mine = np.flatnonzero(sample.y == c)
        mine = mine[np.argsort(sample.hash[mine], kind="stable")]
        if edge and len(sample.place):
            mine = mine[np.argsort(_turn(sample.place[mine], edge), kind="stable")]
        keep.append(mine[: max(1, each)])
    return sample.take(np.sort(np.concatenate(keep)))


def _turn(place: NDArray[np.int64], edge: float) -> NDArray[np.int64]:
    """How many rows before it lie in the same square of `edge` [m], for every row."""
    _, square = np.unique(place // round(1000 * edge), axis=0, return_inverse=True)
    square = square.ravel()
    order = np.argsort(square, kind="stable")
    first = np.searchsorted(square[order], square[order])
    turn = np.empty(len(square), np.int64)
    turn[order] = np.arange(len(square)) - first
    return turn


def pieces(sample: Sample, folds: int) -> NDArray[np.int64]:
    """A fold (rows,) for every row: each strip is cut into pieces of consecutive pulses, dealt out in turn.

    Neighbouring echoes of a strip share a piece, so that a fold is not judged by the neighbours of its own rows.
    """
    count = 4 * folds
    order = np.argsort(sample.key, kind="stable")
    fold = np.empty(sample.rows, np.int64)
    fold[order] = np.arange(sample.rows) * count // max(1, sample.rows) % folds
    return fold
