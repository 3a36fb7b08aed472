"""Parquet files of somebody else's numbers, and lists of numbers: looked at before they are read."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fwclass.errors import InputError, first_line
from fwclass.formats.parquet_footer import check_file, count_values

EACH = 2000
"""Bytes that one of a file unpacks to, at most."""

_LISTS = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)


@dataclass(frozen=True)
class Footer:
    """Schema, rows of every row group, and values of all columns."""

    schema: pa.Schema
    rows: tuple[int, ...]
    values: int

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of itself; letters that are none are replaced."""
        pairs = (self.schema.metadata or {}).items()
        return {k.decode("utf-8", "replace"): v.decode("utf-8", "replace") for k, v in pairs}


@contextmanager
def check_undamaged(path: Path, expected: str) -> Iterator[None]:
    """`InputError` where Arrow refuses the file."""
    try:
        yield
    except (pa.ArrowException, OSError, ValueError) as fault:
        raise InputError(
            "the Parquet file cannot be read",
            where=path,
            expected=expected,
            got=first_line(fault),
            do="it is cut short or damaged; write it again",
        ) from None


def read_footer(path: Path) -> Footer:
    """What the file holds, by its footer. `pa.ArrowException`, `OSError` or `ValueError` where it is damaged, or would
    unpack to more than any such file does."""
    with pq.ParquetFile(path) as file:
        schema, footer = file.schema_arrow, file.metadata
        rows = tuple(footer.row_group(g).num_rows for g in range(footer.num_row_groups))
    values = count_values(path)
    check_file(path, EACH)
    return Footer(schema, rows, values)


def check_numbers(
    path: Path, footer: Footer, columns: Collection[str], lists: Collection[str], free: int, a_byte: int
) -> None:
    """`InputError` where one of `columns` does not hold numbers, or, those of `lists`, lists of numbers; or where the
    file counts more of them than `free` and `a_byte` further ones for each of its bytes."""
    for name in (n for n in footer.schema.names if n in columns):
        kind = footer.schema.field(name).type
        nested = any(test(kind) for test in _LISTS)
        inner = kind.value_type if nested else kind
        if nested != (name in lists) or not (pa.types.is_integer(inner) or pa.types.is_floating(inner)):
            raise InputError(
                "a column has a type that it cannot have",
                where=f"{path}: column {name}",
                expected="lists of whole numbers or floats" if name in lists else "numbers",
                got=str(kind),
                do="write the column again",
            )
    size, rows = path.stat().st_size, sum(footer.rows)
    most = free + a_byte * size
    if min([*footer.rows, 0]) < 0 or max(footer.values, rows) > most:
        raise InputError(
            "the file counts more than it can hold",
            where=path,
            expected=f"at most {most:,} numbers in {size:,} bytes",
            got=f"{rows:,} rows, {footer.values:,} numbers",
            do="the file is damaged, or nearly all of its numbers are equal: write it again, or without compression",
        )


def numbers_of(column: pa.Array) -> NDArray[np.float64]:
    """The column's numbers (rows,); NaN where one is missing."""
    return np.asarray(column.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy(zero_copy_only=False))
