"""Progressive TIN densification: PTD (Axelsson 2000) and IPTD (Zhao et al. 2016, as Shi 2019 uses it)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.methods.densify import Limits, densify
from fwclass.ground.methods.seeds import Cloud, grid_seeds, opened_seeds, plausible, stand_ins
from fwclass.ground.params import IptdParams, PtdParams
from fwclass.ground.tin.delaunay import empty_mesh, insert_all
from fwclass.ground.tin.tin import Tin, tin_heights, unique_points
from fwclass.units import QUANTUM

_FLOOR = 1e-9


def ptd(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: PtdParams) -> NDArray[np.bool_]:
    """Ground among points: what is near the TIN that grows from the lowest point of every cell of `res`.

    A point joins its triangle if it is at most `distance` from its plane, and `angle` between plane and any vertex;
    on a triangle steeper than `max_slope` also if that holds for its image mirrored in the nearest vertex. This is
    done with the smaller first_distance and first_angle until nothing joins, then again with these.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized.

    Source: Axelsson 2000, without thresholds from the data. The first pass is an addition: it settles bare ground
    before the wide limits, whose triangles are large at first, can take a car for a hump.
    """
    return _grown(x, y, z, params, "ptd")


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
    return _grown(x, y, z, params, "iptd")


def _grown(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: PtdParams, section: str
) -> NDArray[np.bool_]:
    order, px, py, origin = unique_points(x, y, z)
    pz = z[order] / QUANTUM
    cloud = Cloud((px + origin[0]) * QUANTUM, (py + origin[1]) * QUANTUM, pz)
    seeds = _seeds(cloud, params, section)
    bx, by, bz = stand_ins(px, py, pz, seeds, (params.res or 1.0) / QUANTUM)
    heights = np.r_[pz, bz]
    mesh = empty_mesh(np.r_[px, bx], np.r_[py, by])
    insert_all(mesh, np.arange(len(px), len(heights)))
    insert_all(mesh, seeds)
    done = np.zeros(len(heights), bool)
    done[seeds] = done[len(px) :] = True
    for distance, angle in ((params.first_distance, params.first_angle), (params.distance, params.angle)):
        limits = _limits(params, distance, angle)
        densify(mesh, heights, done, len(bx), limits)
    terrain = tin_heights(Tin(mesh, heights * QUANTUM, origin), x, y)
    return np.abs(z - terrain) <= params.offset + _FLOOR


def _limits(params: PtdParams, distance: float, angle: float) -> Limits:
    """The limits of one pass, in mm."""
    sine = math.sin(math.radians(angle))
    return Limits(distance / QUANTUM, sine, params.spacing / QUANTUM, math.tan(math.radians(params.max_slope)))


def _seeds(cloud: Cloud, params: PtdParams, section: str) -> NDArray[np.int64]:
    """At least one seed; those far below their surroundings are left out."""
    usable = plausible(cloud, params.cell, params.low_slope, f"{section}.cell")
    if not usable.any():
        usable = np.ones(len(usable), bool)
    res = params.res or 1.0
    if isinstance(params, IptdParams):
        found = opened_seeds(cloud, usable, res, params.cell, params.tolerance, f"{section}.cell")
        if len(found):
            return found
    return grid_seeds(cloud, usable, res, f"{section}.res")
