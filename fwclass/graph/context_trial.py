"""Whether a second layer pays: both are tried on squares that neither has learned from, and the squares are drawn."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.intervals import FIGURES, LEAST, class_gains, difference, scores

MOST_SQUARES = 1000
"""Squares that are drawn from at most; of more, four become one."""

_UNITS = 1000
"""Whole numbers that the weight of a row counts in."""

_FIGURES = {"overall_accuracy": "overall accuracy", "mean_iou": "mean IoU"}


@dataclass(frozen=True)
class LayerTrial:
    """What both layers say of rows that neither has learned from, by square.

    Attributes
    ----------
    square : int64 (squares, 2), column and row of the square on the global grid.
    first, both : int64 (squares, classes, classes), rows by class (second axis) and answer, of the first layer and of
        both.
    """

    square: NDArray[np.int64]
    first: NDArray[np.int64]
    both: NDArray[np.int64]

    @classmethod
    def of(cls, square: NDArray[np.int64], truth: NDArray, first: NDArray, both: NDArray, classes: int) -> LayerTrial:
        """The trial of rows, each with its `square` (rows, 2), class and answers (rows,)."""
        squares, at = np.unique(square, axis=0, return_inverse=True)
        pair = (at.reshape(-1) * classes + truth) * classes
        shape = (len(squares), classes, classes)
        counts = (
            np.bincount(pair + layer, minlength=len(squares) * classes**2).reshape(shape) for layer in (first, both)
        )
        return cls(squares, *counts)

    @classmethod
    def joined(cls, trials: Iterable[LayerTrial], classes: int) -> LayerTrial:
        """Trials of different squares as one, `MOST_SQUARES` at most."""
        parts = [*trials]
        none = np.empty((0, classes, classes), np.int64)
        whole = cls(
            np.concatenate([np.empty((0, 2), np.int64), *(p.square for p in parts)]),
            np.concatenate([none, *(p.first for p in parts)]),
            np.concatenate([none, *(p.both for p in parts)]),
        )
        while len(whole.square) > MOST_SQUARES:
            squares, at = np.unique(whole.square // 2, axis=0, return_inverse=True)
            first, both = (np.zeros((len(squares), classes, classes), np.int64) for _ in range(2))
            np.add.at(first, at.reshape(-1), whole.first)
            np.add.at(both, at.reshape(-1), whole.both)
            whole = cls(squares, first, both)
        return whole


@dataclass(frozen=True)
class Verdict:
    """Why a second layer does not pay, nothing where it does; what was measured, in words and as plain data."""

    why: tuple[str, ...]
    sentence: str
    facts: Mapping[str, Any]

    @property
    def pays(self) -> bool:
        """Nothing speaks against it."""
        return not self.why


def verdict(trial: LayerTrial, eligible: NDArray[np.int64], names: tuple[str, ...]) -> Verdict:
    """Both layers pay where overall accuracy and mean IoU rise, the 95 % interval of one of the two gains lies above 0,
    and no class loses IoU by an interval that lies below 0.

    Rows of a class are weighed by the labelled echoes that they were drawn from, `eligible` (classes,): a class of few
    echoes counts as in the survey, not as in the sample. Intervals are those of squares drawn with replacement
    (`assess.intervals`).
    """
    rows = trial.first.sum(axis=(0, 2))
    counted = {k: int(np.trace(getattr(trial, k).sum(axis=0))) for k in ("first", "both")}
    facts = {"rows": int(rows.sum()), **counted}
    weight = np.rint(_UNITS * eligible / np.maximum(rows, 1)).astype(np.int64)[None, :, None]
    first, both = trial.first * weight, trial.both * weight
    gain = difference(first, both)
    if gain is None:
        few = f"a second layer could be tried on {len(trial.square)} squares of the training areas"
        return Verdict((f"it takes {LEAST} squares to tell",), few, facts)
    of_class = class_gains(first, both)
    figures = [(words, gain[name]["difference"], gain[name]["interval"]) for name, words in _FIGURES.items()]
    sure = any(ends is not None and ends[0] > 0 for _, _, ends in figures)
    why = [
        *(f"{words} does not rise" for words, change, _ in figures if change <= 0),
        *([] if sure else ["neither gains for sure"]),
        *(
            f"{name} loses {_span(one['value'], (one['low'], one['high']))} points of IoU"
            for name, one in zip(names, of_class, strict=True)
            if one and one["high"] is not None and one["high"] < 0
        ),
    ]
    reached = dict(zip(FIGURES, scores(both.sum(axis=0)[None])[0].tolist(), strict=True))
    changed = " and ".join(f"{words} by {_span(change, ends)}" for words, change, ends in figures)
    sentence = (
        f"tried on {len(trial.square)} squares of the training areas that neither layer had learned from, the second "
        f"one changes {changed} points (95 % intervals)"
    )
    known = {name: None if np.isnan(value) else value for name, value in reached.items()}  # no kappa of one class
    return Verdict(tuple(why), sentence, {**facts, "gain": gain, "classes": of_class, "reached": known})


def _span(value: float, ends: Sequence[float] | None) -> str:
    return f"{100 * value:+.2f}" + (f" ({100 * ends[0]:+.2f} to {100 * ends[1]:+.2f})" if ends else "")
