"""Whether a second layer pays, and what its classes weigh: both layers are tried on squares that neither has learned
from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.confusion import confusion_by_square
from fwclass.assess.intervals import FIGURES, LEAST, class_gains, difference, scores

MOST_SQUARES = 1000
"""Squares that are drawn from at most; of more, four become one."""

_UNITS = 1000
"""Whole numbers that the weight of a row counts in."""

_STEPS = 4
"""Steps of a class's weight to twice as much; four classes and a factor of two are then tried in some 30 ms."""

_ROUNDS = 10
"""Rounds over all classes at most; two or three are the rule."""

_FIGURES = {"overall_accuracy": "overall accuracy", "mean_iou": "mean IoU"}


@dataclass(frozen=True)
class LayerTrial:
    """What both layers say of rows that neither has learned from, by square.

    `square`: int64 (squares, 2), column and row of the square on the global grid. `first`, `both`: int64 (squares,
    classes, classes), rows by class (second axis) and answer, of the first layer and of both.
    """

    square: NDArray[np.int64]
    first: NDArray[np.int64]
    both: NDArray[np.int64]

    @classmethod
    def of(cls, square: NDArray[np.int64], truth: NDArray, first: NDArray, both: NDArray, classes: int) -> LayerTrial:
        """The trial of rows, each with its `square` (rows, 2), class and answers (rows,)."""
        squares, of_first = confusion_by_square(square, truth, first, classes)
        return cls(squares, of_first, confusion_by_square(square, truth, both, classes)[1])

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
    """Why a second layer does not pay, nothing where it does; what was measured, in words and as plain data.
    `changed`: by how many points both figures, with their intervals."""

    why: tuple[str, ...]
    sentence: str
    changed: str
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
        return Verdict((f"it takes {LEAST} squares to tell",), few, "", facts)
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
    changed += " points (95 % intervals)"
    sentence = (
        f"tried on {len(trial.square)} squares of the training areas that neither layer had learned from, the second "
        f"one changes {changed}"
    )
    known = {name: None if np.isnan(value) else value for name, value in reached.items()}  # no kappa of one class
    return Verdict(tuple(why), sentence, changed, {**facts, "gain": gain, "classes": of_class, "reached": known})


def _span(value: float, ends: Sequence[float] | None) -> str:
    return f"{100 * value:+.2f}" + (f" ({100 * ends[0]:+.2f} to {100 * ends[1]:+.2f})" if ends else "")


class Answers(NamedTuple):
    """What both layers say of rows that neither has learned from: their shares (rows, classes), added up, the rows'
    classes (rows,), and the squares that they lie in (rows, 2), as `LayerTrial` has them."""

    shares: NDArray[np.float64]
    truth: NDArray[np.uint8]
    square: NDArray[np.int64]


@dataclass(frozen=True)
class Weighing:
    """What classes weigh in the answer of both layers: a factor of each one's share, 1 at least, and what this changes
    on squares that the weights were not chosen on, in words."""

    weights: tuple[float, ...]
    sentence: str


def weighing(
    answers: Sequence[Answers], eligible: NDArray[np.int64], names: tuple[str, ...], most: float
) -> Weighing | None:
    """The weights by which overall accuracy and mean IoU, added up, are greatest; None where weights that are chosen
    on all folds but one do not pay on that one, over all folds, by the rule of `verdict`.

    A sample has as many rows of a rare class as of others, so that its shares are too large where it is rare; how much
    of that is to be taken back differs from class to class, and the rows that neither layer has learned from tell.

    `answers`: by fold. `eligible`: int64 (classes,), labelled echoes that the rows of a class stand for. `most`: no
    class weighs so many times another, or more than this.
    """
    span = math.floor(_STEPS * math.log2(most) + 1e-9)
    if len(answers) < 2 or span < 1:
        return None
    every = [_rows_of(answers)] + [_rows_of([*answers[:k], *answers[k + 1 :]]) for k in range(len(answers))]
    rows = np.bincount(every[0].truth, minlength=len(eligible))
    stand_for = np.rint(_UNITS * eligible / np.maximum(rows, 1)).astype(np.int64)[:, None]
    chosen, *without = (_best_levels(some, stand_for, span) for some in every)
    trials = (
        LayerTrial.of(a.square, a.truth, a.shares.argmax(axis=1), (a.shares * _weights(w)).argmax(axis=1), len(names))
        for a, w in zip(answers, without, strict=True)
    )
    judged = verdict(LayerTrial.joined(trials, len(names)), eligible, names)
    if not judged.pays:
        return None
    weights = tuple(_weights(chosen - chosen.min()).tolist())
    each = ", ".join(f"{name} {weight:.2f}" for name, weight in zip(names, weights, strict=True))
    said = f"the shares of the classes weigh {each}: on squares that this was not chosen on {judged.changed}"
    return Weighing(weights, said)


def _rows_of(answers: Sequence[Answers]) -> Answers:
    return Answers(*(np.concatenate(arrays) for arrays in zip(*answers, strict=True)))


def _weights(level: NDArray[np.int64]) -> NDArray[np.float64]:
    """Of three digits, so that they are the same on every processor."""
    return np.round(2.0 ** (level / _STEPS), 3)


def _best_levels(answers: Answers, stand_for: NDArray[np.int64], span: int) -> NDArray[np.int64]:
    """int64 (classes,): steps of the classes' weights, class by class the best one within half the span, until none
    is better."""
    shares, of_truth, classes = answers.shares, answers.truth.astype(np.int64) * len(stand_for), len(stand_for)

    def score(winner: NDArray[np.int64]) -> float:
        counts = np.bincount(of_truth + winner, minlength=classes**2).reshape(classes, classes) * stand_for
        reached = dict(zip(FIGURES, scores(counts[None])[0], strict=True))
        return sum(float(reached[name]) for name in _FIGURES)

    best = np.zeros(classes, np.int64)
    reached = score(shares.argmax(axis=1))
    reach = max(span // 2, 1)
    for _ in range(_ROUNDS):
        before = best
        for k in range(classes):
            begin = best
            weighed = shares * _weights(begin)
            weighed[:, k] = -1.0
            other = weighed.argmax(axis=1)
            most = weighed.max(axis=1)
            for step in range(-reach, reach + 1):
                tried = begin.copy()
                tried[k] += step
                if np.ptp(tried) > span:
                    continue
                own = shares[:, k] * _weights(tried)[k]
                now = score(np.where((own > most) | ((own == most) & (k < other)), k, other))  # the first of equals
                if now > reached:
                    best, reached = tried, now
        if best is before:
            break
    return best
