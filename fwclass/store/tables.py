"""Tables as Parquet: one file per part, columns described, 64 k row groups, same bytes for the same rows.

Coordinates in metres that are whole millimetres, as all are, are stored as such: half the bytes.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.errors import StoreError
from fwclass.formats.arrow import arrow_array, file_to_write, numpy_values, repeats
from fwclass.grid import Box
from fwclass.lazy_module import LazyModule
from fwclass.schema import Table, column
from fwclass.store.legible import legible
from fwclass.units import QUANTUM

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
else:
    pa, pq = LazyModule("pyarrow"), LazyModule("pyarrow.parquet")

ROW_GROUP = 65_536

FEW = 64
"""Rows up to which a group is not compressed: to begin Zstandard for each column takes as long as to write them."""

_TABLE = "a table"
_QUANTUM, _MILLIMETRES = b"quantum", str(QUANTUM).encode()
"""Metadata of a field: its whole numbers times this are the values."""

MANY_GROUPS = 64
"""Footers of tables with so many row groups are kept: each of thousands of tiles reads one group of the same table."""

KEPT_FOOTERS = 8 << 20
"""Bytes of footers that a process keeps; parsed they take some ten times as much."""

_footers: OrderedDict[str, tuple[tuple[int, ...], pq.FileMetaData]] = OrderedDict()


def to_arrow(table: Table) -> pa.Table:
    """An Arrow table with unit, meaning and source of every column as field metadata."""
    fields, arrays = [], []
    for name, values in table.items():
        c = column(name)
        whole = _whole_millimetres(values) if c.unit == "m" and c.dtype == "f8" else None
        arrays.append(arrow_array(values if whole is None else whole))
        fields.append(_field(name, arrays[-1].type, whole is not None))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


@lru_cache(maxsize=1024)
def _field(name: str, kind: pa.DataType, whole: bool) -> pa.Field:
    """The field of a column; `whole` where its numbers are millimetres."""
    c = column(name)
    about: dict[str | bytes, str | bytes] = {"unit": c.unit, "meaning": c.meaning, "source": c.source}
    return pa.field(name, kind, nullable=False, metadata=about | ({_QUANTUM: _MILLIMETRES} if whole else {}))


def _whole_millimetres(metres: NDArray[np.float64]) -> NDArray[np.int64] | None:
    """Values as whole millimetres, None unless these give back every bit of all."""
    with np.errstate(invalid="ignore", over="ignore"):
        whole = np.rint(metres / QUANTUM).astype(np.int64)
    back = whole * QUANTUM
    return whole if np.array_equal(back.view(np.int64), metres.view(np.int64)) else None


def _encoding(arrow: pa.Table, rows: int, repeating: Iterable[str] = ()) -> Mapping[str, Any]:
    """How columns are written, in groups of some `rows`: fractions by byte planes, whole numbers by their differences,
    codes by dictionary, as fractions that are `repeating`."""
    kinds = {f.name: f.type for f in arrow.schema}
    fractions = {n for n, kind in kinds.items() if pa.types.is_floating(kind)}
    encoding = {n: "BYTE_STREAM_SPLIT" for n in kinds if n in fractions.difference(repeating)}
    wide = (n for n, kind in kinds.items() if pa.types.is_integer(kind) and kind.bit_width >= 32)
    encoding |= dict.fromkeys(wide, "DELTA_BINARY_PACKED")
    compression = {"compression": "zstd", "compression_level": 1} if rows > FEW else {"compression": "none"}
    return {
        **compression,
        "use_dictionary": [n for n in kinds if n not in encoding],
        "column_encoding": encoding or None,
        "write_statistics": True,
    }


def bytes_of(table: Table) -> int:
    """Of its values; Arrow takes as long to count them as to write a row."""
    return sum(values.nbytes for values in table.values())


@counted("writing")
def write_table(path: Path, table: Table, row_group: int = ROW_GROUP) -> None:
    """Write `table` to `path` (which the caller stages)."""
    arrow = to_arrow(table)
    repeating = [name for name, values in table.items() if values.dtype.kind == "f" and repeats(values)]
    with file_to_write(path, bytes_of(table)) as file:
        pq.write_table(arrow, file, row_group_size=row_group, **_encoding(arrow, arrow.num_rows, repeating))


@dataclass(frozen=True)
class Group:
    """A row group: its rows, and the box that they lie in, None where that is not known."""

    rows: int
    box: Box | None

    def touches(self, box: Box | None) -> bool:
        """It may hold rows inside `box`."""
        return box is None or self.box is None or self.box.touches(box)


@counted("reading")
def row_groups_of(path: Path) -> tuple[Group, ...]:
    """The row groups of the table at `path`."""
    with legible(path, _TABLE), open_parquet(path) as file:
        return tuple(_group(file, g) for g in range(file.metadata.num_row_groups))


def _group(file: pq.ParquetFile, number: int) -> Group:
    """A row group with the box of its x, y statistics."""
    about, schema = file.metadata.row_group(number), file.schema_arrow
    if "x" not in schema.names or "y" not in schema.names:
        return Group(about.num_rows, None)
    sides = []
    for at in (schema.names.index("x"), schema.names.index("y")):
        statistics, unit = about.column(at).statistics, _quantum(schema.field(at)) or 1.0
        if statistics is None or not statistics.has_min_max:
            return Group(about.num_rows, None)
        sides.append((statistics.min * unit, statistics.max * unit))
    return Group(about.num_rows, _box_of(*sides))


def group_of(table: Table) -> Group | None:
    """What `row_groups_of` tells of a table of one row group, None where only its file can tell."""
    if "x" not in table or "y" not in table:
        return Group(table.rows, None)
    if any(_whole_millimetres(table[name]) is None for name in "xy"):
        return None
    return Group(table.rows, _box_of(*((float(table[name].min()), float(table[name].max())) for name in "xy")))


def _box_of(across: tuple[float, float], along: tuple[float, float]) -> Box:
    """Box that holds rows of these least and greatest x and y [m]."""
    return Box(across[0], along[0], across[1] + 1e-9, along[1] + 1e-9).grown(0.001)


def _quantum(field: pa.Field) -> float | None:
    """What a field's whole numbers are to be taken times, None for one that holds the values themselves."""
    text = (field.metadata or {}).get(_QUANTUM)
    return float(text) if text is not None else None


