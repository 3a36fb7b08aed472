"""A model that leaves its range: how much of a survey lies outside of what it has seen, in words and as a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.classify.params import ClassifyParams
from fwclass.errors import QualityError, visible
from fwclass.model.density import BETWEEN, DENSITY, Densities
from fwclass.model.ranges import RANGES, shares

SAID_FROM = 0.1
"""Share of the worst feature from which it is said; 0.04 on the survey that a model comes from."""

WORST = 3
"""Features that are named."""

SEVERAL, OFF_GROUND = "number_of_echoes", 0.1
"""Feature that tells single returns from others, and share of the echoes above the ground from which plants must be
among them, or edges; a desert has neither, and its classes are right by single returns."""

DENSER, OF_ONE = 1.5, 4 / 3
"""Times what nine tenths of what was learned have at most, or one tenth, from which another density is said; and what
these are to the median of a card without them. At half the density, one strip in place of two, nearly all values of the
worst feature lie outside."""


def drift(
    card: Mapping[str, Any], counts: Sequence[Mapping[str, Sequence[int]]], dense: Densities | None = None
) -> dict[str, Any] | None:
    """``outside``: the share of every feature's values outside of what the model has seen, the largest first;
    ``density``, where both are known: ``learned``, ``between`` and ``here``, echoes per m²; and ``remarks``. None where
    its card does not say. `counts`: of all parts, as `RangeCounter.counts` gives them; `dense`: how the echoes lie."""
    if RANGES not in card:
        return None
    outside = shares(counts)
    worst = [(name, share) for name, share in outside.items() if share >= SAID_FROM]
    remarks = []
    if worst:
        listed = ", ".join(f"{_percent(s)} of {visible(n)}{_learned_range(card, n)}" for n, s in worst[:WORST])
        more = f", and {len(worst) - WORST} more features from {_percent(SAID_FROM)} on" if len(worst) > WORST else ""
        remarks = [f"the model has not seen such data: outside of what it learned from lie {listed}{more}"]
    density = _density(card, dense)
    if density and not density["between"][0] / DENSER <= density["here"] <= density["between"][1] * DENSER:
        low, high = density["between"]
        remarks.append(
            f"the model learned from {density['learned']:.2g} echoes per m² ({low:.2g} to {high:.2g}), here are "
            f"{density['here']:.2g}: shapes and heights of few neighbours differ from those of many, even in features "
            "that keep their range"
        )
    return {"outside": outside, **({DENSITY: density} if density else {}), "remarks": remarks}


def with_returns(
    drift: Mapping[str, Any], card: Mapping[str, Any], returns: Mapping[str, Any] | None, ground: int, echoes: int
) -> dict[str, Any]:
    """`drift` with ``returns``, and that among its remarks: that the model learned by pulses with several returns, and
    no pulse has them here, though more than `OFF_GROUND` of the `echoes` are no `ground`; "" for nothing of the kind.
    `returns`: as `returns_facts` has them."""
    ranges = card.get(RANGES) or {}
    learned = (ranges.get(SEVERAL) or (1.0, 1.0))[1]
    said = ""
    if returns and returns["single"] and learned > 1.0 and echoes - ground > OFF_GROUND * echoes:
        said = (
            f"the model learned from pulses of up to {learned:.0f} echoes, every pulse here has one, and "
            f"{_percent(1 - ground / echoes)} of the echoes are no ground"
        )
    return {**drift, "returns": said, "remarks": [*drift["remarks"], *([said] if said else [])]}


def _density(card: Mapping[str, Any], dense: Densities | None) -> dict[str, Any] | None:
    """What a model learned from, the median and between what, and what is here; None where one of them is unknown."""
    learned: Any = card.get(DENSITY)
    if dense is None or not _is_density(learned):
        return None
    between = card.get(BETWEEN)
    if not (isinstance(between, list) and len(between) == 2 and all(map(_is_density, between))):  # a card of before
        between = [learned / OF_ONE, learned * OF_ONE]
    return {"learned": learned, "between": between, "here": dense.middle}


def _is_density(value: Any) -> bool:
    return isinstance(value, int | float) and 0 < value < 1e9


def _learned_range(card: Mapping[str, Any], name: str) -> str:
    pair = card[RANGES].get(name)
    return f" (learned {pair[0]:.4g} to {pair[1]:.4g})" if pair else ""


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def judge_drift(drift: Mapping[str, Any] | None, params: ClassifyParams, where: object) -> None:
    """`QualityError` where a feature leaves the model's range further than `classify.max_outside`, or pulses lack the
    returns that it learned by (`with_returns`)."""
    if not drift or params.accept_drift:
        return
    if said := drift.get("returns"):
        raise QualityError(
            "the model decides by returns that this survey does not have",
            where=where,
            expected="some pulses with several returns",
            got=said,
            do="export all returns with their numbers, or train on labels of this survey; --accept-drift "
            "(classify.accept_drift=true) takes the classes as they are",
        )
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
