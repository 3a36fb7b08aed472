"""Class codes by echo identity, as Parquet: reference labels, and corrections, where a later row of an echo counts."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError, first_line, nearest, visible
from fwclass.formats.parquet_footer import check_unpacked, values_in
from fwclass.lazy_module import LazyModule
from fwclass.schema import PLACE

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq
else:
    pa, pc, pq = LazyModule("pyarrow"), LazyModule("pyarrow.compute"), LazyModule("pyarrow.parquet")

TAKEN_BACK = -1
"""The class of a row that takes earlier rows of its echo back; null in the file."""
FIELD = "class"
DELIVERED = b"fwclass"
"""Key of the metadata of delivered tables."""
_IDENTITY = {"strip": 65_535, "pulse": 2**32 - 1, "echo_number": 255}
"""Whole numbers that tell an echo, and the largest of each."""
MOST_ROWS = 20_000_000
"""Rows of a file; 120 bytes of memory each while they are read."""
FREE_ROWS, ROWS_A_BYTE = 500_000, 2
"""Rows of a file of any size, and further ones for each of its bytes; no true place is told in less than a byte."""
EACH = 200
"""Bytes that one of a file unpacks to, at most."""
MOST_BYTES = 1 << 31
"""Bytes of a file, and of its columns unpacked, as its footer says."""
LONGEST_NAME = 100
"""Letters of who made a correction."""


@dataclass(frozen=True)
class EchoLabels:
    """Rows in the order in which they were made; a later row of an echo counts.

    Attributes
    ----------
    strip, pulse, echo_number : uint16, uint32, uint8 (rows,), the echo.
    code : int16 (rows,), class code 0 to 255, `TAKEN_BACK` for none.
    x, y, z : float64 (rows,) [m], where the echo was.
    time : int64 (rows,), microseconds since 1970 (UTC); 0 where not known.
    who : (rows,) text, who made the row; "" where not known.
    """

    strip: NDArray[np.uint16]
    pulse: NDArray[np.uint32]
    echo_number: NDArray[np.uint8]
    code: NDArray[np.int16]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    time: NDArray[np.int64]
    who: NDArray[np.object_]

    @property
    def rows(self) -> int:
        """Number of labels."""
        return len(self.code)

    @property
    def key(self) -> NDArray[np.uint64]:
        """uint64 (rows,), one number for every echo, as `schema.canonical_key`."""
        strip, pulse = self.strip.astype(np.uint64), self.pulse.astype(np.uint64)
        return np.asarray(strip << np.uint64(40) | pulse << np.uint64(8) | self.echo_number.astype(np.uint64))

    def take(self, rows: NDArray) -> EchoLabels:
        """The same with only `rows` (index or mask)."""
        return EchoLabels(*(getattr(self, name)[rows] for name in _DTYPES))

    def standing(self) -> EchoLabels:
        """The last row of every echo, by echo; those that take back are among them."""
        key = self.key
        order = np.argsort(key, kind="stable")
        last = np.ones(len(key), bool)
        last[:-1] = key[order][1:] != key[order][:-1]
        return self.take(order[last])

    @classmethod
    def of(cls, columns: Mapping[str, Any], code: Any, time: int, who: str) -> EchoLabels:
        """New rows of echoes (`columns` has strip, pulse, echo_number, x, y, z), made at `time` by `who`.

        `code`: int (rows,), `TAKEN_BACK` to take earlier rows back.
        """
        code = np.asarray(code, np.int16)
        name = np.full(len(code), visible(who)[:LONGEST_NAME], object)
        named = {n: np.asarray(columns[n], kind) for n, kind in _DTYPES.items() if n in columns}
        return cls(**{**named, "code": code, "time": np.full(len(code), time, np.int64), "who": name})

    @classmethod
    def none(cls) -> EchoLabels:
        """No labels."""
        return cls(*(np.empty(0, kind) for kind in _DTYPES.values()))

    @classmethod
    def joined(cls, several: list[EchoLabels]) -> EchoLabels:
        """The rows of all, in order."""
        if not several:
            return cls.none()
        return cls(*(np.concatenate([getattr(one, name) for one in several]) for name in _DTYPES))


_DTYPES: Mapping[str, Any] = {
    "strip": np.uint16,
    "pulse": np.uint32,
    "echo_number": np.uint8,
    "code": np.int16,
    "x": np.float64,
    "y": np.float64,
    "z": np.float64,
    "time": np.int64,
    "who": object,
}


def read_echo_labels(source: Path | bytes, where: object, field: str = FIELD, signed: bool = False) -> EchoLabels:
    """The rows of a file, or of the bytes of one.

    `where`: what it is called in messages. `field`: the column of class codes. `signed`: read `time` and `who` too.

    `InputError`: it is damaged, too large, lacks a column, or has a value that no echo has.
    """
    try:
        return _read(source, where, field, signed)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as fault:
        raise _unreadable(fault, where, "it is cut short or damaged; write it again") from fault


def check_echo_labels(path: Path, field: str = FIELD) -> None:
    """`InputError` where the file has no such columns, or too many rows; no row is read."""
    try:
        with path.open("rb") as stream:
            _check_counts(stream, path.stat().st_size, path)
        with pq.ParquetFile(path) as file:
            _check_columns(file.schema_arrow, path, field)
    except (pa.ArrowException, OSError, ValueError) as fault:
        raise _unreadable(fault, path, "name a Parquet file of labels by echo (docs/corrections.md)") from fault


def is_echo_labels(path: Path) -> bool:
    """A Parquet file whose columns are those of labels by echo; what is none, or has geometries, is not."""
    if path.suffix.lower() != ".parquet" or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            check_unpacked(stream, path.stat().st_size, EACH)
        with pq.ParquetFile(path) as file:
            names, metadata = file.schema_arrow.names, file.schema_arrow.metadata or {}
    except (pa.ArrowException, OSError, ValueError, InputError):
        return False
    return {*_IDENTITY, FIELD, *PLACE} <= {*names} and b"geo" not in metadata


def written_by_fwclass(path: Path) -> bool:
    """The file is a table that a run has delivered: what it calls classes may be a model's answers."""
    try:
        return DELIVERED in (pq.read_metadata(path).metadata or {})
    except (pa.ArrowException, OSError, ValueError):
        return False


