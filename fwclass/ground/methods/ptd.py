"""Progressive TIN densification: PTD (Axelsson 2000) and IPTD (Zhao et al. 2016, as Shi 2019 uses it)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.methods.densify import Limits, densify
from fwclass.ground.methods.params import IptdParams, PtdParams
from fwclass.ground.methods.seeds import Cloud, find_opened_seeds, lowest_of_cells, plausible, sliding_seeds, stand_ins
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.lattice import window_over
from fwclass.ground.raster.surface import gradient
from fwclass.ground.tin.delaunay import Mesh, empty_mesh, insert_all, triangles
from fwclass.ground.tin.tin import Tin, tin_heights, tin_raster, unique_points
from fwclass.units import QUANTUM

_FLOOR = 1e-9
"""m, so that points of the TIN itself are within a tolerance of 0."""
_STEEPEST = 0.9
"""Quantile of the facets' slopes that `angle_of_slope` is taken times."""
_APART = 6.0
"""Distance of the stand-ins around the cloud [cells]: near enough to follow the ground at its border."""


def ptd(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: PtdParams) -> NDArray[np.bool_]:
    """Ground among points: what is near the TIN that grows from the lowest points of squares of edge `res`.

    Only the lowest point of every `cell` may join the TIN, so that density does not matter: where every echo may, the
    small triangles of a dense cloud lead up cars and walls in steps. A point joins its triangle if it is at most
    `distance` from its plane, and `angle` between plane and any vertex; on a triangle steeper than `max_slope` also if
    that holds for its image mirrored in the nearest vertex. Points are asked from coarse to fine: first the lowest of
    cells about half as wide as `res`, which are seldom on a roof, then of cells half as wide, and so on. This is done
    with the smaller first_distance and first_angle, then again with these. At the end a point is ground where it is
    at most `offset` + `scalar` × slope of the TIN from it.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized.

    Source: Axelsson 2000. Additions: the cells, the first pass, the squares slide (`sliding_seeds`), the slope at the
    end. Axelsson takes both thresholds from the points in the TIN, anew in every round: they would differ between
    blocks of one survey, so they are fixed unless `angle_of_slope` is given, which takes the angle from the TIN. Zhao
    and Shi do not make a triangle denser that has an edge shorter than a length: in a dense cloud that still lets
    any echo beside a car join, so that here the cells do this, and `spacing` looks at the longest edge.
    """
    return _grow(x, y, z, params, "ptd")


def iptd(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: IptdParams
) -> NDArray[np.bool_]:
    """As `ptd`, from the many seeds that a morphological opening of the lowest points leaves.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized.

    Source: Zhao et al. 2016; the seeds are the cells that an opening does not lower, in place of their fit of planes.
    """
    return _grow(x, y, z, params, "iptd")


def _grow(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: PtdParams, section: str
) -> NDArray[np.bool_]:
    order, px, py, origin = unique_points(x, y, z)
    cloud = Cloud((px + origin[0]) * QUANTUM, (py + origin[1]) * QUANTUM, z[order] / QUANTUM)
    rows = lowest_of_cells(cloud, params.cell, f"{section}.cell")
    tin = _densify(Cloud(*(v[rows] for v in cloud)), px[rows], py[rows], origin, params, section)
    tolerance = params.offset + params.scalar * _slope(tin, x, y, params.cell, section)
    return np.abs(z - tin_heights(tin, x, y)) <= tolerance + _FLOOR


def _densify(
    cloud: Cloud,
    px: NDArray[np.float64],
    py: NDArray[np.float64],
    origin: tuple[int, int],
    params: PtdParams,
    section: str,
) -> Tin:
    """The TIN of what is ground among the lowest points of cells, at px, py [mm] from the origin."""
    seeds = _seeds(cloud, params, section)
    bx, by, bz = stand_ins(px, py, cloud.z, seeds, _APART * params.cell / QUANTUM)
    heights = np.r_[cloud.z, bz]
    mesh = empty_mesh(np.r_[px, bx], np.r_[py, by])
    insert_all(mesh, np.arange(len(px), len(heights)))
    insert_all(mesh, seeds)
    inserted = np.zeros(len(heights), bool)
    inserted[seeds] = inserted[len(px) :] = True
    candidates = list(_coarse_to_fine(cloud, len(bx), params, section))
    first, then = _passes(params)
    for step in candidates:
        densify(mesh, heights, inserted, len(bx), first, step)
    for step in candidates:
        densify(mesh, heights, inserted, len(bx), _by_slope(then, first, mesh, heights, len(px), params), step)
    return Tin(mesh, heights * QUANTUM, origin)


def _coarse_to_fine(cloud: Cloud, stand_ins: int, params: PtdParams, section: str) -> Iterator[NDArray[np.bool_]]:
    """The points that may join: the lowest of cells, first of those up to `res`, last of those of `cell`."""
    for k in range(max(int(math.log2((params.res or 1.0) / params.cell)), 0), -1, -1):
        lowest = np.zeros(len(cloud.z) + stand_ins, bool)
        lowest[lowest_of_cells(cloud, params.cell * 2**k, f"{section}.cell")] = True
        yield lowest


def _passes(params: PtdParams) -> tuple[Limits, Limits]:
    """The limits of both passes, in mm; the first is never the wider one."""
    first = min(params.first_distance, params.distance), min(params.first_angle, params.angle)
    steep = math.tan(math.radians(params.max_slope))

    def limits(distance: float, angle: float) -> Limits:
        return Limits(distance / QUANTUM, math.sin(math.radians(angle)), params.spacing / QUANTUM, steep)

    return limits(*first), limits(params.distance, params.angle)


def _by_slope(
    limits: Limits, first: Limits, mesh: Mesh, heights: NDArray[np.float64], points: int, params: PtdParams
) -> Limits:
    """`limits` with the angle that the slopes of the TIN of `points` tell, between that of the first pass and its own.

    Source: after Axelsson 2000, who takes the median of the angles; few triangles are as steep as what is to be added.
    """
    if params.angle_of_slope is None:
        return limits
    corners = triangles(mesh)
    a, b, c = corners[(corners < points).all(axis=1)].T
    if len(a) == 0:
        return limits
    at = np.c_[mesh.x, mesh.y, heights]
    normal = np.cross(at[b] - at[a], at[c] - at[a])
    slope = np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), np.abs(normal[:, 2]))
    angle = min(params.angle_of_slope * float(np.quantile(slope, _STEEPEST)), math.pi / 2.0)
    return limits._replace(sine=min(max(math.sin(angle), first.sine), limits.sine))


def _slope(tin: Tin, x: NDArray[np.float64], y: NDArray[np.float64], cell: float, section: str) -> NDArray[np.float64]:
    """Slope of the TIN, rise over run, at points: between the centres of cells two apart."""
    window = window_over(x, y, cell, f"{section}.cell")
    slope = gradient(tin_raster(tin, window), cell)
    return np.nan_to_num(bilinear(slope, window, x, y))


def _seeds(cloud: Cloud, params: PtdParams, section: str) -> NDArray[np.int64]:
    """At least one seed; those far below their surroundings are left out."""
    usable = plausible(cloud, params.cell, params.low_slope, f"{section}.cell")
    if not usable.any():
        usable = np.ones(len(usable), bool)
    res = params.res or 1.0
    if isinstance(params, IptdParams):
        seeds = find_opened_seeds(cloud, usable, res, params.cell, params.tolerance, f"{section}.cell")
        if len(seeds):
            return seeds
    return sliding_seeds(cloud, usable, res, f"{section}.res")
