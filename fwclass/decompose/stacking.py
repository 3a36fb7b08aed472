"""Echoes that no single pulse can show: neighbouring waveforms added up along the surface that predicts them.

A pulse that has lost its light in a crown may still have an echo of the ground, below the noise. Where the terrain is
known from its neighbours, the time of that echo is known too, to within a window; the samples of several such pulses,
each shifted by its own predicted time, are added, and noise averages out while the echo stays (as seismic traces are
stacked along a horizon; Mayne 1962). What the fit took for echoes is taken off before, the level is left free.
"""

from __future__ import annotations

import math

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.classes import GROUND
from fwclass.decompose.params import StackParams
from fwclass.decompose.stack_candidates import STEP, Candidates, Floats
from fwclass.decompose.stack_kernels import stack_groups
from fwclass.grid import Box, quantise
from fwclass.schema import Table
from fwclass.stage import Computation
from fwclass.units import SIGMA_PER_MAD

STACKED = 3
"""Value of `origin`: an echo of several pulses together."""

STACK_COLUMNS = (
    *("strip", "pulse", "echo_number", "number_of_echoes", "origin"),
    *("x", "y", "z", "gps_time"),
    *("amplitude", "amplitude_sigma", "range_sigma"),
    *("stacked_pulses", "significance", "classification"),
)

NEIGHBOURS, LOOKED_AT = 8, 20_000
"""Echoes around one that tell what the surface is like; echoes that are held against theirs, about."""
HIGHEST = 8.0
"""Standard deviations over the least threshold up to which a higher one is looked for."""


def stack(
    candidates: Candidates, known: Floats, box: Box, roughness: float, params: StackParams, code: int = GROUND
) -> tuple[Table, dict[str, float]]:
    """The echoes that groups of candidates show, of those that meet the surface in `box`.

    Parameters
    ----------
    candidates : candidates of `box` and of `params.radius` around it.
    known : (n, 2) where single pulses have shown the surface, in `box` and `params.gap` around it [m].
    roughness : standard deviation of the surface's own echoes about it [m]; part of every echo's error.
    code : class code of the echoes.

    Returns
    -------
    `STACK_COLUMNS`, a row an echo, and counts: ``candidates`` that are `gap` from what is known and have enough
    neighbours, ``stack`` echoes among them, ``decoys`` tried beneath the surface, ``false`` ones that reach
    `params.threshold` there, and the ``threshold`` that was needed for no more than a share of `params.max_false` of
    the echoes to be such.
    """
    members = _groups(candidates, params)
    own = box.contains(candidates.place[:, 0], candidates.place[:, 1]) & ((members >= 0).sum(axis=1) >= params.least)
    rows = np.flatnonzero(own & _far(candidates.place[:, :2], known, params.gap))
    fair = np.where((members >= 0) & candidates.fair[members], members, -1)[rows]
    fair = fair[(fair >= 0).sum(axis=1) >= params.least]
    decoys = _heights(_stack(fair, candidates.below, candidates))
    sums = _stack(members[rows], candidates.product, candidates)
    threshold = threshold_of(_heights(sums), decoys, params)
    significant = _heights(sums) > threshold
    counts = {
        "candidates": len(rows),
        "stacked": int(significant.sum()),
        "decoys": len(fair),
        "false": int((decoys > params.threshold).sum()),
        "threshold": threshold if np.isfinite(threshold) else -1.0,
    }
    return _echoes(candidates, rows[significant], sums[significant], roughness, code), counts


def threshold_of(heights: Floats, decoys: Floats, params: StackParams) -> float:
    """The least threshold [standard deviations], from `params.threshold` on, that at most `params.max_false` of the
    `heights` (candidates,) above it owe to noise, as the `decoys` (places,) show it (target and decoy; Elias and Gygi
    2007); infinite where there is none.

    One decoy more than is seen counts: of none seen nothing follows for a single echo.
    """
    if len(decoys) == 0:
        return math.inf
    for at in np.arange(params.threshold, params.threshold + HIGHEST, 0.05):
        passing, noise = int((heights > at).sum()), int((decoys > at).sum()) * len(heights) / len(decoys)
        if passing == 0:
            break
        if noise + min(noise_share(at) * len(heights), 1.0) <= params.max_false * passing:
            return float(at)
    return math.inf


