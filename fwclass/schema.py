"""Tables: equal-length columns of declared names (`fwclass.columns`) and dtypes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fwclass.columns import COLUMNS
from fwclass.columns import Column as Column
from fwclass.errors import InputError, nearest

_SCALED = re.compile(r"^(?P<base>[a-z_]+)_r(?P<cm>\d+)$")

IDENTITY = ("strip", "pulse", "echo_number")


def column(name: str) -> Column:
    """The record of `name`; ``echo_ratio_r100`` is ``echo_ratio`` over a radius of 100 cm."""
    if name in COLUMNS:
        return COLUMNS[name]
    found = _SCALED.match(name)
    if found and found["base"] in COLUMNS:
        base = COLUMNS[found["base"]]
        las = f"{base.las} r{found['cm']}" if base.las else ""
        return replace(base, name=name, las=las, meaning=f"{base.meaning}; radius {int(found['cm']) / 100:g} m")
    raise KeyError(f"no column {name!r}; {nearest(name, COLUMNS)}")


def scaled(base: str, radius: float) -> str:
    """Name of feature `base` at `radius` [m]: ``scaled('echo_ratio', 1.0)`` is ``echo_ratio_r100``."""
    return f"{base}_r{round(radius * 100)}"


class Table(Mapping[str, NDArray]):
    """Equal-length numpy columns of declared names and dtypes.

    A column of another dtype is converted if no value changes its meaning (any numeric dtype to the declared one);
    an undeclared name or a length that differs is an error of the program, a `ValueError` or `KeyError`.
    """

    __slots__ = ("_columns", "_rows")

    def __init__(self, columns: Mapping[str, ArrayLike]) -> None:
        self._columns: dict[str, NDArray] = {}
        rows: int | None = None
        for name, values in columns.items():
            array = np.ascontiguousarray(values, dtype=column(name).dtype)
            if array.ndim != 1:
                raise ValueError(f"column {name!r} has shape {array.shape}, expected one dimension")
            if rows is not None and len(array) != rows:
                raise ValueError(f"column {name!r} has {len(array)} rows, the others {rows}")
            rows = len(array)
            self._columns[name] = array
        self._rows = rows or 0

    def __getitem__(self, name: str) -> NDArray:
        try:
            return self._columns[name]
        except KeyError:
            raise KeyError(f"this table has no column {name!r}; {nearest(name, self._columns)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns, as for any mapping; `rows` is the number of rows."""
        return len(self._columns)

    @property
    def rows(self) -> int:
        return self._rows

    def select(self, names: Iterable[str]) -> Table:
        return Table({n: self[n] for n in names})

    def take(self, index: NDArray) -> Table:
        """Rows by integer index, boolean mask or slice-like array."""
        return Table({n: v[index] for n, v in self._columns.items()})

    def with_columns(self, columns: Mapping[str, ArrayLike]) -> Table:
        return Table({**self._columns, **columns})

    @classmethod
    def empty(cls, names: Iterable[str]) -> Table:
        return cls({n: np.empty(0, column(n).dtype) for n in names})

    @classmethod
    def concat(cls, tables: Iterable[Table]) -> Table:
        """Rows of all tables, in order; all must have the same columns."""
        parts = list(tables)
        if not parts:
            raise ValueError("nothing to concatenate")
        names = list(parts[0])
        for part in parts[1:]:
            if list(part) != names:
                raise ValueError(f"tables differ in columns: {names} and {list(part)}")
        return cls({n: np.concatenate([p[n] for p in parts]) for n in names})


def canonical_key(table: Table) -> NDArray[np.uint64]:
    """(strip, pulse, echo_number) as one sortable integer; unique in a survey."""
    strip = table["strip"].astype(np.uint64) << np.uint64(40)
    pulse = table["pulse"].astype(np.uint64) << np.uint64(8)
    return np.asarray(strip | pulse | table["echo_number"].astype(np.uint64), np.uint64)


def require(table: Table, names: Iterable[str], where: object) -> None:
    """`InputError` naming the first column that `table` lacks."""
    for name in names:
        if name not in table:
            raise InputError(
                f"column {name!r} is missing",
                where=where,
                expected=", ".join(names),
                got=", ".join(table),
                do="re-run the stage that writes it, or use data that has it",
            )
