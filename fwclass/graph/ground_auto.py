"""Parameters of the ground filter for every square of the fixed grid, from a sample of its echoes, without labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Tile, TileGrid
from fwclass.ground.auto import adapt_square, lowest_points
from fwclass.ground.measure import WIDEST
from fwclass.ground.params import GroundParams
from fwclass.ground.stage import last_of
from fwclass.ground.tuning_params import GroundAutoParams, largest_halo, with_values
from fwclass.neighbours import Points
from fwclass.run.part import Name
from fwclass.waveforms import IMPLAUSIBLE

AUTO = "ground-auto"
"""The stage, and the key of what its receipts and the report tell."""

MEASURED = ("building", "slope_median", "slope_steep", "ground", "roughness")
"""What is told of the land by which parameters were chosen (`ground.measure`)."""


def adapts(plan: Plan) -> bool:
    """Whether the filter's parameters are chosen from echoes."""
    return plan.config.ground.method == "auto"


def squares(plan: Plan) -> tuple[Tile, ...]:
    """The squares with parameters of their own that own an echo."""
    blocks = plan.layout.blocks(plan.config.ground.block)
    return tuple(sorted({_square_of(block, plan) for block in blocks}))


def _square_of(block: Tile, plan: Plan) -> Tile:
    """The square that the middle of a block lies in."""
    edge, box = square_edge(plan), block.box
    x, y = ((low + high) / 2.0 for low, high in ((box.xmin, box.xmax), (box.ymin, box.ymax)))
    ix, iy = TileGrid(edge).indices(np.array([x]), np.array([y]))
    return Tile(int(ix[0]), int(iy[0]), edge)


def square_edge(plan: Plan) -> float:
    """Edge of the squares with parameters of their own [m]: whole blocks of the filter."""
    return plan.config.ground.block * plan.config.ground_auto.blocks


def choose_parameters(here: StageInputs, ground: GroundParams, auto: GroundAutoParams) -> Result:
    """The filter's parameters for one square, for the receipt: ``parameters``, and by what evidence.

    Looked at are the lowest echoes of all cells of the square and of what is around it, as far as buildings are
    measured; where too few cells have one, the parameters are those of the configuration.
    """
    sample = lowest_points(_shown(here, ground.last_returns), auto.cell)
    own = here.tile.box.contains(sample[0], sample[1])
    occupied = int(own.sum())
    if occupied < auto.least:
        return {"parameters": _chosen(auto, ground.max_building_size, {}), "occupied": occupied, "evidence": None}
    suited = adapt_square(sample, own, ground, auto)
    measured = suited.measured.plain()
    return {
        "parameters": _chosen(auto, suited.params.max_building_size, suited.values),
        "occupied": occupied,
        "evidence": {
            "agreement": suited.agreement[0] if suited.agreement else None,
            "agreement_before": suited.agreement[1] if suited.agreement else None,
            **{name: measured[name] for name in MEASURED},
        },
    }


def _chosen(auto: GroundAutoParams, building: float, values: Mapping[str, float]) -> dict[str, Any]:
    return {"method": auto.method, "max_building_size": building, "values": dict(values)}


def _shown(here: StageInputs, last_returns: bool) -> Iterator[Points]:
    """Places of the echoes that a filter looks at, tile by tile."""
    box, present = here.tile.box.grown(here.halo), set(here.present)
    for key in TileGrid(here.tile_size).keys_touching(box):
        if key in present:
            table = here.inputs.rows(key, here.columns, box)
            keep = (table["fit_flags"] & IMPLAUSIBLE) == 0
            table = table.take(keep & last_of(table) if last_returns else keep)
            yield table["x"], table["y"], table["z"]


def parameters_at(here: StageInputs, ground: GroundParams) -> GroundParams:
    """The parameters for a block, of the first part that `parts_for` names; `ground` where they are not chosen."""
    keys = here.parts(AUTO)
    return settled_ground(here.inputs.meta(AUTO, keys[0]), ground) if keys else ground


def settled_ground(meta: Mapping[str, Any], ground: GroundParams) -> GroundParams:
    """`ground` with the parameters that a receipt of the stage tells."""
    chosen = meta["parameters"]
    params = ground.model_copy(update={name: chosen[name] for name in ("method", "max_building_size")})
    return with_values(params, chosen["values"])


def parts_for(plan: Plan, block: Tile) -> list[Name]:
    """The part that tells the parameters for a block: that of its square; of a block that `fwclass seams` moved the
    first that is there of those that it touches."""
    if not adapts(plan):
        return []
    edge = square_edge(plan)
    near = [_square_of(block, plan), *TileGrid(edge).touching(block.box)]
    all_squares = set(squares(plan)) if block.origin != (0.0, 0.0) else {near[0]}
    return [(AUTO, square.key) for square in dict.fromkeys(near) if square in all_squares]


def halo_of(plan: Plan) -> float:
    """What a block of the filter reads around it, at most [m]: known before any parameters are chosen."""
    ground, auto = plan.config.ground, plan.config.ground_auto
    return largest_halo(ground, auto) if adapts(plan) else ground.halo


def auto_facts(receipts: Iterable[tuple[str, Mapping[str, Any]]], edge: float) -> dict[str, Any]:
    """For the report: the squares, each with its bounds [m], its parameters and the evidence for them."""
    facts = [{"square": key, "bounds": list(TileGrid(edge).tile(key).box.bounds), **meta} for key, meta in receipts]
    return {"edge": edge, "squares": facts, "fixed": sum(square["evidence"] is None for square in facts)}


CHOOSE_PARAMETERS = Stage(
    AUTO,
    2,
    "block",
    "echo",
    choose_parameters,
    when=adapts,
    parts=squares,
    edge=square_edge,
    arguments=lambda plan: {"ground": plan.config.ground, "auto": plan.config.ground_auto},
    reads=("x", "y", "z", "echo_number", "number_of_echoes", "fit_flags"),
    halo=WIDEST,
)
