"""Voids: areas inside a survey where no pulse came back; and the pieces that a survey falls into. Both are the same
whatever the stripes that its raster comes in."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import Box, Window
from fwclass.pieces import linked_groups

LISTED = 1000
"""Largest voids that are told one by one."""

PIECE, BESIDE = 0.05, 100.0
"""Share of the area from which on a piece of the survey counts, and how far from another [m] one lies beside it."""


@dataclass(frozen=True)
class Void:
    """Cells that hang together: their area [m²], and the box around them."""

    area: float
    box: Box


class CellGroups:
    """Cells of `window` that hang together by their sides, or by `corners` too, taken in stripe by stripe from the
    north; memory grows with their groups."""

    def __init__(self, window: Window, corners: bool = False) -> None:
        self._window, self._groups, self._corners = window, 0, corners
        self._north: NDArray[np.int64] | None = None
        self._joins: list[NDArray[np.int64]] = []
        self._facts: list[NDArray[np.int64]] = []

    def add(self, stripe: Window, chosen: NDArray[np.bool_]) -> None:
        """Take in the next `stripe` to the south, as wide as the window; row 0 of `chosen`, (rows, columns), is its
        south."""
        labels, n = scipy.ndimage.label(chosen, np.ones((3, 3)) if self._corners else None)
        ids = np.where(labels > 0, labels.astype(np.int64) + (self._groups - 1), -1)
        if self._north is not None:
            for k in (-1, 0, 1) if self._corners else (0,):
                north, south = (row[max(s, 0) : len(row) + min(s, 0)] for row, s in ((self._north, k), (ids[-1], -k)))
                both = (north >= 0) & (south >= 0)
                self._joins.append(np.unique(np.stack([north[both], south[both]], axis=1), axis=0))
        rows, cols = np.nonzero(chosen)
        of = labels[rows, cols] - 1
        facts = np.zeros((n, 6), np.int64)
        facts[:, 0] = np.bincount(of, minlength=n)
        facts[:, 1:3], facts[:, 3:5] = np.iinfo(np.int64).max, np.iinfo(np.int64).min
        for k, values in ((1, rows + stripe.row), (2, cols + stripe.col)):
            np.minimum.at(facts[:, k], of, values)
            np.maximum.at(facts[:, k + 2], of, values)
        edge = [labels[:, 0], labels[:, -1]]
        edge += [labels[-1]] if stripe.row + stripe.nrows == self._window.row + self._window.nrows else []
        edge += [labels[0]] if stripe.row == self._window.row else []
        outer = np.unique(np.concatenate(edge))
        facts[outer[outer > 0] - 1, 5] = 1
        self._facts.append(facts)
        self._north = ids[0]
        self._groups += n

    def voids(self, least: float) -> list[Void]:
        """Groups of at least `least` [m²] that do not reach the window's edge, the largest first."""
        return self._voids(least, False)

    @property
    def area(self) -> float:
        """Area of all groups [m²]."""
        return float(sum(int(facts[:, 0].sum()) for facts in self._facts)) * self._window.cell**2

    def pieces(self, share: float = PIECE) -> list[Void]:
        """Groups of at least this `share` of the area [m²], the largest first: of sparse echoes nearly every cell is a
        group."""
        return self._voids(share * self.area, True)

    def _voids(self, least: float, outer: bool) -> list[Void]:
        facts = np.concatenate([np.empty((0, 6), np.int64), *self._facts])
        joins = np.concatenate([np.empty((0, 2), np.int64), *self._joins])
        n, cell = len(facts), self._window.cell
        of = linked_groups(n, joins[:, 0], joins[:, 1])
        number = int(of.max(initial=-1)) + 1
        cells = np.bincount(of, facts[:, 0], minlength=number)
        low = np.full((number, 2), np.iinfo(np.int64).max)
        high = np.full((number, 2), np.iinfo(np.int64).min)
        np.minimum.at(low, of, facts[:, 1:3])
        np.maximum.at(high, of, facts[:, 3:5])
        outside = np.bincount(of, facts[:, 5], minlength=number) > 0
        chosen = np.flatnonzero((outer | ~outside) & (cells * cell**2 >= least))
        order = chosen[np.lexsort((low[chosen, 1], low[chosen, 0], -cells[chosen]))]
        boxes = np.concatenate([low[:, ::-1], high[:, ::-1] + 1], axis=1) * cell
        return [Void(float(cells[k]) * cell**2, Box(*boxes[k].tolist())) for k in order.tolist()]


def void_facts(voids: Sequence[Void], least: float, area: float) -> dict[str, Any]:
    """``least`` [m²] that counts, ``count``, ``area`` of all [m²], ``share`` of them and `area` that has echoes, and
    the ``largest``: area and bounds [m] of up to `LISTED`."""
    total = sum(v.area for v in voids)
    return {
        "least": least,
        "count": len(voids),
        "area": total,
        "share": total / (area + total) if area + total else None,
        "largest": [{"area": v.area, "bounds": list(v.box.bounds)} for v in voids[:LISTED]],
    }


def piece_remarks(pieces: Sequence[Void], area: float) -> list[str]:
    """That a survey of so much `area` [m²] falls into `pieces` beside each other, as where a strip or a file is
    missing: what lies between them is open to the outside, and no void."""
    apart = min((_apart(a.box, b.box) for a, b in itertools.combinations(pieces, 2)), default=BESIDE)
    if apart >= BESIDE:
        return []
    shares = " and ".join(f"{100 * p.area / area:.0f} %" for p in pieces)
    return [
        f"the echoes lie in {len(pieces)} pieces beside each other ({shares} of the area): water, or is a strip or a "
        "file missing between them? What is open to the outside is no void; polygons of the survey (quality.area) tell "
        "such gaps"
    ]


def _apart(a: Box, b: Box) -> float:
    """How far two boxes lie from each other, along the axis that they are further apart on [m]."""
    return max(a.xmin - b.xmax, b.xmin - a.xmax, a.ymin - b.ymax, b.ymin - a.ymax, 0.0)
