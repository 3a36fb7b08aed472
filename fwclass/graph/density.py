"""Stages of how dense the echoes are: of the training areas, and of all that a model answers for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from fwclass.graph.areas import within
from fwclass.graph.rasters import owned
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, Tile, millimetres
from fwclass.model.density import EDGE, Densities, densities_of, squares_by_count

SQUARES = "squares"


def count_echoes(here: StageInputs, areas: tuple[Box, ...] | None = None) -> Result:
    """How many of a block's squares hold how many echoes; of `areas`: the squares that hold an echo of these. All their
    echoes count, as neighbours of a training area's echoes lie beside it too."""
    table = here.inputs.inside(owned(here.tile, EDGE).box, here.tile_size, here.columns, here.present)
    some = None if areas is None else within(table, areas)
    counted = squares_by_count(millimetres(table["x"]), millimetres(table["y"]), some)
    return {SQUARES: {str(n): k for n, k in counted.items()}}


def densities_by_receipts(counts: Iterable[Mapping[str, int]]) -> Densities | None:
    """How dense echoes are by what the receipts of blocks tell; None without any."""
    return densities_of({int(n): k for n, k in one.items()} for one in counts)


def training_blocks(plan: Plan) -> tuple[Tile, ...]:
    """Blocks that touch a training area."""
    boxes = plan.config.areas.boxes("train")
    return tuple(
        block
        for block in plan.layout.blocks(plan.config.terrain.block)
        if any(owned(block, EDGE).box.touches(b) for b in boxes)
    )


COUNT_ECHOES = Stage(
    "echo-density",
    1,
    "block",
    "echo",
    count_echoes,
    edge=lambda plan: plan.config.terrain.block,
    reads=("x", "y"),
    halo=0.0,
    area=lambda plan, block: owned(block, EDGE).box,
)
COUNT_TRAINING_ECHOES = replace(
    COUNT_ECHOES,
    name="training-density",
    when=lambda plan: plan.config.survey.model is None,
    parts=training_blocks,
    arguments=lambda plan: {"areas": plan.config.areas.boxes("train")},
)
