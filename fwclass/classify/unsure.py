"""How much of a survey a model is unsure of: a share of its echoes that needs no label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.params import ClassifyParams
from fwclass.errors import QualityError, first_few, visible
from fwclass.schema import Table

PERCENT = 101

MEASURED_BELOW = 0.6
"""Confidence below which echoes are counted as unsure in a model's card, as `classify.unsure` is by default."""

SHOWN = 5
"""Sources that are named."""

SAID_FROM = 0.055
"""Share from which it is said: below it models that had left home had 92 to 98 % right, above it 73 to 96 %
(docs/models.md)."""


LEAST_ECHOES, TIMES_OTHERS = 1_000, 2
"""Classified echoes from which on a file is looked at alone, and times the share of unsure ones of less unsure files
from which it is unlike them. Six files of a town: 0.6 to 7.6 % unsure, so none is above the bound; one of them with
noise of 0.1 m: 16.1 and 10.6 % (two models), 5.8 and 4.1 times the others."""


@dataclass(frozen=True)
class Left:
    """Echoes with a confidence `below` this are left without a class: they get `code`."""

    below: float
    code: int

    @classmethod
    def of(cls, params: ClassifyParams) -> Left | None:
        """None where every echo gets a class."""
        return None if params.leave is None else cls(params.leave_below, params.leave)


def with_left(answered: Table, left: Left | None) -> Table:
    """`answered` (as `classify` gives it) without the classes of unsure echoes; their confidence stays."""
    if left is None:
        return answered
    unsure = percent_of(answered["confidence"]) < round(100 * left.below)
    codes = np.where(unsure, np.uint8(left.code), answered["classification"])
    return answered.with_columns({"classification": codes})


def percent_of(confidence: NDArray[np.float32]) -> NDArray[np.int64]:
    """int64 (rows,): confidences, 0 to 1, in whole percent, rounded down."""
    percent = np.floor(100 * confidence.astype(np.float64) + 1e-4).astype(np.int64)
    return np.clip(percent, 0, PERCENT - 1)


def by_percent(confidence: NDArray[np.float32]) -> NDArray[np.int64]:
    """int64 (101,): echoes by their confidence [%]; those without one (NaN) were not classified."""
    known = np.isfinite(confidence)
    return np.bincount(percent_of(confidence[known]), minlength=PERCENT).astype(np.int64)


def by_file(answered: Table) -> dict[str, list[int]]:
    """`by_percent` of the echoes of every source file, by its number as text."""
    strips = np.unique(answered["strip"]).tolist()
    return {str(s): by_percent(answered["confidence"][answered["strip"] == s]).tolist() for s in strips}


UNCALIBRATED = ("linear-svm", "rbf-svm")
"""Classifiers whose confidences are no probabilities; the bounds were measured with forests."""


def share_below(automation: Sequence[Sequence[float]], bound: float) -> float:
    """Share of the test echoes with a confidence below `bound`, by the curve that ``assess`` keeps: (confidence, share
    that is as sure or surer, …), by ascending confidence."""
    return 1.0 - next((share for least, share, _ in automation if least >= bound - 1e-9), 0.0)


