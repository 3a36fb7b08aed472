"""Work of the parts of the ground: blocks of the fixed grid, and their columns by tile."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import StoreError
from fwclass.graph.work.rasters import Mosaic, write_rasters
from fwclass.grid import Box, Tile, TileGrid, Window, groups, joint_box
from fwclass.ground.params import GroundParams
from fwclass.ground.stage import GROUND_FILTER, filtered
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import terrain
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.schema import Table, column
from fwclass.store.cells import CELLS, by_name, by_place
from fwclass.store.tables import write_table

WITHIN = 0.01
"""Difference of terrain heights that counts as none [m]."""


@dataclass(frozen=True)
class Surroundings:
    """Echoes of a block and its halo, tile after tile.

    Attributes
    ----------
    table : their columns.
    own : the block owns the echo.
    pieces : (tile, rows of it that the block owns), in the order of `table`.
    """

    table: Table
    own: NDArray[np.bool_]
    pieces: tuple[tuple[str, int], ...]

    def told(self, made: Table) -> dict[str, Any]:
        """For the receipt of a block that `made` this of its own echoes: whose they are, a digest for every tile."""
        offsets = np.cumsum([0, *(rows for _, rows in self.pieces)])
        cells = by_name(made, (key for key, _ in self.pieces), offsets.tolist())
        return {"pieces": [list(p) for p in self.pieces], CELLS: cells}


def surroundings(
    inputs: PartInputs, block: Tile, halo: float, tile_size: float, columns: Mapping[str, str], present: tuple[str, ...]
) -> Surroundings:
    """Echoes of `block` grown by `halo` [m] from the tiles that are there."""
    box, here = block.box.grown(halo), set(present)
    wanted = {**dict.fromkeys(("x", "y"), "tile"), **columns}
    tables, owned, pieces = [], [], []
    for tile in TileGrid(tile_size).touching(box):
        if tile.key not in here:
            continue
        table = inputs.rows(tile.key, wanted, box).select(wanted)
        own = block.box.contains(table["x"], table["y"])
        tables.append(table)
        owned.append(own)
        if own.any():
            pieces.append((tile.key, int(own.sum())))
    if not tables:
        return Surroundings(Table.empty(wanted), np.zeros(0, bool), ())
    return Surroundings(Table.concat(tables), np.concatenate(owned), tuple(pieces))


def filtered_block(
    block: Tile, tile_size: float, present: tuple[str, ...], params: GroundParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Ground and noise flags of a block's echoes, tile after tile."""
    columns = dict.fromkeys(GROUND_FILTER.reads, "tile")
    around = surroundings(inputs, block, GROUND_FILTER.halo(params), tile_size, columns, present)
    flags = filtered(around.table, params)
    table = Table({"ground": flags.ground[around.own], "noise": flags.noise[around.own]})
    write_table(directory / TABLE, table)
    return {
        **around.told(table),
        "ground": int(table["ground"].sum()),
        "noise": int(table["noise"].sum()),
        "rows": table.rows,
    }


