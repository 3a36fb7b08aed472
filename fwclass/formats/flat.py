"""Coordinates that are no lengths on a plane: degrees, places that count from the middle of the earth, and depths.

Everything here measures in metres, with z up. A file says by its coordinate system that it does not, or by its numbers
where it names none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from fwclass.errors import InputError

TAKEN_FOR_METRES = "no coordinate system is named: the numbers are taken for metres (--crs names one)"
"""What a command says of a file whose units nobody tells."""

DEGREES, GEOCENTRIC, DOWN = "in degrees", "geocentric", "downwards"

_WORDS = {
    DEGREES: "the coordinates are in degrees",
    GEOCENTRIC: "the coordinates are geocentric: they count from the middle of the earth, and z is not up",
    DOWN: "heights are depths: their system counts downwards",
}
_LIKE = {
    DEGREES: "the coordinates look like degrees",
    GEOCENTRIC: "the coordinates look geocentric, as if they counted from the middle of the earth",
    DOWN: _WORDS[DOWN],
}

LONGEST, HIGHEST = 360.0, 90.0
"""Degrees: no longitude, and no latitude, is larger."""

WIDEST = 5.0
"""Degrees that a file spans at most; 500 km of a flight."""

FINEST = 2e-5
"""Step of stored coordinates up to which they may be degrees (2 m); lengths are stored in coarser ones, of 1e-4 and
more, and degrees in such steps would be places 10 m and more apart."""

STEEP = 10.0
"""Heights of so many times the width are no piece of land in metres, whatever the step."""

RADIUS, ABOUT = 6.371e6, 6e4
"""Of the earth [m], and how far a place on it or above it is from that."""

NO_HEIGHT = 1e5
"""m, higher than anything over land or sea."""


class PlacedFile(Protocol):
    """A file that says where its points lie: bounds (6) with the least x, y, z before the largest, steps of x, y, z."""

    @property
    def path(self) -> Path:
        """Of the file, for messages."""
        ...

    @property
    def bounds(self) -> tuple[float, ...]:
        """xmin, ymin, zmin, xmax, ymax, zmax as the header has them."""
        ...

    @property
    def scales(self) -> tuple[float, ...]:
        """Steps of x, y, z."""
        ...

    @property
    def crs(self) -> Any:
        """The coordinate system, or None."""
        ...


def not_flat(crs: Any, low: Sequence[float], high: Sequence[float], step: float | None = None) -> str:
    """`DEGREES`, `GEOCENTRIC`, `DOWN` or "".

    `crs`: `pyproj.CRS` of the coordinates, or None. Beside a projected one, as a user may have named for a file in
    degrees, the numbers must say twice that they are degrees. `low`, `high`: least and largest x, y and z; numbers that
    are not finite say nothing. `step`: of the stored x and y, None where they are text.
    """
    if crs is not None and crs.is_geographic:
        return DEGREES
    if crs is not None and crs.is_geocentric:
        return GEOCENTRIC
    if crs is not None and any(axis.direction == "down" for axis in crs.axis_info):
        return DOWN
    if not all(map(math.isfinite, (*low, *high))):
        return ""
    away = math.hypot(*((a + b) / 2.0 for a, b in zip(low, high, strict=True)))
    if abs(away - RADIUS) < ABOUT and min(abs(low[2]), abs(high[2])) > NO_HEIGHT:
        return GEOCENTRIC
    wide, deep, up = (b - a for a, b in zip(low, high, strict=True))
    small = max(abs(low[0]), abs(high[0])) <= LONGEST and max(abs(low[1]), abs(high[1])) <= HIGHEST
    if not small or not 0.0 < max(wide, deep) <= WIDEST:
        return ""
    fine, steep = step is not None and step <= FINEST, up > STEEP * max(wide, deep)
    return DEGREES if (fine and steep if crs is not None else fine or steep) else ""


def _named(crs: Any) -> bool:
    """A projected system, which the numbers are not of."""
    return crs is not None and not (crs.is_geographic or crs.is_geocentric)


def words(kind: str, crs: Any) -> str:
    """What `not_flat` told, in words: certain where the system says it."""
    return (_LIKE if crs is None or _named(crs) else _WORDS)[kind]


def refuse_unless_flat(
    crs: Any, low: Sequence[float], high: Sequence[float], where: object, step: float | None = None
) -> None:
    """`InputError` for what `not_flat` tells; the parameters are its own."""
    kind = not_flat(crs, low, high, step)
    if kind:
        x, y, z = (f"{a} {u:.10g} to {v:.10g}" for a, u, v in zip("xyz", low, high, strict=True))
        raise InputError(
            words(kind, crs),
            where=where,
            expected="a projected coordinate system in metres: every distance here is a length, and z is up",
            got=f"{crs.name}; {x}, {y}, {z}" if crs is not None else f"no coordinate system named; {x}, {y}, {z}",
            do="reproject the file first (for example with PDAL's filters.reprojection), or bring it into "
            "another system: fwclass decompose --crs, in a run read.project_to"
            + (", or name the system that its metres are in" if crs is None else "")
            + ("; naming a system (--crs, survey.crs) transforms nothing" if _named(crs) else ""),
        )


def refuse_source(source: PlacedFile, crs: Any) -> None:
    """`InputError` where the header of `source` says that its coordinates are not flat; `crs` is what holds for it."""
    refuse_unless_flat(crs, source.bounds[:3], source.bounds[3:], source.path, max(source.scales[:2]))


def flat_faults(source: PlacedFile, low: Sequence[float], high: Sequence[float]) -> list[str]:
    """What `info` says of a file whose coordinates lie within `low` and `high`; its own degrees are told already."""
    kind = not_flat(source.crs, low, high, max(source.scales[:2]))
    if not kind or (source.crs is not None and source.crs.is_geographic):
        return []
    return [f"{words(kind, source.crs)}: reproject the file to metres first, or decompose it with --crs"]
