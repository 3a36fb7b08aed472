"""Pieces of strips, what a block knows of each, and the strips that they make together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NO_TIME = np.iinfo(np.int64).min
"""Span of time of echoes whose time is unknown."""

SUMS = ("n", "x", "y", "t", "xx", "xy", "yy", "xt", "yt", "tt")
"""Sums over a piece's echoes in a block: places in decimetres from the block's corner, times in hundredths of a second
from the beginning of the span; whole numbers, and exact in any order."""

UNIT, TICK = 0.1, 0.01
"""m and s: places and times of the sums are whole numbers of these."""

MAX_TIME = 1e12
"""s, beyond which a time is none."""

LEAST_LENGTH = 1.0
"""m that a strip must have moved along its line for its times to tell the direction."""


@dataclass(frozen=True)
class Pieces:
    """Echoes of one source file in one span of time, in one block.

    Attributes
    ----------
    file : number of the source file, int64 (pieces,).
    span : number of the span of `quality.line_gap` since time 0, `NO_TIME` without times, int64.
    sums : float64 (pieces, 10), `SUMS`.
    """

    file: NDArray[np.int64]
    span: NDArray[np.int64]
    sums: NDArray[np.float64]


def pieces_of(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    time: NDArray[np.float64],
    file: NDArray[np.integer],
    corner: tuple[float, float],
    gap: float,
) -> tuple[Pieces, NDArray[np.int64]]:
    """The pieces of a block whose south-west `corner` this is [m], and the number of each echo's piece."""
    span = np.full(len(x), NO_TIME)
    known = (np.abs(time) < MAX_TIME) & (time != 0)  # writers that know no time write 0
    span[known] = np.floor(time[known] / gap).astype(np.int64)
    files, of_file = np.unique(file.astype(np.int64), return_inverse=True)
    spans, of_span = np.unique(span, return_inverse=True)
    rows, number = np.unique(of_file * len(spans) + of_span, return_inverse=True)
    u, v = (np.rint((a - c) / UNIT) for a, c in ((x, corner[0]), (y, corner[1])))
    t = np.zeros(len(x))
    t[known] = np.rint((time[known] - span[known] * gap) / TICK)
    values = (np.ones(len(x)), u, v, t, u * u, u * v, v * v, u * t, v * t, t * t)
    sums = np.stack([np.bincount(number, a, minlength=len(rows)) for a in values], axis=1).astype(np.float64)
    at = divmod(rows, max(len(spans), 1))
    return Pieces(files[at[0]], spans[at[1]], sums), number


