"""Training: a sample of the labelled tiles, trees from it, one forest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import __version__
from fwclass.model import FORMAT, ClassDef, Forest, Tree, assemble
from fwclass.model.ranges import RANGES, ranges_of
from fwclass.schema import Table
from fwclass.stage import Computation
from fwclass.train.bag import bag
from fwclass.train.gain import GINI, entropy_table
from fwclass.train.grow import count_out_of_bag, grow
from fwclass.train.importance import summary
from fwclass.train.node import workspace
from fwclass.train.params import TrainParams
from fwclass.train.ranked import COUNTED, Ranks, rank
from fwclass.train.sample import Sample, draw, join, review
from fwclass.train.weights import whole_weights


def candidates(
    features: Table,
    reference: NDArray[np.uint8],
    key: NDArray[np.uint64],
    inside: NDArray[np.bool_],
    params: TrainParams,
    classes: Sequence[ClassDef],
    place: NDArray[np.int64] | None = None,
    first: NDArray[np.bool_] | None = None,
) -> Sample:
    """The rows of one tile that may train.

    Parameters
    ----------
    features : the feature columns and nothing else, core rows of the tile; NaN is "no value".
    reference : uint8 (rows,), reference class codes.
    key : uint64 (rows,), `schema.canonical_key` of the rows.
    inside : bool (rows,), the row lies in a training area.
    classes : the classes in the order of the votes.
    place : int64 (rows, 2), x and y in whole millimetres, where the sample is to know.
    first : bool (rows,), rows that are drawn before all others, as far as `corrected_share` lets them.
    """
    return draw(features, reference, key, inside, classes, params.samples_per_class, params.seed, place, first)


def merge(samples: Iterable[Sample], params: TrainParams) -> Sample:
    """The survey's sample: that of the union of all tiles, whatever the tiling and the order."""
    return join(samples, params.samples_per_class, params.corrected_share)


class Grower:
    """Grows the trees of one sample; what they share is prepared once.

    A node draws m features without replacement, tries the thresholds that the split rule gives each, and takes the
    best by the criterion, the first among equals; x < t goes left, x >= t and NaN right. A feature that is constant
    in the node cannot divide it; where none of the m can, further ones are drawn. A node is a leaf when it is pure,
    has fewer draws than `min_samples_split`, or no feature divides it; it gives its heaviest class, on a tie the first.

    Equal width (Fan 2013): min + k (max - min) / steps, k = 1 .. steps. Exact: halfway between neighbouring values.
    Histogram: between neighbouring bins. The last two may also divide known from missing (t infinite).

    Parameters
    ----------
    X : float32 (rows, features), finite or NaN.
    y : uint8 (rows,), below the number of `names`.
    names : of the classes.
    """

    def __init__(self, X: NDArray[np.float32], y: NDArray[np.uint8], names: Sequence[str], params: TrainParams) -> None:
        X, y = np.asarray(X, np.float32), np.asarray(y, np.uint8)
        if X.ndim != 2 or len(X) != len(y) or len(y) == 0:
            raise ValueError(f"a sample of {X.shape} values and {y.shape} classes cannot be trained on")
        if np.isinf(X).any() or int(y.max()) >= len(names):
            raise ValueError("infinite values or unknown classes in the sample")
        self.params, self.y = params, y
        self.columns: NDArray = np.ascontiguousarray(X.T)
        self.ranks: Ranks | None = None
        if params.split != "equal-width":
            self.columns, self.ranks = rank(self.columns, params.bins if params.split == "histogram" else None)
        self.class_weight = whole_weights(params.class_weights, np.bincount(y, minlength=len(names)), names)

    def tree(self, number: int) -> Tree:
        """(feature, threshold, child) as in `Forest`; the same for the same sample, seed and number."""
        params = self.params
        drawn, state = bag(len(self.y), number, params.drawing)
        table = GINI
        if params.criterion == "entropy":
            table = entropy_table(int((drawn * self.class_weight[self.y]).sum()))
        codes = 0 if self.ranks is None else min(COUNTED, int(self.ranks.missing.max()) + 1)
        node = workspace(len(self.y), len(self.columns), self.class_weight, params.steps, codes)
        per_split = params.per_split(len(self.columns))
        return grow(self.columns, self.ranks, self.y, drawn, state, per_split, params.min_samples_split, table, node)


