"""Stages of the ground: filters and terrain by blocks of the fixed grid, their columns by tile, and the seams."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classes import GROUND
from fwclass.errors import StoreError
from fwclass.graph.breaklines import BREAKLINES, beside_ground, breaklines_in, breaklines_needed
from fwclass.graph.check_points import has_check_points
from fwclass.graph.ground_auto import AUTO, halo_of, parameters_at, parts_for
from fwclass.graph.rasters import write_rasters
from fwclass.graph.stage import Names, Plan, Stage, always
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.water import LEVELS, Water, levels_needed, water_of
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.ground.filters import Flags
from fwclass.ground.measure import ground_in_pits, ground_on_halls
from fwclass.ground.params import GroundParams
from fwclass.ground.raster.lattice import cells_of
from fwclass.ground.stage import GROUND_FILTER, TERRAIN, filter_ground, last_of
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import FLATTENED, NO_TERRAIN, ON_BREAKLINE, terrain
from fwclass.neighbours import Points
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Name
from fwclass.schema import Table, column
from fwclass.store.row_digests import ROW_DIGESTS, digests_by_name
from fwclass.survey.layout import Layout
from fwclass.waveforms import IMPLAUSIBLE

STORED = ("dtm", "dsm", "mask", "distance", "roughness")
"""Rasters of a block of the terrain."""


@dataclass(frozen=True)
class BlockEchoes:
    """Echoes of a block and its halo, tile after tile.

    `table`: their columns. `own`: the block owns the echo. `pieces`: (tile, rows of it that the block owns), in the
    order of `table`.
    """

    table: Table
    own: NDArray[np.bool_]
    pieces: tuple[tuple[str, int], ...]

    def facts(self, results: Table) -> dict[str, Any]:
        """Facts for the receipt of a block with `results` of its echoes: whose they are, a digest for every tile."""
        offsets = np.cumsum([0, *(rows for _, rows in self.pieces)])
        digests = digests_by_name(results, (key for key, _ in self.pieces), offsets.tolist())
        return {"pieces": [list(p) for p in self.pieces], ROW_DIGESTS: digests}


def surroundings(
    inputs: PartInputs, block: Tile, halo: float, tile_size: float, columns: Mapping[str, str], present: tuple[str, ...]
) -> BlockEchoes:
    """Echoes of `block` grown by `halo` [m] from the tiles that are there."""
    box, here = block.box.grown(halo), set(present)
    stages = {**dict.fromkeys(("x", "y"), "tile"), **columns}
    tables, owned, pieces = [], [], []
    for key in TileGrid(tile_size).keys_touching(box):
        if key not in here:
            continue
        table = inputs.rows(key, stages, box).select(stages)
        own = block.box.contains(table["x"], table["y"])
        tables.append(table)
        owned.append(own)
        if own.any():
            pieces.append((key, int(own.sum())))
    if not tables:
        return BlockEchoes(Table.empty(stages), np.zeros(0, bool), ())
    return BlockEchoes(Table.concat(tables), np.concatenate(owned), tuple(pieces))


def around_block(here: StageInputs, halo: float | None = None) -> BlockEchoes:
    """The declared columns of a block's echoes and of those in its halo, or no further than `halo` [m]."""
    reach = here.halo if halo is None else halo
    return surroundings(here.inputs, here.tile, reach, here.tile_size, here.columns, here.present)


def filter_block(here: StageInputs, params: GroundParams) -> Result:
    """Ground and noise flags of a block's echoes, tile after tile."""
    params = parameters_at(here, params)
    around = around_block(here, params.halo)
    flags = filter_ground(around.table, params)
    table, facts = flags_of_block(around, flags)
    places = around.table.select("xyz").take(flags.ground)
    width, on = ground_on_halls(places["x"], places["y"], places["z"], params.max_building_size)
    own, pits = around.own[flags.ground], ground_in_pits(places["x"], places["y"], places["z"])
    halls = {"width": width, "ground": int((on & own).sum())}
    return table, {**facts, "halls": halls, "pits": int((pits & own).sum())}


