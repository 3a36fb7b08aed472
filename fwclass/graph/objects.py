"""Objects beside echoes: the cells of a tile that hold some, and the objects of all tiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.objects import COUNTED, ObjectCells, cells_across, count_objects, object_classes, object_figures
from fwclass.assess.params import ObjectParams
from fwclass.graph.stage import Plan
from fwclass.graph.stage_work import StageInputs
from fwclass.grid import Tile, TileGrid
from fwclass.model import ClassDef
from fwclass.schema import Table
from fwclass.store.arrays import write_arrays

OBJECTS = "objects"


def judged_objects(plan: Plan) -> tuple[int, ...]:
    """Indices of the classes whose objects are judged."""
    return object_classes(plan.config.classes, plan.config.assess.objects.classes)


def write_cells(
    here: StageInputs, table: Table, classes: Sequence[ClassDef], judged: Sequence[int], cell: float
) -> None:
    """The cells of a tile's tested echoes, of edge `cell` [m]."""
    xy = table["x"], table["y"]
    cells = ObjectCells.of(xy, table["reference"], table["classification"], classes, judged, cell)
    write_arrays(here.directory / OBJECTS, {"place": cells.place, "counts": cells.counts})


def objects_of_tiles(
    here: StageInputs, stage: str, blocks: NDArray[np.int64], block: float, names: Sequence[str], judging: Mapping
) -> dict[str, Any]:
    """What `object_figures` tells, whatever the tiles of `stage` were. `blocks` are the counts of blocks of edge
    `block` [m]; `judging` has the ``params`` and the edge of the ``tile``s [m].

    A tile at a time, and then four squares at a time up to one of all tiles; of each only what may go on beyond it is
    held, so that memory follows the borders of a survey and not its area.
    """
    params: ObjectParams = judging["params"]
    across = cells_across(blocks, block, params)
    cell = across * params.step
    grid = TileGrid(judging["tile"])
    tiles = [grid.tile(key) for key in here.parts(stage)]
    if not tiles:
        return object_figures(np.zeros((len(names), len(params.sizes), len(COUNTED)), np.int64), names, cell, params)
    first = min(t.ix for t in tiles), min(t.iy for t in tiles)
    squares = [{(t.ix - first[0], t.iy - first[1]) for t in tiles}]
    while len(squares[-1]) > 1:
        squares.append({(x >> 1, y >> 1) for x, y in squares[-1]})
    origin = (first[0] * grid.size, first[1] * grid.size)
    counts = np.zeros((len(names), len(params.sizes), len(COUNTED)), np.int64)

    def cells_beyond(level: int, x: int, y: int) -> ObjectCells:
        """The cells of a square of 2^`level` tiles whose objects may go on beyond it; the others are counted."""
        nonlocal counts
        if level:
            below = [(2 * x + i, 2 * y + j) for i in (0, 1) for j in (0, 1)]
            cells = ObjectCells.merged(cells_beyond(level - 1, *s) for s in below if s in squares[level - 1])
        else:
            arrays, _ = here.inputs.arrays(stage, f"{x + first[0]}_{y + first[1]}", OBJECTS)
            cells = ObjectCells(arrays["place"], arrays["counts"]).coarser(across)
        whole, rest = cells.parted(Tile(x, y, grid.size * 2**level, origin).box, cell)
        counts += count_objects(whole, len(names), cell, params)
        return rest

    counts += count_objects(cells_beyond(len(squares) - 1, 0, 0), len(names), cell, params)
    return object_figures(counts, names, cell, params)
