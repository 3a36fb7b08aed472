"""The echoes of one file in the tiles that they have in a run: its stages work on them, in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.errors import FwclassError
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.graph.ground import MAKE_TERRAIN, terrain_of_block
from fwclass.graph.noise import FILTER_NOISE, GATHER_NOISE, NOISE_READS
from fwclass.graph.stage import Plan, Stage, always, names_under
from fwclass.graph.stage_work import Result, StageInputs, Work
from fwclass.grid import Box, TileGrid
from fwclass.ground.terrain.params import TerrainParams
from fwclass.run.in_memory import Held, PartsInMemory
from fwclass.run.inputs import Declared
from fwclass.run.part import Name
from fwclass.schema import IDENTITY, Table
from fwclass.survey.layout import Layout
from fwclass.tile.stage import TILE
from fwclass.units import QUANTUM

Tell = Callable[[str], None]
"""Told what begins now."""

HELD = 256 << 20
"""Bytes of features that are held."""


def quiet(text: str) -> None:
    """A `Tell` that says nothing."""


class FileConfig:
    """Sections of the configuration by name, as stages are planned by: the defaults with `settings`, or those given."""

    def __init__(self, settings: tuple[str, ...], **given: Any) -> None:
        self._settings = settings
        vars(self).update(given)

    def __getattr__(self, name: str) -> Any:
        vars(self)[name] = conf.section(name, self._settings)
        return vars(self)[name]

    @property
    def whole(self) -> Any:
        """It stands for a whole configuration wherever no other section is asked for."""
        return self


class FileTiles:
    """Echoes of one file by tile, and what stages make of them when it is asked for.

    Parameters
    ----------
    table : at least one echo, in any order: x, y [m], and the columns that the first stages read.
    stages : those that may be asked; what one of them reads of another is made before it.
    words : what is told before a part of a stage is made, by its name: the words, and how many are begun of how many.
    held : bytes of features that are held; those of a tile that is asked again are computed again.
    planned : fields of the `Plan`.
    """

    def __init__(
        self,
        table: Table,
        config: FileConfig,
        stages: Iterable[Stage],
        tell: Tell = quiet,
        words: Mapping[str, str] | None = None,
        held: int = HELD,
        **planned: Any,
    ) -> None:
        self._stages = {stage.name: stage for stage in stages}
        self._tell, self._words, self._held = tell, dict(words or {}), held
        plan = Plan(config.whole, **planned)
        every = [*IDENTITY, "x", "y"]
        for stage in self._stages.values():
            every += [*names_under(stage.reads, plan), *names_under(stage.own, plan)]
        table = table.select(n for n in dict.fromkeys(every) if n in table)
        grid, x, y = TileGrid(config.tile.size), table["x"], table["y"]
        ix, iy = grid.indices(x, y)
        self._order = np.lexsort((iy, ix))
        new = np.r_[True, (np.diff(ix[self._order]) != 0) | (np.diff(iy[self._order]) != 0)]
        first = np.flatnonzero(new)
        keys = [f"{ix[r]}_{iy[r]}" for r in self._order[first]]
        sorted_table = table.take(self._order)
        self._rows = {key: slice(a, b) for key, a, b in zip(keys, first, [*first[1:], len(new)], strict=True)}
        self._parts: dict[Name, Held] = {
            (TILE.name, key): (Table({n: v[rows] for n, v in sorted_table.items()}), {})
            for key, rows in self._rows.items()
        }
        self._facts: dict[Name, Mapping[str, Any]] = {}
        self._features: list[Name] = []
        stage_of = dict.fromkeys(table, TILE.name)
        for stage in self._stages.values():
            for column in stage.columns(plan) if stage.over == "tile" else ():
                stage_of.setdefault(column, stage.name)
        edges = {stage.edge(plan) for stage in self._stages.values() if stage.edge is not None}
        layout = Layout(
            config.whole,
            tuple(sorted(map(grid.tile, keys))),
            {edge: frozenset(TileGrid(edge).keys(x, y)) for edge in edges},
            frozenset(),
            Box(float(x.min()), float(y.min()), float(x.max()) + QUANTUM, float(y.max()) + QUANTUM),
            (np.nan, np.nan),
            {},
            np.nan,
            table.rows,
            providers=stage_of,
        )
        self.plan = replace(plan, tiled=layout, providers=stage_of)
        named = (stage for stage in self._stages.values() if stage.name in self._words)
        self._numbers = {stage.name: [0, len(stage.all_parts(self.plan))] for stage in named}

    @property
    def keys(self) -> list[str]:
        """The tiles that own an echo."""
        return list(self._rows)

    def make(self, stage: Stage, key: str) -> Held:
        """A part's table, and what is to be said of it; made, after all that it reads, unless it is held."""
        name = (stage.name, key)
        if name not in self._parts:
            size = stage.edge(self.plan) if stage.edge is not None else self.plan.config.tile.size
            task = stage.task(self.plan, TileGrid(size).tile(key))
            while lacking := [other for other in task.needs if other not in self._parts]:
                for of_stage, part in lacking:
                    self.make(self._stages[of_stage], part)
            if stage.name in self._words:
                self._numbers[stage.name][0] += 1
                self._tell("{} {} of {}".format(self._words[stage.name], *self._numbers[stage.name]))
            inputs = self.inputs(Declared(name, frozenset(task.needs), task.within))
            if not isinstance(task.work, Work):
                raise FwclassError("a stage of a file has no adapter of tables", where=stage.name)
            table, facts = task.work.result(task.work.here(inputs, Path()))
            self._parts[name] = (Table({}) if table is None else table, facts)
            self._facts[name] = facts
            if stage.name == COMPUTE_FEATURES.name:
                self._hold(name)
        return self._parts[name]

    def inputs(self, declared: Declared | None = None) -> PartsInMemory:
        """The parts that are held; of them what is `declared`, None for all."""
        return PartsInMemory(self._parts, declared)

    def _hold(self, name: Name) -> None:
        """Features of a tile are kept, and those of earlier ones as far as there is room."""
        self._features.append(name)
        while len(self._features) > 1 and sum(map(self._bytes, self._features)) > self._held:
            del self._parts[self._features.pop(0)]

    def _bytes(self, name: Name) -> int:
        return sum(v.nbytes for v in self._parts[name][0].values())

    def rows(self, key: str, names: Iterable[str]) -> Table:
        """Columns `names` of a tile's echoes, of the stages that write them."""
        columns = self.plan.layout.columns(names)
        for stage in columns.values():
            if stage != TILE.name:
                self.make(self._stages[stage], key)
        return self.inputs().rows(key, columns)

    def columns(
        self, stage: Stage, names: Iterable[str], out: Mapping[str, NDArray] | None = None
    ) -> dict[str, NDArray]:
        """Columns `names` of a stage over tiles for all echoes, in the table's order; in the arrays `out`, if given."""
        columns = dict(out or {})
        for key, rows in self._rows.items():
            table, _ = self.make(stage, key)
            for name in names:
                if name not in columns:
                    columns[name] = np.empty(len(self._order), table[name].dtype)
                columns[name][self._order[rows]] = table[name]
        return columns

    def facts(self, stage: Stage) -> list[Mapping[str, Any]]:
        """What is to be said of all tiles of a stage that is made."""
        return [self._facts[stage.name, key] for key in self._rows]

    def facts_of_blocks(self, stage: Stage) -> list[Mapping[str, Any]]:
        """Likewise of the blocks that were made of a stage over blocks."""
        return [facts for (name, _), facts in self._facts.items() if name == stage.name]


