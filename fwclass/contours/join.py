"""Pieces of contour lines of all blocks become lines, by where they begin and end alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.contours.chains import chains
from fwclass.contours.lines import Lines


@dataclass(frozen=True)
class LinePieces:
    """What is known of pieces without their vertices.

    Attributes
    ----------
    ends : int64 (n, 8) level, where it begins and ends (three numbers each, see `Lines`), and how many vertices it has.
    measures : float64 (n, 6) length [m], twice the area about its first vertex [m²], x and y of its first and its last
        vertex [m].
    """

    ends: NDArray[np.int64]
    measures: NDArray[np.float64]

    @classmethod
    def of(cls, lines: Lines) -> LinePieces:
        """Ends, lengths and areas of the pieces that `lines` of one block are."""
        first = np.append(0, np.cumsum(lines.count))[:-1]
        tips = np.hstack([lines.vertices[first], lines.vertices[first + lines.count - 1]])
        away = lines.vertices - np.repeat(tips[:, :2], lines.count, axis=0)
        step = np.diff(lines.vertices, axis=0, append=lines.vertices[-1:])
        step[first + lines.count - 1] = 0.0  # to the next piece
        measured = np.stack([np.hypot(*step.T), away[:, 0] * step[:, 1] - away[:, 1] * step[:, 0]])
        sums = np.add.reduceat(measured, first, axis=1) if len(first) else np.empty((2, 0))
        ends = np.column_stack([lines.level, lines.begin, lines.end, lines.count])
        return cls(ends, np.column_stack([*sums, tips]))


@dataclass(frozen=True)
class ContourLines:
    """Contour lines, as rows of `LinePieces`.

    Attributes
    ----------
    order : int64 (n,) the pieces, line after line.
    first : int64 (lines + 1,) where each line begins in `order`.
    level : int64 (lines,).
    length : float64 (lines,) [m].
    depression : bool (lines,) closed around lower land.
    """

    order: NDArray[np.int64]
    first: NDArray[np.int64]
    level: NDArray[np.int64]
    length: NDArray[np.float64]
    depression: NDArray[np.bool_]


def join_lines(pieces: LinePieces) -> ContourLines:
    """Lines of the pieces of all blocks, by the first piece of each."""
    ends, n = pieces.ends, len(pieces.ends)
    places = np.concatenate([ends[:, :4], ends[:, [0, 4, 5, 6]]])
    number = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
    begins = np.full(2 * n, -1, np.int64)
    begins[number[:n]] = np.arange(n)
    lines = chains(begins[number[n:]])
    length, area, x0, y0, x1, y1 = pieces.measures[lines.order].T
    counts = np.diff(lines.first)
    x, y = (np.repeat(v[lines.first[:-1]], counts) for v in (x0, y0))  # areas about one vertex of the line
    area = area + (x0 - x) * (y1 - y0) - (y0 - y) * (x1 - x0)
    whole = [np.add.reduceat(v, lines.first[:-1]) if n else v for v in (length, area)]
    return ContourLines(
        lines.order, lines.first, ends[lines.order[lines.first[:-1]], 0], whole[0], lines.closed & (whole[1] < 0)
    )
