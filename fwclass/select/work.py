"""What a feature costs, as far as it can be told from its name: it decides between equals, so it is no timing."""

from __future__ import annotations

import math
from collections.abc import Iterable

from fwclass.schema import Scale, split_known

DENSITY = 4.0
"""Echoes/m2, to compare a radius with a number of nearest echoes (Fan 2013)."""

OPTIMAL = 250.0
"""Neighbours looked at for the optimal radius: those of nine spheres of 0.4 to 1.5 m."""


def scale_of(name: str) -> Scale | None:
    """The neighbourhood that a feature is taken over; None for a measured column."""
    parts = split_known(name)
    return parts[1] if parts is not None else None


def work(scale: Scale) -> float:
    """Number of neighbours that a neighbourhood is made of, about [echoes]."""
    if scale.kind == "k":
        return float(scale.size)
    if scale.kind == "o":
        return OPTIMAL
    area = math.pi * scale.metres**2 if scale.kind in "rc" else scale.metres**2
    return DENSITY * area


def extra_work(name: str, chosen: Iterable[str]) -> float:
    """Number of neighbours [echoes] that `name` adds to what `chosen` needs anyway; 0 where it needs no more
    neighbourhoods."""
    scale = scale_of(name)
    if scale is None or any(scale_of(c) == scale for c in chosen):
        return 0.0
    return work(scale)


def nominal(names: Iterable[str]) -> float:
    """Number of neighbours [echoes] that all of `names` need together."""
    return sum(work(s) for s in sorted({s for s in map(scale_of, names) if s is not None}))
