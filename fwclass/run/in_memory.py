"""Parts that are held in memory, read as those of a run are: for commands on one file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fwclass.errors import FwclassError
from fwclass.grid import Box
from fwclass.run.inputs import TABLE, Declared, PartInputs
from fwclass.run.part import Name
from fwclass.schema import Table

Held = tuple[Table, Mapping[str, Any]]
"""The table of a part, and what its receipt would say."""


class PartsInMemory(PartInputs):
    """As `PartInputs`, of tables and facts in memory; nothing else of a part can be read."""

    def __init__(self, parts: Mapping[Name, Held], declared: Declared | None) -> None:
        super().__init__(_NO_STORE, declared=declared)
        object.__setattr__(self, "_parts", parts)

    _parts: Mapping[Name, Held]

    def rows(self, part: str, columns: Mapping[str, str], box: Box | None = None, base: str = "tile") -> Table:
        """As in a run: columns of a tile by the stages that wrote them; only rows inside `box` [m] if given."""
        for stage in {base, *columns.values()}:
            self._check(stage, part, [n for n, s in columns.items() if s == stage])
        self._check_rows(part, base, box)
        if box is None:
            return Table({n: self._parts[stage, part][0][n].copy() for n, stage in columns.items()})
        located = self._parts[base, part][0]
        inside = np.flatnonzero(box.contains(located["x"], located["y"]))
        return Table({n: self._parts[s, part][0][n][inside] for n, s in {**columns, "x": base, "y": base}.items()})

    def table(self, stage: str, part: str, columns: Iterable[str] | None = None, name: str = TABLE) -> Table:
        """A part's table; `columns` None for all."""
        self._check(stage, part)
        table = self._parts[stage, part][0]
        return table if columns is None else table.select(columns)

    def meta(self, stage: str, part: str) -> Mapping[str, Any]:
        """What the stage says of a part besides its table."""
        self._check(stage, part)
        return self._parts[stage, part][1]


class _NoStore:
    def __getattr__(self, name: str) -> Any:
        raise FwclassError("a part in memory has a table and facts, and no files", got=name)


_NO_STORE: Any = _NoStore()
