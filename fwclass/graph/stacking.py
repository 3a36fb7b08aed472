"""Stages of stacking: a first terrain, the weak echoes of ground, roofs and water that pulses along them show
together, their delivery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.classes import BUILDING, GROUND, WATER
from fwclass.decompose.params import DecomposeParams, StackParams
from fwclass.decompose.plane_surface import planar, plane_surface
from fwclass.decompose.stack_candidates import Candidates, Surface, candidates
from fwclass.decompose.stacking import STACK, STACK_COLUMNS, roughness_of, stack
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.ground import around_block, survey_blocks, terrain_blocks
from fwclass.graph.outputs import NO_BYTE
from fwclass.graph.rasters import Mosaic, write_rasters
from fwclass.graph.sources import placement_of, pulse_of, strip_of, waveforms_of
from fwclass.graph.stage import Names, Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.tiling import SPLIT_ECHOES
from fwclass.graph.water import LEVELS, levels_needed, water_of
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


@dataclass(frozen=True)
class Searched:
    """A surface along which weak echoes are looked for.

    `code`: class code of its echoes; `heights`: its own, in the block and around it. `known`: (n, 2) where single
    pulses have shown it [m]; `roughness`: of those echoes [m].
    """

    code: int
    heights: Surface
    known: NDArray[np.float64]
    roughness: float


def stack_block(here: StageInputs, params: StackParams, fit: DecomposeParams, cell: float, block: float) -> Result:
    """The weak echoes that the pulses of a block show together, surface after surface."""
    box = here.tile.box
    reach = box.grown(params.radius)
    searched = _surfaces(here, params, cell, block)
    parts: dict[str, list[Candidates]] = {name: [] for name in searched}
    passed: dict[str, list[NDArray[np.float64]]] = {name: [] for name in searched}
    for span in here.parts("read"):
        strip, inputs = strip_of(span), here.inputs
        waves, pulse, placement = waveforms_of(span, inputs), pulse_of(strip, inputs), placement_of(strip, inputs)
        for name, one in searched.items():
            silent = one.code != GROUND
            part, through = candidates(waves, strip, one.heights, reach, params, fit, pulse, placement, silent=silent)
            parts[name] += [part] if part is not None else []
            passed[name] += [through] if silent else []
    tables, facts = [Table.empty(STACK_COLUMNS)], {}
    for name, one in searched.items():
        counts = {"roughness": one.roughness}
        if parts[name]:
            elsewhere = np.concatenate([one.known, *passed[name]])
            table, more = stack(Candidates.joined(parts[name]), elsewhere, box, one.roughness, params, one.code)
            tables.append(table)
            counts |= more
        facts[name] = counts
    return Table.concat(tables), facts


def _surfaces(here: StageInputs, params: StackParams, cell: float, block: float) -> dict[str, Searched]:
    """What `params.surfaces` names, as far as there is some."""
    window = Window.covering(here.tile.box.grown(params.radius), cell, 2)
    blocks = [TileGrid(block).tile(key) for key in here.parts(FIRST_TERRAIN)]
    dtm = Mosaic(here.inputs, FIRST_TERRAIN, blocks, cell, {"dtm": np.float32(np.nan)}).laid(window)["dtm"]
    terrain, echoes = Surface(dtm, window), around_block(here).table
    out = {}
    if "ground" in params.surfaces:
        ground = echoes.take(echoes["ground"])
        under = ground.take(ground["number_of_echoes"] > 1)  # crowns, as what is looked for
        out["ground"] = Searched(GROUND, terrain, _plan(ground), roughness_of(*_places(under).T))
    if "roof" in params.surfaces:
        last = echoes.take(~echoes["ground"] & ~echoes["noise"] & (echoes["echo_number"] == echoes["number_of_echoes"]))
        high = last.take(last["z"] - terrain.at(last["x"], last["y"]) > params.clear)
        roofs = high.take(planar(_places(high), params))
        heights = plane_surface(_places(roofs), window, params)
        out["roof"] = Searched(BUILDING, heights, _plan(_along(heights, high, params)), roughness_of(*_places(roofs).T))
    water = water_of(here) if "water" in params.surfaces else None
    if water is not None:
        heights = Surface(water.of_cells(window).astype(np.float32), window)
        inside = _along(heights, echoes, params)
        out["water"] = Searched(WATER, heights, _plan(inside), roughness_of(*_places(inside).T))
    return out


def _along(surface: Surface, echoes: Table, params: StackParams) -> Table:
    """The echoes that show a surface: to within the window that is searched."""
    return echoes.take(np.abs(echoes["z"] - surface.at(echoes["x"], echoes["y"])) < params.window)


def _places(echoes: Table) -> NDArray[np.float64]:
    return np.stack([echoes[axis] for axis in "xyz"], axis=1)


def _plan(echoes: Table) -> NDArray[np.float64]:
    return _places(echoes)[:, :2]


def deliver_stack(here: StageInputs, params: PublishParams, crs: str | None, standard_time: bool) -> Result:
    """The stacked echoes of a block as LAZ and GeoParquet, where it has some."""
    table = here.inputs.table(STACK.name, here.part)
    if table.rows:
        target = here.directory / "stacked"
        target.mkdir(parents=True)
        write_tile_laz(table, target / f"{here.part}.laz", crs_of_wkt(crs), params, standard_time=standard_time)
        write_geoparquet(table, target / f"{here.part}.parquet", crs_of_wkt(crs), params)
    return {"rows": table.rows}


def _is_enabled(plan: Plan) -> bool:
    return plan.config.stack.enabled


def spans_near(plan: Plan, box: Box) -> Names:
    """Spans with waveforms that have an echo in a tile that `box`, grown by `ASIDE`, touches."""
    spans = _spans_of_tiles(plan)
    tiles = TileGrid(plan.config.tile.size).touching(box.grown(ASIDE))
    return tuple(sorted({span for tile in tiles for span in spans.get(tile.key, ())}))


_known: list[tuple[Plan, dict[str, list[str]]]] = []
"""Of the plan that was asked about last: blocks are planned one after the other."""


def _spans_of_tiles(plan: Plan) -> dict[str, list[str]]:
    """For every tile the spans with waveforms that have an echo in it."""
    if not _known or _known[0][0] is not plan:
        spans: dict[str, list[str]] = {}
        for stage, part in plan.splits:
            if (
                stage == SPLIT_ECHOES.name
                and not plan.returns
                and plan.indexed["index", part.split("-")[0]].meta["pulses"]
            ):
                for key in plan.splits[stage, part].meta["tiles"]:
                    spans.setdefault(key, []).append(part)
        _known[:] = [(plan, spans)]
    return _known[0][1]


def _stack_needs(plan: Plan, block: Tile) -> list[Name]:
    box = block.box.grown(plan.config.stack.radius + 3.0 * plan.config.terrain.cell)
    spans = spans_near(plan, box)
    strips = sorted({c.split("-")[0] for c in spans})
    return [
        *((FIRST_TERRAIN, b.key) for b in terrain_blocks(plan.layout) if b.box.touches(box)),
        *(("read", c) for c in spans),
        *((stage, s) for s in strips for stage in ("pulse", "places")),
        *(levels_needed(plan) if "water" in plan.config.stack.surfaces else ()),
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
    parts=survey_blocks,
    arguments=lambda plan: {
        "params": plan.config.stack,
        "fit": plan.config.decompose,
        "cell": plan.config.terrain.cell,
        "block": plan.config.terrain.block,
    },
    reads=STACK.reads,
    writes=STACK.writes,
    halo=lambda plan: STACK.halo(plan.config.stack),
    after=("read", "pulse", "places", FIRST_TERRAIN, LEVELS),
    needs=_stack_needs,
)
DELIVER_STACK = Stage(
    "publish-stack",
    2,
    "block",
    "part",
    deliver_stack,
    when=_is_enabled,
    parts=survey_blocks,
    arguments=lambda plan: {
        "params": plan.config.publish,
        "crs": plan.survey.crs,
        "standard_time": plan.survey.standard_time,
    },
    silent=NO_BYTE,
    after=(STACK.name,),
    needs=lambda plan, block: [(STACK.name, block.key)],
    place="deliver",
)
