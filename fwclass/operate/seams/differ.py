"""What differs between what the run has and what was computed once more, to the last bit; NaN equals NaN."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fwclass.schema import IDENTITY, Table


def differs(stored: NDArray, now: NDArray) -> NDArray[np.bool_]:
    """Values that are not the same to the bit (0.0 and -0.0 differ); one NaN is as good as another."""
    if stored.dtype.kind != "f":
        return np.asarray(stored != now, bool)
    bits = f"u{stored.dtype.itemsize}"
    same = np.ascontiguousarray(stored).view(bits) == np.ascontiguousarray(now).view(bits)
    return np.asarray(~(same | (np.isnan(stored) & np.isnan(now))), bool)


@dataclass
class ColumnDifference:
    """Differences of one column: how many, how many of these with a value on one side only, and the worst."""

    differ: int = 0
    one_sided: int = 0
    worst: float | None = None

    def add(self, stored: NDArray, now: NDArray, wrong: NDArray[np.bool_]) -> None:
        """Count the values of a part that differ: both sides, and where they are `wrong`."""
        a, b = stored[wrong].astype(np.float64), now[wrong].astype(np.float64)
        both = np.isfinite(a) & np.isfinite(b)
        self.differ += int(wrong.sum())
        self.one_sided += int((np.isnan(a) != np.isnan(b)).sum())
        if both.any():
            self.worst = max(self.worst or 0.0, float(np.abs(a - b)[both].max()))


@dataclass
class Seam:
    """Differences of one stage.

    Attributes
    ----------
    stage, parts, units : which, what its parts are, and what its rows are.
    rows, differ : how many were compared; how many have any column that differs.
    columns : by name.
    at : tile of the shifted grid, or block: (rows, how many of them differ).
    examples : rows that differ, up to `listed`, with their identity and place.
    """

    stage: str
    parts: Literal["tile", "block"]
    units: str
    listed: int
    rows: int = 0
    differ: int = 0
    columns: dict[str, ColumnDifference] = field(default_factory=dict)
    at: dict[str, tuple[int, int]] = field(default_factory=dict)
    examples: list[dict[str, Any]] = field(default_factory=list)

    def add(self, part: str, stored: Mapping[str, NDArray], now: Mapping[str, NDArray], located: Table | None) -> None:
        """Compare columns of one tile or block; `located` has identity, x and y of its rows (None: of cells)."""
        rows = len(next(iter(now.values())))
        wrong = np.zeros(rows, bool)
        for name, values in now.items():
            off = differs(stored[name], values)
            self.columns.setdefault(name, ColumnDifference()).add(stored[name], values, off)
            wrong |= off
            self._list(part, name, stored[name], values, off, located)
        self.rows += rows
        self.differ += int(wrong.sum())
        self.at[part] = rows, int(wrong.sum())

    def _list(
        self, part: str, name: str, stored: NDArray, now: NDArray, off: NDArray[np.bool_], located: Table | None
    ) -> None:
        if located is None:
            return
        for k in np.flatnonzero(off)[: max(0, self.listed - len(self.examples))].tolist():
            who = {n: located[n][k].item() for n in (*IDENTITY, "x", "y")}
            values = {"column": name, "run": _plain(stored[k]), "shifted": _plain(now[k])}
            self.examples.append({"part": part, **who, **values})

    def as_json(self) -> dict[str, Any]:
        """As plain data, with shares."""
        columns = {
            n: {"differ": c.differ, "share": c.differ / max(self.rows, 1), "one_sided": c.one_sided, "worst": c.worst}
            for n, c in self.columns.items()
        }
        return {
            "stage": self.stage,
            "parts": self.parts,
            "units": self.units,
            "rows": self.rows,
            "differ": self.differ,
            "share": self.differ / max(self.rows, 1),
            "columns": columns,
            "examples": self.examples,
            "where": [{"part": p, "rows": n, "differ": d} for p, (n, d) in self.at.items() if d],
        }


def _plain(value: Any) -> Any:
    """A number for JSON, which knows no NaN."""
    plain = value.item()
    return plain if not isinstance(plain, float) or np.isfinite(plain) else str(plain)
