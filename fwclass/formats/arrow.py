"""numpy arrays as Arrow arrays and back, by their buffers: Arrow's own way loads pandas where that is installed, half a
second of every process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fwclass.lazy_module import LazyModule

if TYPE_CHECKING:
    import pyarrow as pa
else:
    pa = LazyModule("pyarrow")


JUDGED, NEAR = 4096, 65_536
"""Of so many values, spread over the first so many, it is told whether a column repeats itself."""

REPEATING = 0.5
"""Different values among those judged, as a share, up to which a dictionary is shorter than byte planes: of 64 features
of `p1` it is within 1.2 % of the shorter one for each."""


TOGETHER = 1 << 20
"""Bytes of values up to which a file is put together in memory and written at once: Parquet writes page by page, and
the calls of the system for one row of 28 columns take as long as all else."""


@contextmanager
def file_to_write(path: Path, size: float) -> Iterator[Any]:
    """Where Parquet writes the file `path` of some `size` bytes to."""
    if size > TOGETHER:
        yield path
        return
    stream = pa.BufferOutputStream()
    yield stream
    path.write_bytes(stream.getvalue())


def repeats(values: NDArray) -> bool:
    """Whether the values (n,) are so few different ones that Parquet keeps them best in a dictionary; of fewer than
    `JUDGED` its page costs what it saves."""
    judged = values[: NEAR : max(min(len(values), NEAR) // JUDGED, 1)]
    return len(judged) >= JUDGED and len(arrow_array(judged).unique()) <= REPEATING * len(judged)


def arrow_array(values: NDArray) -> pa.Array:
    """An Arrow array (n,) of numbers or truth values (n,), without missing values; numbers are not copied."""
    kind = pa.from_numpy_dtype(values.dtype)
    if values.dtype == bool:
        buffer = np.packbits(values, bitorder="little")
    else:
        buffer = np.ascontiguousarray(values)
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(buffer)])


def numpy_values(column: pa.ChunkedArray) -> NDArray:
    """The values (n,) of an Arrow column of numbers or truth values; missing ones as Arrow gives them to numpy."""
    if column.null_count or not (pa.types.is_boolean(column.type) or pa.types.is_primitive(column.type)):
        return np.asarray(column.to_numpy())
    truth = pa.types.is_boolean(column.type)
    dtype = np.dtype(np.uint8 if truth else column.type.to_pandas_dtype())
    pieces = []
    for chunk in column.chunks:
        buffer, first, rows = chunk.buffers()[1], chunk.offset, len(chunk)
        if buffer is None or not rows:
            continue
        if truth:
            bits = np.unpackbits(np.frombuffer(buffer, np.uint8), count=first + rows, bitorder="little")
            pieces.append(bits[first:].astype(bool))
        else:
            pieces.append(np.frombuffer(buffer, dtype, first + rows)[first:])
    if not pieces:
        return np.empty(0, bool if truth else dtype)
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
