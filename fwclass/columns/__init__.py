"""Every column of every table, declared once.

The stages, the store, the LAS extra bytes, the GeoParquet metadata and the manual all read these records.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from fwclass.columns.echoes import ECHOES
from fwclass.columns.features import FEATURES
from fwclass.columns.record import PER_CODE, SCALES, Column
from fwclass.columns.results import RESULTS
from fwclass.columns.street import STREET
from fwclass.errors import ConfigError

__all__ = ["COLUMNS", "FEATURES", "PER_CODE", "SCALES", "STREET", "Column", "declare"]

_NAME = re.compile(r"(?!.*_(?:[rckg][0-9]+|opt|[0-9]+)$)[a-z][a-z0-9_]{0,63}")
"""Of a user's column: none that would be read as another one's at a scale, or of a class."""

_LAS_FIELDS = frozenset(
    {
        *("X", "Y", "Z", "x", "y", "z", "x_t", "y_t", "z_t", "intensity", "return_number", "number_of_returns"),
        *("synthetic", "key_point", "withheld", "overlap", "scanner_channel", "scan_direction_flag", "classification"),
        *("edge_of_flight_line", "user_data", "scan_angle", "scan_angle_rank", "point_source_id", "gps_time", "red"),
        *("green", "blue", "nir", "wavepacket_index", "wavepacket_offset", "wavepacket_size"),
        "return_point_wave_location",
    }
)
"""Names of the fields of LAS points, as laspy has them."""

_DECLARED = (*ECHOES, *FEATURES, *STREET, *RESULTS)
COLUMNS: dict[str, Column] = {c.name: c for c in _DECLARED}


def declare(columns: Iterable[Column]) -> None:
    """Make columns known in this process, as a user's own stage writes them; `ConfigError` for a name that is taken."""
    kinds = sorted({c.dtype for c in _DECLARED})
    las_names = {c.las for c in _DECLARED if c.las} | _LAS_FIELDS
    for column in columns:
        if not _NAME.fullmatch(column.name) or (
            column.las and (len(column.las.encode()) > 32 or column.las in las_names)
        ):
            raise ConfigError(
                "this cannot be the name of a column",
                where=f"column {column.name!r}, las {column.las!r}",
                expected="small letters, digits and _, no end as of a scale (_r100); as an extra byte at most 32 bytes "
                "and no name that a field or another one has",
                got=column.name if not _NAME.fullmatch(column.name) else column.las,
            )
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
