"""Shorelines as rows of places, and which of them an echo is near to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.units import QUANTUM
from fwclass.water.along import Bounds, divide, edges

MOST_BODIES = int(np.iinfo(np.int16).max)
"""Bodies of water of a survey; points know theirs by a number of 16 bits."""


def check_bodies(parts: int, where: object) -> None:
    """`InputError` for more bodies of water than `MOST_BODIES`."""
    if parts > MOST_BODIES:
        raise InputError(
            "too many polygons of water",
            where=where,
            expected=f"at most {MOST_BODIES:,}",
            got=f"{parts:,}",
            do="leave out the small ones, or those outside the survey",
        )


NEAREST = 4
"""Places of a shoreline that are held against each other; hardly ever are more as near as each other."""


@dataclass(frozen=True)
class Shoreline:
    """Places along shorelines.

    Attributes
    ----------
    x, y : float64 (n,) [m], whole millimetres.
    body : int64 (n,) the body of water, from 0.
    stretch : int64 (n,) the piece of its shoreline, from 0.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    body: NDArray[np.int64]
    stretch: NDArray[np.int64]


def shoreline(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    ring_start: NDArray[np.int64],
    part_start: NDArray[np.int64],
    step: float,
    stretch: float,
    box: Bounds | None = None,
) -> Shoreline:
    """Places every `step` [m] at most along the rings of bodies, which are cut into pieces of `stretch` [m].

    Where two bodies share a side there is no shore.

    Parameters
    ----------
    x, y : (points,) [mm], rings one after another, each closed.
    ring_start, part_start : points of every ring, rings of every body.
    box : xmin, ymin, xmax, ymax [m]; places in it are made, and some beside.
    """
    at = edges(ring_start, len(x))
    ring = np.searchsorted(ring_start, at, "right") - 1
    body = np.searchsorted(part_start, ring, "right") - 1
    length = np.hypot(x[at + 1] - x[at], y[at + 1] - y[at]) * QUANTUM
    along = np.cumsum(length) - length
    along -= along[np.searchsorted(body, body)]
    turned = (x[at] > x[at + 1]) | ((x[at] == x[at + 1]) & (y[at] > y[at + 1]))
    low, high = np.where(turned, at + 1, at), np.where(turned, at, at + 1)  # a shared side gets the same places
    limits = None if box is None else (box[0] / QUANTUM, box[1] / QUANTUM, box[2] / QUANTUM, box[3] / QUANTUM)
    edge, share = divide((x[low], x[high]), (y[low], y[high]), length, step, limits)
    places = [np.rint(v[low[edge]] + share * (v[high[edge]] - v[low[edge]])).astype(np.int64) for v in (x, y)]
    piece = np.floor((along[edge] + share * length[edge]) / stretch).astype(np.int64)
    single = _of_one(np.column_stack(places), body[edge])
    px, py = (np.asarray(v[single] * QUANTUM, np.float64) for v in places)
    return Shoreline(px, py, body[edge][single], piece[single])


def _of_one(places: NDArray[np.int64], body: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Places that no other body has too."""
    if not len(places):
        return np.zeros(0, bool)
    place = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.lexsort((body, place))
    starts = np.flatnonzero(np.r_[True, np.diff(place[order]) > 0])
    several = np.minimum.reduceat(body[order], starts) < np.maximum.reduceat(body[order], starts)
    return ~several[place]


def nearest_shore(
    line: Shoreline, x: NDArray[np.float64], y: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Points [m] within `reach` [m] of a place of the shoreline, and the number of the nearest place of each; of
    places as near as each other the first, whatever other points and places there are."""
    none = np.zeros(0, np.int64)
    if not len(x) or not len(line.x):
        return none, none
    origin = np.array([line.x[0], line.y[0]])
    near = (line.x >= x.min() - reach) & (line.x <= x.max() + reach)
    near &= (line.y >= y.min() - reach) & (line.y <= y.max() + reach)
    places = np.flatnonzero(near)
    if not len(places):
        return none, none
    tree = scipy.spatial.cKDTree(np.column_stack([line.x, line.y])[places] - origin)
    nearest = tree.query(np.column_stack([x, y]) - origin, NEAREST, distance_upper_bound=reach)
    distance, number = (np.asarray(values) for values in nearest)
    rows = np.flatnonzero(np.isfinite(distance[:, 0]))
    equal = distance[rows] == distance[rows, :1]
    return rows, places[np.where(equal, number[rows], len(places)).min(axis=1)]
