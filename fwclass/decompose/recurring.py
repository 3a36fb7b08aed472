"""Echoes that no scene makes: in many waveforms one of the same share of the highest echo's height follows it, or goes
before, by the same time, or one of the same height stands at the same place of the record.

A receiver that rings, is overloaded or does not grow with the light, a pulse that has another shape in some waveforms,
and crosstalk at a time of the receiver's own do so, in records of any format.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import Fits

Floats = NDArray[np.float64]

BEHIND, OVERLOADED, IN_RECORD = "behind", "overloaded", "in record"
"""What the time of recurring echoes counts from: the highest echo of their waveform, one that is saturated, whose
height is not known well enough to be a measure of theirs, or the first sample."""

IN_WIDTHS, IN_HEIGHTS = 0.25, 0.35
"""Edges of the cells in which echoes are counted: of time in pulse widths, of height in its natural logarithm."""

ASIDE_IN_TIME, ASIDE_IN_HEIGHT = (3, 4, 5), (3, 4)
"""How many cells away, to either side, echoes are counted that are like any others."""

FAR, HIGH = 3.0, 0.3
"""Pulse widths from the highest echo from which on one more than so many times as high is a second surface, as a
greenhouse's roof."""

ABOVE = 3.0
"""Times as many as there that may lie together by the scene: on three receivers 0.9 to 3.0 lie in the fullest cells,
where the scene is even 1.3."""

FEWEST = 30
"""Echoes that lie together by chance."""


@dataclass(frozen=True)
class Recurring:
    """Echoes that come again, beyond what the scene makes.

    Attributes
    ----------
    of : `BEHIND`, `OVERLOADED` or `IN_RECORD`.
    time : where they are [ns], negative: before the highest echo.
    height : share of the highest echo's height; in the record [DN]; behind saturated ones 0.
    separate : so far from the highest echo that a vendor's return would be its own.
    waveforms, share : that have one, and of those with echoes, both less `ABOVE` times the number beside.
    """

    of: str
    time: float
    height: float
    separate: bool
    waveforms: int
    share: float


def recurring_echoes(fits: Fits, fwhm: float, tolerance: float) -> tuple[Recurring, ...]:
    """What comes again among the echoes of a strip's sample, of each kind at most one.

    Parameters
    ----------
    fits : of the sample; every row is a waveform.
    fwhm, tolerance : width of the pulse, and how far an echo may be from its return [ns].
    """
    waveforms = len(np.unique(fits.row))
    order = np.lexsort((fits.time, -fits.amplitude, fits.row))
    row, time, height = fits.row[order], fits.time[order], fits.amplitude[order]
    highest = np.append(True, row[1:] != row[:-1])[: len(row)]
    other = np.flatnonzero(~highest & (height > 0.0))
    top = np.maximum.accumulate(np.where(highest, np.arange(len(row)), 0))[other]
    after, share = time[other] - time[top], height[other] / height[top]
    full, near = fits.flags[order][top] & SATURATED > 0, (np.abs(after) <= FAR * fwhm) | (share <= HIGH)
    kinds = (
        (BEHIND, after[near], np.log(share[near])),
        (OVERLOADED, after[full], np.zeros(int(full.sum()))),
        (IN_RECORD, time[other], np.log(height[other])),
    )
    every = np.stack([time / (IN_WIDTHS * fwhm), np.log(np.maximum(height, 1e-9)) / IN_HEIGHTS], axis=1)
    crowded = []
    for kind, at, high in kinds:
        points = np.stack([at / (IN_WIDTHS * fwhm), high / IN_HEIGHTS], axis=1)
        # first echoes begin where the receiver was triggered, the highest ones as well as others
        more, when, size = _crowded(points, every if kind == IN_RECORD else points)
        if more > 0:
            when, size = when * IN_WIDTHS * fwhm, 0.0 if kind == OVERLOADED else float(np.exp(size * IN_HEIGHTS))
            separate = kind == IN_RECORD or abs(when) > tolerance
            crowded.append(Recurring(kind, when, size, separate, more, more / waveforms))
    return tuple(crowded)


def _crowded(points: Floats, like: Floats) -> tuple[int, float, float]:
    """(points, u, v) of the 2 x 2 cells of edge 1 that hold most `points`, (n, 2), less `ABOVE` times those of `like`,
    (m, 2), on the fuller side, and their middle; no points where these are few."""
    if len(points) < FEWEST:
        return 0, 0.0, 0.0
    counts = _by_corner(points)
    (a, b), most = max(counts.items(), key=lambda one: (one[1], one[0]))
    beside = counts if like is points else _by_corner(like)
    sides = [[(a + way * d, b) for d in ASIDE_IN_TIME] for way in (-1, 1)]
    sides += [[(a, b + way * d) for d in ASIDE_IN_HEIGHT] for way in (-1, 1)]
    more = int(most - ABOVE * max(sum(beside.get(cell, 0) for cell in side) / len(side) for side in sides))
    return (more if most >= FEWEST else 0), a + 1.0, b + 1.0


def _by_corner(points: Floats) -> dict[tuple[int, int], int]:
    """How many `points`, (n, 2), lie in the 2 x 2 cells of edge 1 that begin at every corner near one."""
    cells = np.floor(points).astype(np.int64)
    corners = np.concatenate([cells - (i, j) for i in (0, 1) for j in (0, 1)])
    kinds, count = np.unique(corners, axis=0, return_counts=True)
    return {(int(a), int(b)): int(n) for (a, b), n in zip(kinds, count, strict=True)}
