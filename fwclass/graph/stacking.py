"""Stages of stacking: a first terrain, the weak ground echoes that pulses along it show together, their delivery."""

from __future__ import annotations

import numpy as np

from fwclass.decompose.params import DecomposeParams, StackParams
from fwclass.decompose.stacking import STACK, STACK_COLUMNS, Candidates, Surface, candidates, roughness_of, stack
from fwclass.graph.ground import around_block, terrain_blocks
from fwclass.graph.outputs import NO_BYTE, crs_of
from fwclass.graph.rasters import Mosaic, write_rasters
from fwclass.graph.sources import placement_of, pulse_of, strip_of, waveforms_of
from fwclass.graph.stage import Names, Plan, Result, Stage, StageInputs
from fwclass.graph.tiling import SPLIT_ECHOES
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.ground.stage import TERRAIN
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import terrain
from fwclass.publish.geoparquet import write_geoparquet
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.params import PublishParams
from fwclass.run.part import Name
from fwclass.schema import Table

FIRST_TERRAIN = "first-terrain"

ASIDE = 60.0
"""How far from their echoes pulses may meet the terrain [m]: 100 m below at 30 degrees."""


def make_first_terrain(here: StageInputs, params: TerrainParams) -> Result:
    """The terrain of a block as single pulses show it."""
    core = Window.covering(here.tile.box, params.cell)
    t = around_block(here).table
    nobody = np.zeros(t.rows, bool)
    first = terrain(t["x"], t["y"], t["z"], t["ground"], t["noise"], nobody, core, params)
    write_rasters(here.directory, {"dtm": first.dtm}, core)
    return {}


def stack_block(here: StageInputs, params: StackParams, fit: DecomposeParams, cell: float, block: float) -> Result:
    """The ground echoes that the pulses of a block show together."""
    box = here.tile.box
    reach = box.grown(params.radius)
    window = Window.covering(reach, cell, 2)
    blocks = [TileGrid(block).tile(key) for key in here.parts(FIRST_TERRAIN)]
    dtm = Mosaic(here.inputs, FIRST_TERRAIN, blocks, cell, {"dtm": np.float32(np.nan)}).laid(window)["dtm"]
    surface = Surface(dtm, window)
    ground = around_block(here).table
    ground = ground.take(ground["ground"])
    under = ground.take(ground["number_of_echoes"] > 1)  # crowns, as what is looked for
    roughness = roughness_of(under["x"], under["y"], under["z"])
    parts = []
    for chunk in here.parts("read"):
        strip, inputs = strip_of(chunk), here.inputs
        pulse, placement = pulse_of(strip, inputs), placement_of(strip, inputs)
        part = candidates(waveforms_of(chunk, inputs), strip, surface, reach, params, fit, pulse, placement)
        parts += [part] if part is not None else []
    if not parts:
        return Table.empty(STACK_COLUMNS), {"roughness": roughness}
    known = np.stack([ground["x"], ground["y"]], axis=1)
    table, counts = stack(Candidates.joined(parts), known, box, roughness, params)
    return table, {**counts, "roughness": roughness}


def deliver_stack(here: StageInputs, params: PublishParams, crs: str | None, standard_time: bool) -> Result:
    """The stacked echoes of a block as LAZ and GeoParquet, where it has some."""
    table = here.inputs.table(STACK.name, here.part)
    if table.rows:
        target = here.directory / "stacked"
        target.mkdir(parents=True)
        write_tile_laz(table, target / f"{here.part}.laz", crs_of(crs), params, standard_time=standard_time)
        write_geoparquet(table, target / f"{here.part}.parquet", crs_of(crs), params)
    return {"rows": table.rows}


def _is_enabled(plan: Plan) -> bool:
    return plan.config.stack.enabled


def _blocks(plan: Plan) -> tuple[Tile, ...]:
    return plan.layout.blocks(plan.config.terrain.block)


def chunks_near(plan: Plan, box: Box) -> Names:
    """Chunks with waveforms that have an echo in a tile that `box`, grown by `ASIDE`, touches."""
    chunks = _chunks_of_tiles(plan)
    tiles = TileGrid(plan.config.tile.size).touching(box.grown(ASIDE))
    return tuple(sorted({chunk for tile in tiles for chunk in chunks.get(tile.key, ())}))


_known: list[tuple[Plan, dict[str, list[str]]]] = []
"""Of the plan that was asked about last: blocks are planned one after the other."""


def _chunks_of_tiles(plan: Plan) -> dict[str, list[str]]:
    """For every tile the chunks with waveforms that have an echo in it."""
    if not _known or _known[0][0] is not plan:
        chunks: dict[str, list[str]] = {}
        for stage, part in plan.splits:
            if stage == SPLIT_ECHOES.name and plan.indexed["index", part.split("-")[0]].meta["pulses"]:
                for key in plan.splits[stage, part].meta["tiles"]:
                    chunks.setdefault(key, []).append(part)
        _known[:] = [(plan, chunks)]
    return _known[0][1]


def _stack_needs(plan: Plan, block: Tile) -> list[Name]:
    box = block.box.grown(plan.config.stack.radius + 3.0 * plan.config.terrain.cell)
    chunks = chunks_near(plan, box)
    strips = sorted({c.split("-")[0] for c in chunks})
    return [
        *((FIRST_TERRAIN, b.key) for b in terrain_blocks(plan.layout) if b.box.touches(box)),
        *(("read", c) for c in chunks),
        *((stage, s) for s in strips for stage in ("pulse", "places")),
    ]


MAKE_FIRST_TERRAIN = Stage(
    FIRST_TERRAIN,
    TERRAIN.version,
    "block",
    "echo",
    make_first_terrain,
    when=_is_enabled,
    parts=lambda plan: terrain_blocks(plan.layout),
    arguments=lambda plan: {"params": plan.config.terrain},
    reads=TERRAIN.reads,
    halo=lambda plan: TERRAIN.halo(plan.config.terrain),
    area=lambda plan, block: Window.covering(block.box, plan.config.terrain.cell).box,
)
STACK_PULSES = Stage(
    STACK.name,
    STACK.version,
    "block",
    "pulse",
    stack_block,
    when=_is_enabled,
    parts=_blocks,
    arguments=lambda plan: {
        "params": plan.config.stack,
        "fit": plan.config.decompose,
        "cell": plan.config.terrain.cell,
        "block": plan.config.terrain.block,
    },
    reads=STACK.reads,
    writes=STACK.writes,
    halo=lambda plan: STACK.halo(plan.config.stack),
    after=("read", "pulse", "places", FIRST_TERRAIN),
    needs=_stack_needs,
)
DELIVER_STACK = Stage(
    "publish-stack",
    2,
    "block",
    "part",
    deliver_stack,
    when=_is_enabled,
    parts=_blocks,
    arguments=lambda plan: {
        "params": plan.config.publish,
        "crs": plan.survey.crs,
        "standard_time": plan.survey.standard_time,
    },
    silent=NO_BYTE,
    after=(STACK.name,),
    needs=lambda plan, block: [(STACK.name, block.key)],
    where="deliver",
)
