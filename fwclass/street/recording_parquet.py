"""Recordings as Parquet: a row a frame, lists of ranges."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.parquet_numbers import check_numbers, check_undamaged, numbers_of, read_footer
from fwclass.street.frames import Frame, Scan
from fwclass.street.recording_columns import (
    COLUMNS,
    LISTS,
    MOST_BEAMS,
    NUMBERS,
    check_columns,
    class_codes,
    frame_of,
    settings_of,
)

EXPECTED = f"a row a frame: {', '.join(COLUMNS)}"
BLOCK = 64
"""Frames that are held at a time."""

A_BYTE = 2000
"""Numbers that a byte of a file holds, at most: those of frames without a return are all the same."""

ROWS = 512
"""Frames of a row group that is written."""


class ParquetRecording:
    """Frames of a Parquet file; see `recording_columns`. Settings that hold for all may stand in its metadata."""

    def __init__(self, path: Path, scan: Scan) -> None:
        self.path = path
        with check_undamaged(path, EXPECTED):
            footer = read_footer(path)
        self._names = list(footer.schema.names)
        check_columns(self._names, path)
        check_numbers(path, footer, self._names, LISTS, 0, A_BYTE)
        for name in self._names:
            kind = footer.schema.field(name).type
            if pa.types.is_fixed_size_list(kind) and kind.list_size > MOST_BEAMS:
                raise InputError(
                    "a frame has more beams than any scanner",
                    where=f"{path}: column {name}",
                    expected=f"at most {MOST_BEAMS}",
                    got=kind.list_size,
                )
        self._scan = settings_of(footer.metadata, scan)
        self.about: Mapping[str, Any] = {"kind": "Parquet", "rows": sum(footer.rows), "columns": self._names}

    def frames(self) -> Iterator[Frame]:
        """As `Recording.frames`."""
        at = 0
        with (
            check_undamaged(self.path, EXPECTED),
            pq.ParquetFile(self.path, pre_buffer=False) as file,
        ):  # a buffer keeps all
            for batch in file.iter_batches(BLOCK, columns=self._names, use_threads=False):
                numbers = {n: numbers_of(batch.column(n)) for n in self._names if n in NUMBERS}
                for row in range(batch.num_rows):
                    here = {n: float(v[row]) for n, v in numbers.items()}
                    ranges = _floats(batch, "ranges", row)
                    labels = self._codes(batch, row, at) if "labels" in self._names else None
                    light = _floats(batch, "intensities", row) if "intensities" in self._names else None
                    light = light if light is not None and len(light) else None
                    yield frame_of(at, here, ranges, labels, self._scan, self.path, light)
                    at += 1

    def _codes(self, batch: pa.RecordBatch, row: int, at: int) -> NDArray[np.uint8]:
        """Labels of a row; 0 where there is none."""
        values = batch.column("labels")[row].values
        if values is None:
            return np.empty(0, np.uint8)
        codes = np.asarray(values.fill_null(0).to_numpy(zero_copy_only=False))
        return class_codes(codes, f"{self.path}: row {at + 1}")


def _floats(batch: pa.RecordBatch, name: str, row: int) -> NDArray[np.float32]:
    """A list of a row, NaN where a number is missing; (0,) where the list is."""
    values = batch.column(name)[row].values
    if values is None:
        return np.empty(0, np.float32)
    if values.null_count or values.type != pa.float32():
        values = values.cast(pa.float32(), safe=False).fill_null(np.nan)
    return np.asarray(values.to_numpy(zero_copy_only=False))


def write_recording(path: Path, frames: Iterable[Frame]) -> int:
    """Write frames, of one scan each like the first, as `ParquetRecording` reads them; return their number."""
    writer: pq.ParquetWriter | None = None
    waiting: list[Frame] = []
    count = 0

    def flush() -> None:
        nonlocal writer, waiting
        if not waiting:
            return
        lit = (
            any(f.intensities is not None for f in waiting) if writer is None else "intensities" in writer.schema.names
        )
        table = _table(waiting, lit)
        writer = writer or pq.ParquetWriter(path, table.schema, compression="zstd")
        writer.write_table(table)
        waiting = []

    try:
        for frame in frames:
            waiting.append(frame)
            count += 1
            if len(waiting) == ROWS:
                flush()
        flush()
    finally:
        if writer is not None:
            writer.close()
    return count


def _table(frames: list[Frame], lit: bool) -> pa.Table:
    scan, beams = frames[0].scan, frames[0].scan.beams
    columns: dict[str, pa.Array] = {
        "frame": pa.array([f.number for f in frames], pa.int64()),
        "time": pa.array([f.time for f in frames], pa.float64()),
        "speed": pa.array([f.speed for f in frames], pa.float64()),
    }
    if not all(np.isnan(f.place) for f in frames):
        columns["place"] = pa.array([f.place for f in frames], pa.float64())
    ranges = pa.array(np.concatenate([f.ranges for f in frames]), pa.float32())
    columns["ranges"] = pa.FixedSizeListArray.from_arrays(ranges, beams)
    if frames[0].labels is not None:
        labels = pa.array(np.concatenate([f.labels for f in frames if f.labels is not None]), pa.uint8())
        columns["labels"] = pa.FixedSizeListArray.from_arrays(labels, beams)
    if lit:
        light = [np.full(beams, np.nan, np.float32) if f.intensities is None else f.intensities for f in frames]
        columns["intensities"] = pa.FixedSizeListArray.from_arrays(pa.array(np.concatenate(light), pa.float32()), beams)
    settings = {"angle_min": scan.first, "angle_increment": scan.step, "range_min": scan.range_min}
    settings["range_max"] = scan.range_max
    return pa.table(columns).replace_schema_metadata({k: repr(float(v)) for k, v in settings.items()})
