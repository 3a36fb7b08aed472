"""A model that leaves its range: how much of a survey lies outside of what it has seen, in words and as a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.classify.params import ClassifyParams
from fwclass.errors import QualityError, visible
from fwclass.model.density import DENSITY
from fwclass.model.ranges import RANGES, shares

SAID_FROM = 0.1
"""Share of the worst feature from which it is said; 0.04 on the survey that a model comes from."""

WORST = 3
"""Features that are named."""

DENSER = 2.0
"""Times the density of what was learned, up or down, from which it is said: at half the density, one strip in place of
two, nearly all values of the worst feature lie outside."""


def drift(
    card: Mapping[str, Any], counts: Sequence[Mapping[str, Sequence[int]]], density: float | None = None
) -> dict[str, Any] | None:
    """``outside``: the share of every feature's values outside of what the model has seen, the largest first;
    ``density``, where both are known: ``learned`` and ``here``, echoes per m²; and ``remarks``. None where its card
    does not say. `counts`: of all parts, as `RangeCounter.counts` gives them; `density`: of the echoes."""
    if RANGES not in card:
        return None
    known = card.get(DENSITY)
    learned = float(known) if isinstance(known, int | float) and 0 < known < math.inf else None
    outside = shares(counts)
    worst = [(name, share) for name, share in outside.items() if share >= SAID_FROM]
    remarks = []
    if worst:
        listed = ", ".join(f"{_percent(s)} of {visible(n)}{_learned_range(card, n)}" for n, s in worst[:WORST])
        more = f", and {len(worst) - WORST} more features from {_percent(SAID_FROM)} on" if len(worst) > WORST else ""
        remarks = [f"the model has not seen such data: outside of what it learned from lie {listed}{more}"]
    if learned and density and not learned / DENSER < density < learned * DENSER:
        remarks.append(
            f"the model learned from {learned:.2g} echoes per m², here are {density:.2g}: shapes and heights of few "
            "neighbours differ from those of many, even in features that keep their range"
        )
    densities = {DENSITY: {"learned": learned, "here": density}} if learned and density else {}
    return {"outside": outside, **densities, "remarks": remarks}


def _learned_range(card: Mapping[str, Any], name: str) -> str:
    pair = card[RANGES].get(name)
    return f" (learned {pair[0]:.4g} to {pair[1]:.4g})" if pair else ""


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def judge_drift(drift: Mapping[str, Any] | None, params: ClassifyParams, where: object) -> None:
    """`QualityError` where a feature leaves the model's range further than `classify.max_outside`."""
    if not drift or params.accept_drift:
        return
    name, share = next(iter(drift["outside"].items()), ("", 0.0))
    if share > params.max_outside:
        raise QualityError(
            "the model has not seen such data",
            where=where,
            expected=f"at most {_percent(params.max_outside)} of a feature's values outside of what it learned from "
            "(classify.max_outside)",
            got=f"{_percent(share)} of {name}",
            do="train on labels of this survey, or take a model of like data, or one that was trained with "
            "survey.features=portable; --accept-drift (classify.accept_drift=true) takes the classes as they are",
        )
