"""All ground filters behind one function: points in, flags out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import millimetres
from fwclass.ground.methods.csf import csf
from fwclass.ground.methods.moving_surface import moving_surface
from fwclass.ground.methods.noise import noise
from fwclass.ground.methods.params import CsfSmrfParams
from fwclass.ground.methods.pmf import pmf
from fwclass.ground.methods.ptd import iptd, ptd
from fwclass.ground.methods.slope import slope
from fwclass.ground.methods.smrf import smrf
from fwclass.ground.params import GroundParams
from fwclass.units import QUANTUM

Filter = Callable[[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], Any], NDArray[np.bool_]]
"""``filter(x, y, z, params)``: finite coordinates [m] in any order, which must not matter; True is ground."""


def csf_smrf(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: CsfSmrfParams
) -> NDArray[np.bool_]:
    """Ground among points: what both filters call ground; SMRF sees only what the cloth kept.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized; the cloth's should keep all ground, for what it drops is not asked again.

    Source: He et al. 2023.
    """
    ground = csf(x, y, z, params.csf)
    if ground.any():
        ground[ground] = smrf(x[ground], y[ground], z[ground], params.smrf)
    return ground


FILTERS: dict[str, Filter] = {
    "slope": slope,
    "pmf": pmf,
    "smrf": smrf,
    "moving-surface": moving_surface,
    "ptd": ptd,
    "iptd": iptd,
    "csf": csf,
    "csf+smrf": csf_smrf,
}
"""Every single filter by its name on the command line."""


@dataclass(frozen=True)
class Flags:
    """What the filters say of points.

    Attributes
    ----------
    ground : bool (n,), taken for ground.
    noise : bool (n,), no surface at all: below it, or alone in the air; never ground.
    """

    ground: NDArray[np.bool_]
    noise: NDArray[np.bool_]


def ground_points(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    last: NDArray[np.bool_],
    params: GroundParams,
) -> Flags:
    """Ground among points, by the filter that `params` name.

    Noise goes first, then only last echoes are looked at. Filters see heights above the lowest point that is left,
    in whole millimetres, so that a shift of all heights by whole millimetres changes nothing.

    Parameters
    ----------
    x, y, z : (n,) coordinates [m], in any order; a point with NaN or infinity among them is noise.
    last : (n,) the point is the last, or only, echo of its pulse.
    """
    dropped = ~(np.isfinite(x) & np.isfinite(y) & np.isfinite(z))
    if dropped.any():
        rows = np.flatnonzero(~dropped)
        dropped[rows] = noise(x[rows], y[rows], z[rows], last[rows], params.noise)
    else:
        dropped = noise(x, y, z, last, params.noise)
    rows = np.flatnonzero(~dropped & last) if params.last_returns else np.flatnonzero(~dropped)
    ground = np.zeros(len(x), bool)
    if len(rows):
        height = millimetres(z[rows])
        ground[rows] = _ask(x[rows], y[rows], (height - height.min()) * QUANTUM, params)
    return Flags(ground, dropped)


def _ask(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: GroundParams
) -> NDArray[np.bool_]:
    """What the named filter says, or what enough of the filters of a consensus say."""
    if params.method != "consensus":
        return FILTERS[params.method](x, y, z, params.of(params.method))
    votes = np.zeros(len(x), np.int64)
    for method in params.consensus.methods:
        votes += FILTERS[method](x, y, z, params.of(method))
    return votes >= params.consensus.votes
