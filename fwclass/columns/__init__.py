"""Every column of every table, declared once.

The stages, the store, the LAS extra bytes, the GeoParquet metadata and the manual all read these records.
"""

from __future__ import annotations

from collections.abc import Iterable

from fwclass.columns.echoes import ECHOES
from fwclass.columns.features import FEATURES
from fwclass.columns.record import PER_CODE, SCALES, Column
from fwclass.columns.results import RESULTS
from fwclass.errors import ConfigError

__all__ = ["COLUMNS", "FEATURES", "PER_CODE", "SCALES", "Column", "declare"]

_DECLARED = (*ECHOES, *FEATURES, *RESULTS)
COLUMNS: dict[str, Column] = {c.name: c for c in _DECLARED}


def declare(columns: Iterable[Column]) -> None:
    """Make columns known in this process, as a user's own stage writes them; `ConfigError` for a name that is taken."""
    kinds = sorted({c.dtype for c in _DECLARED})
    for column in columns:
        if column.dtype not in kinds:
            raise ConfigError(
                "a column's dtype is none that all outputs can hold",
                where=column.name,
                expected=", ".join(kinds),
                got=column.dtype,
                do="numpy's short names: f4 is a float of four bytes, u1 a whole number of 0 to 255",
            )
        if COLUMNS.setdefault(column.name, column) != column:
            raise ConfigError(
                "a stage declares a column of a name that means something else",
                where=column.name,
                expected=COLUMNS[column.name].meaning,
                got=column.meaning,
                do="give the column another name",
            )


if len(COLUMNS) < len(_DECLARED):
    raise ValueError("a column is declared twice")
