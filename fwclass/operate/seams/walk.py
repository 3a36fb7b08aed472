"""A finished run's tile borders, computed once more in tiles that lie elsewhere: what `fwclass seams` tells."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from fwclass.conf import Config
from fwclass.errors import ConfigError, FwclassError, StoreError, first_few
from fwclass.graph.ground_seams import CHECK_SEAMS, WITHIN
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stages import DELIVERY, JUDGING
from fwclass.grid import Box, Tile, TileGrid, draw_order
from fwclass.operate.seams.differ import Seam
from fwclass.operate.seams.inputs import BandInputs, OtherTilesInputs, Tiles
from fwclass.operate.seams.measure import (
    BlockShiftEffect,
    ComparableStages,
    block_seams,
    compare_moved_blocks,
    shifted_blocks,
    tile_seams,
)
from fwclass.operate.seams.shifted_squares import ShiftedSquare, choose_squares, shifted_squares
from fwclass.operate.seams.summary import SeamResult
from fwclass.operate.status.walk import StatusWalk
from fwclass.run.inputs import PartInputs
from fwclass.run.progress import Display
from fwclass.store.lock import holder_text
from fwclass.store.run_location import RunLocation, address_of, held_by, open_store
from fwclass.survey.area_of_interest import Area
from fwclass.survey.layout import Layout
from fwclass.walk.steps import tasks_of, until_tiles
from fwclass.walk.workflow import Workflow, after_tiles
from fwclass.workflows import workflow_of


@dataclass(frozen=True)
class SeamRequest:
    """`shift` of the tiles [m]; `share` of the borders, or `length` of them [m]; `tiles` that the run was restricted to
    (None: all), by `workflow`."""

    shift: tuple[float, float]
    share: float
    length: float | None
    tiles: frozenset[str] | Area | None
    workflow: str = "classification"


def seams(config: Config, location: RunLocation, asked: SeamRequest, display: Display) -> SeamResult:
    """Compute bands along tile borders, and some blocks, once more and compare; the run is only read."""
    check_idle(location)
    look = StatusWalk(location, config.run.accept_libraries)
    where = address_of(location)
    try:
        workflow = workflow_of(asked.workflow)
        stages = tuple(s for s in after_tiles(workflow.stages) if s not in (CHECK_SEAMS, *JUDGING, *DELIVERY))
        plan = _make_plan(config, look, workflow, stages)
        compared = ComparableStages.of(s for s in stages if s.when(plan))
    except ConfigError:
        raise
    except FwclassError as fault:
        if look.store.generations.current() is not None and not look.libraries:
            raise StoreError(
                "the run's parts were removed, and seams are compared with them",
                where=where,
                expected="a run with its store",
                got="a delivery alone (fwclass clean, or run.keep_intermediate: false)",
                do="run the survey again with --set run.keep_intermediate=true, then fwclass seams",
            ) from fault
        raise StoreError("the run is not finished", where=where, got=fault.what, do="finish it first") from fault
    layout = plan.layout
    only = asked.tiles
    if isinstance(only, Area):
        only = only.tiles(layout, plan.survey.crs, display.say)
    keys = layout.keys if only is None else layout.keys & only
    check_done(look, keys, (*compared.of_tiles, *compared.gathering))
    candidates = shifted_squares(keys, config.tile.size, asked.shift, config.seams.width)
    if not candidates:
        raise ConfigError("no two tiles of this run share a border", where=where, got=f"{len(keys)} tiles")
    squares = choose_squares(candidates, asked.share, asked.length, config.seams.seed)
    total = sum(p.length for p in candidates)
    share = min(1.0, sum(p.length for p in squares) / total)
    tiles = Tiles(look.store, TileGrid(config.tile.size), layout.keys)
    of_tiles = [s for s in stages if s.name in compared.of_tiles]
    bounded = _bands(plan, of_tiles, squares, tiles, display)
    bounded += _blocks(plan, compared.of_blocks, share, look, tiles, display)
    moved = _compare_moved(plan, compared.of_blocks, share, look, tiles, display)
    check_unchanged(look, tiles.used, (*compared.of_tiles, "tile", *compared.gathering))
    size = layout.config.tile.size * config.seams.tile
    return SeamResult(
        where,
        asked.shift,
        config.seams.width,
        total,
        tuple(squares),
        tuple(bounded),
        tuple(moved),
        size,
        plan.survey.crs,
    )


def _make_plan(config: Config, look: StatusWalk, workflow: Workflow, stages: tuple[Stage, ...]) -> Plan:
    """The plan of a finished run, whose parts of `stages` are looked at."""
    plan = until_tiles(workflow.begin(config), look, workflow.stages)
    if workflow.choose is not None:
        config = workflow.choose(config, look.beside())
        plan = replace(plan, config=config, names=config.features_asked, tiled=replace(plan.layout, config=config))
    for stage in stages:
        look.do(stage.tasks(plan))
    return plan


def _bands(plan: Plan, stages: list[Stage], squares: list[ShiftedSquare], tiles: Tiles, display: Display) -> list[Seam]:
    whole = plan.layout
    moved = tuple(p.tile for p in squares)
    ever = dict.fromkeys((t.key for t in moved), (whole.times,))  # which strips pass these tiles is not known
    there = replace(plan, tiled=replace(whole, tiles=moved, passes=ever))
    inputs = BandInputs(tiles.store, tiles, {p.tile.key: p for p in squares}, {})
    return tile_seams(tasks_of(there, stages), inputs, plan.config.seams.listed, display)


def _count(share: float, blocks: int) -> int:
    """So many of the blocks, at least one."""
    return max(1, round(share * blocks))


def _blocks(
    plan: Plan, stages: tuple[Stage, ...], share: float, look: StatusWalk, tiles: Tiles, display: Display
) -> list[Seam]:
    """Filter and terrain of some blocks, the same blocks, read from tiles of another size."""
    whole, config = plan.layout, plan.config
    size = round(1000.0 * config.tile.size * config.seams.tile) / 1000.0
    grid, chosen, around = TileGrid(size), [], set()
    for stage in stages:
        reads = partial(stage.box, plan)
        done = whole_blocks(stage.name, list(stage.all_parts(plan)), whole, look, reads)
        blocks = [b for b in done if b.key in whole.occupied[b.size]]
        for k in draw_order(blocks, config.seams.seed)[: _count(share, len(blocks))]:
            chosen.append((stage, blocks[k]))
            around |= set(grid.touching(reads(blocks[k])))
    config = replace(config, tile=config.tile.model_copy(update={"size": size}))
    other = replace(plan, config=config, tiled=replace(whole, tiles=tuple(sorted(around)), config=config))
    tasks = [(block, stage.task(other, block)) for stage, block in chosen]
    return block_seams(tasks, other, OtherTilesInputs(tiles.store, tiles, grid), config.seams.listed, display)


def _compare_moved(
    plan: Plan, stages: tuple[Stage, ...], share: float, look: StatusWalk, tiles: Tiles, display: Display
) -> list[BlockShiftEffect]:
    """Filter and terrain of blocks that lie elsewhere: what is not bounded."""
    pairs, seed = [], plan.config.seams.seed
    for stage in stages:
        here = shifted_blocks(stage, plan)
        whole = set(whole_blocks("", [p.tile for p in here], plan.layout, look, partial(stage.box, plan)))
        here = [p for p in here if p.tile in whole]
        here = [here[k] for k in draw_order([p.tile for p in here], seed)]
        count = _count(share, len(here))
        pairs.append(compare_moved_blocks(stage, here, count, plan, PartInputs(tiles.store), WITHIN, display))
    return pairs


def check_idle(location: RunLocation) -> None:
    """`StoreError` while a run writes to `location`; its lock is not taken."""
    where, writer = address_of(location), held_by(location)
    if isinstance(where, Path) and not (where / "store").is_dir():
        raise StoreError("this is no run directory", where=where, expected="a directory with `store`", do="name a run")
    if writer is not None:
        raise StoreError(
            "a run is writing to this directory", where=where, got=holder_text(writer), do="wait for it to end"
        )


def check_done(look: StatusWalk, tiles: Iterable[str], stages: Sequence[str]) -> None:
    """`StoreError` if a stage of one of `tiles` is not done from the inputs and parameters as they are now."""
    here = [(s, t) for t in sorted(tiles) for s in stages if (s, t) in look.states]
    late = [n for n in here if look.states[n].standing != "done"]
    if late or not here:
        raise StoreError(
            "the run is not finished: nothing can be compared with what it would make now",
            where=look.store.where,
            got=first_few([f"{'/'.join(n)} {look.states[n].standing}" for n in late], 3),
            do="finish it first; `fwclass status` tells what is missing or stale, and why",
        )


def whole_blocks(
    stage: str, blocks: list[Tile], layout: Layout, look: StatusWalk, reads: Callable[[Tile], Box]
) -> list[Tile]:
    """Blocks that are done, as are flags and heights of all tiles that they are made from: all blocks of a whole run,
    those in the middle of one that was restricted to some tiles. `reads` tells where a block reads; `stage` empty: only
    the tiles count."""
    whole, keys, grid = [], layout.keys, TileGrid(layout.config.tile.size)
    for block in blocks:
        near = [key for key in grid.keys_touching(reads(block)) if key in keys]
        names = [(s, t) for t in near for s in ("ground", "height")] + ([(stage, block.key)] if stage else [])
        if near and all(n in look.states and look.states[n].standing == "done" for n in names):
            whole.append(block)
    return whole


def check_unchanged(look: StatusWalk, tiles: Iterable[str], stages: Sequence[str]) -> None:
    """`StoreError` if a part that was compared with has been made anew meanwhile."""
    check_idle(look.location)
    now = open_store(look.location, read_only=True)
    parts = sorted(tiles)
    now.look_up((stage, part) for part in parts for stage in stages)
    for part in parts:
        for stage in stages:
            before = look.store.receipt(stage, part)
            if before is not None and now.receipt(stage, part) != before:
                raise StoreError(
                    "the run was changed while it was compared",
                    where=f"{stage}/{part} in {now.where}",
                    do="run it again",
                )
