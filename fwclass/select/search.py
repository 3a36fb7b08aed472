"""Three ways to choose features: forward (Fan 2013), backward by importance (Xiong 2018), by F-score (Shi 2019)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.select.params import SelectParams
from fwclass.select.score import Evaluate, Names, Score, Trial, as_good
from fwclass.select.work import extra_work, nominal

Scored = Callable[[Trial], Score]


@dataclass(frozen=True)
class Step:
    """One set on the way.

    `score` is that of the set. `tried` are the features that this step added or dropped; `kept` tells whether what was
    added stays (in a given order a feature without gain does not).
    """

    score: Score
    tried: Names
    kept: bool = True


@dataclass(frozen=True)
class Search:
    """The steps in order; `ranks` (feature, figure) by falling figure where the method ranks the candidates."""

    steps: tuple[Step, ...]
    ranks: tuple[tuple[str, float], ...] = ()

    @property
    def best(self) -> Score:
        """The set with the best score, a share; of equals the smallest, then the one with least work."""
        return min((s.score for s in self.steps), key=lambda s: (-s.value, len(s.features), nominal(s.features)))

    @property
    def smallest(self) -> Score:
        """The smallest set that is as good as the best, within one standard error."""
        good = [s.score for s in self.steps if as_good(s.score, self.best)]
        return min(good, key=lambda s: (len(s.features), -s.value, nominal(s.features)))


def forward(candidates: Names, evaluate: Evaluate, scored: Scored, params: SelectParams) -> Search:
    """Add the feature that gives the best score, again and again (Fan 2013, 3.2).

    Of equals the one with less further work, then the first by name. Ends when `params.patience` features in a row
    brought no gain over the best set so far, or nothing is left.
    """
    chosen: Names = ()
    steps: list[Step] = []
    best, idle = -math.inf, 0
    while len(chosen) < len(candidates) and idle < params.patience:
        left = [c for c in candidates if c not in chosen]
        trials = evaluate([in_order((*chosen, c), candidates) for c in left])
        scores = {c: scored(t) for c, t in zip(left, trials, strict=True)}
        best_name = min(left, key=lambda c: (-scores[c].value, extra_work(c, chosen), c))
        steps.append(Step(scores[best_name], (best_name,)))
        chosen = (*chosen, best_name)
        gains = scores[best_name].value > best
        best, idle = max(best, scores[best_name].value), 0 if gains else idle + 1
    return Search(tuple(steps))


def in_given_order(order: Names, candidates: Names, evaluate: Evaluate, scored: Scored) -> Search:
    """Add the features of `order` one after another; one that brings no gain is dropped again (as γ in Fan 2013)."""
    chosen: Names = ()
    steps: list[Step] = []
    best = -math.inf
    for name in order:
        trial = evaluate([in_order((*chosen, name), candidates)])[0]
        result = scored(trial)
        gains = result.value > best
        steps.append(Step(result, (name,), gains))
        if gains:
            chosen, best = (*chosen, name), result.value
    return Search(tuple(steps))


def backward(candidates: Names, evaluate: Evaluate, scored: Scored, params: SelectParams) -> Search:
    """Drop the least important features, again and again (RFFS, Xiong 2018).

    Importances are those of the present set, averaged over folds and repeats; of equals the one with more work goes
    first, then the last by name. A round drops ``params.drop`` of the set, one feature at least (``drop: 0`` is the
    paper), until ``params.least`` are left. `Search.ranks` are the importances in the set of all candidates.
    """
    chosen: Names = candidates
    dropped: Names = ()
    steps: list[Step] = []
    ranks: tuple[tuple[str, float], ...] = ()
    while True:
        trial = evaluate([chosen], ranked=True)[0]
        steps.append(Step(scored(trial), dropped))
        if trial.importance is None:
            raise ValueError("backward elimination needs importances")
        importances = dict(zip(chosen, trial.importance.tolist(), strict=True))
        ranks = ranks or rank(importances)
        count = min(max(1, math.floor(params.drop * len(chosen))), len(chosen) - params.least)
        if count <= 0:
            return Search(tuple(steps), ranks)
        falling = sorted(chosen, key=lambda c: (-importances[c], extra_work(c, ()), c))
        dropped = tuple(falling[len(falling) - count :])
        chosen = tuple(c for c in chosen if c not in dropped)


def by_fscore(
    candidates: Names, X: NDArray[np.float32], y: NDArray[np.uint8], evaluate: Evaluate, scored: Scored
) -> Search:
    """Add the candidates by falling F-score (Shi 2019, 2.3) of X (rows, features), y (rows,); a step for every length
    of the list."""
    figures = dict(zip(candidates, f_scores(X, y).tolist(), strict=True))
    ranks = rank(figures)
    order = [name for name, _ in ranks]
    sets = [in_order(order[: k + 1], candidates) for k in range(len(order))]
    steps = [Step(scored(t), (name,)) for name, t in zip(order, evaluate(sets), strict=True)]
    return Search(tuple(steps), ranks)


def f_scores(X: NDArray[np.float32], y: NDArray[np.uint8]) -> NDArray[np.float64]:
    """F-score of every column of X (rows, features) for classes y (rows,); NaN is no value (Chen and Lin 2006).

    F = Σ_c (m_c - m)² / Σ_c s_c², m_c and s_c² the mean and the variance (divided by n_c - 1) of class c, m the mean
    of all rows. Infinite where classes differ and none varies, 0 where a column has no value or one value. Scaling a
    column changes nothing. Source: Shi 2019, eq. 9.
    """
    out = np.zeros(X.shape[1])
    for k in range(X.shape[1]):
        value = X[:, k].astype(np.float64)
        known = ~np.isnan(value)
        if not known.any() or value[known].min() == value[known].max():
            continue
        value -= value[known].mean()
        groups = [value[known & (y == c)] for c in np.unique(y[known])]
        between = sum(float(g.mean()) ** 2 for g in groups)
        within = sum(float(g.var(ddof=1)) for g in groups if len(g) > 1)
        out[k] = between / within if within > 0 else math.inf
    return out


def in_order(names: Sequence[str], candidates: Names) -> Names:
    """`names` in the order of the candidates, so that the same set is the same trial."""
    chosen = set(names)
    return tuple(c for c in candidates if c in chosen)


def rank(figures: dict[str, float]) -> tuple[tuple[str, float], ...]:
    """(name, figure) by falling figure, of equals the one with less work, then by name."""
    return tuple(sorted(figures.items(), key=lambda item: (-item[1], extra_work(item[0], ()), item[0])))