def _unreadable(fault: Exception, where: object, do: str) -> InputError:
    return InputError(
        "labels by echo cannot be read",
        where=where,
        expected="a Parquet table with strip, pulse, echo_number, class, x, y and z",
        got=first_line(fault),
        do=do,
    )


def echo_labels_bytes(labels: EchoLabels) -> bytes:
    """A file of these rows; the same rows give the same bytes."""
    kinds = {"strip": pa.uint16(), "pulse": pa.uint32(), "echo_number": pa.uint8()}
    fields = {n: pa.array(getattr(labels, n), kind) for n, kind in kinds.items()}
    fields[FIELD] = pa.array(labels.code.clip(0).astype(np.uint8), pa.uint8(), mask=labels.code < 0)
    fields |= {n: pa.array(getattr(labels, n), pa.float64()) for n in PLACE}
    fields["time"] = pa.array(labels.time, pa.timestamp("us", tz="UTC"))
    fields["who"] = pa.array(labels.who.tolist(), pa.string())
    stream = io.BytesIO()
    pq.write_table(pa.table(fields), stream, compression="zstd", use_dictionary=[FIELD, "who", "time", "strip"])
    return stream.getvalue()


def _read(source: Path | bytes, where: object, field: str, signed: bool) -> EchoLabels:
    size = source.stat().st_size if isinstance(source, Path) else len(source)
    with source.open("rb") if isinstance(source, Path) else io.BytesIO(source) as stream:
        _check_counts(stream, size, where)
        stream.seek(0)
        with pq.ParquetFile(stream, read_dictionary=["who"] if signed else None) as file:
            _check_columns(file.schema_arrow, where, field)
            more = ("time", "who") if signed else ()
            there = [n for n in more if n in file.schema_arrow.names]
            table = file.read([*_IDENTITY, field, *PLACE, *there], use_threads=False)
    columns: dict[str, NDArray] = {n: _whole(table.column(n), n, most, where) for n, most in _IDENTITY.items()}
    code = _codes(table.column(field), field, where)
    columns |= {n: _place(table.column(n), n, where) for n in PLACE}
    rows = len(code)
    time = _times(table.column("time")) if "time" in there else np.zeros(rows, np.int64)
    who = _names(table.column("who")) if "who" in there else np.full(rows, "", object)
    identity = {n: v.astype(_DTYPES[n]) for n, v in columns.items()}
    return EchoLabels(**identity, code=code, time=time, who=who)


