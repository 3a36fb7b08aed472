"""Support vector machines: scores of planes, decisions between pairs of classes.

A row's sums run in a fixed order, so that a result depends on no other row (a library's matrix product would).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.support_blocks import support_blocks
from fwclass.kernel import kernel
from fwclass.model import KernelMachine, LinearMachine

STEEPEST = 700.0
"""Largest exponent that is raised; exp(710) is infinite."""


def linear_scores(X: NDArray[np.float32], model: LinearMachine) -> NDArray[np.float64]:
    """Scores (rows, scores) of a matrix (rows, features) that fits the checked `model`."""
    scores = np.empty((len(X), len(model.bias)))
    _planes(model.preparation(X), np.ascontiguousarray(model.weights), model.bias, scores)
    return scores


@kernel
def _planes(x, weights, bias, scores):  # type: ignore[no-untyped-def]
    for i in range(len(x)):
        for k in range(len(bias)):
            total = 0.0
            for m in range(x.shape[1]):
                total += weights[k, m] * x[i, m]
            scores[i, k] = total + bias[k]


def pair_decisions(X: NDArray[np.float32], model: KernelMachine) -> NDArray[np.float64]:
    """Decisions (rows, pairs) of a matrix (rows, features) that fits the checked `model`; see `KernelMachine`.

    They are computed in single precision with a bound of their error (`support_blocks`); a row with a decision that is
    nearer to zero than its bound is computed again in double precision. So every sign is that of double precision,
    and a value elsewhere is off by less than itself, mostly by less than 0.001.
    """
    ready, blocks = model.preparation(X), support_blocks(model)
    if blocks is None:
        decisions, unsure = np.empty((len(X), len(model.bias))), np.arange(len(X))
    else:
        decisions, bound = blocks(ready, model.bias)
        unsure = np.flatnonzero(~(np.abs(decisions) > bound).all(axis=1))
    if len(unsure):
        decisions[unsure] = double_decisions(ready[unsure], model)
    return decisions


def double_decisions(ready: NDArray[np.float64], model: KernelMachine) -> NDArray[np.float64]:
    """As `pair_decisions`, of prepared rows, all in double precision."""
    decisions = np.empty((len(ready), len(model.bias)))
    ends = np.zeros(len(model.counts) + 1, np.int64)
    np.cumsum(model.counts, out=ends[1:])
    by_feature = np.ascontiguousarray(model.vectors.T)
    _decide(ready, by_feature, np.ascontiguousarray(model.dual), model.bias, ends, float(model.gamma[0]), decisions)
    return decisions


@kernel
def _decide(x, vectors, dual, bias, ends, gamma, decisions):  # type: ignore[no-untyped-def]
    """`vectors` (features, vectors): the inner loop runs over neighbours in memory."""
    near, n = np.empty(vectors.shape[1]), len(ends) - 1
    for row in range(len(x)):
        near[:] = 0.0
        for m in range(len(vectors)):
            here = x[row, m]
            for s in range(len(near)):
                apart = here - vectors[m, s]
                near[s] += apart * apart
        for s in range(len(near)):
            near[s] = np.exp(-gamma * near[s])
        pair = 0
        for i in range(n):
            for j in range(i + 1, n):
                total = 0.0
                for s in range(ends[i], ends[i + 1]):
                    total += dual[j - 1, s] * near[s]
                for s in range(ends[j], ends[j + 1]):
                    total += dual[i, s] * near[s]
                decisions[row, pair] = total + bias[pair]
                pair += 1


def votes_and_shares(decisions: NDArray[np.float64], n: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Votes (rows, n) of the pairs of `n` classes, and shares (rows, n) that add up to 1.

    The shares couple the pairs: with P(i | i or j) = 1 / (1 + exp(-d_ij)) share i is 1 / (1 + sum over j of
    exp(-d_ij)), then all are scaled to 1. They are no calibrated probabilities.

    Source: Price et al. 1995, as in Wu, Lin and Weng 2004.
    """
    votes = np.zeros((len(decisions), n), np.int64)
    against = np.ones((len(decisions), n))
    pair = 0
    for i in range(n):
        for j in range(i + 1, n):
            d = decisions[:, pair]
            votes[:, i] += d > 0
            votes[:, j] += ~(d > 0)
            against[:, i] += np.exp(np.minimum(-d, STEEPEST))
            against[:, j] += np.exp(np.minimum(d, STEEPEST))
            pair += 1
    shares = 1.0 / against
    return votes, shares / shares.sum(axis=1, keepdims=True)
