"""Accuracy against cost: which sets nothing else beats on both."""

from __future__ import annotations

from collections.abc import Sequence

from fwclass.select.score import Score, as_good

SAME = 0.03
"""Two timings that differ by less than this share of the lower one tell nothing."""


def levels(costs: Sequence[float]) -> list[float]:
    """Costs with those that are the same, as far as timings can tell, made equal to the lowest of them."""
    made, level = [0.0] * len(costs), 0.0
    for k, i in enumerate(sorted(range(len(costs)), key=lambda i: costs[i])):
        if k == 0 or costs[i] > level * (1.0 + SAME):
            level = costs[i]
        made[i] = level
    return made


def front(values: Sequence[float], costs: Sequence[float]) -> tuple[int, ...]:
    """Indices of the sets that no other one equals at less cost or beats at no more, by rising cost."""
    found: list[int] = []
    level = levels(costs)
    for i in sorted(range(len(values)), key=lambda i: (level[i], -values[i], i)):
        if not found or values[i] > values[found[-1]]:
            found.append(i)
    return tuple(found)


def cheapest(scores: Sequence[Score], costs: Sequence[float], best: Score) -> int:
    """Index of the cheapest set that is as good as `best` within one standard error; of equally cheap ones the
    smallest."""
    level = levels(costs)
    good = [i for i, s in enumerate(scores) if as_good(s, best)]
    return min(good, key=lambda i: (level[i], len(scores[i].features), -scores[i].value, i))
