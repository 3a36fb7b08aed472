"""The second layer: which echoes are at the boundary of two classes, and what they are.

Source: Shi 2019, section 2.4 (the fine layer); what a boundary is, is ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.shares import answer, entropy
from fwclass.classify.stage import probability_columns
from fwclass.model import TwoLayer
from fwclass.neighbours import nearest_within
from fwclass.schema import Table
from fwclass.stage import Chunk, Computation

COARSE = ("coarse_class", "coarse_confidence", "coarse_entropy")
"""Columns of the first layer's answers."""

BOUNDARY = "boundary"

REFINE = Computation(name="refine", version=1, writes=(BOUNDARY,))


def at_boundary(chunk: Chunk, pair: tuple[int, int], within: float) -> NDArray[np.bool_]:
    """bool (core rows,): the first layer says one of the class codes `pair`, and of an echo within `within` [m] the
    other. `chunk` has x, y, z and ``coarse_class``, and rows as far around."""
    table, core = chunk.table, chunk.core
    codes = table["coarse_class"]
    boundary = np.zeros(len(core), bool)
    for mine, yours in (pair, pair[::-1]):
        ask, others = core[codes[core] == mine], np.flatnonzero(codes == yours)
        if len(ask) and len(others):
            near, _ = nearest_within(_places(table, ask), _places(table, others), within)
            boundary[codes[core] == mine] = near >= 0
    return boundary


def _places(table: Table, rows: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    return table["x"][rows], table["y"][rows], table["z"][rows]


def refine_boundary(table: Table, X: NDArray[np.float32], model: TwoLayer, coarse: Table | None = None) -> Table:
    """Class, confidence and entropy of rows that have `COARSE` and `BOUNDARY`; X, float32 (boundary rows, features),
    are the fine features of those at the boundary. Elsewhere the first layer's answers stay as they are.

    The table has (rows,) of each, confidence and entropy from 0 to 1. With `coarse`, what `classify` says by the first
    layer with probabilities, the share of every class too: at the boundary that of the second layer for the pair, 0 for
    the others.
    """
    rows = np.flatnonzero(table[BOUNDARY])
    names = ("classification", "confidence", "entropy")
    answers = {name: table[column].copy() for name, column in zip(names, COARSE, strict=True)}
    shares = {n: coarse[n].copy() for n in probability_columns(model.codes)} if coarse is not None else {}
    if len(rows):
        winner, of_pair = answer(X, model.fine)
        every = np.zeros((len(rows), len(model.codes)))
        order = np.argsort(model.codes)
        every[:, order[np.searchsorted(model.codes[order], model.fine.codes)]] = of_pair
        answers["classification"][rows] = model.fine.codes[winner]
        answers["confidence"][rows] = np.take_along_axis(of_pair, winner[:, None], axis=1)[:, 0]
        answers["entropy"][rows] = entropy(every)
        for k, values in enumerate(shares.values()):
            values[rows] = every[:, k]
    return Table({**answers, **shares})