@dataclass(frozen=True)
class PlacedStrip:
    """A strip and where it lies.

    Attributes
    ----------
    files : numbers of its source files.
    echoes : how many.
    times : first and last span [s], None without times.
    centre : mean of its echoes [m].
    along : unit vector of the flight; by the times (`timed`), else the longer axis of its area, its sense unknown.
    half : half of its width across and of its length along the line [m], of echoes spread evenly.
    """

    files: tuple[int, ...]
    echoes: int
    times: tuple[float, float] | None
    centre: tuple[float, float]
    along: tuple[float, float]
    timed: bool
    half: tuple[float, float]

    @property
    def across(self) -> tuple[float, float]:
        """Unit vector (east, north) to the right of the flight."""
        return self.along[1], -self.along[0]

    @property
    def azimuth(self) -> float:
        """Of the flight, clockwise from north [deg]; of the axis below 180 where the sense is unknown."""
        return float(np.degrees(np.arctan2(self.along[0], self.along[1])) % (360.0 if self.timed else 180.0))

    def within(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
        """Places (x, y) [m] across and along, from -1 to 1 from edge to edge."""
        dx, dy = x - self.centre[0], y - self.centre[1]
        (ax, ay), (lx, ly) = self.across, self.along
        return (dx * ax + dy * ay) / self.half[0], (dx * lx + dy * ly) / self.half[1]


def lines(file: NDArray[np.int64], span: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 (pieces,): number of the line of every piece, of `file` and `span` int64 (pieces,): spans that follow one
    another without a gap are one, whatever the files; pieces without times are one for each file."""
    spans = np.unique(span[span != NO_TIME])
    starts = spans[np.flatnonzero(np.diff(spans, prepend=spans[:1] - 2) > 1)] if len(spans) else spans
    number = np.searchsorted(starts, span, side="right") - 1
    untimed = span == NO_TIME
    others = np.unique(file[untimed])
    number[untimed] = len(starts) + np.searchsorted(others, file[untimed])
    return number.astype(np.int64)


def strips_of(
    blocks: Sequence[Pieces], corners: Sequence[tuple[float, float]], number: Sequence[NDArray[np.int64]], gap: float
) -> list[PlacedStrip]:
    """The strips, in order of the `number`, int64 (pieces,), that each block's pieces have.

    `corners`: (x, y) of every block [m]. `gap`: what a span of time lasts [s].
    """
    strips = 1 + max((int(n.max()) for n in number if len(n)), default=-1)
    middle = np.mean(corners, axis=0) if len(corners) else np.zeros(2)
    first = np.full(strips, np.iinfo(np.int64).max)
    last = np.full(strips, NO_TIME)
    for block, n in zip(blocks, number, strict=True):
        timed = block.span != NO_TIME
        np.minimum.at(first, n[timed], block.span[timed])
        np.maximum.at(last, n[timed], block.span[timed])
    total = np.zeros((strips, len(SUMS)))
    files: list[set[int]] = [set() for _ in range(strips)]
    for block, corner, n in zip(blocks, corners, number, strict=True):
        begin = np.where(block.span == NO_TIME, 0, block.span - np.where(last[n] == NO_TIME, 0, first[n])) * gap
        np.add.at(total, n, _shift(block.sums, corner[0] - middle[0], corner[1] - middle[1], begin))
        for k, f in zip(n.tolist(), block.file.tolist(), strict=True):
            files[k].add(f)
    return [
        _strip(
            total[k],
            tuple(sorted(files[k])),
            (int(first[k]), int(last[k])) if last[k] != NO_TIME else None,
            middle,
            gap,
        )
        for k in range(strips)
    ]


def _shift(sums: NDArray[np.float64], dx: float, dy: float, dt: NDArray[np.float64]) -> NDArray[np.float64]:
    """`sums` in metres and seconds, of places and times moved by so much."""
    n = sums[:, 0]
    scale = np.array([1, UNIT, UNIT, TICK, UNIT**2, UNIT**2, UNIT**2, UNIT * TICK, UNIT * TICK, TICK**2])
    _, x, y, t, xx, xy, yy, xt, yt, tt = (sums * scale).T
    return np.stack(
        [
            n,
            x + n * dx,
            y + n * dy,
            t + n * dt,
            xx + 2 * dx * x + n * dx * dx,
            xy + dx * y + dy * x + n * dx * dy,
            yy + 2 * dy * y + n * dy * dy,
            xt + dx * t + dt * x + n * dx * dt,
            yt + dy * t + dt * y + n * dy * dt,
            tt + 2 * dt * t + n * dt * dt,
        ],
        axis=1,
    )


def _strip(
    sums: NDArray[np.float64],
    files: tuple[int, ...],
    spans: tuple[int, int] | None,
    middle: NDArray[np.float64],
    gap: float,
) -> PlacedStrip:
    n = sums[0]
    x, y, t = sums[1:4] / n
    xx, xy, yy, xt, yt, tt = sums[4:] / n - np.array([x * x, x * y, y * y, x * t, y * t, t * t])
    moved = np.hypot(xt, yt) / np.sqrt(tt) if tt > 0 else 0.0  # what time explains of the places [m]
    timed = spans is not None and bool(moved > LEAST_LENGTH)
    if timed:
        along = np.array([xt, yt]) / np.hypot(xt, yt)
    else:
        angle = 0.5 * np.arctan2(2 * xy, xx - yy)
        along = np.array([np.cos(angle), np.sin(angle)])
        along = along if along[1] > 0 or (along[1] == 0 and along[0] > 0) else -along
    right = np.array([along[1], -along[0]])
    spread = [max(0.0, float(d @ np.array([[xx, xy], [xy, yy]]) @ d)) for d in (right, along)]
    half = tuple(max(np.sqrt(3 * s), LEAST_LENGTH) for s in spread)
    times = None if spans is None else (spans[0] * gap, (spans[1] + 1) * gap)
    centre = float(middle[0] + x), float(middle[1] + y)
    return PlacedStrip(
        files, int(n), times, centre, (float(along[0]), float(along[1])), timed, (float(half[0]), float(half[1]))
    )