def heights_of_block(here: StageInputs, params: TerrainParams) -> Result:
    """As `make_terrain`, without its rasters."""
    return terrain_of_block(here, params)[:2]


MAKE_HEIGHTS = replace(MAKE_TERRAIN, function=heights_of_block, margin=0)
"""Of the blocks that own an echo alone: no other has a height."""

FIND_NOISE, GIVE_NOISE = (replace(stage, when=always) for stage in (FILTER_NOISE, GATHER_NOISE))
"""Also where a ground filter would find it: none is asked for."""


def with_noise_flags(table: Table, config: FileConfig, tell: Tell = quiet) -> Table:
    """`table` with `noise`, as in a run, unless it has it or noise counts as a neighbour."""
    if "noise" in table or config.features.noise_counts:
        return table
    words = {FIND_NOISE.name: "noise: block"}
    tiles = FileTiles(points_of(table, NOISE_READS), config, (FIND_NOISE, GIVE_NOISE), tell, words)
    return table.with_columns(tiles.columns(GIVE_NOISE, ("noise",)))


def points_of(table: Table, names: Iterable[str]) -> Table:
    """Identity and columns `names` of echoes; those of a text are single ones without a fault."""
    whole = {"number_of_echoes": table["echo_number"], "fit_flags": np.zeros(table.rows), **table}
    return Table({n: whole[n] for n in dict.fromkeys((*IDENTITY, *names))})
