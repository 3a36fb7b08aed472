"""Parameters of the ground filters that suit a cloud, found without labels.

The largest building is measured. The other parameters are those with which the filter agrees best with two filters
of another principle, on the points where these two agree: filters of different principles seldom err on the same
points.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import TileGrid
from fwclass.ground.filters import ground_points
from fwclass.ground.measure import Measured, measure
from fwclass.ground.methods import Method
from fwclass.ground.methods.noise import noise
from fwclass.ground.params import GroundParams, section_of
from fwclass.ground.raster.lattice import cells_of, window_over
from fwclass.ground.tuning_params import GroundAutoParams

Points = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]

PRINCIPLES: dict[Method, set[str]] = {
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


def adapt_filter(
    points: Points, last: NDArray[np.bool_], base: GroundParams, rules: GroundAutoParams, method: Method | None = None
) -> tuple[GroundParams, Measured]:
    """`base` with a filter and parameters that suit the points, and what was measured.

    Parameters
    ----------
    points : x, y, z, (n,) finite [m], at least one, in any order, which does not matter.
    last : (n,) last or only echoes of their pulses.
    method : the filter; None takes `rules.method`.
    """
    measured = measure(*points, last)
    chosen = method if method is not None else rules.method
    sized = base.model_copy(update={"method": chosen, "max_building_size": building_size(measured, base, rules)})
    tried = [with_values(sized, update) for update in rules.updates(chosen)]
    if not tried:
        return sized, measured
    rows = np.flatnonzero(last) if base.last_returns and last.any() else np.arange(len(last))
    agreement = sum(_agreement(part, tried, rules) for part in _sample(_thin(points, rows, rules), rules))
    kappas = [_kappa(matrix) for matrix in np.asarray(agreement).reshape(len(tried), 2, 2)]
    return tried[int(np.argmax(kappas))], measured


def building_size(measured: Measured, base: GroundParams, rules: GroundAutoParams) -> float:
    """Edge of the largest building [m]: that of `base`, or more where a wider one was found."""
    size = math.ceil(rules.building_margin * measured.building)
    return float(max(base.max_building_size, min(size, rules.building_most)))


def with_values(params: GroundParams, update: dict[str, float]) -> GroundParams:
    """`params` with other values, [name in its section: number in that setting's unit], for its method.

    pydantic's `ValidationError` for a value that cannot be.
    """
    section = section_of(params.method)
    own = getattr(params, section)
    values: dict[str, Any] = own.model_dump()
    for name, value in update.items():
        *part, last = name.split(".")
        (values[part[0]] if part else values)[last] = value
    return params.model_copy(update={section: type(own).model_validate(values)})


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
    x, y, z = points
    every = math.ceil(len(x) / rules.sample)
    if every == 1:
        yield points
        return
    ix, iy = TileGrid(rules.square).indices(x, y)
    order = np.lexsort((iy, ix))
    edges = np.flatnonzero((np.diff(ix[order]) != 0) | (np.diff(iy[order]) != 0)) + 1
    for rows in np.split(order, edges)[every // 2 :: every]:
        yield x[rows], y[rows], z[rows]


def _agreement(points: Points, tried: list[GroundParams], rules: GroundAutoParams) -> NDArray[np.int64]:
    """(tried, 4) counts of the points where the referees agree: both ground, only they, only the filter, none."""
    clean = ~noise(*points, tried[0].noise)
    x, y, z = (np.ascontiguousarray(a[clean]) for a in points)
    last = np.ones(len(x), bool)
    off = tried[0].noise.model_copy(update={"low": False, "high": False, "sigma_rule": False})

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
