"""Parts of the ground: filters and terrain by blocks of the fixed grid, their columns by tile, and the seams."""

from __future__ import annotations

from functools import partial

from fwclass.graph.layout import Layout, needs_of, plain
from fwclass.graph.work import ground
from fwclass.grid import Tile, TileGrid, Window
from fwclass.ground.stage import GROUND_FILTER, TERRAIN
from fwclass.run.part import Task
from fwclass.run.tasks import Tasks

SEAMS_VERSION = 2


def ground_tasks(layout: Layout) -> Tasks:
    """From tiles of echoes to ground flags, terrain rasters and heights above ground."""
    made = _filter_tasks(layout)
    made += _column_tasks(layout, "ground", GROUND_FILTER.name, GROUND_FILTER.writes, layout.config.ground.block)
    made += _terrain_tasks(layout)
    made += _column_tasks(layout, "height", TERRAIN.name, TERRAIN.writes, layout.config.terrain.block)
    return made


def _filter_tasks(layout: Layout) -> Tasks:
    config, here = layout.config, layout.keys
    halo, params = GROUND_FILTER.halo(config.ground), plain(config.ground)

    def made(block: Tile) -> Task:
        within = block.box.grown(halo)
        present = layout.around(within, here)
        return Task(
            GROUND_FILTER.name,
            block.key,
            GROUND_FILTER.version,
            params,
            partial(ground.filtered_block, block, config.tile.size, present, config.ground),
            needs=tuple(("tile", k) for k in present),
            within=within,
        )

    return Tasks.of(GROUND_FILTER.name, layout.blocks(config.ground.block), made)


def _terrain_tasks(layout: Layout) -> Tasks:
    config, here = layout.config, layout.keys
    halo, params = TERRAIN.halo(config.terrain), plain(config.terrain)
    columns = layout.columns(TERRAIN.reads)

    def made(block: Tile) -> Task:
        within = Window.covering(block.box, config.terrain.cell).box.grown(halo)
        present = layout.around(within, here)
        return Task(
            TERRAIN.name,
            block.key,
            TERRAIN.version,
            params,
            partial(ground.terrain_block, block, config.tile.size, columns, present, config.terrain),
            needs=needs_of(columns, present),
            within=within,
        )

    return Tasks.of(TERRAIN.name, layout.blocks(config.terrain.block, margin=1), made)


def _column_tasks(layout: Layout, stage: str, source: str, columns: tuple[str, ...], block: float) -> Tasks:
    """What blocks wrote about echoes, put into the rows of their tiles."""
    there = {b.key for b in layout.blocks(block)}
    params = {"columns": list(columns), "block": block}

    def made(tile: Tile) -> Task:
        mine = tuple(b for b in TileGrid(block).touching(tile.box) if b.key in there)
        return Task(
            stage,
            tile.key,
            1,
            params,
            partial(ground.gathered_columns, tile, mine, source, columns),
            needs=(("tile", tile.key), *((source, b.key) for b in mine)),
            within=tile.key,
        )

    return Tasks.of(stage, layout.tiles, made)


def seam_tasks(layout: Layout) -> list[Task]:
    """The check that cutting the survey into blocks changed nothing; none where the survey is too large for it."""
    config = layout.config
    if layout.echoes > config.run.seam_check_echoes:
        return []
    columns = layout.columns(tuple(dict.fromkeys((*GROUND_FILTER.reads, *GROUND_FILTER.writes))))
    keys = tuple(t.key for t in layout.tiles)
    blocks = terrain_blocks(layout)
    most = config.run.seam_check_cells
    params = {"ground": plain(config.ground), "terrain": plain(config.terrain), "cells": most}
    work = partial(ground.measured_seams, keys, columns, blocks, layout.box, config.ground, config.terrain, most)
    needs = (*needs_of(columns, keys), *((TERRAIN.name, b.key) for b in blocks))
    return [Task("seams", "all", SEAMS_VERSION, params, work, needs=needs, check=True)]


def terrain_blocks(layout: Layout) -> tuple[Tile, ...]:
    """Terrain blocks that the survey's box touches."""
    blocks = layout.blocks(layout.config.terrain.block, margin=1)
    return tuple(b for b in blocks if b.box.touches(layout.box))
