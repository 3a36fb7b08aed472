"""The rows that a tree grows from: a bootstrap, or a share without replacement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.hashing import below, seed_for
from fwclass.kernel import kernel


class Drawing(NamedTuple):
    """How a tree's rows are drawn: what `share` of the sample, 0 to 1, with or without `replacement`."""

    seed: int
    share: float
    replacement: bool


@kernel
def draw_bag(state, draws, weight):  # type: ignore[no-untyped-def]
    """Draw rows with replacement; `weight` (rows,) int32 counts how often each was drawn."""
    weight[:] = 0
    for _ in range(draws):
        weight[below(state, len(weight))] += 1


@kernel
def draw_share(state, draws, weight):  # type: ignore[no-untyped-def]
    """Draw rows without replacement: every row by the odds that the rest must still be filled (Knuth 1997, 3.4.2 S).
    `weight` (rows,) int32 becomes 1 for those that are drawn, 0 for the others."""
    rest = draws
    for i in range(len(weight)):
        weight[i] = 1 if below(state, len(weight) - i) < rest else 0
        rest -= weight[i]


def bag(rows: int, tree: int, drawing: Drawing) -> tuple[NDArray[np.int32], NDArray[np.uint64]]:
    """int32 (rows,): how often every row was drawn for `tree`; uint64 (1,): the generator's state after that."""
    state = np.array([seed_for(drawing.seed, tree + 1)], np.uint64)
    weight = np.zeros(rows, np.int32)
    draws = max(1, round(rows * drawing.share))
    (draw_bag if drawing.replacement else draw_share)(state, draws, weight)
    return weight, state
