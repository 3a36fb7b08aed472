"""How parameters of the ground filters are found: adapted to a cloud without labels, or searched on labelled points."""

from __future__ import annotations

import itertools
import math
from typing import Any, Self

from pydantic import Field, model_validator

from fwclass.ground.methods import Method
from fwclass.ground.methods.params import LEAST_CELL
from fwclass.ground.params import GroundParams, section_of
from fwclass.params import Params

MOST_TRIED = 10_000
"""Combinations of parameters."""

Values = tuple[float, ...]
Group = dict[str, Values]
"""Parameters that change together, ``part.name`` for those of a combined filter's part: as many values of each."""


class GroundAutoParams(Params):
    """How parameters are adapted.

    Attributes
    ----------
    building_margin, building_most : the largest building is so many times the widest that was found, at most [m].
    method : the filter where none is asked for.
    referees : filters that others are compared with: the first two of another principle.
    candidates : by filter, groups of parameters that change together; every combination of the groups is tried. A
        filter without candidates keeps its parameters.
    thin : clouds with at least so many times as many points as cells of `cell` are thinned to the lowest of each,
    cell : whose edge this is [m].
    sample, square : larger clouds are judged by evenly spread squares of this edge [m] with about so many points.
    blocks : in a survey parameters are chosen for squares, so many blocks of the filter (`ground.block`) along an edge,
    least : where at least so many cells of `cell` hold an echo; others keep what is set,
    tried : and tried on so many squares of edge `square` of each.
    """

    building_margin: float = Field(ge=1, le=100)
    building_most: float = Field(gt=0, le=10_000)
    method: Method
    referees: tuple[Method, ...] = Field(min_length=3)
    candidates: dict[Method, tuple[Group, ...]]
    thin: float = Field(ge=1)
    cell: float = Field(ge=LEAST_CELL)
    sample: int = Field(gt=0, le=1_000_000_000)
    square: float = Field(ge=1, le=100_000)
    blocks: int = Field(ge=1, le=1000)
    least: int = Field(ge=1, le=1_000_000_000)
    tried: int = Field(ge=1, le=10_000)

    @model_validator(mode="after")
    def _groups_fit(self) -> Self:
        for method, groups in self.candidates.items():
            for group in groups:
                if len({len(v) for v in group.values()}) != 1 or not all(group.values()):
                    raise ValueError(
                        f"candidates of {method}: parameters that change together need as many values each"
                    )
            if math.prod(len(next(iter(group.values()))) for group in groups) > MOST_TRIED:
                raise ValueError(f"candidates of {method}: more than {MOST_TRIED} combinations")
        return self

    def updates(self, method: Method) -> list[dict[str, float]]:
        """Every combination of the groups of a filter, by name and in the settings' units [m], the first values first;
        none where it has no candidates."""
        groups = self.candidates.get(method, ())
        steps = [[dict(zip(g, v, strict=True)) for v in zip(*g.values(), strict=True)] for g in groups]
        return [{k: v for part in some for k, v in part.items()} for some in itertools.product(*steps)] if steps else []


def with_values(params: GroundParams, update: dict[str, float]) -> GroundParams:
    """`params` with other values, [name in its section: number in that setting's unit], for its method.

    pydantic's `ValidationError` for a value that cannot be.
    """
    section = section_of(params.method)
    own = getattr(params, section)
    values: dict[str, Any] = own.model_dump()
    for name, value in update.items():
        *part, last = name.split(".")
        (values[part[0]] if part else values)[last] = value
    return params.model_copy(update={section: type(own).model_validate(values)})


def largest_halo(base: GroundParams, rules: GroundAutoParams) -> float:
    """What is read around a block at most [m], whichever parameters its square gets."""
    fixed = base.model_copy(update={"method": rules.method})
    largest = max(base.max_building_size, rules.building_most)
    sized = fixed.model_copy(update={"max_building_size": largest})
    return max(p.halo for p in (fixed, *(with_values(sized, update) for update in ({}, *rules.updates(rules.method)))))


class GroundSearchParams(Params):
    """What is tried to find a filter's best parameters.

    Attributes
    ----------
    leading : so many parameters, the first of each filter's ranges, are tried together on a coarse grid.
    coarse : values of each of them on that grid.
    rounds : then all parameters are improved one after another, at most so many times.
    ranges : values tried, rising, by filter and parameter; the parameters of most effect come first.
    """

    leading: int = Field(ge=1, le=4)
    coarse: int = Field(ge=2, le=20)
    rounds: int = Field(ge=1, le=1000)
    ranges: dict[str, dict[str, Values]]

    @model_validator(mode="after")
    def _rising(self) -> Self:
        for method, own in self.ranges.items():
            for name, values in own.items():
                if not values or any(b <= a for a, b in itertools.pairwise(values)):
                    raise ValueError(f"{method}.{name} must list rising values")
        return self