def noise_share(threshold: float) -> float:
    """Share of windows, of about ten places each, in which noise alone reaches a threshold [standard deviations]."""
    return 5.0 * math.erfc(threshold / math.sqrt(2.0))


def _far(places: Floats, known: Floats, gap: float) -> NDArray[np.bool_]:
    if len(known) == 0 or len(places) == 0:
        return np.ones(len(places), bool)
    corner = known.min(axis=0)
    near, _ = scipy.spatial.cKDTree(known - corner).query(places - corner)
    return np.asarray(near > gap)


def _groups(candidates: Candidates, params: StackParams) -> NDArray[np.int64]:
    """The nearest candidates of every candidate, itself among them; -1 where there are fewer within the radius."""
    places = candidates.place[:, :2]
    if len(places) == 0:
        return np.empty((0, params.pulses), np.int64)
    tree = scipy.spatial.cKDTree(places - places.min(axis=0))
    _, near = tree.query(tree.data, k=list(range(1, params.pulses + 1)), distance_upper_bound=params.radius)
    return np.where(near < len(places), near, -1).astype(np.int64)


def _stack(members: NDArray[np.int64], product: Floats, candidates: Candidates) -> Floats:
    out = np.empty((len(members), 6))
    stack_groups(np.ascontiguousarray(members), product, candidates.energy, candidates.slope, candidates.weight, out)
    return out


def _heights(sums: Floats) -> Floats:
    """Significance of every group's peak; of one at either end of the window none."""
    return np.where(np.isfinite(sums[:, 3]), sums[:, 0], -np.inf)


def _echoes(candidates: Candidates, rows: NDArray[np.int64], sums: Floats, roughness: float, code: int) -> Table:
    tried = candidates.product.shape[1]
    later = STEP * (sums[:, 3] - tried // 2)
    place = candidates.place[rows] + later[:, None] * candidates.beam[rows]
    speed = np.sqrt((candidates.beam[rows] ** 2).sum(axis=1))
    steep = np.abs(candidates.beam[rows, 2]) / speed
    number = np.minimum(candidates.echoes[rows] + 1, 255)
    columns = {axis: quantise(place[:, c]) for c, axis in enumerate("xyz")}
    return Table(
        {
            "strip": candidates.strip[rows],
            "pulse": candidates.pulse[rows],
            "echo_number": number,
            "number_of_echoes": number,
            "origin": np.full(len(rows), STACKED),
            **columns,
            "gps_time": candidates.gps_time[rows],
            "amplitude": sums[:, 1],
            "amplitude_sigma": sums[:, 2],
            "range_sigma": np.hypot(sums[:, 4] * speed, roughness / np.maximum(steep, 0.1)),
            "stacked_pulses": sums[:, 5],
            "significance": sums[:, 0],
            "classification": np.full(len(rows), code),
        }
    )


def roughness_of(x: Floats, y: Floats, z: Floats) -> float:
    """Standard deviation of a surface's echoes about the plane of the `NEIGHBOURS` nearest others [m]; 0 for a few.

    Of many the same `LOOKED_AT`, about, whatever their order.
    """
    if len(z) < 4 * NEIGHBOURS:
        return 0.0
    order = np.lexsort((z, y, x))
    places = np.stack([x, y], axis=1)[order] - (x.min(), y.min())
    height = z[order]
    some = np.arange(0, len(z), -(-len(z) // LOOKED_AT))
    _, near = scipy.spatial.cKDTree(places).query(places[some], k=NEIGHBOURS + 1)
    near = np.asarray(near)[:, 1:]
    local = np.concatenate([np.ones((*near.shape, 1)), places[near] - places[some][:, None]], axis=2)
    products = local.transpose(0, 2, 1) @ local + 1e-6 * np.eye(3)
    weights = np.linalg.solve(products, local.transpose(0, 2, 1))[:, 0]  # of the neighbours, for the middle's height
    off = height[some] - (weights * height[near]).sum(axis=1)
    return float(SIGMA_PER_MAD * np.median(np.abs(off) / np.sqrt(1.0 + (weights**2).sum(axis=1))))


STACK = Computation(
    "stack",
    2,
    reads=("x", "y", "z", "ground", "noise", "echo_number", "number_of_echoes"),
    writes=STACK_COLUMNS,
    halo=lambda p: float(p.radius + ("roof" in p.surfaces) * 2.0 * p.plane_reach),
)
