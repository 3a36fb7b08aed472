"""Tables as Parquet: one file per part, columns described, 64 k row groups, same bytes for the same rows."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fwclass.errors import StoreError
from fwclass.formats.arrow import arrow_array, numpy_values
from fwclass.grid import Box
from fwclass.lazy_module import LazyModule
from fwclass.schema import Table, column

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
else:
    pa, pq = LazyModule("pyarrow"), LazyModule("pyarrow.parquet")

ROW_GROUP = 65_536

MANY_GROUPS = 64
"""Footers of tables with so many row groups are kept: each of thousands of tiles reads one group of the same table."""

KEPT_FOOTERS = 8 << 20
"""Bytes of footers that a process keeps; parsed they take some ten times as much."""

_footers: OrderedDict[str, tuple[tuple[int, ...], pq.FileMetaData]] = OrderedDict()


def to_arrow(table: Table) -> pa.Table:
    """An Arrow table with unit, meaning and source of every column as field metadata."""
    fields = []
    for name in table:
        c = column(name)
        about = {"unit": c.unit, "meaning": c.meaning, "source": c.source}
        fields.append(pa.field(name, pa.from_numpy_dtype(np.dtype(c.dtype)), nullable=False, metadata=about))
    return pa.Table.from_arrays([arrow_array(v) for v in table.values()], schema=pa.schema(fields))


def write_table(path: Path, table: Table, row_group: int = ROW_GROUP) -> None:
    """Write `table` to `path` (which the caller stages)."""
    floats = [n for n in table if table[n].dtype.kind == "f"]
    integers = [n for n in table if table[n].dtype.kind in "iu" and table[n].dtype.itemsize >= 4]
    encoding = dict.fromkeys(floats, "BYTE_STREAM_SPLIT") | dict.fromkeys(integers, "DELTA_BINARY_PACKED")
    rest = [n for n in table if n not in encoding]
    pq.write_table(
        to_arrow(table),
        path,
        row_group_size=row_group,
        compression="zstd",
        compression_level=1,
        use_dictionary=rest,
        column_encoding=encoding or None,
        write_statistics=True,
    )


def _groups_touching(file: pq.ParquetFile, box: Box | None) -> list[int]:
    """Row groups whose x, y statistics meet `box`."""
    metadata = file.metadata
    groups = list(range(metadata.num_row_groups))
    names = file.schema_arrow.names
    if box is None or "x" not in names:
        return groups
    at_x, at_y = names.index("x"), names.index("y")
    kept = []
    for g in groups:
        sx, sy = (metadata.row_group(g).column(i).statistics for i in (at_x, at_y))
        unknown = sx is None or sy is None or not (sx.has_min_max and sy.has_min_max)
        if unknown or Box(sx.min, sy.min, sx.max + 1e-9, sy.max + 1e-9).grown(0.001).touches(box):
            kept.append(g)
    return kept


def open_parquet(path: Path) -> pq.ParquetFile:
    try:
        now, known = _looks(path), _footers.get(str(path))
        if known is not None and known[0] == now:
            return pq.ParquetFile(path, metadata=known[1])
        file = pq.ParquetFile(path)
        if file.metadata.num_row_groups >= MANY_GROUPS:
            _keep_footer(str(path), now, file.metadata)
        return file
    except (OSError, pa.ArrowInvalid) as fault:
        raise StoreError(
            "a table of the store cannot be read", where=path, got=fault, do="remove its part's directory and run again"
        ) from fault


def _looks(path: Path) -> tuple[int, ...]:
    facts = path.stat()
    return facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


def _keep_footer(path: str, now: tuple[int, ...], footer: pq.FileMetaData) -> None:
    _footers[path] = now, footer
    while len(_footers) > 1 and sum(f.serialized_size for _, f in _footers.values()) > KEPT_FOOTERS:
        _footers.popitem(last=False)


def row_groups(path: Path, box: Box | None) -> list[int]:
    """Row groups of the table at `path` that may hold rows inside `box`."""
    with open_parquet(path) as file:
        return _groups_touching(file, box)


def read_table(path: Path, columns: Iterable[str] | None = None, groups: list[int] | None = None) -> Table:
    """The table at `path`: chosen columns (all), chosen row groups (all)."""
    with open_parquet(path) as file:
        there = file.schema_arrow.names
        names = list(columns) if columns is not None else there
        lacking = [n for n in names if n not in there]
        if lacking:
            raise StoreError(
                f"a table of the store lacks {', '.join(lacking)}",
                where=path,
                got=", ".join(there),
                do="run again; if that does not help, use a fresh run directory",
            )
        wanted = list(range(file.metadata.num_row_groups)) if groups is None else groups
        if not wanted:
            return Table.empty(names)
        arrow = file.read_row_groups(wanted, columns=names, use_threads=False)
    return Table({n: numpy_values(arrow.column(n)) for n in names})


def write_groups(path: Path, table: Table, offsets: Iterable[int]) -> None:
    """Write `table` with one row group per run of rows ``offsets[k]:offsets[k + 1]``."""
    arrow = to_arrow(table)
    bounds = [int(o) for o in offsets]
    with pq.ParquetWriter(path, arrow.schema, compression="zstd", compression_level=1) as writer:
        for low, high in zip(bounds[:-1], bounds[1:], strict=True):
            writer.write_table(arrow.slice(low, high - low), row_group_size=max(high - low, 1))
