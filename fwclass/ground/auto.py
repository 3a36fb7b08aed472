"""Parameters of the ground filters that suit a cloud, found without labels.

The largest building is measured. The other parameters are those with which the filter agrees best with two filters
of another principle, on the points where these two agree: filters of different principles seldom err on the same
points.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import TileGrid, millimetres, whole_millimetres
from fwclass.ground.filters import ground_points
from fwclass.ground.measure import Measured, measure
from fwclass.ground.methods import Method
from fwclass.ground.methods.noise import noise
from fwclass.ground.params import GroundParams
from fwclass.ground.raster.lattice import cells_of, window_over
from fwclass.ground.tuning_params import GroundAutoParams, with_values
from fwclass.neighbours import Points

PRINCIPLES: dict[str, set[str]] = {
    "ptd": {"tin"},
    "iptd": {"tin"},
    "smrf": {"opening"},
    "pmf": {"opening"},
    "csf": {"cloth"},
    "csf+smrf": {"cloth", "opening"},
    "moving-surface": {"polynomial"},
    "slope": {"slope"},
}
"""What a filter rests on; who shares a principle shares its errors, and is no referee."""


@dataclass(frozen=True)
class Adapted:
    """Parameters that suit a cloud, and by what evidence.

    Attributes
    ----------
    params : the filter and its parameters.
    values : what a candidate changed of them, by name; empty where the filter has no candidates.
    measured : of the cloud.
    agreement : kappa with the referees of what was chosen, and of the first candidate; None where none was tried.
    """

    params: GroundParams
    values: dict[str, float]
    measured: Measured
    agreement: tuple[float, float] | None


def adapt_filter(
    points: Points, last: NDArray[np.bool_], base: GroundParams, rules: GroundAutoParams, method: Method | None = None
) -> Adapted:
    """`base` with a filter and parameters that suit the points.

    Parameters
    ----------
    points : x, y, z, (n,) finite [m], at least one, in any order, which does not matter.
    last : (n,) last or only echoes of their pulses.
    method : the filter; None takes `rules.method`.
    """
    rows = np.flatnonzero(last) if base.last_returns and last.any() else np.arange(len(last))
    chosen = method if method is not None else rules.method
    return _choose(measure(*points, last), _sample(_thin(points, rows, rules), rules), base, rules, chosen)


def adapt_square(sample: Points, own: NDArray[np.bool_], base: GroundParams, rules: GroundAutoParams) -> Adapted:
    """As `adapt_filter` of a square of a survey, with the filter `rules.method`.

    Parameters
    ----------
    sample : `lowest_points` (n,) of the square and of its surroundings, in which buildings are measured.
    own : (n,) those of the square; some of its squares of edge `rules.square` are what candidates are tried on.
    """
    x, y, z = (np.ascontiguousarray(a[own]) for a in sample)
    pieces = list(_by_squares((x, y, z), rules.square))
    full = max(len(p[0]) for p in pieces) / 2
    pieces = [p for p in pieces if len(p[0]) >= full]
    every = math.ceil(len(pieces) / rules.tried)
    measured = measure(*sample, np.ones(len(sample[0]), bool))
    return _choose(measured, pieces[(every - 1) // 2 :: every], base, rules, rules.method)


def _choose(
    measured: Measured, parts: Iterable[Points], base: GroundParams, rules: GroundAutoParams, method: Method
) -> Adapted:
    """The candidate that agrees best with the referees on `parts`."""
    sized = base.model_copy(update={"method": method, "max_building_size": building_size(measured, base, rules)})
    updates = rules.updates(method)
    tried = [with_values(sized, update) for update in updates]
    if not tried:
        return Adapted(sized, {}, measured, None)
    agreement = sum(_agreement(part, tried, rules) for part in parts)
    kappas = [_kappa(matrix) for matrix in np.asarray(agreement).reshape(len(tried), 2, 2)]
    best = int(np.argmax(kappas))
    return Adapted(tried[best], updates[best], measured, (kappas[best], kappas[0]))


def lowest_points(pieces: Iterable[Points], cell: float) -> Points:
    """The lowest point of every cell of edge `cell` [m] of the global raster, of equally low ones the most
    south-western; by cell. However the points are cut, these are the same.

    Parameters
    ----------
    pieces : x, y, z (n,) finite [m], in any order; in memory are one of them and the lowest of those before.
    """
    kept: Points = (np.zeros(0), np.zeros(0), np.zeros(0))
    edge = whole_millimetres(cell, "ground_auto.cell")
    for piece in pieces:
        x, y, z = (np.concatenate(both) for both in zip(kept, piece, strict=True))
        column, row = millimetres(x) // edge, millimetres(y) // edge
        order = np.lexsort((y, x, z, column, row))
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(column[order]) != 0) | (np.diff(row[order]) != 0)
        kept = x[order[first]], y[order[first]], z[order[first]]
    return kept


def building_size(measured: Measured, base: GroundParams, rules: GroundAutoParams) -> float:
    """Edge of the largest building [m]: that of `base`, or more where a wider one was found."""
    size = math.ceil(rules.building_margin * measured.building)
    return float(max(base.max_building_size, min(size, rules.building_most)))


def _thin(points: Points, rows: NDArray[np.int64], rules: GroundAutoParams) -> Points:
    """The points of `rows`; of dense clouds the lowest of every cell, of equally low ones the most south-western."""
    x, y, z = (np.ascontiguousarray(a[rows]) for a in points)
    window = window_over(x, y, rules.cell, "ground_auto.cell")
    cells, _ = cells_of(x, y, window)
    order = np.lexsort((y, x, z, cells))
    lowest = order[np.r_[True, np.diff(cells[order]) > 0]]
    if len(x) < rules.thin * len(lowest):
        return x, y, z
    return x[lowest], y[lowest], z[lowest]


def _sample(points: Points, rules: GroundAutoParams) -> Iterator[Points]:
    """All points, or those of evenly spread squares of the global grid."""
    every = math.ceil(len(points[0]) / rules.sample)
    if every == 1:
        yield points
        return
    yield from list(_by_squares(points, rules.square))[every // 2 :: every]


def _by_squares(points: Points, edge: float) -> Iterator[Points]:
    """The points of every square of the global grid that has one."""
    x, y, z = points
    ix, iy = TileGrid(edge).indices(x, y)
    order = np.lexsort((iy, ix))
    edges = np.flatnonzero((np.diff(ix[order]) != 0) | (np.diff(iy[order]) != 0)) + 1
    for rows in np.split(order, edges):
        yield x[rows], y[rows], z[rows]


def _agreement(points: Points, tried: list[GroundParams], rules: GroundAutoParams) -> NDArray[np.int64]:
    """(tried, 4) counts of the points where the referees agree: both ground, only they, only the filter, none."""
    clean = ~noise(*points, np.ones(len(points[0]), bool), tried[0].noise)
    x, y, z = (np.ascontiguousarray(a[clean]) for a in points)
    last = np.ones(len(x), bool)
    off = tried[0].noise.model_copy(update={"low": False, "high": False, "sigma_rule": False, "surface": False})

    def flags(params: GroundParams) -> NDArray[np.bool_]:
        return ground_points(x, y, z, last, params.model_copy(update={"noise": off})).ground

    mine = PRINCIPLES.get(tried[0].method, set())
    names = [m for m in rules.referees if not PRINCIPLES[m] & mine][:2]
    first, second = (flags(tried[0].model_copy(update={"method": m})) for m in names)
    sure = first == second
    counts = np.zeros((len(tried), 4), np.int64)
    for k, params in enumerate(tried):
        counts[k] = np.bincount(2 * ~first[sure] + ~flags(params)[sure], minlength=4)
    return counts


def _kappa(matrix: NDArray[Any]) -> float:
    """Of two by two counts; 1 where all points are of one kind for both."""
    total = float(matrix.sum())
    if total == 0:
        return 0.0
    chance = float(matrix.sum(axis=0) @ matrix.sum(axis=1)) / (total * total)
    return (float(np.trace(matrix)) / total - chance) / (1.0 - chance) if chance < 1.0 else 1.0