def unsure_facts(
    counts: NDArray[np.int64], params: ClassifyParams, given: Mapping[str, Any] | None
) -> dict[str, Any] | None:
    """``share`` of the classified echoes with a confidence ``below`` that of `params`, ``left``, the share that got no
    class, and ``remarks``; None for none.

    Parameters
    ----------
    counts : int64 (101,), `by_percent` of all echoes.
    given : the card of a model that was not trained in this run; None: of one that was, the test areas tell more.
    """
    total = int(counts.sum())
    if not total:
        return None
    share = int(counts[: round(100 * params.unsure)].sum()) / total
    left = int(counts[: round(100 * params.leave_below)].sum()) / total if params.leave is not None else 0.0
    remarks = []
    if left:
        remarks.append(
            f"{100 * left:.1f} % of the classified echoes got no class but code {params.leave}: their confidence is "
            f"below {params.leave_below:g} (classify.leave_below)"
        )
    judged = given is not None and given.get("method") not in UNCALIBRATED
    before = _as_a_stranger(given) if given is not None and params.unsure == MEASURED_BELOW else ""
    if given is not None and (before or share > SAID_FROM):
        many = (
            ": those of a support vector machine are no probabilities, and nothing follows from how many are low"
            if not judged
            else f". Where models that left home were unsure of more than {100 * SAID_FROM:g} %, 4 to 27 % of the "
            "classes were wrong: look at the least sure places (`fwclass view`), and label some (`fwclass suggest`)"
        )
        remarks.append(
            f"the model is unsure of {100 * share:.1f} % of the classified echoes (confidence below "
            f"{params.unsure:g}){before}{many if share > SAID_FROM else ''}"
        )
    return {
        "share": share,
        "below": params.unsure,
        "left": left,
        "given": given is not None,
        "judged": judged,
        "remarks": remarks,
    }


def unlike_files(of_files: Mapping[str, NDArray[np.int64]], params: ClassifyParams) -> dict[str, Any]:
    """Files that the average hides: ``files``, [name, share of unsure echoes] by descending share where it is above
    `classify.max_unsure` and `TIMES_OTHERS` that of all less unsure files together, and ``remarks`` on them;
    `of_files`: `by_percent` by name."""
    bound = round(100 * params.unsure)
    shares: dict[str, float] = {}
    unsure = total = 0
    ascending = sorted((int(c[:bound].sum()) / max(int(c.sum()), 1), name) for name, c in of_files.items())
    for share, name in ascending:
        count = int(of_files[name].sum())
        if min(count, total) >= LEAST_ECHOES and share > max(params.max_unsure, TIMES_OTHERS * unsure / total):
            shares[name] = share
        unsure, total = unsure + int(of_files[name][:bound].sum()), total + count
    unlike = sorted(shares.items(), key=lambda pair: (-pair[1], pair[0]))
    if not unlike:
        return {"files": [], "remarks": []}
    named = first_few([f"{visible(name)} {100 * share:.1f} %" for name, share in unlike], SHOWN)
    remark = (
        f"of some files the model is unsure {TIMES_OTHERS} times as often as of others, or more ({named}): they are "
        "unlike these, or what it learned from, which the average hides; tiles.gpkg ranks the tiles"
    )
    return {"files": [list(pair) for pair in unlike], "remarks": [remark]}


def _as_a_stranger(card: Mapping[str, Any]) -> str:
    """What the model's card tells of surveys that a model of the others had not seen: how unsure, how often right."""
    measured = card.get("measured")
    judged = measured.get("left_out") if isinstance(measured, Mapping) else None
    try:
        rows = sorted((float(o["unsure"]), float(o["overall_accuracy"]), str(o["source"])) for o in judged or ())
    except (KeyError, TypeError, ValueError, OverflowError):
        return ""
    each = [f"{100 * share:.1f} % on {visible(name)} ({100 * right:.1f} % right)" for share, right, name in rows]
    return f"; on what it had not seen it was unsure of {first_few(each, SHOWN)}" if each else ""


def judge_unsure(facts: dict[str, Any] | None, params: ClassifyParams, where: object) -> None:
    """`QualityError` where a given model is unsure of more than `classify.max_unsure`."""
    if (
        facts is None
        or not facts.get("judged", facts["given"])
        or params.accept_drift
        or facts["share"] <= params.max_unsure
    ):
        return
    raise QualityError(
        "the model is unsure of too much",
        where=where,
        expected=f"at most {100 * params.max_unsure:g} % of the classified echoes with a confidence below "
        f"{params.unsure:g} (classify.max_unsure)",
        got=f"{100 * facts['share']:.1f} %",
        do="take a model of like data, or label some places (`fwclass suggest`) and learn from them "
        "(survey.base_model); --accept-drift (classify.accept_drift=true) takes the classes as they are",
    )
