"""Training: a sample of the labelled tiles, trees from it, one forest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fwclass import __version__
from fwclass.hashing import seeded
from fwclass.model import FORMAT, ClassDef, Forest, Tree, assemble
from fwclass.schema import Table
from fwclass.stage import Params, Stage
from fwclass.train.grow import count_out_of_bag, draw_bag, entropy_table, grow, workspace
from fwclass.train.sample import Sample, draw, join, review


class TrainParams(Params):
    """Parameters of the sample and the forest; numbers and sources stand in `conf/base.yaml`."""

    seed: int = Field(ge=0)
    samples_per_class: int = Field(ge=1)
    trees: int = Field(ge=1, le=65535)
    features_per_split: int = Field(ge=0)
    steps: int = Field(ge=1, le=1000)
    min_samples_split: int = Field(ge=2)
    bagging: float = Field(gt=0, le=1)

    def per_split(self, features: int) -> int:
        """Features drawn at a node: int(lb M + 1) unless given (Fan 2013, eq. 4)."""
        return min(features, self.features_per_split or int(math.log2(features) + 1))


def candidates(
    features: Table,
    reference: NDArray[np.uint8],
    key: NDArray[np.uint64],
    inside: NDArray[np.bool_],
    params: TrainParams,
    classes: Sequence[ClassDef],
) -> Sample:
    """The rows of one tile that may train.

    Parameters
    ----------
    features : the feature columns and nothing else, core rows of the tile; NaN is "no value".
    reference : uint8 (rows,), reference class codes.
    key : uint64 (rows,), `schema.canonical_key` of the rows.
    inside : bool (rows,), the row lies in a training area.
    classes : the classes in the order of the votes.
    """
    return draw(features, reference, key, inside, classes, params.samples_per_class, params.seed)


def merge(samples: Iterable[Sample], params: TrainParams) -> Sample:
    """The survey's sample: that of the union of all tiles, whatever the tiling and the order."""
    return join(samples, params.samples_per_class)


def _bag(rows: int, tree: int, params: TrainParams) -> tuple[NDArray[np.int32], NDArray[np.uint64]]:
    """How often every row was drawn for `tree`, and the generator's state after that."""
    state = np.array([seeded(params.seed, tree + 1)], np.uint64)
    weight = np.zeros(rows, np.int32)
    draw_bag(state, max(1, round(rows * params.bagging)), weight)
    return weight, state


def grow_tree(X: NDArray[np.float32], y: NDArray[np.uint8], n_classes: int, tree: int, params: TrainParams) -> Tree:
    """Grow tree number `tree` from a bootstrap of the sample (Fan 2013).

    A node draws m features without replacement, tries the thresholds min + k (max - min) / steps, k = 1 ..
    steps, of each and takes the largest information gain, the first among equals; x < t goes left, x >= t
    and NaN right. A feature that is constant in the node cannot divide it; where none of the m can, further
    ones are drawn. A node is a leaf when it is pure, smaller than `min_samples_split`, or no feature
    divides it; on a tie of classes it gets the first.

    Parameters
    ----------
    X : float32 (rows, features), finite or NaN.
    y : uint8 (rows,), below `n_classes`.

    Returns
    -------
    (feature, threshold, child) as in `Forest`; the same for the same sample, seed and tree number.
    """
    X, y = np.asarray(X, np.float32), np.asarray(y, np.uint8)
    if X.ndim != 2 or len(X) != len(y) or len(y) == 0:
        raise ValueError(f"a sample of {X.shape} values and {y.shape} classes cannot be trained on")
    if np.isinf(X).any() or int(y.max()) >= n_classes:
        raise ValueError("infinite values or unknown classes in the sample")
    weight, state = _bag(len(y), tree, params)
    columns = np.ascontiguousarray(X.T)
    table = entropy_table(int(weight.sum()))
    node = workspace(len(y), len(columns), n_classes, params.steps)
    per_split = params.per_split(len(columns))
    return grow(columns, y, weight, state, per_split, params.min_samples_split, table, node)


def grow_trees(sample: Sample, classes: Sequence[ClassDef], first: int, count: int, params: TrainParams) -> list[Tree]:
    """Trees number `first` to ``first + count - 1``; parts of a forest that is grown by several workers."""
    return [grow_tree(sample.X, sample.y, len(classes), t, params) for t in range(first, first + count)]


def card(sample: Sample, classes: Sequence[ClassDef], params: TrainParams) -> dict[str, Any]:
    """What a model says about itself: plain data for JSON."""
    return {
        "format": FORMAT,
        "features": list(sample.features),
        "classes": [{"name": c.name, "code": c.code, "codes": list(c.codes)} for c in classes],
        "params": params.model_dump(mode="json"),
        "samples": [int(n) for n in sample.counts],
        "eligible": [int(n) for n in sample.eligible],
        "training": sample.digest,
        "fwclass": __version__,
        "notes": list(review(sample, classes)),
    }


def out_of_bag(sample: Sample, trees: Sequence[Tree], n_classes: int, params: TrainParams) -> dict[str, Any]:
    """Accuracy on the sample, each row judged by the trees that did not see it; `trees` are all, in order.

    ``accuracy`` is the share of right rows, ``rows`` how many could be judged, ``per_class`` the share of
    right rows of every class; None where no row could be judged.
    """
    votes = np.zeros((sample.rows, n_classes), np.uint16)
    for number, (feature, threshold, child) in enumerate(trees):
        weight, _ = _bag(sample.rows, number, params)
        count_out_of_bag(sample.X, feature, threshold, child, weight, votes)
    judged = votes.any(axis=1)
    right = votes.argmax(axis=1)[judged] == sample.y[judged]
    seen = np.bincount(sample.y[judged], minlength=n_classes)
    hits = np.bincount(sample.y[judged][right], minlength=n_classes)
    return {
        "accuracy": float(right.mean()) if len(right) else None,
        "rows": int(judged.sum()),
        "per_class": [float(h / s) if s else None for h, s in zip(hits, seen, strict=True)],
    }


def train(sample: Sample, trees: Sequence[Tree], params: TrainParams, classes: Sequence[ClassDef]) -> Forest:
    """The forest of all `trees` (in order of their number), with its card and its out-of-bag accuracy."""
    written = card(sample, classes, params)
    written["out_of_bag"] = out_of_bag(sample, trees, len(classes), params)
    return assemble(trees, written)


TRAIN_SAMPLE = Stage(
    name="sample",
    version=1,
    kind="tile",
    function=candidates,
    params=TrainParams,
    reads=("strip", "pulse", "echo_number", "reference"),
)
TRAIN_TREES = Stage(name="trees", version=1, kind="gather", function=grow_trees, params=TrainParams)
TRAIN = Stage(name="train", version=1, kind="gather", function=train, params=TrainParams)
