"""Raw waveforms as Parquet: a row a waveform, see `raw_columns`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fwclass.formats.parquet_numbers import check_numbers, check_undamaged, numbers_of, read_footer
from fwclass.lazy_module import LazyModule
from fwclass.read.beam_source import LONGEST, BeamRows, Layout, Ragged
from fwclass.read.raw_columns import (
    LISTS,
    OPTIONAL,
    PER_NS,
    REQUIRED,
    Settings,
    beam_rows,
    check_columns,
    kind_of_direction,
)

if TYPE_CHECKING:
    import pyarrow.compute as pc
else:
    pc = LazyModule("pyarrow.compute")

MAGIC = b"PAR1"
EXPECTED = f"a table with lists of at most {LONGEST} samples"
BLOCK = 2_000
"""Rows that are held at a time."""

FREE, A_BYTE = 2_000_000, 50
"""Numbers that a file of any size may hold, and further ones for each of its bytes: each takes some 28 bytes of memory,
and samples of a receiver, which differ, are packed to a byte for a few."""


def is_raw_parquet(path: Path) -> bool:
    """A Parquet file with a column of samples; polygons have none."""
    try:
        with path.open("rb") as stream:
            if stream.read(4) != MAGIC:
                return False
        with pq.ParquetFile(path) as file:
            return "samples" in file.schema_arrow.names
    except (OSError, pa.ArrowException, ValueError):
        return False


@dataclass(frozen=True)
class ParquetLayout(Layout):
    """The columns of a file; `groups` are the rows at which its row groups begin, and behind the last their number."""

    path: Path
    settings: Settings
    columns: tuple[str, ...]
    direction: str
    groups: tuple[int, ...]

    @property
    def timed(self) -> bool:
        return "begin_ns" in self.columns

    @property
    def n_rows(self) -> int:
        return self.groups[-1]

    def blocks(self) -> Iterator[BeamRows]:
        yield from self._rows(range(len(self.groups) - 1))

    def read(self, first: int, last: int) -> BeamRows:
        groups = [g for g in range(len(self.groups) - 1) if self.groups[g] < last and self.groups[g + 1] > first]
        parts, at = [], self.groups[groups[0]] if groups else 0
        for rows in self._rows(groups):
            low, high = max(first - at, 0), min(last - at, len(rows))
            if low < high:
                parts.append(rows.take(slice(low, high)))
            at += len(rows)
            if at >= last:
                break
        empty = beam_rows(
            {n: np.empty(0) for n in REQUIRED}, {"samples": Ragged.none(0)}, self.settings, PER_NS, 0, self.path
        )
        return BeamRows.joined(parts) if parts else empty

    def _rows(self, groups: range | list[int]) -> Iterator[BeamRows]:
        if not groups:
            return
        first = self.groups[groups[0]]
        with check_undamaged(self.path, EXPECTED), pq.ParquetFile(self.path) as file:
            batches = file.iter_batches(BLOCK, row_groups=list(groups), columns=self.columns, use_threads=False)
            for batch in batches:
                numbers = {n: numbers_of(batch.column(n)) for n in self.columns if n not in LISTS}
                lists = {n: _ragged(batch.column(n)) for n in LISTS if n in self.columns}
                yield beam_rows(numbers, lists, self.settings, self.direction, first, self.path)
                first += batch.num_rows


def open_raw_parquet(path: Path) -> tuple[ParquetLayout, Settings]:
    """Look at schema and counts; `InputError` for what is no table of waveforms, or counts more than it can hold."""
    with check_undamaged(path, EXPECTED):
        footer = read_footer(path)
    settings, names = Settings.of(footer.metadata, path), list(footer.schema.names)
    check_columns(names, settings, path)
    check_numbers(path, footer, (*REQUIRED, *OPTIONAL), LISTS, FREE, A_BYTE)
    columns = tuple(n for n in (*REQUIRED, *OPTIONAL) if n in names)
    groups = tuple(np.concatenate([[0], np.cumsum(footer.rows)]).astype(int).tolist())
    return ParquetLayout(path, settings, columns, _direction(path, columns, settings), groups), settings


def _direction(path: Path, columns: tuple[str, ...], settings: Settings) -> str:
    names = [n for n in ("dx", "dy", "dz", "spacing_ns") if n in columns]
    with check_undamaged(path, EXPECTED), pq.ParquetFile(path) as file:
        batch = next(file.iter_batches(BLOCK, columns=names, use_threads=False), None)
        if batch is None:
            return kind_of_direction(np.empty((0, 3)), np.empty(0), path)
        numbers = {n: numbers_of(batch.column(n)) for n in names}
    spacing = numbers.get("spacing_ns", np.full(batch.num_rows, settings.spacing or np.nan))
    return kind_of_direction(np.stack([numbers[n] for n in ("dx", "dy", "dz")], axis=1), spacing, path)


def _ragged(column: pa.Array) -> Ragged:
    """Lists; a missing one is empty, a missing number NaN. Lists beyond `LONGEST` stay, so that they are counted."""
    lengths = np.asarray(pc.list_value_length(column).fill_null(0).to_numpy(zero_copy_only=False), np.int64)
    flat = column.flatten()
    if pa.types.is_floating(flat.type) or flat.null_count:
        values = np.asarray(flat.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy(zero_copy_only=False))
    else:
        values = np.asarray(flat.to_numpy(zero_copy_only=False))
    return Ragged(values, np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64))