def flags_of_block(around: BlockEchoes, flags: Flags) -> tuple[Table, dict[str, Any]]:
    """What a filter says of all echoes around a block, as the block's part: of its own ones alone."""
    table = Table({"ground": flags.ground[around.own], "noise": flags.noise[around.own]})
    plausible = around.own & ((around.table["fit_flags"] & IMPLAUSIBLE) == 0)
    return table, {
        **around.facts(table),
        "ground": int(table["ground"].sum()),
        "noise": int(table["noise"].sum()),
        "rows": table.rows,
        "seen": int(plausible.sum()),
        "last": int((plausible & last_of(around.table)).sum()),
    }


STACK = "stack"
"""The stage whose echoes, of several pulses together, are ground too."""


def stacked_ground(here: StageInputs, block: str) -> Table:
    """Places of the ground echoes that several pulses of a block show together."""
    table = here.inputs.table(STACK, block, (*"xyz", "classification"))
    return table.take(table["classification"] == GROUND).select("xyz")


def make_terrain(here: StageInputs, params: TerrainParams) -> Result:
    """Terrain rasters of a block, and the heights above ground of its echoes, tile after tile."""
    heights, facts, rasters = terrain_of_block(here, params)
    write_rasters(here.directory, rasters, Window.covering(here.tile.box, params.cell))
    return heights, facts


def terrain_of_block(
    here: StageInputs, params: TerrainParams
) -> tuple[Table, Mapping[str, Any], Mapping[str, NDArray]]:
    """Heights above ground [m] of a block's echoes, tile after tile; facts for its receipt; and its rasters (`STORED`),
    which cover its cells."""
    core = Window.covering(here.tile.box, params.cell)
    around = around_block(here)
    t, own = around.table.select(TERRAIN.reads), around.own
    more = [stacked_ground(here, key) for key in here.parts(STACK)]
    for table in more:
        no, yes = np.zeros(table.rows, bool), np.ones(table.rows, bool)
        t, own = Table.concat([t, table.with_columns({"ground": yes, "noise": no})]), np.concatenate([own, no])
    water = water_of(here)
    ground = t["ground"]
    if water is not None:
        level = water.levels(t["x"], t["y"])
        ground = ground & np.isnan(level)
    knots = knots_in(here, water, here.tile.box.grown(here.halo))
    rasters = terrain(t["x"], t["y"], t["z"], ground, t["noise"], own, core, params, knots)
    stored, height = {name: getattr(rasters, name) for name in STORED}, rasters.height
    lines = breaklines_in(here, core.box)
    for x, y, _ in lines:
        along = np.zeros(core.shape, bool)
        along.flat[cells_of(x, y, core)[0]] = True
        stored["mask"] = np.where(along & (stored["mask"] != NO_TERRAIN), np.uint8(ON_BREAKLINE), stored["mask"])
    if water is not None:
        height = np.where(np.isnan(level[own]), height, t["z"][own] - level[own]).astype(np.float32)
        flat = water.of_cells(core)
        stored["dtm"] = np.where(np.isnan(flat), stored["dtm"], flat).astype(np.float32)
        stored["mask"] = np.where(np.isnan(flat), stored["mask"], np.uint8(FLATTENED))
    heights = Table({"height_above_ground": height[: len(around.own)]})
    facts = {
        **around.facts(heights),
        "measured": int((rasters.support == 0).sum()),
        "beyond": int((rasters.support == 2).sum()),
        "without_terrain": int(np.isnan(heights["height_above_ground"]).sum()),
        **({"stacked": sum(table.rows for table in more)} if more else {}),
        **({"breaklines": beside_ground(lines, *(t[n][ground] for n in "xyz"))} if lines else {}),
    }
    return heights, facts, stored


def knots_in(here: StageInputs, water: Water | None, box: Box) -> Points | None:
    """Places in `box` that the terrain passes through: of shores and of breaklines; None without any."""
    some = [*([water.knots_in(box)] if water is not None else []), *breaklines_in(here, box)]
    if not some:
        return None
    x, y, z = (np.concatenate(v) for v in zip(*some, strict=True))
    return x, y, z


