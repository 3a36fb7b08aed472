"""A finished run's tile borders, computed once more in tiles that lie elsewhere: what `fwclass seams` tells."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fwclass.conf import Config
from fwclass.errors import ConfigError, FwclassError, StoreError
from fwclass.graph import forest, ground
from fwclass.graph.area_of_interest import Area
from fwclass.graph.layout import Layout
from fwclass.graph.walk import Tiled, until_labels, until_tiles
from fwclass.graph.work.ground import WITHIN
from fwclass.grid import TileGrid
from fwclass.operate.seams.differ import Seam
from fwclass.operate.seams.guard import check_done, check_idle, check_unchanged, whole_blocks
from fwclass.operate.seams.inputs import OtherTilesInputs, StripInputs, Tiles
from fwclass.operate.seams.measure import (
    BLOCK_STAGES,
    TILE_STAGES,
    Apart,
    apart,
    block_seams,
    reach_of,
    shifted_blocks,
    size_of,
    tile_seams,
)
from fwclass.operate.seams.places import Place, chosen, drawn, places
from fwclass.operate.seams.summary import Found
from fwclass.operate.status.walk import StatusWalk
from fwclass.run.inputs import PartInputs
from fwclass.run.progress import Display
from fwclass.run.tasks import Tasks
from fwclass.store import remote_file
from fwclass.store.run_location import RunLocation, address_of
from workflows import xiong2018
from workflows.classification import features_of


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
    layout = plan.tiled.layout
    only = asked.tiles
    if isinstance(only, Area):
        only = only.tiles(layout, plan.tiled.survey.crs)
    keys = layout.keys if only is None else layout.keys & only
    check_done(look, keys, (*TILE_STAGES, "ground", "height"))
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
    check_unchanged(look, tiles.used, (*TILE_STAGES, "tile", "ground", "height"))
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
        plan.tiled.survey.crs,
    )


@dataclass(frozen=True)
class Plan:
    """A run's parts, looked at: `names` decide, `computed` are the columns that there are."""

    tiled: Tiled
    names: tuple[str, ...]
    computed: tuple[str, ...]
    model: tuple[remote_file.Location, str] | None

    def tasks(self, layout: Layout) -> Tasks:
        """All that `classification` does with the tiles of `layout`, until their classes."""
        labelled = until_labels(replace(self.tiled, layout=layout), self.computed)
        return labelled + forest.classify_tasks(layout, self.names, self.model)


def _planned(config: Config, look: StatusWalk, workflow: str) -> Plan:
    names, model = features_of(config)
    computed = (*names, *config.features.also)
    tiled = until_tiles(config, look, names)
    if workflow == xiong2018.NAME:
        _, config = xiong2018.selected(config, look.beside())
        computed, names = names, config.features_asked
    layout = replace(tiled.layout, config=config)
    plan = Plan(replace(tiled, layout=layout), names, computed, model)
    look.do([t for t in plan.tasks(layout) if t.stage != "classify"])
    look.do([] if model else forest.training_tasks(layout))
    look.do(forest.classify_tasks(layout, names, model))
    return plan


def _strips(plan: Plan, strips: list[Place], tiles: Tiles, display: Display) -> list[Seam]:
    whole = plan.tiled.layout
    places = tuple(p.tile for p in strips)
    ever = dict.fromkeys((t.key for t in places), (whole.times,))  # which strips pass these tiles is not known
    layout = replace(whole, tiles=places, passes=ever)
    inputs = StripInputs(tiles.store, tiles, {p.tile.key: p for p in strips}, {})
    mine = [t for t in plan.tasks(layout) if t.stage in TILE_STAGES and t.part in inputs.places]
    return tile_seams(mine, inputs, layout.config.seams.listed, display)


def _count(share: float, blocks: int) -> int:
    """So many of the blocks, at least one."""
    return max(1, round(share * blocks))


def _blocks(plan: Plan, share: float, look: StatusWalk, tiles: Tiles, display: Display) -> list[Seam]:
    """Filter and terrain of some blocks, the same blocks, read from tiles of another size."""
    whole = plan.tiled.layout
    config = whole.config
    size = round(1000.0 * config.tile.size * config.seams.tile) / 1000.0
    grid, wanted, around = TileGrid(size), [], set()
    for stage in BLOCK_STAGES:
        halo = reach_of(stage, whole)
        done = whole_blocks(stage.name, list(whole.blocks(size_of(stage.name, whole))), whole, look, halo)
        for k in drawn(done, config.seams.seed)[: _count(share, len(done))]:
            wanted.append((stage.name, done[k].key))
            around |= set(grid.touching(done[k].box.grown(halo)))
    cut = config.tile.model_copy(update={"size": size})
    other = replace(whole, tiles=tuple(sorted(around)), config=replace(config, tile=cut))
    tasks = [t for t in ground.ground_tasks(other) if t.name in wanted]
    return block_seams(tasks, other, OtherTilesInputs(tiles.store, tiles, grid), config.seams.listed, display)


def _moved(plan: Plan, share: float, look: StatusWalk, tiles: Tiles, display: Display) -> list[Apart]:
    """Filter and terrain of blocks that lie elsewhere: what is not bounded."""
    layout, found = plan.tiled.layout, []
    seed = layout.config.seams.seed
    for stage in BLOCK_STAGES:
        here = shifted_blocks(stage, layout)
        done = set(whole_blocks("", [p.tile for p in here], layout, look, reach_of(stage, layout)))
        here = [p for p in here if p.tile in done]
        here = [here[k] for k in drawn([p.tile for p in here], seed)]
        found.append(apart(stage, here, _count(share, len(here)), layout, PartInputs(tiles.store), WITHIN, display))
    return found
