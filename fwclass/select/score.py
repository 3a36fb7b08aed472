"""How good a set of features is: figures of its folds, and whether another is as good."""

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
        return mean(self.decides)

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "features": list(self.features),
            "accuracy": _rounded(mean(self.accuracy)),
            "accuracy_std": _rounded(spread(self.accuracy)),
            "kappa": _rounded(mean(self.kappa)),
            "kappa_std": _rounded(spread(self.kappa)),
            "score": _rounded(self.value),
            "folds": [_rounded(float(v)) for v in self.decides],
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
    """Over the folds that have a value; NaN if none has."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else float("nan")


def spread(values: NDArray[np.float64]) -> float:
    """Standard deviation over the folds; 0 with fewer than two."""
    known = values[~np.isnan(values)]
    return float(known.std(ddof=1)) if len(known) > 1 else 0.0


def as_good(one: Score, best: Score) -> bool:
    """`one` is no more than a standard error worse than `best`.

    The folds are the same for both, so the error is that of their difference by fold: what is hard for one is hard for
    the other, and a spread between easy and hard places says nothing about the sets.
    """
    short = best.decides - one.decides
    known = int((~np.isnan(short)).sum())
    return known == 0 or mean(short) <= spread(short) / np.sqrt(known) + 1e-12


def _rounded(value: float) -> float | None:
    return None if np.isnan(value) else round(value, 6)
