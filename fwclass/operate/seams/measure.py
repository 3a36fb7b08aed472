"""Stages computed once more: of tiles for the bands along borders, of blocks from other tiles, of other blocks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import StoreError
from fwclass.graph.ground import surroundings
from fwclass.graph.rasters import RASTERS
from fwclass.graph.stage import Plan, Stage
from fwclass.grid import Tile, TileGrid
from fwclass.operate.seams.differ import Seam
from fwclass.operate.seams.inputs import BandInputs, OtherTilesInputs
from fwclass.operate.seams.shifted_squares import ShiftedSquare, shifted_squares
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.run.part import Outcome, Task, settle_process
from fwclass.run.progress import Display
from fwclass.schema import IDENTITY, Table
from fwclass.store.arrays import arrays_at, read_arrays
from fwclass.store.tables import read_table
from fwclass.temporary import temporary_directory


@dataclass(frozen=True)
class ComparableStages:
    """The stages of a workflow that compute something of echoes, and can be compared.

    `of_tiles`: names of those whose parts are tiles. `of_blocks`: those whose parts are blocks. `gathering`: names of
    those that put what blocks computed into tiles.
    """

    of_tiles: tuple[str, ...]
    of_blocks: tuple[Stage, ...]
    gathering: tuple[str, ...]

    @classmethod
    def of(cls, stages: Iterable[Stage]) -> ComparableStages:
        """Those of the stages of a workflow."""
        some = [s for s in stages if s.writes]
        tiles = [s for s in some if s.over == "tile"]
        return cls(
            tuple(dict.fromkeys(s.name for s in tiles if not s.named)),
            tuple(s for s in some if s.over == "block"),
            tuple(s.name for s in tiles if s.named),
        )


_PLACE = dict.fromkeys((*IDENTITY, "x", "y"), "tile")


def tile_seams(tasks: Iterable[Task], inputs: BandInputs, listed: int, display: Display) -> list[Seam]:
    """Do the work of `tasks` (stages of tiles, in order, whose parts are squares of `inputs`) and compare every column.

    What a stage reads of an earlier one of these is what was computed here, so that a class answers for its features.
    """
    settle_process()
    by_place: dict[str, list[Task]] = {}
    for task in tasks:
        by_place.setdefault(task.part, []).append(task)
    display.expect(Counter(t.stage for some in by_place.values() for t in some))
    seams: dict[str, Seam] = {}
    for part, some in by_place.items():
        here = replace(inputs, fresh={})
        located = here.stored(part, {})
        if not located.rows:  # a band without echoes
            some = []
        for task in some:
            with temporary_directory("seams") as directory:
                task.work(here, directory)
                now = read_table(directory / TABLE)
            here = replace(here, fresh={**here.fresh, task.name: now})
            stored = here.stored(part, dict.fromkeys(now, task.stage))
            seams.setdefault(task.stage, Seam(task.stage, "tile", "echoes", listed)).add(part, stored, now, located)
            display.ended(Outcome(*task.name, "computed"))
    return list(seams.values())


def block_seams(
    tasks: Sequence[tuple[Tile, Task]], plan: Plan, inputs: OtherTilesInputs, listed: int, display: Display
) -> list[Seam]:
    """Do the work of `tasks` (filter and terrain of blocks) with tiles of another size (those of `plan`), compare the
    columns of the blocks' echoes and the cells of the terrain."""
    settle_process()
    display.expect(Counter(t.stage for _, t in tasks))
    seams: dict[str, Seam] = {}
    size, keys = plan.config.tile.size, tuple(plan.layout.keys)
    for block, task in tasks:
        with temporary_directory("seams") as directory:
            task.work(inputs, directory)
            now = read_table(directory / TABLE)
            rasters = arrays_at(directory / RASTERS)
            cells = read_arrays(rasters)[0] if rasters else {}
        stage = gathering_stage(plan, now)
        stored = surroundings(inputs, block, 0.0, size, {**_PLACE, **dict.fromkeys(now, stage)}, keys).table
        _same_rows(stored, now, task)
        seams.setdefault(stage, Seam(stage, "block", "echoes", listed)).add(
            task.part, stored, now, stored.select(_PLACE)
        )
        if cells:
            before = {n: v.ravel() for n, v in inputs.arrays(task.stage, task.part, RASTERS)[0].items()}
            now_flat = {n: v.ravel() for n, v in cells.items()}
            seams.setdefault(task.stage, Seam(task.stage, "block", "cells", 0)).add(task.part, before, now_flat, None)
        display.ended(Outcome(*task.name, "computed"))
    return list(seams.values())


