"""Objects beside echoes: the cells of a tile that hold some, and the objects of all tiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.objects import COUNTED, ObjectCells, cells_across, count_objects, object_classes, object_figures
from fwclass.assess.params import ObjectParams
from fwclass.graph.stage import Plan, StageInputs
from fwclass.grid import TileGrid
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
    """What `object_figures` tells, whatever the tiles of `stage` were; a tile at a time, and of each only what may go
    on beyond it is held. `blocks` are the counts of blocks of edge `block` [m]; `judging` has the ``params`` and the
    edge of the ``tile``s [m]."""
    params: ObjectParams = judging["params"]
    across = cells_across(blocks, block, params)
    cell, tiles = across * params.step, TileGrid(judging["tile"])
    counts, beyond = np.zeros((len(names), len(params.sizes), len(COUNTED)), np.int64), []
    for tile in here.parts(stage):
        arrays, _ = here.inputs.arrays(stage, tile, OBJECTS)
        whole, rest = ObjectCells(arrays["place"], arrays["counts"]).coarser(across).parted(tiles.tile(tile).box, cell)
        counts += count_objects(whole, len(names), cell, params)
        beyond.append(rest)
    counts += count_objects(ObjectCells.merged(beyond), len(names), cell, params)
    return object_figures(counts, names, cell, params)
