"""Folds of cross-validation that lie apart in space: whole blocks of one global grid."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import millimetres, whole_millimetres


@dataclass(frozen=True)
class Folds:
    """Which fold judges a row, and which rows may train for a fold.

    Attributes
    ----------
    fold : int16 (rows,), the fold in which a row is judged.
    near : bool (folds, rows), the row lies in a block of the fold or nearer than the gap to one.
    blocks : how many blocks have rows.
    """

    fold: NDArray[np.int16]
    near: NDArray[np.bool_]
    blocks: int

    def trains(self, fold: int) -> NDArray[np.bool_]:
        """bool (rows,): rows that the forest of `fold` is grown from."""
        return np.asarray(~self.near[fold])

    def judged(self, fold: int) -> NDArray[np.bool_]:
        """bool (rows,): rows that `fold` judges."""
        return np.asarray(self.fold == fold)


def spatial_folds(
    x: NDArray[np.float64], y: NDArray[np.float64], classes: NDArray[np.uint8], edge: float, gap: float, folds: int
) -> Folds:
    """Folds of blocks of `edge` [m] of the grid with origin (0, 0); rows nearer than `gap` [m] to a judged block do
    not train for it.

    Blocks are dealt out one after another, those with the largest share of a class first, each to the fold that has
    least of the block's classes: every fold gets its share of every class as far as whole blocks allow. The rows'
    order and the tiles they came from change nothing.
    """
    mm, wide = whole_millimetres(edge, "select.block"), round(gap * 1000)
    mx, my = millimetres(x), millimetres(y)
    col0, row0 = int((mx // mm).min()) - 1, int((my // mm).min()) - 1
    ncols = int((mx // mm).max()) - col0 + 2

    def block(dx: int, dy: int) -> NDArray[np.int64]:
        return ((my + dy) // mm - row0) * ncols + (mx + dx) // mm - col0

    known, inverse = np.unique(block(0, 0), return_inverse=True)
    if len(known) < folds:
        raise InputError(
            "the training areas have too few blocks to judge one by the others",
            where="select.folds, select.block",
            expected=f"at least {folds} blocks of {edge:g} m with labelled echoes",
            got=f"{len(known)} blocks",
            do="give more or larger training areas, or smaller blocks: --set select.block=...",
        )
    dealt = _dealt(inverse, classes, len(known), folds)
    near = np.zeros((folds, len(mx)), bool)
    steps = (-wide, wide) if 2 * wide <= mm else (-wide, 0, wide)  # no block lies between the ends of a short step
    for dx, dy in product(steps, steps):
        there = block(dx, dy)
        place = np.minimum(np.searchsorted(known, there), len(known) - 1)
        rows = np.flatnonzero(known[place] == there)
        near[dealt[place[rows]], rows] = True
    return Folds(dealt[inverse].astype(np.int16), near, len(known))


def _dealt(block: NDArray[np.int64], classes: NDArray[np.uint8], blocks: int, folds: int) -> NDArray[np.int64]:
    """The fold of every block."""
    n = int(classes.max()) + 1
    count = np.bincount(block * n + classes, minlength=blocks * n).reshape(blocks, n)
    share = count / np.maximum(count.sum(axis=0), 1)
    has = np.zeros((folds, n))
    fold = np.empty(blocks, np.int64)
    for b in np.argsort(-share.max(axis=1), kind="stable"):
        clash = has @ share[b]
        fold[b] = min(range(folds), key=lambda f: (clash[f], has[f].sum(), f))
        has[fold[b]] += share[b]
    return fold


def check_folds(folds: Folds, classes: NDArray[np.uint8], names: tuple[str, ...]) -> tuple[str, ...]:
    """Remarks for the user; `classes`, uint8 (rows,), are those of the sample's rows.

    `InputError` where a forest would have to judge a class that it never saw.
    """
    notes = []
    for k, name in enumerate(names):
        mine = classes == k
        judging = [f for f in range(len(folds.near)) if (mine & folds.judged(f)).any()]
        for f in judging:
            if not (mine & folds.trains(f)).any():
                raise InputError(
                    f"class {name!r} cannot be judged in places that did not train it",
                    where="select.block, select.gap",
                    expected="labelled echoes of every class in several blocks of the training areas",
                    got=f"all {int(mine.sum())} echoes of {name!r} lie in fold {f} or within the gap around it",
                    do="give training areas with more of it, smaller blocks (--set select.block=...), or leave it out",
                )
        lacking = len(folds.near) - len(judging)
        if lacking:
            notes.append(f"class {name!r} is judged in {len(judging)} of {len(folds.near)} folds only")
    return tuple(notes)
