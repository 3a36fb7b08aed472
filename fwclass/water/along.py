"""Places along lines, at equal steps of every edge."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError, InputError

Ends = tuple[NDArray[Any], NDArray[Any]]
"""A coordinate of the beginnings and of the ends of edges."""

Bounds = tuple[float, float, float, float]
"""xmin, ymin, xmax, ymax in the unit of the lines."""

MOST = 10_000_000
"""Places along the lines of a file, near the survey; every 0.5 m they are 5000 km."""

LONGEST = 4.0e7
"""m, around the Earth: no edge of a line is longer."""


def edges(ring_start: NDArray[np.int64], points: int) -> NDArray[np.int64]:
    """Indices of the points from which an edge leads to the next point of the same line.

    `ring_start`: int64 (lines + 1,), the first point of every line, and the number of all `points`.
    """
    last = np.zeros(points, bool)
    last[ring_start[1:] - 1] = True
    return np.flatnonzero(~last)


def divide(
    x: Ends, y: Ends, length: NDArray[np.float64], step: float, box: Bounds | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Places at the beginning of every edge and `step` [m] at most apart on it: int64 (places,), the number of its
    edge, and float64 (places,), the share of its length that lies before the place, 0 to 1.

    `x`, `y` (edges,) [m]: where edges begin and end; `length` (edges,) [m]. Of edges that leave the `box` the places in
    it are made, and one or two beside. `InputError` where these are more than `MOST`, and for an edge beyond `LONGEST`.
    """
    whole, first, count = _counted(x, y, length, step, box)
    if not _few(length, count):
        raise InputError(**_too_long("water.file or breaklines.file", length, step))
    number = count.astype(np.int64)
    edge = np.repeat(np.arange(len(length)), number)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(number) - number, number) + first[edge]
    return edge, place / whole[edge]


def check_lines(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    ring_start: NDArray[np.int64],
    step: float,
    box: Bounds,
    where: object,
) -> None:
    """`ConfigError` for lines that `knots_along` or `shoreline` would refuse, before anything is made of them.

    `x`, `y` (points,) [m]: the lines one after another; `ring_start` int64 (lines + 1,), as `edges` has it; `step` [m]
    between places; `box` [m], None: all of them count.
    """
    at = edges(ring_start, len(x))
    length = _lengths(x, y, at)
    if not _few(length, _counted((x[at], x[at + 1]), (y[at], y[at + 1]), length, step, box)[2]):
        raise ConfigError(**_too_long(where, length, step))


def _lengths(x: NDArray[Any], y: NDArray[Any], at: NDArray[np.int64]) -> NDArray[np.float64]:
    with np.errstate(over="ignore"):
        out: NDArray[np.float64] = np.hypot(x[at + 1] - x[at], y[at + 1] - y[at])
    return out


def _counted(
    x: Ends, y: Ends, length: NDArray[np.float64], step: float, box: Bounds | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Of every edge the places on all of it, the first that is made, and how many are."""
    whole = np.maximum(1, np.ceil(length / step))
    first, last = np.zeros(len(whole)), whole
    if box is not None:
        enter, leave = _shares_in(x, y, box)
        with np.errstate(invalid="ignore"):  # a length without end
            first, last = np.maximum(0, np.floor(enter * whole) - 1), np.minimum(whole, np.ceil(leave * whole) + 2)
    return whole, first, np.maximum(0, last - first)


def _few(length: NDArray[np.float64], count: NDArray[np.float64]) -> bool:
    return bool((length <= LONGEST).all() and count.sum() <= MOST)


def _too_long(where: object, length: NDArray[np.float64], step: float) -> dict[str, Any]:
    return {
        "what": "lines are too long",
        "where": where,
        "expected": f"at most {MOST * step / 1000:,.0f} km, with a place every {step:g} m (terrain.thin)",
        "got": f"{length.sum() / 1000:.3g} km",
        "do": "check the file and its coordinate system, or leave out what is outside the survey",
    }


def _shares_in(x: Ends, y: Ends, box: Bounds) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """From which share of its length to which each edge lies in the box; the first is more than the last where it does
    not (Liang & Barsky 1984)."""
    enter, leave = np.zeros(len(x[0])), np.ones(len(x[0]))
    for (begin, end), low, high in zip((x, y), box[:2], box[2:], strict=True):
        way = end - begin
        with np.errstate(divide="ignore", invalid="ignore"):
            to_low, to_high = (low - begin) / way, (high - begin) / way
        still, inside = way == 0, (begin >= low) & (begin <= high)
        enter = np.maximum(enter, np.where(still, np.where(inside, 0.0, 2.0), np.minimum(to_low, to_high)))
        leave = np.minimum(leave, np.where(still, 1.0, np.maximum(to_low, to_high)))
    return enter, leave


def lines_outside(x: NDArray[np.float64], y: NDArray[np.float64], ring_start: NDArray[np.int64], box: Bounds) -> int:
    """How many lines have no place in `box` [m]; `x`, `y` (points,) [m] and `ring_start` as `check_lines` has them."""
    at = edges(ring_start, len(x))
    enter, leave = _shares_in((x[at], x[at + 1]), (y[at], y[at + 1]), box)
    line = np.searchsorted(ring_start, at[enter <= leave], side="right")
    return len(ring_start) - 1 - len(np.unique(line))


def knots_along(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    ring_start: NDArray[np.int64],
    step: float,
    box: Bounds | None = None,
) -> tuple[NDArray[np.float64], ...]:
    """x, y, z [m] of places every `step` [m] at most along lines, their last points among them, with heights between
    those of the points; those in `box` [m] and some beside."""
    at = edges(ring_start, len(x))
    length = _lengths(x, y, at)
    edge, share = divide((x[at], x[at + 1]), (y[at], y[at + 1]), length, step, box)
    a, ends = at[edge], ring_start[1:] - 1
    return tuple(np.append(v[a] + share * (v[a + 1] - v[a]), v[ends]) for v in (x, y, z))