def gather_columns(here: StageInputs, source: str, columns: tuple[str, ...], block: float) -> Result:
    """Columns that blocks of edge `block` [m] wrote about a tile's echoes, in the tile's row order."""
    places = here.inputs.rows(here.part, {"x": "tile", "y": "tile"})
    out = {n: np.zeros(places.rows, np.dtype(column(n).dtype)) for n in columns}
    echoes, grid = 0, TileGrid(block)
    for key in here.parts(source):
        first = 0
        for tile, rows in here.inputs.meta(source, key)["pieces"]:
            if tile == here.part:
                own = grid.tile(key).box.contains(places["x"], places["y"])
                piece = here.inputs.table(source, key, columns)
                if int(own.sum()) != rows:
                    raise StoreError("a block's echoes are not the tile's", where=f"{source}/{key}", got=rows)
                for name in columns:
                    out[name][own] = piece[name][first : first + rows]
                echoes += rows
            first += rows
    if echoes != places.rows:
        raise StoreError("echoes of a tile lie in no block", where=f"{source} of {here.part}", got=places.rows - echoes)
    return Table(out), {"rows": places.rows}


def terrain_blocks(layout: Layout) -> tuple[Tile, ...]:
    """Terrain blocks that the survey's box touches."""
    blocks = layout.blocks(layout.config.terrain.block, margin=1)
    return tuple(b for b in blocks if b.box.touches(layout.box))


def survey_blocks(plan: Plan) -> tuple[Tile, ...]:
    """Blocks of the terrain's edge that hold tiles; what is made of echoes alone needs no more."""
    return plan.layout.blocks(plan.config.terrain.block)


def _stacked_around(plan: Plan, block: Tile) -> list[Name]:
    """The blocks whose stacked echoes reach into a block of the terrain and its halo."""
    if not plan.config.stack.enabled:
        return []
    edge = plan.config.terrain.block
    box = block.box.grown(TERRAIN.halo(plan.config.terrain) + plan.config.stack.window)
    return [(STACK, key) for key in TileGrid(edge).keys_touching(box) if key in plan.layout.occupied[edge]]


def filters_ground(plan: Plan) -> bool:
    """False where the sources' returns are only judged, and no check points ask for the ground."""
    return has_check_points(plan) or not (plan.returns and plan.only_judges)


def gathers(name: str, source: Stage, columns: Names, block: Any, when: Callable[[Plan], bool] = always) -> Stage:
    """The stage that puts what blocks wrote about echoes into the rows of their tiles."""

    def blocks(plan: Plan, tile: Tile) -> list[Name]:
        edge = block(plan)
        return [
            (source.name, key) for key in TileGrid(edge).keys_touching(tile.box) if key in plan.layout.occupied[edge]
        ]

    return Stage(
        name,
        1,
        "tile",
        "echo",
        gather_columns,
        when=when,
        arguments=lambda plan: {"source": source.name, "columns": columns, "block": block(plan)},
        own=("x", "y"),
        writes=columns,
        after=(source.name,),
        needs=blocks,
        named=True,
        row_digests=True,
    )


FILTER_GROUND = Stage(
    GROUND_FILTER.name,
    GROUND_FILTER.version,
    "block",
    "echo",
    filter_block,
    when=filters_ground,
    edge=lambda plan: plan.config.ground.block,
    arguments=lambda plan: {"params": plan.config.ground},
    reads=GROUND_FILTER.reads,
    writes=GROUND_FILTER.writes,
    halo=halo_of,
    after=(AUTO,),
    needs=parts_for,
)
GATHER_GROUND = gathers(
    "ground", FILTER_GROUND, GROUND_FILTER.writes, lambda plan: plan.config.ground.block, filters_ground
)
MAKE_TERRAIN = Stage(
    TERRAIN.name,
    TERRAIN.version,
    "block",
    "echo",
    make_terrain,
    edge=lambda plan: plan.config.terrain.block,
    margin=1,
    arguments=lambda plan: {"params": plan.config.terrain},
    reads=TERRAIN.reads,
    writes=TERRAIN.writes,
    halo=lambda plan: TERRAIN.halo(plan.config.terrain),
    area=lambda plan, block: Window.covering(block.box, plan.config.terrain.cell).box,
    after=(STACK, LEVELS, BREAKLINES),
    needs=lambda plan, block: [*_stacked_around(plan, block), *levels_needed(plan), *breaklines_needed(plan)],
)
GATHER_HEIGHT = gathers("height", MAKE_TERRAIN, TERRAIN.writes, lambda plan: plan.config.terrain.block)
