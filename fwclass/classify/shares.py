"""What every kind of model says of a sample: the class, and how the classes share it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.boosted import probabilities, raw_scores
from fwclass.classify.machines import linear_scores, pair_decisions, votes_and_shares
from fwclass.classify.vote import count, lay_out
from fwclass.errors import InputError
from fwclass.model import Boosted, Contextual, Forest, KernelMachine, LinearMachine, Model, TwoLayer

Answer = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Index of the class (rows,), shares (rows, classes) that add up to 1."""


def answer(X: NDArray[np.float32], model: Model) -> Answer:
    """Class and shares of every row of X, float32 (rows, features) in the order of ``model.deciding``.

    The class is the one that the model's own rule gives, the first on a tie:

    - forest: most votes; shares are votes over trees.
    - boosting: largest score; shares are probabilities, the softmax of the scores.
    - linear SVM: largest score; shares are the softmax of the scores, which is no calibrated probability.
    - RBF SVM: most votes of the pairs; shares see `votes_and_shares`.
    - in context: largest share; shares are the means of both layers, weighed by class.
    - two layers: what the first one says; which echoes the second one answers a row alone does not tell.

    `InputError` if the matrix does not fit the model or the model is damaged.
    """
    model.check()  # once, and of both layers, for it looks at every node
    return _answer(X, model)


def _answer(X: NDArray[np.float32], model: Model) -> Answer:
    """`answer` of a model that was checked."""
    return _ANSWERS[type(model)](fitting(X, model), model)


def fitting(X: NDArray[np.float32], model: Model) -> NDArray[np.float32]:
    """X (rows, features), if it has the model's columns; else an `InputError`."""
    X = np.asarray(X)
    if X.ndim != 2 or X.shape[1] != len(model.deciding):
        raise InputError(
            f"the samples do not fit the {model.kind}",
            expected=f"{len(model.deciding)} columns: {', '.join(model.deciding)}",
            got=f"shape {X.shape}",
            do="compute the features that the model was trained with",
        )
    return X


def _by_forest(X: NDArray[np.float32], model: Forest) -> Answer:
    votes = count(X, lay_out(model))
    return votes.argmax(axis=1), votes / float(model.trees)


def _by_boosting(X: NDArray[np.float32], model: Boosted) -> Answer:
    scores = raw_scores(X, model)
    shares = probabilities(scores, len(model.codes))
    return (scores[:, 0] > 0).astype(np.int64) if scores.shape[1] < shares.shape[1] else scores.argmax(axis=1), shares


def _by_planes(X: NDArray[np.float32], model: LinearMachine) -> Answer:
    scores = linear_scores(X, model)
    if scores.shape[1] == 1:
        return (scores[:, 0] > 0).astype(np.int64), probabilities(scores, 2)
    return scores.argmax(axis=1), probabilities(scores, scores.shape[1])


def _by_pairs(X: NDArray[np.float32], model: KernelMachine) -> Answer:
    votes, shares = votes_and_shares(pair_decisions(X, model), len(model.codes))
    return votes.argmax(axis=1), shares


def _in_context(X: NDArray[np.float32], model: Contextual) -> Answer:
    first = _answer(np.ascontiguousarray(X[:, : len(model.features)]), model.coarse)[1]
    shares = (first + _answer(X, model.fine)[1]) / 2
    if model.weights:
        shares *= model.weights
        shares /= shares.sum(axis=1, keepdims=True)
    return shares.argmax(axis=1), shares


def _by_first(X: NDArray[np.float32], model: TwoLayer) -> Answer:
    return _answer(X, model.coarse)


_ANSWERS: dict[type[Model], Callable[[NDArray[np.float32], Any], Answer]] = {
    Forest: _by_forest,
    Boosted: _by_boosting,
    LinearMachine: _by_planes,
    KernelMachine: _by_pairs,
    Contextual: _in_context,
    TwoLayer: _by_first,
}


def entropy(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Entropy (rows,) of shares (rows, classes) over its largest value, ln(classes): 0 sure, 1 undecided.

    0 where there is one class.
    """
    if shares.shape[1] < 2:
        return np.zeros(len(shares))
    terms = np.where(shares > 0, shares * np.log(np.where(shares > 0, shares, 1.0)), 0.0)
    total = np.zeros(len(shares))
    for k in range(shares.shape[1]):  # column by column: the order of the sum is fixed
        total -= terms[:, k]
    return np.clip(total / np.log(shares.shape[1]), 0.0, 1.0)
