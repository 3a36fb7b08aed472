"""Search of C and gamma of the kernel machine: every pair judged in folds that did not train it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.train.baselines import fit
from fwclass.train.baselines.params import RbfSvmParams
from fwclass.train.baselines.prepare import fewer, pieces, preparation
from fwclass.train.sample import Sample
from fwclass.train.trim import trim_rows


@dataclass(frozen=True)
class Folding:
    """Which rows of a sample a fold judges, and which it learns from.

    Attributes
    ----------
    fold : int (rows,), the fold in which a row is judged.
    learns : bool (folds, rows).
    note : what is to be said of the folds, or "".
    blocks : squares that have rows; 0 for folds of consecutive pulses.
    """

    fold: NDArray[Any]
    learns: NDArray[np.bool_]
    note: str = ""
    blocks: int = 0


def by_pulses(sample: Sample, folds: int, note: str = "") -> Folding:
    """Folds of pieces of consecutive pulses, for a sample without places."""
    fold = pieces(sample, folds)
    return Folding(fold, np.array([fold != k for k in range(folds)]), note)


@dataclass(frozen=True)
class Places:
    """How the places of rows count: squares of `edge` [m] that a sample is thinned by (0: not at all), and
    ``folding(sample, folds)``."""

    edge: float
    folding: Callable[[Sample, int], Folding]


BY_PULSES = Places(0.0, by_pulses)


def right(
    sample: Sample, folding: Folding, fold: int, c: float, gamma: float, svm: RbfSvmParams, scaling: str, weights: Any
) -> dict[str, int]:
    """What the machine of one (C, gamma, fold) has right: ``right`` of ``judged`` rows; scaling and trimming are those
    of the rows that it learns from."""
    learns, judged = folding.learns[fold], np.asarray(folding.fold == fold)
    X = preparation(sample.X[learns], scaling)(sample.X) if learns.any() else np.zeros(sample.X.shape)
    clean, _ = trim_rows(X[learns], sample.y[learns], svm.trim)
    learns = learns.copy()
    learns[np.flatnonzero(learns)[~clean]] = False
    hits = fit.count_right(X, sample.y, learns, judged, c, gamma, weights)
    return {"right": hits, "judged": int(judged.sum())}


def smoothest(tried: Iterable[tuple[float, float, float]]) -> tuple[float, float]:
    """(C, gamma) of the best score among (C, gamma, score); of equal ones the smallest gamma, then the smallest C."""
    c, gamma, _ = min(tried, key=lambda one: (-one[2], one[1], one[0]))
    return c, gamma


def search_rows(sample: Sample, svm: RbfSvmParams, edge: float) -> Sample:
    """The rows of a sample that the search looks at, thinned by squares of `edge` [m] to `svm.search_rows`."""
    return fewer(fewer(sample, svm.max_rows, edge), svm.search_rows, edge)


def search_summary(
    rows: int, folding: Folding, pairs: Sequence[tuple[float, float]], counts: Sequence[Sequence[dict[str, int]]]
) -> dict[str, Any]:
    """What the card says of a search: `counts` as `right` gives them, for every one of `pairs` (C, gamma) and
    fold; accuracies are shares, 0 to 1."""
    share = [sum(f["right"] for f in of) / max(1, sum(f["judged"] for f in of)) for of in counts]
    tried = [{"c": a, "gamma": b, "accuracy": s} for (a, b), s in zip(pairs, share, strict=True)]
    c, gamma = smoothest((a, b, s) for (a, b), s in zip(pairs, share, strict=True))
    return {
        "rows": rows,
        "folds": len(folding.learns),
        "blocks": folding.blocks,
        "tried": tried,
        "c": c,
        "gamma": gamma,
        "note": "; ".join(filter(None, (folding.note, _at_the_edge(pairs, c, gamma)))),
    }


def _at_the_edge(pairs: Sequence[tuple[float, float]], c: float, gamma: float) -> str:
    """What to tell of a choice beyond which nothing was tried; "" of one inside."""
    sentences = []
    for name, setting, value, tried in (
        ("C", "c", c, sorted({a for a, _ in pairs})),
        ("gamma", "gamma", gamma, sorted({b for _, b in pairs})),
    ):
        if len(tried) > 1 and value in (tried[0], tried[-1]):
            end, further = ("smallest", "smaller") if value == tried[0] else ("largest", "larger")
            sentences.append(
                f"{name} = {value:g} is the {end} that was tried, a {further} one may do better "
                f"(compare.rbf_svm.{setting})"
            )
    return "; ".join(sentences)


def search(sample: Sample, folding: Folding, svm: RbfSvmParams, scaling: str, weights: Any) -> dict[str, Any]:
    """All pairs of the settings on `sample`, one after another; see `search_summary`."""
    pairs, folds = pairs_of(svm), range(len(folding.learns))
    counts = [[right(sample, folding, f, c, g, svm, scaling, weights) for f in folds] for c, g in pairs]
    return search_summary(sample.rows, folding, pairs, counts)


def pairs_of(svm: RbfSvmParams) -> list[tuple[float, float]]:
    """(C, gamma) of the settings, in the order of the search."""
    return [(c, g) for c in svm.c for g in svm.gamma]
