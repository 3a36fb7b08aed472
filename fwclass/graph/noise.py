"""The stage that flags noise alone, for workflows without ground: the ground filter's first and quickest step."""

from __future__ import annotations

import numpy as np

from fwclass.graph.ground import around_block, filters_ground, gathers
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.ground.methods.noise import noise
from fwclass.ground.methods.params import NoiseParams
from fwclass.ground.stage import last_of
from fwclass.schema import Table
from fwclass.waveforms import IMPLAUSIBLE

NOISE_READS = ("x", "y", "z", "echo_number", "number_of_echoes", "fit_flags")


def filter_noise(here: StageInputs, params: NoiseParams) -> Result:
    """Noise flags of a block's echoes, tile after tile: those of `ground.filter_block`."""
    around = around_block(here)
    t = around.table
    rows = np.flatnonzero((t["fit_flags"] & IMPLAUSIBLE == 0) & np.isfinite([t[n] for n in "xyz"]).all(axis=0))
    flags = np.ones(t.rows, bool)
    flags[rows] = noise(t["x"][rows], t["y"][rows], t["z"][rows], last_of(t)[rows], params)
    table = Table({"noise": flags[around.own]})
    return table, {**around.facts(table), "noise": int(table["noise"].sum()), "rows": table.rows}


def _noise_alone(plan: Plan) -> bool:
    return not filters_ground(plan)


FILTER_NOISE = Stage(
    "noise-filter",
    1,
    "block",
    "echo",
    filter_noise,
    when=_noise_alone,
    edge=lambda plan: plan.config.ground.block,
    arguments=lambda plan: {"params": plan.config.ground.noise},
    reads=NOISE_READS,
    writes=("noise",),
    # the sigma rule looks at what the groups have left
    halo=lambda plan: plan.config.ground.noise.reach + plan.config.ground.noise.sigma_radius,
)
GATHER_NOISE = gathers("noise", FILTER_NOISE, ("noise",), lambda plan: plan.config.ground.block, _noise_alone)