def grow_trees(sample: Sample, classes: Sequence[ClassDef], first: int, count: int, params: TrainParams) -> list[Tree]:
    """Trees number `first` to ``first + count - 1``; parts of a forest that is grown by several workers."""
    grower = Grower(sample.X, sample.y, [c.name for c in classes], params)
    return [grower.tree(t) for t in range(first, first + count)]


def plain_card(sample: Sample, classes: Sequence[ClassDef], params: TrainParams) -> dict[str, Any]:
    """What reading a model asks for, and what it learned from: plain data for JSON."""
    return {
        "format": FORMAT,
        "features": list(sample.features),
        "classes": [c.plain() for c in classes],
        "params": params.model_dump(mode="json"),
        "samples": [int(n) for n in sample.counts],
        "eligible": [int(n) for n in sample.eligible],
        "training": sample.digest,
        "fwclass": __version__,
        "notes": [],
    }


def card(sample: Sample, classes: Sequence[ClassDef], params: TrainParams) -> dict[str, Any]:
    """What a model says about itself, with remarks on its rows and the ranges of its features: plain data for JSON."""
    notes, ranges = list(review(sample, classes)), ranges_of(sample.X, sample.features)
    return {**plain_card(sample, classes, params), "notes": notes, RANGES: ranges}


def out_of_bag(sample: Sample, trees: Sequence[Tree], n_classes: int, params: TrainParams) -> dict[str, Any]:
    """Accuracy on the sample, each row judged by the trees that did not see it; `trees` are all, in order.

    ``accuracy`` is the share of right rows, ``rows`` how many could be judged, ``per_class`` the share of
    right rows of every class; None where no row could be judged.
    """
    votes, columns = np.zeros((sample.rows, n_classes), np.uint16), np.ascontiguousarray(sample.X.T)
    for number, (feature, threshold, child) in enumerate(trees):
        weight, _ = bag(sample.rows, number, params.drawing)
        count_out_of_bag(columns, feature, threshold, child, weight, votes)
    judged = votes.any(axis=1)
    right = votes.argmax(axis=1)[judged] == sample.y[judged]
    judged_rows = np.bincount(sample.y[judged], minlength=n_classes)
    hits = np.bincount(sample.y[judged][right], minlength=n_classes)
    return {
        "accuracy": float(right.mean()) if len(right) else None,
        "rows": int(judged.sum()),
        "per_class": [float(h / s) if s else None for h, s in zip(hits, judged_rows, strict=True)],
    }


def train(
    sample: Sample,
    trees: Sequence[Tree],
    params: TrainParams,
    classes: Sequence[ClassDef],
    drops: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None,
) -> Forest:
    """The forest of all `trees` (in order of their number), with its card and its out-of-bag accuracy.

    `drops` of all trees, int64 (trees, features, repeats) and (trees,) as `importance.drops` counts them, become the
    card's ``importance``.
    """
    facts = card(sample, classes, params)
    per_split = params.features_per_split
    if isinstance(per_split, int) and per_split > len(sample.features):
        facts["notes"].append(f"train.features_per_split is {per_split}: all {len(sample.features)} features are tried")
    facts["out_of_bag"] = out_of_bag(sample, trees, len(classes), params)
    if drops is not None:
        facts["importance"] = summary(sample.features, *drops)
    return assemble(trees, facts)


TRAIN_SAMPLE = Computation(name="sample", version=7)
TRAIN_TREES = Computation(name="trees", version=1)
TRAIN_IMPORTANCE = Computation(name="importance", version=1)
TRAIN = Computation(name="train", version=5)
