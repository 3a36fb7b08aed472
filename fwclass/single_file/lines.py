"""Whether the flight lines of one file lie at one height and at one place, and see something smooth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fwclass import conf
from fwclass.grid import TileGrid
from fwclass.quality.block import READS, block_quality
from fwclass.quality.compared import compare_strips
from fwclass.quality.roughness import roughness_remarks
from fwclass.quality.steps import step_remarks
from fwclass.quality.strips import offset_remarks, unsound_strips
from fwclass.schema import Table


def lines_of(table: Table, path: Path, settings: tuple[str, ...]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """How the lines of the echoes in `table` (columns `READS`) lie, and how smooth the smoothest places are, as a run's
    quality tells it (``strips`` of `report.judge_echoes`), and what is to be said of them, by the bounds of a
    run. Without times all is one line; nothing where a column is lacking."""
    if not all(name in table for name in READS):
        return {}, ()
    params = conf.section("quality", settings).model_copy(update={"strips": "times"})
    grid = TileGrid(conf.section("terrain", settings).block)
    column, row = grid.indices(table["x"], table["y"])
    order = np.lexsort((row, column))
    new = (np.diff(column[order]) != 0) | (np.diff(row[order]) != 0)
    parts = np.split(order, np.flatnonzero(new) + 1)
    blocks = [grid.tile(f"{column[rows[0]]}_{row[rows[0]]}") for rows in parts]
    of_lines = Table({name: table[name] for name in READS})
    of_block = [block_quality(of_lines.take(np.sort(r)), b.box, params) for b, r in zip(blocks, parts, strict=True)]
    arrays = {b.key: q.arrays() for b, q in zip(blocks, of_block, strict=True)}
    counts = np.sum([(len(q.pairs.dz), *q.between()) for q in of_block], axis=0).tolist()
    files = {int(k): path.stem for k in np.unique(table["strip"])}
    facts, _ = compare_strips(blocks, lambda key, only: arrays[key], tuple(counts), params, files)
    said = (*(unsound_strips(facts) or offset_remarks(facts)), *step_remarks(facts))
    return facts, (*said, *roughness_remarks(facts["roughness"]))