def terrain_block(
    block: Tile,
    tile_size: float,
    columns: Mapping[str, str],
    present: tuple[str, ...],
    params: TerrainParams,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Terrain rasters of a block, and the heights above ground of its echoes, tile after tile."""
    core = Window.covering(block.box, params.cell)
    around = surroundings(inputs, block, params.block_halo, tile_size, columns, present)
    t = around.table
    made = terrain(t["x"], t["y"], t["z"], t["ground"], t["noise"], around.own, core, params)
    write_rasters(directory, {"dtm": made.dtm, "dsm": made.dsm, "support": made.support}, core)
    heights = Table({"height_above_ground": made.height})
    write_table(directory / TABLE, heights)
    return {
        **around.told(heights),
        "measured": int((made.support == 0).sum()),
        "beyond": int((made.support == 2).sum()),
        "without_terrain": int(np.isnan(made.height).sum()),
    }


def gathered_columns(
    tile: Tile, blocks: tuple[Tile, ...], source: str, columns: tuple[str, ...], inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Columns that blocks wrote about a tile's echoes, in the tile's row order."""
    places = inputs.rows(tile.key, {"x": "tile", "y": "tile"})
    out = {n: np.zeros(places.rows, np.dtype(column(n).dtype)) for n in columns}
    found = 0
    for block in blocks:
        first = 0
        for key, rows in inputs.meta(source, block.key)["pieces"]:
            if key == tile.key:
                own = block.box.contains(places["x"], places["y"])
                piece = inputs.table(source, block.key, columns)
                if int(own.sum()) != rows:
                    raise StoreError("a block's echoes are not the tile's", where=f"{source}/{block.key}", got=rows)
                for name in columns:
                    out[name][own] = piece[name][first : first + rows]
                found += rows
            first += rows
    if found != places.rows:
        raise StoreError("echoes of a tile lie in no block", where=f"{source} of {tile.key}", got=places.rows - found)
    table = Table(out)
    write_table(directory / TABLE, table)
    return {"rows": places.rows, CELLS: by_place(table, places["x"], places["y"])}


def measured_seams(
    tiles: tuple[str, ...],
    columns: Mapping[str, str],
    blocks: tuple[Tile, ...],
    box: Box,
    ground: GroundParams,
    terrain_params: TerrainParams,
    most_cells: int,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The survey filtered once more as a single block, against what its blocks say.

    Where it lies in several places, each of them is one: blocks that do not touch know nothing of each other. A place
    whose box has more than `most_cells` cells of the terrain is left out, and so is a single block among several.
    """
    table = Table.concat([inputs.rows(key, columns).select(columns) for key in tiles])
    mosaic = Mosaic(inputs, "terrain", blocks, terrain_params.cell, {"dtm": np.float32(np.nan)})
    grid = TileGrid(ground.block)
    ix, iy = grid.indices(table["x"], table["y"])
    owned, block_of = np.unique(np.stack([ix, iy], axis=1), axis=0, return_inverse=True)
    parts = groups(Tile(int(cx), int(cy), ground.block) for cx, cy in owned)
    part_of = {(t.ix, t.iy): k for k, part in enumerate(parts) for t in part}
    place = np.array([part_of[cx, cy] for cx, cy in owned.tolist()], np.int64)[block_of.reshape(-1)]
    seen, left_out = _Seams(), 0
    for k, part in enumerate(parts):
        inside = box if len(parts) == 1 else joint_box(t.box for t in part).common(box)
        window = Window.covering(inside or box, terrain_params.cell)
        if math.prod(window.shape) > most_cells or (len(part) == 1 < len(parts)):
            left_out += int((place == k).sum())
            continue
        echoes = table if len(parts) == 1 else table.take(place == k)
        seen.add(echoes, mosaic.laid(window)["dtm"], window, ground, terrain_params)
    return {**seen.told(), "left_out": left_out}


@dataclass
class _Seams:
    """What differs, place by place."""

    counts: Counter[str] = field(default_factory=Counter)
    off: list[NDArray[np.float32]] = field(default_factory=list)

    def add(
        self, table: Table, dtm: NDArray[np.float32], window: Window, ground: GroundParams, params: TerrainParams
    ) -> None:
        """Filter the echoes of one place as one block, and hold the answer against their flags and the `dtm`."""
        whole = filtered(table, ground)
        nobody = np.zeros(table.rows, bool)
        place = (table["x"], table["y"], table["z"])
        surface = terrain(*place, whole.ground, whole.noise, nobody, window, params).dtm
        differs = (table["ground"] != whole.ground) | (table["noise"] != whole.noise)
        both = np.isfinite(dtm) & np.isfinite(surface)
        off = np.abs(dtm - surface)[both]
        self.off.append(off)
        self.counts.update(
            echoes=table.rows,
            flags_differ=int(differs.sum()),
            cells=int((np.isfinite(dtm) | np.isfinite(surface)).sum()),
            cells_one_sided=int((np.isfinite(dtm) != np.isfinite(surface)).sum()),
            cells_off=int((off > WITHIN).sum()),
        )

    def told(self) -> dict[str, Any]:
        """Counts, and how far heights are apart [m]."""
        off = np.concatenate([np.empty(0, np.float32), *self.off])
        names = ("echoes", "flags_differ", "cells", "cells_one_sided", "cells_off")
        return {
            **{n: self.counts[n] for n in names},
            "within": WITHIN,
            "dtm_p999": float(np.quantile(off, 0.999)) if off.size else None,
            "dtm_worst": float(off.max()) if off.size else None,
        }
