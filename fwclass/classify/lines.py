"""Echoes of wires: classes whose echoes lie on straight lines get those that do, and lose those that do not.

Leaves around a wire hide its shape from every neighbourhood, while some metres on it hangs free: sure echoes of a wire
say where the others are. Over ten metres a wire is straight; its sag is a bound on the heights.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.line_kernels import on_line
from fwclass.classify.params import LineParams
from fwclass.grid import millimetres
from fwclass.model.contextual import WHOLE
from fwclass.schema import Table
from fwclass.stage import Computation

LINES = Computation(name="lines", version=2, writes=())

SQUARE = 10.0
"""m, squares of the lattice whose first echoes are the density of pulses."""

VOXEL = 0.5
"""m, cubes of the lattice of which one sure echo counts: two for every cell of a line."""

AT_A_TIME = 2_000
"""Echoes that one call of a kernel looks from: between two calls an interrupt is heeded."""


def settle_lines(
    table: Table,
    core: NDArray[np.int64],
    own: NDArray[np.uint8],
    shares: NDArray[np.float64],
    line: int,
    params: LineParams,
    learned: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.float64], int]:
    """The `shares` after echoes have joined the class number `line` or left it, and how many might have joined but
    for too few pulses.

    An echo is on a line where, along some direction through it, `needed` cells of a metre to both sides hold a sure
    echo of the class. Echoes that may be of the class and are on a line join it: its share and the greatest are
    exchanged. Those that were answered for with it and have not half as many cells leave it: its share and the next
    are exchanged. Sure echoes that would leave count for nobody. Where pulses are so few that a wire would hardly be
    seen none leaves, and where they are half as many none joins; where more than ``params.most`` sure echoes are in
    reach neither. Nor do echoes that the model has `learned` from.

    Parameters
    ----------
    table : x, y, z [m] and echo_number of the core rows and of all within ``params.halo`` of them.
    core : rows that are answered for.
    own : (rows, classes), the model's own shares [1/255].
    shares : (core rows, classes), which the answers so far go by.
    learned : bool (core rows,): the model has seen their labels; None: no label of these echoes.
    """
    if not len(core):
        return shares, 0
    place = np.stack([millimetres(table[n]) for n in ("x", "y", "z")], axis=1)
    reach = round(1000 * params.reach)
    low, high = place[core, :2].min(axis=0), place[core, :2].max(axis=0)
    near = ((place[:, :2] >= low - reach) & (place[:, :2] <= high + reach)).all(axis=1)
    sure = np.flatnonzero(own[:, line] >= params.sure * WHOLE)
    answered = shares.argmax(axis=1) == line
    may = answered | (own[core, line] >= params.least * WHOLE)
    asked = np.flatnonzero(may if learned is None else may & ~learned)
    if not len(asked):
        return shares, 0
    judged = np.union1d(sure[near[sure]], core[asked])
    joining, staying = needed(place, table["echo_number"] == 1, judged, params)
    seen = _on_line(place, judged, staying, sure, params, True)
    support = np.setdiff1d(sure, judged[~seen])
    at = np.searchsorted(judged, core[asked])
    joins = _on_line(place, core[asked], joining[at], support, params, False) & ~answered[asked]
    leaves = answered[asked] & ~seen[at]
    sparse = np.isinf(joining[at]) & ~answered[asked]
    return _exchanged(shares, asked[joins | leaves], line), int(sparse.sum())


def count_settled(before: NDArray[np.uint8], after: NDArray[np.uint8], codes: Iterable[int]) -> tuple[int, int]:
    """How many echoes have got a class of `codes`, and how many have lost one; classes (echoes,) of both times."""
    other = before != after
    return int((other & np.isin(after, [*codes])).sum()), int((other & np.isin(before, [*codes])).sum())


def line_remarks(parts: Iterable[Mapping[str, Any]]) -> list[str]:
    """What to say of echoes that have got a class and lost it (``lines``), and that might have got it but for too few
    pulses (``too_sparse``), by the facts of parts; nothing without a part that looked for lines."""
    counts = [(*facts["lines"], facts.get("too_sparse", 0)) for facts in parts if "lines" in facts]
    if not counts:
        return []
    joined, left, sparse = (sum(numbers) for numbers in zip(*counts, strict=True))
    few = f"; {sparse:,} may be of a wire where pulses are too few to tell a line" if sparse else ""
    return [
        f"{joined:,} echoes have got a wire's class as they lie in line with sure ones, and {left:,} have lost it as "
        f"they lie in line with too few (classify.lines){few}"
    ]


def needed(
    place: NDArray[np.int64], first: NDArray[np.bool_], rows: NDArray[np.int64], params: LineParams
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How many cells of a metre of a line through each of `rows` must hold a sure echo for it to join, and to stay.

    A wire returns a pulse that comes within half of ``params.width``; the density of pulses is that of first echoes
    in a square of the lattice. To join takes ``params.share`` of the cells that a whole wire would be seen in, and
    ``params.fewest``; it is infinite where these are fewer than twice that. To stay takes half; it is 0 where these
    are fewer than four times that. `place` (echoes, 3) [mm].
    """
    square = place[:, :2] // round(1000 * SQUARE)
    square -= square.min(axis=0)
    number = square[:, 1] * (int(square[:, 0].max()) + 1) + square[:, 0]
    asked, of = np.unique(number[rows], return_inverse=True)
    at = np.searchsorted(asked, number[first])
    at[at == len(asked)] = 0
    count = np.bincount(at[asked[at] == number[first]], minlength=len(asked))
    expected = 2.0 * params.reach * (1.0 - np.exp(-params.width * count / SQUARE**2))
    need = np.maximum(np.ceil(params.share * expected), params.fewest)
    joining = np.where(expected < 2 * params.fewest, np.inf, need)
    staying = np.where(expected < 4 * params.fewest, 0.0, 0.5 * need)
    return joining[of], staying[of]


def _on_line(
    place: NDArray[np.int64],
    rows: NDArray[np.int64],
    need: NDArray[np.float64],
    support: NDArray[np.int64],
    params: LineParams,
    crowded: bool,
) -> NDArray[np.bool_]:
    """Whether each of `rows` is on a line of the sure echoes `support`, of `need` cells; `crowded` where there are too
    many of these to tell."""
    seen = need <= 0
    ask = np.flatnonzero(~seen & np.isfinite(need))
    if not len(ask):
        return seen
    kept = _one_a_voxel(place[support])
    x, y, z = (np.ascontiguousarray(kept[:, k]) for k in range(3))
    reach, tolerance = round(1000 * params.reach), 1000 * params.tolerance
    for begin in range(0, len(ask), AT_A_TIME):
        some = ask[begin : begin + AT_A_TIME]
        seen[some] = on_line(
            place[rows[some]],
            need[some],
            *(x, y, z),
            reach,
            tolerance,
            0.001 * params.sag,
            params.slope,
            params.most,
            crowded,
        )
    return seen


def _one_a_voxel(place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of the places in every cube of the lattice the first by x, y and z; in that order."""
    place = np.unique(place, axis=0)
    cube = place // round(1000 * VOXEL)
    _, first = np.unique(cube, axis=0, return_index=True)
    return place[np.sort(first)]


def _exchanged(shares: NDArray[np.float64], rows: NDArray[np.int64], line: int) -> NDArray[np.float64]:
    """`shares` with that of `line` exchanged for the greatest other one in some `rows`."""
    after = shares.copy()
    others = after[rows]
    others[:, line] = -1.0
    other = others.argmax(axis=1)
    after[rows, line], after[rows, other] = shares[rows, other], shares[rows, line]
    return after
