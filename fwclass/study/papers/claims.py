"""A paper's claims against our figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

HOLDS, FAILS, UNSURE, OPEN = "holds", "does not hold", "undecided", "not comparable"

Facts = Mapping[str, Any]
"""What a study measured, as its report has it."""

Verdict = tuple[str, str, str]
"""(our figure, one of `HOLDS`, `FAILS`, `UNSURE`, `OPEN`, why)."""


def judge_claims(
    printed: Mapping[str, Mapping[str, Any]], tests: Mapping[str, Callable[[Any], Verdict]], facts: Facts
) -> list[dict[str, Any]]:
    """Every claim with the paper's figure, ours, the verdict and why."""
    judgements = []
    for name, claim in printed.items():
        ours, verdict, why = tests[name](facts)
        judgements.append({"name": name, **claim, "ours": ours, "verdict": verdict, "why": why})
    return judgements


def verdict(holds: bool) -> str:
    """`HOLDS` or `FAILS`."""
    return HOLDS if holds else FAILS


def of_gain(one: Mapping[str, Any], claimed: float) -> str:
    """Verdict on a gain whose interval is known; undecided where that holds both zero and the paper's own figure."""
    if one["low"] > 0:
        return HOLDS
    return UNSURE if one["low"] <= 0 <= one["high"] and one["low"] <= claimed <= one["high"] else FAILS


def percent(value: float, digits: int = 1) -> str:
    """A fraction as text in percent."""
    return f"{100 * value:.{digits}f} %"


def points(value: float, digits: int = 1) -> str:
    """A difference of fractions in points, with its sign."""
    return f"{100 * value:+.{digits}f}".replace("-", "−")


def difference_words(difference: Mapping[str, Any], key: str = "overall_accuracy") -> str:
    """A difference in points with its interval."""
    one = difference[key]
    if one["low"] is None:
        return f"{points(one['value'], 2)} points"
    return f"{points(one['value'], 2)} points [{points(one['low'], 2)}, {points(one['high'], 2)}]"