def _values(column: pa.ChunkedArray, field: pa.Field) -> NDArray:
    values, quantum = numpy_values(column), _quantum(field)
    return values if quantum is None else values * quantum


def open_parquet(path: Path) -> pq.ParquetFile:
    """A Parquet file; the footer of one with many row groups is kept in memory while the file stays as it is."""
    with legible(path, _TABLE):
        now, footer = _looks(path), _footers.get(str(path))
        if footer is not None and footer[0] == now:
            return pq.ParquetFile(path, metadata=footer[1], pre_buffer=False)
        file = pq.ParquetFile(path, pre_buffer=False)  # to read ahead from a disk of here takes longer than to read
        if file.metadata.num_row_groups >= MANY_GROUPS:
            _keep_footer(str(path), now, file.metadata)
        return file


def _looks(path: Path) -> tuple[int, ...]:
    facts = path.stat()
    return facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


def _keep_footer(path: str, now: tuple[int, ...], footer: pq.FileMetaData) -> None:
    _footers[path] = now, footer
    while len(_footers) > 1 and sum(f.serialized_size for _, f in _footers.values()) > KEPT_FOOTERS:
        _footers.popitem(last=False)


def row_groups(path: Path, box: Box | None) -> list[int]:
    """Row groups of the table at `path` that may hold rows inside `box`."""
    return [k for k, group in enumerate(row_groups_of(path)) if group.touches(box)]


@counted("reading")
def read_table(path: Path, columns: Iterable[str] | None = None, groups: list[int] | None = None) -> Table:
    """The table at `path`: chosen columns (all), chosen row groups (all)."""
    with legible(path, _TABLE), open_parquet(path) as file:
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
        chosen = list(range(file.metadata.num_row_groups)) if groups is None else groups
        if not chosen:
            return Table.empty(names)
        arrow = file.read_row_groups(chosen, columns=names, use_threads=False)
        return Table({n: _values(arrow.column(n), arrow.schema.field(n)) for n in names})


@counted("writing")
def write_groups(path: Path, table: Table, offsets: Iterable[int]) -> None:
    """Write `table` with one row group per run of rows ``offsets[k]:offsets[k + 1]``."""
    arrow = to_arrow(table)
    bounds = [int(o) for o in offsets]
    how = _encoding(arrow, arrow.num_rows // max(len(bounds) - 1, 1))
    with file_to_write(path, bytes_of(table)) as file, pq.ParquetWriter(file, arrow.schema, **how) as writer:
        for low, high in zip(bounds[:-1], bounds[1:], strict=True):
            writer.write_table(arrow.slice(low, high - low), row_group_size=max(high - low, 1))
