"""Neighbours that agree: a mean field over the shares that a model gives echoes, by a Potts model of neighbouring
classes.

Source: mean field of a conditional random field (Krähenbühl and Koltun 2011, NIPS 24), a fixed number of rounds and all
echoes at once in each; nearest neighbours, whole-number shares and weights, and ties that no tile changes are ours.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.mean_field_kernels import agree, weigh
from fwclass.classify.params import RegularizeParams
from fwclass.classify.shares import entropy
from fwclass.classify.stage import probability_columns
from fwclass.grid import millimetres
from fwclass.model.contextual import WHOLE
from fwclass.neighbours import CELLS_PER_POINT, FEW_CELLS, sort_by_cell
from fwclass.schema import Table
from fwclass.stage import Computation

REGULARIZE = Computation(name="regularize", version=2, writes=())

UNIT = 256
"""Weights are whole numbers of this part, so that sums are exact, whatever their order."""

WANTED, CROWDED = 4, 16
"""Echoes of a cell of the search on average, and of the cell that an echo is in above which cells are halved."""


def model_share_columns(codes: Iterable[int]) -> tuple[str, ...]:
    """Names of the columns with the model's own share of every class."""
    return tuple(f"model_share_{int(code)}" for code in codes)


def whole_columns(answered: Table, codes: Iterable[int]) -> Table:
    """The shares of `answered` (as `classify` gives it, with probabilities) in 255ths, uint8, as `model_share_columns`
    names them. The class that was answered has one more where another, of fewer, is rounded to as much."""
    codes = tuple(codes)
    shares = np.rint(np.stack([answered[n] for n in probability_columns(codes)], axis=1) * WHOLE).astype(np.uint8)
    number = np.zeros(256, np.intp)
    number[list(codes)] = np.arange(len(codes))
    winner = number[answered["classification"]]
    shares[np.arange(len(shares)), winner] += shares.argmax(axis=1) != winner
    return Table(dict(zip(model_share_columns(codes), shares.T, strict=True)))


def shares_of(table: Table, codes: Iterable[int]) -> NDArray[np.uint8]:
    """(rows, classes), the columns of `model_share_columns` side by side [1/255]."""
    return np.stack([table[n] for n in model_share_columns(codes)], axis=1)


def after_mean_field(
    table: Table, core: NDArray[np.int64], before: NDArray[np.uint8], params: RegularizeParams
) -> NDArray[np.float64]:
    """float64 (core rows, classes), the shares after the mean field, or without one `before` as they are.

    `table` has x, y, z [m] of the `core` rows and of all rows within ``params.halo`` of them, `before` their shares
    [1/255].
    """
    if params.strength == 0:
        own = before[core].astype(np.float64)
        return own / np.maximum(own.sum(axis=1, keepdims=True), 1.0)
    place = np.stack([millimetres(table[n]) for n in ("x", "y", "z")], axis=1)
    return agreed_shares(place, before, core, params)


def answers(shares: NDArray[np.float64], codes: NDArray[np.uint8], probabilities: bool) -> Table:
    """As `classify`, by shares (rows, classes) in the order of `codes`. A tie goes to the first class."""
    winner = shares.argmax(axis=1)
    columns: dict[str, NDArray] = {
        "classification": codes[winner],
        "confidence": np.take_along_axis(shares, winner[:, None], axis=1)[:, 0],
        "entropy": entropy(shares),
    }
    if probabilities:
        columns |= {name: shares[:, k] for k, name in enumerate(probability_columns(codes))}
    return Table(columns)


def agreed_shares(
    place: NDArray[np.int64], shares: NDArray[np.uint8], core: NDArray[np.int64], params: RegularizeParams
) -> NDArray[np.float64]:
    """float64 (core rows, classes): shares after the mean field; they add up to 1.

    An echo's share of a class becomes proportional to max(own share, `params.least`) · exp(`params.strength` · s),
    where s adds up its neighbours' last shares of that class by weight, `params.rounds` times, all echoes at once.
    Neighbours are the nearest `params.neighbours` other echoes within `params.reach`, a metre of height counting as
    `params.height`. Weights fall with the squared distance from 1 to 0 at the last of them, at the reach where there
    are fewer. Of equally near ones those count that come first by x, y, z and shares.

    Parameters
    ----------
    place : (echoes, 3) [mm].
    shares : (echoes, classes) [1/255].
    core : rows that are answered for, with all echoes around them within ``params.halo``.
    """
    if not len(core):
        return np.zeros((0, shares.shape[1]))
    order = np.lexsort((*shares.T[::-1], *place.T[::-1]))
    place = place[order]
    number, ncols, nrows, edge = _cells(place)
    rank, start = sort_by_cell(number, ncols * nrows)
    order, place = order[rank], place[rank]
    before = np.ascontiguousarray(shares[order])
    at = np.empty(len(order), np.int64)
    at[order] = np.arange(len(order))
    reach = round(1000 * params.reach)
    around = (params.rounds - 1) * reach
    low, high = place[at[core], :2].min(axis=0) - around, place[at[core], :2].max(axis=0) + around
    asked = np.flatnonzero(((place[:, :2] >= low) & (place[:, :2] <= high)).all(axis=1))
    x, y = (place[:, k] - place[:, k].min() for k in (0, 1))
    z = np.rint(params.height * place[:, 2]).astype(np.int64)
    near = np.full((len(asked), params.neighbours), -1, np.int32)
    weight = np.zeros(near.shape, np.int32)
    weigh(asked, x, y, z, rank, start, ncols, nrows, edge, reach, near, weight)
    cost = np.log(np.maximum(np.arange(WHOLE + 1) / WHOLE, params.least))
    now, after, answers = before, before.copy(), np.zeros((len(asked), before.shape[1]))
    for _ in range(params.rounds):
        agree(asked, before, now, near, weight, cost, params.strength / (UNIT * WHOLE), after, answers)
        now, after = after, before.copy() if now is before else now
    return answers[np.searchsorted(asked, at[core])]


def _cells(place: NDArray[np.int64]) -> tuple[NDArray[np.int64], int, int, int]:
    """Cell of every place (echoes, 3) [mm] in plan, cells of a row and of a column, and their edge [mm]. The edge
    changes no answer: it is halved while echoes crowd and there is room for more cells."""
    x, y = (place[:, k] - place[:, k].min() for k in (0, 1))
    wide, high, rows = int(x.max()) + 1, int(y.max()) + 1, len(place)
    edge = max(int((WANTED * wide * high / rows) ** 0.5), WANTED * max(wide, high) // rows, 1)
    while True:
        ncols, nrows = wide // edge + 1, high // edge + 1
        number = y // edge * ncols + x // edge
        held = np.bincount(number)
        room = 4 * ncols * nrows <= max(FEW_CELLS, CELLS_PER_POINT * rows)
        if edge == 1 or not room or int((held * held).sum()) <= CROWDED * rows:
            return number, ncols, nrows, edge
        edge = (edge + 1) // 2
