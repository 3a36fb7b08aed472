"""A finished run's tile borders, computed once more in tiles that lie elsewhere: what `fwclass seams` tells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from fwclass.conf import Config
from fwclass.errors import ConfigError, FwclassError, StoreError
from fwclass.graph.area_of_interest import Area
from fwclass.graph.ground import WITHIN
from fwclass.graph.stage import Plan
from fwclass.graph.stages import CLASSIFYING, LEARNING
from fwclass.graph.walk import deciding, tasks_of, until_labels, until_tiles
from fwclass.grid import TileGrid
from fwclass.operate.seams.differ import Seam
from fwclass.operate.seams.guard import check_done, check_idle, check_unchanged, whole_blocks
from fwclass.operate.seams.inputs import OtherTilesInputs, StripInputs, Tiles
from fwclass.operate.seams.measure import (
    BLOCK_STAGES,
    GATHERING,
    TILE_STAGES,
    Apart,
    apart,
    block_seams,
    shifted_blocks,
    tile_seams,
)
from fwclass.operate.seams.places import Place, chosen, drawn, places
from fwclass.operate.seams.summary import Found
from fwclass.operate.status.walk import StatusWalk
from fwclass.run.inputs import PartInputs
from fwclass.run.progress import Display
from fwclass.store.run_location import RunLocation, address_of
from workflows import xiong2018


@dataclass(frozen=True)
class Asked:
    """`shift` of the tiles [m]; `share` of the borders, or `length` of them [m]; `tiles` that the run was restricted to
    (None: all), by `workflow`."""

    shift: tuple[float, float]
    share: float
    length: float | None
    tiles: frozenset[str] | Area | None
    workflow: str = "classification"


def seams(config: Config, location: RunLocation, asked: Asked, display: Display) -> Found:
    """Compute strips along tile borders, and some blocks, once more and compare; the run is only read."""
    check_idle(location)
    look = StatusWalk(location, config.run.accept_libraries)
    where = address_of(location)
    try:
        plan = _planned(config, look, asked.workflow)
    except ConfigError:
        raise
    except FwclassError as fault:
        raise StoreError("the run is not finished", where=where, got=fault.what, do="finish it first") from fault
    layout = plan.layout
    only = asked.tiles
    if isinstance(only, Area):
        only = only.tiles(layout, plan.survey.crs)
    keys = layout.keys if only is None else layout.keys & only
    check_done(look, keys, (*TILE_STAGES, *GATHERING))
    candidates = places(keys, config.tile.size, asked.shift, config.seams.width)
    if not candidates:
        raise ConfigError("no two tiles of this run share a border", where=where, got=f"{len(keys)} tiles")
    strips = chosen(candidates, asked.share, asked.length, config.seams.seed)
    total = sum(p.length for p in candidates)
    share = min(1.0, sum(p.length for p in strips) / total)
    tiles = Tiles(look.store, TileGrid(config.tile.size), layout.keys)
    bounded = _strips(plan, strips, tiles, display)
    bounded += _blocks(plan, share, look, tiles, display)
    moved = _moved(plan, share, look, tiles, display)
    check_unchanged(look, tiles.used, (*TILE_STAGES, "tile", *GATHERING))
    size = layout.config.tile.size * config.seams.tile
    return Found(
        where,
        asked.shift,
        config.seams.width,
        total,
        tuple(strips),
        tuple(bounded),
        tuple(moved),
        size,
        plan.survey.crs,
    )


def _planned(config: Config, look: StatusWalk, workflow: str) -> Plan:
    """The plan of a finished run, whose parts are looked at."""
    plan = until_tiles(deciding(config), look)
    if workflow == xiong2018.NAME:
        _, config = xiong2018.selected(config, look.beside())
        names = config.features_asked
        plan = replace(plan, config=config, names=names, tiled=replace(plan.layout, config=config))
    look.do(until_labels(plan))
    look.do(tasks_of(plan, LEARNING))
    look.do(tasks_of(plan, CLASSIFYING))
    return plan


def _strips(plan: Plan, strips: list[Place], tiles: Tiles, display: Display) -> list[Seam]:
    whole = plan.layout
    places = tuple(p.tile for p in strips)
    ever = dict.fromkeys((t.key for t in places), (whole.times,))  # which strips pass these tiles is not known
    there = replace(plan, tiled=replace(whole, tiles=places, passes=ever))
    inputs = StripInputs(tiles.store, tiles, {p.tile.key: p for p in strips}, {})
    tasks = until_labels(there) + tasks_of(there, CLASSIFYING)
    mine = [t for t in tasks if t.stage in TILE_STAGES and t.part in inputs.places]
    return tile_seams(mine, inputs, plan.config.seams.listed, display)


def _count(share: float, blocks: int) -> int:
    """So many of the blocks, at least one."""
    return max(1, round(share * blocks))


def _blocks(plan: Plan, share: float, look: StatusWalk, tiles: Tiles, display: Display) -> list[Seam]:
    """Filter and terrain of some blocks, the same blocks, read from tiles of another size."""
    whole, config = plan.layout, plan.config
    size = round(1000.0 * config.tile.size * config.seams.tile) / 1000.0
    grid, chosen, around = TileGrid(size), [], set()
    for stage in BLOCK_STAGES:
        reads = partial(stage.box, plan)
        done = whole_blocks(stage.name, list(stage.all_parts(plan)), whole, look, reads)
        blocks = [b for b in done if b.key in whole.occupied[b.size]]
        for k in drawn(blocks, config.seams.seed)[: _count(share, len(blocks))]:
            chosen.append((stage, blocks[k]))
            around |= set(grid.touching(reads(blocks[k])))
    config = replace(config, tile=config.tile.model_copy(update={"size": size}))
    other = replace(plan, config=config, tiled=replace(whole, tiles=tuple(sorted(around)), config=config))
    tasks = [(block, stage.task(other, block)) for stage, block in chosen]
    return block_seams(tasks, other, OtherTilesInputs(tiles.store, tiles, grid), config.seams.listed, display)


def _moved(plan: Plan, share: float, look: StatusWalk, tiles: Tiles, display: Display) -> list[Apart]:
    """Filter and terrain of blocks that lie elsewhere: what is not bounded."""
    pairs, seed = [], plan.config.seams.seed
    for stage in BLOCK_STAGES:
        here = shifted_blocks(stage, plan)
        done = set(whole_blocks("", [p.tile for p in here], plan.layout, look, partial(stage.box, plan)))
        here = [p for p in here if p.tile in done]
        here = [here[k] for k in drawn([p.tile for p in here], seed)]
        count = _count(share, len(here))
        pairs.append(apart(stage, here, count, plan, PartInputs(tiles.store), WITHIN, display))
    return pairs