def _check_counts(stream: Any, size: int, where: object) -> None:
    """`InputError` for more than memory is taken for; Arrow is asked only after."""
    values = values_in(stream, size) if size <= MOST_BYTES else 0
    if size > MOST_BYTES or values > MOST_ROWS * (len(_DTYPES) + 100):
        raise InputError(
            "there are too many labels in one file",
            where=where,
            expected=f"at most {MOST_ROWS:,} rows, in {MOST_BYTES:,} bytes",
            got=f"{size:,} bytes, {values:,} values",
            do="give several files, for example one a tile",
        )
    check_unpacked(stream, size, EACH)
    stream.seek(0)
    about = pq.read_metadata(stream)
    groups = [about.row_group(g) for g in range(about.num_row_groups)]
    unpacked = sum(g.total_byte_size for g in groups)  # of its columns Arrow may not be asked: damaged, they end it
    most = min(MOST_ROWS, FREE_ROWS + ROWS_A_BYTE * size)
    if about.num_rows > most or unpacked > 4 * MOST_BYTES or min([unpacked, *(g.num_rows for g in groups)]) < 0:
        raise InputError(
            "there are too many labels in one file",
            where=where,
            expected=f"at most {most:,} rows in {size:,} bytes",
            got=f"{about.num_rows:,} rows of {unpacked:,} bytes",
            do="give several files, for example one a tile",
        )


def _check_columns(schema: Any, where: object, field: str) -> None:
    lacking = [n for n in (*_IDENTITY, field, *PLACE) if n not in schema.names]
    if lacking:
        raise InputError(
            f"labels by echo lack the column {lacking[0]!r}",
            where=where,
            expected=", ".join((*_IDENTITY, field, *PLACE)),
            got=", ".join(schema.names[:20]) or "no column",
            do=nearest(lacking[0], schema.names) if schema.names else "write the table again",
        )
    twice = [n for n in (*_IDENTITY, field, *PLACE, "time", "who") if schema.names.count(n) > 1]
    if twice:
        raise InputError("a column is there twice", where=where, got=", ".join(twice), do="remove one of them")
    for name in (*_IDENTITY, field, *PLACE):
        kind = schema.field(name).type
        numbers = pa.types.is_integer(kind) or (name in PLACE and pa.types.is_floating(kind))
        if not numbers:
            raise InputError(
                "a column of labels by echo has a type that it cannot have",
                where=f"{where}: column {name}",
                expected="numbers in metres" if name in PLACE else "whole numbers",
                got=str(kind),
                do="write the column again as numbers",
            )


def _whole(column: Any, name: str, most: int, where: object) -> NDArray[np.int64]:
    if column.null_count:
        raise _bad(name, where, f"0 to {most}", f"{column.null_count} rows without a value")
    values = np.asarray(column.cast(pa.int64()).to_numpy())
    low = 1 if name == "echo_number" else 0
    wrong = (values < low) | (values > most)
    if wrong.any():
        raise _bad(name, where, f"{low} to {most}", f"{values[wrong][0]} in row {int(np.flatnonzero(wrong)[0]) + 1}")
    return values


def _codes(column: Any, name: str, where: object) -> NDArray[np.int16]:
    values = np.asarray(column.cast(pa.int64()).fill_null(TAKEN_BACK).to_numpy())
    null = np.asarray(column.is_null().to_numpy(), bool)
    wrong = ~null & ((values < 0) | (values > 255))
    if wrong.any():
        raise _bad(name, where, "0 to 255, or no value", f"{values[wrong][0]}")
    return values.astype(np.int16)


def _place(column: Any, name: str, where: object) -> NDArray[np.float64]:
    values = np.asarray(column.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy())
    wrong = ~(np.abs(values) < 1e8)
    if wrong.any():
        raise _bad(name, where, "a place on earth [m]", f"{values[wrong][0]}")
    return values


def _bad(name: str, where: object, expected: str, got: str) -> InputError:
    return InputError(
        "a label by echo has a value that no echo has",
        where=f"{where}: column {name}",
        expected=expected,
        got=got,
        do="the row is of no echo of any run: take it out",
    )


def _times(column: Any) -> NDArray[np.int64]:
    if not pa.types.is_timestamp(column.type):
        return np.zeros(len(column), np.int64)
    whole = column.cast(pa.timestamp("us", tz="UTC"), safe=False).cast(pa.int64())
    return np.asarray(whole.fill_null(0).to_numpy(), np.int64)


def _names(column: Any) -> NDArray[np.object_]:
    """Texts, what cannot be seen written out, cut to `LONGEST_NAME`; each once, however many rows have it."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return np.full(len(column), "", object)
    coded = column.combine_chunks() if pa.types.is_dictionary(column.type) else pc.dictionary_encode(column)
    chunks = coded.chunks if isinstance(coded, pa.ChunkedArray) else [coded]
    parts = []
    for chunk in chunks:
        known = np.array([*(visible(t or "")[:LONGEST_NAME] for t in chunk.dictionary.to_pylist()), ""], object)
        parts.append(
            known[np.asarray(chunk.indices.fill_null(len(known) - 1).to_numpy(zero_copy_only=False), np.int64)]
        )
    return np.concatenate(parts) if parts else np.empty(0, object)
