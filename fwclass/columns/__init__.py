"""Every column of every table, declared once.

The stages, the store, the LAS extra bytes, the GeoParquet metadata and the manual all read these records.
"""

from __future__ import annotations

from fwclass.columns.echoes import ECHOES
from fwclass.columns.features import FEATURES
from fwclass.columns.record import PER_CODE, SCALES, Column
from fwclass.columns.results import RESULTS

__all__ = ["COLUMNS", "FEATURES", "PER_CODE", "SCALES", "Column"]

_DECLARED = (*ECHOES, *FEATURES, *RESULTS)
COLUMNS: dict[str, Column] = {c.name: c for c in _DECLARED}

if len(COLUMNS) < len(_DECLARED):
    raise ValueError("a column is declared twice")
