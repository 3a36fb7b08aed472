"""How good a set of features is: figures of its folds, whether another is as good, and at what cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Names = tuple[str, ...]


@dataclass(frozen=True)
class Trial:
    """What cross-validation of a set gave.

    Attributes
    ----------
    features : the set, in the candidates' order.
    matrices : int64 (folds, classes, classes), rows reference, columns predicted.
    importance : float64 (features,), mean over folds and repeats of the loss of out-of-bag accuracy; None if not asked.
    """

    features: Names
    matrices: NDArray[np.int64]
    importance: NDArray[np.float64] | None = None


class Evaluate(Protocol):
    """Cross-validates sets of features, all at once; `ranked` asks for importances too."""

    def __call__(self, subsets: Sequence[Names], ranked: bool = False) -> list[Trial]: ...


@dataclass(frozen=True)
class Score:
    """Figures of a set, fractions; one value per fold in `accuracy` and `kappa`, NaN where a fold has none.

    `decides` is the figure that is maximised, per fold.
    """

    features: Names
    accuracy: NDArray[np.float64]
    kappa: NDArray[np.float64]
    decides: NDArray[np.float64]

    @property
    def value(self) -> float:
        """The score that decides: a share [0 to 1], the mean over the folds; NaN where no fold has a value."""
        return mean(self.decides)

    def plain(self) -> dict[str, Any]:
        """For JSON: shares [0 to 1] rounded, None for NaN."""
        return {
            "features": list(self.features),
            "accuracy": _round(mean(self.accuracy)),
            "accuracy_std": _round(spread(self.accuracy)),
            "kappa": _round(mean(self.kappa)),
            "kappa_std": _round(spread(self.kappa)),
            "score": _round(self.value),
            "folds": [_round(float(v)) for v in self.decides],
        }


def score(trial: Trial, weights: NDArray[np.float64], by: str) -> Score:
    """Figures of a trial; a class counts as often as it occurs in the training areas.

    The sample has of every class at most so many rows; `weights` (classes,) is labelled echoes / sampled rows, so that
    the accuracy is an estimate of that of all echoes. `by` is ``overall``, ``kappa`` or ``balanced``.
    """
    rows = [_figures(m * weights[:, None]) for m in trial.matrices]
    accuracy, kappa, balanced = (np.array(v) for v in zip(*rows, strict=True))
    decides = {"overall": accuracy, "kappa": kappa, "balanced": balanced}[by]
    return Score(trial.features, accuracy, kappa, decides)


def _figures(matrix: NDArray[np.float64]) -> tuple[float, float, float]:
    """Overall accuracy, kappa and mean producer's accuracy; NaN where there is none."""
    rows, columns, right = matrix.sum(axis=1), matrix.sum(axis=0), np.diag(matrix)
    total = float(rows.sum())
    if total == 0.0:
        return np.nan, np.nan, np.nan
    agreed, chance = float(right.sum()) / total, float((rows * columns).sum()) / total**2
    there = rows > 0
    kappa = (agreed - chance) / (1.0 - chance) if chance < 1.0 else np.nan
    return agreed, kappa, float((right[there] / rows[there]).mean())


def mean(values: NDArray[np.float64]) -> float:
    """Mean over the folds (folds,) that have a value; NaN if none has."""
    finite = values[~np.isnan(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def spread(values: NDArray[np.float64]) -> float:
    """Standard deviation over the folds (folds,); NaN is no value, 0 with fewer than two."""
    finite = values[~np.isnan(values)]
    return float(finite.std(ddof=1)) if len(finite) > 1 else 0.0


def as_good(one: Score, best: Score) -> bool:
    """`one` is no more than a standard error worse than `best`.

    The folds are the same for both, so the error is that of their difference by fold: what is hard for one is hard for
    the other, and a spread between easy and hard places says nothing about the sets.
    """
    short = best.decides - one.decides
    known = int((~np.isnan(short)).sum())
    return known == 0 or mean(short) <= spread(short) / np.sqrt(known) + 1e-12


def _round(value: float) -> float | None:
    return None if np.isnan(value) else round(value, 6)


SAME = 0.03
"""Two timings that differ by less than this share of the lower one tell nothing."""


def levels(costs: Sequence[float]) -> list[float]:
    """Costs [s] with those that are the same, as far as timings can tell, made equal to the lowest of them."""
    levelled, level = [0.0] * len(costs), 0.0
    for k, i in enumerate(sorted(range(len(costs)), key=lambda i: costs[i])):
        if k == 0 or costs[i] > level * (1.0 + SAME):
            level = costs[i]
        levelled[i] = level
    return levelled


def front(values: Sequence[float], costs: Sequence[float]) -> tuple[int, ...]:
    """Indices of the sets that no other one equals at less cost [s] or beats at no more, by rising cost."""
    indices: list[int] = []
    level = levels(costs)
    for i in sorted(range(len(values)), key=lambda i: (level[i], -values[i], i)):
        if not indices or values[i] > values[indices[-1]]:
            indices.append(i)
    return tuple(indices)


def cheapest(scores: Sequence[Score], costs: Sequence[float], best: Score) -> int:
    """Index of the cheapest [s] set that is as good as `best` within one standard error; of equally cheap ones the
    smallest."""
    level = levels(costs)
    good = [i for i, s in enumerate(scores) if as_good(s, best)]
    return min(good, key=lambda i: (level[i], len(scores[i].features), -scores[i].value, i))
