"""A search for the parameters with the greatest value: a coarse grid of the leading ones, then one after another."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fwclass.ground.tuning_params import GroundSearchParams, Values

Setting = tuple[float, ...]
"""One value for every parameter, in the order of the ranges."""


@dataclass(frozen=True)
class Optimum:
    """Where a search ended: the setting and its value."""

    setting: Setting
    value: float


def most_runs(ranges: Mapping[str, Values], params: GroundSearchParams) -> int:
    """So many settings are tried at most by one search."""
    lengths = [len(v) for v in ranges.values()]
    grid = math.prod(min(params.coarse, n) for n in lengths[: params.leading])
    return grid + params.rounds * sum(n - 1 for n in lengths) + 1


def search(
    ranges: Mapping[str, Values], start: Setting, value: Callable[[Setting], float], params: GroundSearchParams
) -> Optimum:
    """The setting, a number for each of `ranges` (ranges,), of greatest `value` that is found from `start`.

    `start` need not lie on the ranges: what it has stays as long as nothing better is found. Of equal values the one
    tried first wins, and `start` is the very first. `value` may be asked for the same setting again.
    """
    best, most = start, value(start)
    for point in _grid(ranges, start, params):
        if (reached := value(point)) > most:
            best, most = point, reached
    for _ in range(params.rounds):
        before = best
        for k, values in enumerate(ranges.values()):
            for point in [(*best[:k], v, *best[k + 1 :]) for v in values]:
                if (reached := value(point)) > most:
                    best, most = point, reached
        if best == before:
            break
    return Optimum(best, most)


def curves(
    ranges: Mapping[str, Values], best: Setting, value: Callable[[Setting], float]
) -> dict[str, list[tuple[float, float]]]:
    """Per parameter (value, `value` of the setting) over its range, all others as in `best`."""
    values_by_name = {}
    for k, (name, values) in enumerate(ranges.items()):
        line = sorted({*values, best[k]})
        values_by_name[name] = [(v, value((*best[:k], v, *best[k + 1 :]))) for v in line]
    return values_by_name


def _grid(ranges: Mapping[str, Values], start: Setting, params: GroundSearchParams) -> list[Setting]:
    """Every combination of a few values of the leading parameters, the others as in `start`."""
    leading = [pick_evenly(values, params.coarse) for values in list(ranges.values())[: params.leading]]
    return [(*some, *start[len(some) :]) for some in itertools.product(*leading)]


def pick_evenly(values: Values, most: int) -> Values:
    """At most `most` of the values, evenly from the first to the last, the ends left out where there are enough."""
    if len(values) <= most:
        return values
    step = len(values) / most
    return tuple(values[int((k + 0.5) * step)] for k in range(most))
