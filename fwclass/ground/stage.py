"""Ground in two steps, each by blocks of a fixed global grid: which echoes are ground, then terrain and heights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.filters import Flags, ground_points
from fwclass.ground.params import GroundParams
from fwclass.ground.terrain.params import HEIGHTS
from fwclass.schema import Table, require
from fwclass.stage import Computation
from fwclass.waveforms import IMPLAUSIBLE


def filter_ground(table: Table, params: GroundParams) -> Flags:
    """Flags of the echoes of a block and its halo; those near the edge of the halo see too little to be right.

    Parameters
    ----------
    table : ``x, y, z`` [m], ``echo_number, number_of_echoes, fit_flags``, in any order. Implausible echoes are noise,
        and the filter does not see them.
    """
    require(table, GROUND_FILTER.reads, "ground filter")
    sound = (table["fit_flags"] & IMPLAUSIBLE) == 0
    x, y, z, last = table["x"], table["y"], table["z"], last_of(table)
    if sound.all():
        return ground_points(x, y, z, last, params)
    flags = ground_points(x[sound], y[sound], z[sound], last[sound], params)
    ground, noise = np.zeros(table.rows, bool), np.ones(table.rows, bool)
    ground[sound], noise[sound] = flags.ground, flags.noise
    return Flags(ground, noise)


def last_of(table: Table) -> NDArray[np.bool_]:
    """bool (rows,): the echo is the last, or only, one of its pulse."""
    return np.asarray(table["echo_number"] >= table["number_of_echoes"])


GROUND_FILTER = Computation(
    name="ground-filter",
    version=5,
    reads=("x", "y", "z", "echo_number", "number_of_echoes", "fit_flags"),
    writes=("ground", "noise"),
    halo=lambda params: float(params.halo),
)

TERRAIN = Computation(
    name="terrain",
    version=4,
    reads=("x", "y", "z", "ground", "noise"),
    writes=HEIGHTS,
    halo=lambda params: float(params.block_halo),
)
