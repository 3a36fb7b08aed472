"""The stage that measures what cutting the ground into blocks changes: filter and terrain again in other windows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.graph.breaklines import BREAKLINES, breaklines_needed
from fwclass.graph.ground import STACK, knots_in, stacked_ground, surroundings, terrain_blocks
from fwclass.graph.ground_auto import AUTO, adapts, settled_ground, square_edge, squares
from fwclass.graph.rasters import Mosaic
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.water import LEVELS, Water, levels_needed, water_of
from fwclass.grid import Box, Tile, TileGrid, Window, draw_order
from fwclass.ground.params import GroundParams
from fwclass.ground.stage import GROUND_FILTER, TERRAIN, filter_ground
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import terrain
from fwclass.neighbours import Points
from fwclass.schema import Table
from fwclass.waveforms import IMPLAUSIBLE

WITHIN = 0.01
"""Difference of terrain heights that counts as none [m]."""

MOST_CELLS = 16_000_000
"""Cells after which no further window is drawn: what they differ by is held for its quantile."""

SPARSE = 3.0
"""Echoes that a square metre costs as much as, where it has fewer: cells are filtered whether or not they hold one."""

EVERYWHERE = Box(-math.inf, -math.inf, math.inf, math.inf)
BORDER = 5.0
"""What is told of the border between squares with other parameters is told of the echoes as near to it as this [m]."""

Regions = Sequence[tuple[Box, GroundParams]]


def windows(tiles: Iterable[Tile], block: float, seed: int) -> list[Tile]:
    """Squares of the filter's blocks of edge `block` [m], moved by half of it, that share area with `tiles`.

    Their order hangs on them and the seed alone. Every border of blocks lies inside one, and none needs more memory
    than the blocks did.
    """
    grid = TileGrid(block).halfway()
    some = sorted({window for tile in tiles for window in grid.touching(tile.box)})
    return [some[k] for k in draw_order(some, seed)]


def measure_seams(
    here: StageInputs, ground: GroundParams, terrain: TerrainParams, most: int, seed: int, square: float | None = None
) -> Result:
    """Filter and terrain of windows, drawn until they hold or cost as much as `most` echoes (`SPARSE`), against what
    the blocks say.

    With parameters chosen for every `square` [m] each of these is filtered by itself, and what the parameters of
    neighbours would change at its border is told.
    """
    regions = _regions(here, ground, square)
    reach = max(TERRAIN.halo(terrain), *(params.halo + BORDER for _, params in regions))
    cut = TileGrid(terrain.block)
    blocks = [cut.tile(key) for key in here.parts(TERRAIN.name)]
    mosaic = Mosaic(here.inputs, TERRAIN.name, blocks, terrain.cell, {"dtm": np.float32(np.nan)})
    differences, looked, cost, water = _Differences(), 0, 0.0, water_of(here)
    tiles = TileGrid(here.tile_size)
    for place in windows((tiles.tile(key) for key in here.present), ground.block, seed):
        if cost >= most or differences.counts["cells"] >= MOST_CELLS:
            break
        around = surroundings(here.inputs, place, reach, here.tile_size, here.columns, here.present)
        table, own = _where(around.table, around.own, (around.table["fit_flags"] & IMPLAUSIBLE) == 0)
        if not own.any():
            continue
        window = Window.covering(_box(table["x"][own], table["y"][own]), terrain.cell)
        looked += int(around.own.sum())
        cost += max(float(around.own.sum()), SPARSE * window.nrows * window.ncols * terrain.cell**2)
        rows = differences.add_flags(table, own, place.box, regions)
        points = _with_stacked(
            here, (table["x"][rows], table["y"][rows], table["z"][rows]), place.box.grown(reach), terrain.block
        )
        del around, table, own, rows  # the triangles have their room
        knots = knots_in(here, water, place.box.grown(reach))
        differences.add_terrain(points, mosaic.laid(window)["dtm"], window, terrain, water, knots)
    across = {} if square is None else {"across": differences.across()}
    echoes = sum(int(here.inputs.meta("tile", key)["rows"]) for key in here.present)
    return {**differences.facts(), **across, "left_out": echoes - looked}


def _regions(here: StageInputs, ground: GroundParams, square: float | None) -> Regions:
    """Where which parameters hold."""
    if square is None:
        return [(EVERYWHERE, ground)]
    grid = TileGrid(square)
    return [(grid.tile(key).box, settled_ground(here.inputs.meta(AUTO, key), ground)) for key in here.parts(AUTO)]


def _box(x: NDArray[np.float64], y: NDArray[np.float64]) -> Box:
    return Box(float(x.min()), float(y.min()), float(x.max()), float(y.max()))


def _with_stacked(here: StageInputs, points: Points, box: Box, block: float) -> Points:
    """The `points`, and the echoes of several pulses of the blocks of edge `block` [m] around `box`: ground too."""
    parts = [points]
    for key in here.parts(STACK):
        if TileGrid(block).tile(key).box.touches(box):
            table = stacked_ground(here, key)
            parts.append((table["x"], table["y"], table["z"]))
    x, y, z = (np.concatenate(values) for values in zip(*parts, strict=True))
    return x, y, z


def _where(table: Table, flags: NDArray[np.bool_], rows: NDArray[np.bool_]) -> tuple[Table, NDArray[np.bool_]]:
    """The table and flags at `rows`, as they are where that is all."""
    return (table, flags) if rows.all() else (table.take(rows), flags[rows])


@dataclass
class _Differences:
    """What differs, window by window."""

    counts: Counter[str] = field(default_factory=Counter)
    off: list[NDArray[np.float32]] = field(default_factory=list)

    def add_flags(self, table: Table, own: NDArray[np.bool_], window: Box, regions: Regions) -> NDArray[np.bool_]:
        """Filter the echoes of a window and its halo as one block (or a block for each of `regions`), and hold the
        answer about its `own` ones against their flags.

        Returns bool (rows,), ground: by this answer in the window, by the blocks' answer around it.
        """
        x, y, ground = table["x"], table["y"], table["ground"] & ~table["noise"]
        for box, params in regions:
            inside = box.common(window)
            if inside is None:
                continue
            near = inside.grown(params.halo + BORDER).contains(x, y)
            some, mine = _where(table, own & inside.contains(x, y), near)
            if not mine.any():
                continue
            again = filter_ground(some, params)
            differs = (some["ground"] != again.ground) | (some["noise"] != again.noise)
            beyond = own[near] & _other_side(some, inside, [b for b, p in regions if b != box and p != params])
            self.counts.update(echoes=int(mine.sum()), flags_differ=int((differs & mine).sum()))
            self.counts.update(across=int(beyond.sum()), across_differ=int((differs & beyond).sum()))
            ground[np.flatnonzero(near)[mine]] = (again.ground & ~again.noise)[mine]
        return ground

    def across(self) -> dict[str, Any]:
        """Echoes near borders of squares with other parameters, and how many flags are others by these."""
        return {"width": BORDER, "echoes": self.counts["across"], "flags_differ": self.counts["across_differ"]}

    def add_terrain(
        self,
        points: Points,
        dtm: NDArray[np.float32],
        window: Window,
        params: TerrainParams,
        water: Water | None,
        knots: Points | None,
    ) -> None:
        """Hold the terrain of ground `points` in and around a window against the `dtm` of the blocks."""
        yes, no = np.ones(len(points[0]), bool), np.zeros(len(points[0]), bool)
        if water is not None:
            yes = np.isnan(water.levels(*points[:2]))
        surface = terrain(*points, yes, no, no, window, params, knots).dtm
        if water is not None:
            flat = water.of_cells(window)
            surface = np.where(np.isnan(flat), surface, flat).astype(np.float32)
        both = np.isfinite(dtm) & np.isfinite(surface)
        off = np.abs(dtm - surface)[both]
        self.off.append(off)
        self.counts.update(
            cells=int((np.isfinite(dtm) | np.isfinite(surface)).sum()),
            cells_one_sided=int((np.isfinite(dtm) != np.isfinite(surface)).sum()),
            cells_off=int((off > WITHIN).sum()),
        )

    def facts(self) -> dict[str, Any]:
        """Counts, and how far heights are apart [m]."""
        off = np.concatenate([np.empty(0, np.float32), *self.off])
        names = ("echoes", "flags_differ", "cells", "cells_one_sided", "cells_off")
        return {
            **{n: self.counts[n] for n in names},
            "within": WITHIN,
            "dtm_p999": float(np.quantile(off, 0.999)) if off.size else None,
            "dtm_worst": float(off.max()) if off.size else None,
        }


def _other_side(table: Table, box: Box, others: Sequence[Box]) -> NDArray[np.bool_]:
    """Rows beyond the border of `box`, as near as `BORDER`, in one of `others`."""
    near = box.grown(BORDER).contains(table["x"], table["y"])
    inside = [area.contains(table["x"], table["y"]) for area in others if area.touches(box.grown(BORDER))]
    return near & np.any(inside, axis=0) if inside else np.zeros(table.rows, bool)


def _stacked(plan: Plan) -> list[tuple[str, str]]:
    """The blocks of stacked echoes, where there are any."""
    return (
        [(STACK, key) for key in sorted(plan.layout.occupied[plan.config.terrain.block])]
        if plan.config.stack.enabled
        else []
    )


CHECK_SEAMS = Stage(
    "seams",
    6,
    "survey",
    "echo",
    measure_seams,
    when=lambda plan: plan.config.run.seam_check_echoes > 0,
    arguments=lambda plan: {
        "ground": plan.config.ground,
        "terrain": plan.config.terrain,
        "most": plan.config.run.seam_check_echoes,
        "seed": plan.config.seams.seed,
        **({"square": square_edge(plan)} if adapts(plan) else {}),
    },
    reads=tuple(dict.fromkeys((*GROUND_FILTER.reads, *GROUND_FILTER.writes))),
    after=("terrain", STACK, AUTO, LEVELS, BREAKLINES),
    needs=lambda plan, part: [
        *((TERRAIN.name, b.key) for b in terrain_blocks(plan.layout)),
        *((AUTO, square.key) for square in squares(plan) if adapts(plan)),
        *_stacked(plan),
        *levels_needed(plan),
        *breaklines_needed(plan),
    ],
    check=True,
)