def _same_rows(stored: Table, now: Table, task: Task) -> None:
    if stored.rows != now.rows:
        raise StoreError(
            "a block has not the echoes that it had",
            where=f"{task.stage}/{task.part}",
            expected=stored.rows,
            got=now.rows,
            do="run `fwclass status`, then the run again",
        )


@dataclass(frozen=True)
class BlockShiftEffect:
    """What moving the *blocks* changes near their borders: a property of the algorithm, which is not bounded.

    `off`: echoes whose flag is another, or whose height is by more than `within` [m] (NaN on one side counts);
    `p999`, `worst`: of the differences of height [m], None without any height.
    """

    stage: str
    blocks: int
    echoes: int
    off: int
    within: float
    p999: float | None = None
    worst: float | None = None

    def as_json(self) -> dict[str, Any]:
        """As plain data, with the share of echoes."""
        return {**self.__dict__, "share": self.off / max(self.echoes, 1)}


def gathering_stage(plan: Plan, columns: Iterable[str]) -> str:
    """The stage whose tables of tiles hold `columns` that blocks computed."""
    return plan.layout.columns(columns)[next(iter(columns))]


def shifted_blocks(stage: Stage, plan: Plan) -> list[ShiftedSquare]:
    """Blocks moved by half their size that hold a border between two of the stage's blocks."""
    blocks = stage.all_parts(plan)
    size, width = blocks[0].size, plan.config.seams.width
    return shifted_squares((b.key for b in plan.layout.blocks(size)), size, TileGrid(size).halfway().origin, width)


def compare_moved_blocks(
    stage: Stage,
    moved: Sequence[ShiftedSquare],
    count: int,
    plan: Plan,
    inputs: PartInputs,
    within: float,
    display: Display,
) -> BlockShiftEffect:
    """Filter, or make the terrain of, the first `count` of the blocks `moved` that have echoes near the borders of the
    run's blocks, and compare these."""
    columns = stage.columns(plan)
    stage_of_tiles = gathering_stage(plan, columns)
    blocks, echoes, off = 0, 0, 0
    heights: list[NDArray[np.float64]] = []
    for square in moved:
        if blocks == count:
            break
        block, layout = square.tile, plan.layout
        present = layout.around(stage.box(plan, block), layout.keys)
        stages = {**_PLACE, **dict.fromkeys(columns, stage_of_tiles)}
        stored = surroundings(inputs, block, 0.0, plan.config.tile.size, stages, present).table
        near = square.holds(stored["x"], stored["y"])
        if not near.any():
            continue
        with temporary_directory("seams") as directory:
            stage.task(plan, block).work(inputs, directory)
            now = read_table(directory / TABLE)
        wrong, differences = _off(stored.take(near), now.take(near), within)
        heights += differences
        blocks, echoes, off = blocks + 1, echoes + len(wrong), off + int(wrong.sum())
        display.say(f"{stage.name:<12} block moved to {', '.join(f'{v:.0f}' for v in block.box.bounds[:2])}")
    every = np.concatenate(heights) if heights else np.empty(0)
    distances = (float(np.quantile(every, 0.999)), float(every.max())) if every.size else (None, None)
    return BlockShiftEffect(stage_of_tiles, blocks, echoes, off, within, *distances)


def _off(stored: Table, now: Table, within: float) -> tuple[NDArray[np.bool_], list[NDArray[np.float64]]]:
    """Rows with another flag, or another height by more than `within` [m]; the differences of height."""
    wrong, differences = np.zeros(now.rows, bool), []
    for name in now:
        a, b = stored[name], now[name]
        if a.dtype.kind != "f":
            wrong |= a != b
            continue
        difference = np.abs(a.astype(np.float64) - b)
        differences.append(difference[np.isfinite(difference)])
        wrong |= (difference > within) | (np.isnan(a) != np.isnan(b))
    return wrong, differences
