"""Tables: equal-length columns of declared names (`fwclass.columns`) and dtypes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fwclass.columns import COLUMNS, PER_CODE, SCALES
from fwclass.columns import Column as Column
from fwclass.errors import InputError, nearest

_SCALED = re.compile(r"^(?P<base>[a-z][a-z0-9_]*)_(?:(?P<kind>[rckg])(?P<size>[1-9]\d{0,5})|opt)$")

_CODED = re.compile(r"^(?P<base>[a-z_]+)_(?P<code>0|[1-9]\d{0,2})$")

IDENTITY, PLACE = ("strip", "pulse", "echo_number"), ("x", "y", "z")
"""Columns that name an echo; its coordinates."""

MOVED = 1.0
"""m along an axis between two echoes of one identity, from which they are different ones: no other decomposition moves
an echo so far, and where a file's points were sorted anew its pulses have other numbers."""


class Scale(NamedTuple):
    """What a feature is taken over: a `kind` of `columns.SCALES`; `size` in centimetres, or echoes (k), 0 for opt."""

    kind: str
    size: int

    @property
    def metres(self) -> float:
        """The scale in metres."""
        return self.size / 100.0

    @property
    def millimetres(self) -> int:
        """The scale in whole millimetres."""
        return self.size * 10

    @property
    def suffix(self) -> str:
        """The end of a feature's name: ``r100`` for a sphere of 1 m."""
        return "opt" if self.kind == "o" else f"{self.kind}{self.size}"

    def __str__(self) -> str:
        size = "" if self.kind == "o" else f" {self.size}" if self.kind == "k" else f" {self.metres:g} m"
        return f"{SCALES[self.kind]}{size}"


def split_known(name: str) -> tuple[str, Scale | None] | None:
    """As `split_name`, None for no column."""
    if name in COLUMNS and not COLUMNS[name].scales:
        return name, None
    match = _SCALED.match(name)
    if match and match["base"] in COLUMNS:
        scale = Scale(match["kind"] or "o", int(match["size"] or 0))
        if scale.kind in COLUMNS[match["base"]].scales:
            return match["base"], scale
    return None


def split_name(name: str) -> tuple[str, Scale | None]:
    """Base and scale of a column: ``echo_ratio_r100`` is ``echo_ratio`` in a sphere of 1 m; or a `KeyError`."""
    parts = split_known(name)
    if parts is not None:
        return parts
    match = _SCALED.match(name)
    known = COLUMNS.get(match["base"] if match else name)
    if known is not None and known.scales not in ("", PER_CODE):
        ends = " ".join("_opt" if kind == "o" else f"_{kind}…" for kind in known.scales)
        raise KeyError(f"no column {name!r}: {known.name!r} is taken over a neighbourhood, its name ends in {ends}")
    raise KeyError(f"no column {name!r}; {nearest(name, COLUMNS)}")


def base_of(name: str) -> str:
    """A feature's name without its scale; any other name as it is."""
    try:
        return split_name(name)[0]
    except KeyError:
        return name


@lru_cache(maxsize=4096)
def column(name: str) -> Column:
    """The record of `name`; ``echo_ratio_r100`` is ``echo_ratio`` over a radius of 100 cm, ``probability_6`` that of
    class code 6."""
    coded = _CODED.match(name)
    if coded and coded["base"] in COLUMNS and COLUMNS[coded["base"]].scales == PER_CODE and int(coded["code"]) < 256:
        record, code = COLUMNS[coded["base"]], coded["code"]
        las = f"{record.las} {code}" if record.las else ""
        return replace(record, name=name, las=las, meaning=f"{record.meaning}; class code {code}")
    base, scale = split_name(name)
    record = COLUMNS[base]
    if scale is None:
        return record
    las = f"{record.las} {scale.suffix}" if record.las else ""
    return replace(record, name=name, las=las, meaning=f"{record.meaning}; {scale}")


def scaled(base: str, radius: float, kind: str = "r") -> str:
    """Name of feature `base` at `radius` [m]: ``scaled('echo_ratio', 1.0)`` is ``echo_ratio_r100``."""
    return f"{base}_{kind}{round(radius * 100)}"


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

    @classmethod
    def _of(cls, columns: dict[str, NDArray], rows: int) -> Table:
        """A table of columns that have their types and one length already."""
        table = cls.__new__(cls)
        table._columns, table._rows = columns, rows if columns else 0
        return table

    def __getitem__(self, name: str) -> NDArray:
        try:
            return self._columns[name]
        except KeyError:
            raise KeyError(f"this table has no column {name!r}; {nearest(name, self._columns)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns, as for any mapping; `rows` is the number of rows."""
        return len(self._columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self._rows

    def select(self, names: Iterable[str]) -> Table:
        """The same rows with the columns `names` alone, in that order."""
        return self._of({n: self[n] for n in names}, self._rows)

    def take(self, index: NDArray) -> Table:
        """Rows by integer index, boolean mask or slice-like array."""
        columns = {n: np.ascontiguousarray(v[index]) for n, v in self._columns.items()}
        return self._of(columns, len(next(iter(columns.values()), ())))

    def with_columns(self, columns: Mapping[str, ArrayLike]) -> Table:
        """The same rows with `columns` added, or put in the place of those of the same name."""
        return Table({**self._columns, **columns})

    @classmethod
    def empty(cls, names: Iterable[str]) -> Table:
        """A table of no rows with the columns `names`, in their types."""
        return cls._of({n: np.empty(0, column(n).dtype) for n in names}, 0)

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
        return cls._of({n: np.concatenate([p[n] for p in parts]) for n in names}, sum(p.rows for p in parts))


def canonical_key(table: Table) -> NDArray[np.uint64]:
    """(strip, pulse, echo_number) as one sortable integer; unique in a survey."""
    strip = table["strip"].astype(np.uint64) << np.uint64(40)
    pulse = table["pulse"].astype(np.uint64) << np.uint64(8)
    return np.asarray(strip | pulse | table["echo_number"].astype(np.uint64), np.uint64)


def lie_apart(
    first: Mapping[str, NDArray], i: NDArray[np.int64], second: Mapping[str, NDArray], j: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether rows `i` of the first are, though of one identity, other echoes than rows `j` of the second, (n,) each:
    by x, y and z [m], `MOVED`."""
    return np.logical_or.reduce([np.abs(first[axis][i] - second[axis][j]) > MOVED for axis in "xyz"])


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
