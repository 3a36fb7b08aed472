"""Points through laspy, guarded: a damaged file ends in an `InputError`, whatever the decompressor says."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import laspy
import numpy as np
from laspy import DecompressionSelection
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.laszip_input import open_for_laszip
from fwclass.formats.laz import check_written, varies_chunks
from fwclass.read.las import LasSource

BLOCK = 200_000
"""Points that a streaming pass holds at a time."""

ZEROS = 16
"""Points without any value, right on the file's offset, that a block may hold; a page of a disk that was never written
is 4096 bytes, 60 to 200 points."""

FIRST_OF_14, ANGLE_STEP = 6, 0.006
"""Point formats of LAS 1.4, and their unit of scan angles [degrees]; those before have whole degrees."""

_BROKEN = (KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError, InputError)

WAVE_FIELDS = DecompressionSelection.XY_RETURNS_CHANNEL | DecompressionSelection.WAVEPACKET
LINK_FIELDS = WAVE_FIELDS | DecompressionSelection.Z | DecompressionSelection.GPS_TIME
CLASS_FIELDS = DecompressionSelection.XY_RETURNS_CHANNEL | DecompressionSelection.CLASSIFICATION
ALL_FIELDS = DecompressionSelection.all()


@contextmanager
def _guarded(source: LasSource) -> Iterator[None]:
    """Turn whatever laspy, lazrs or LASzip raise into an `InputError`; lazrs panics are no `Exception`."""
    try:
        yield
    except BaseException as error:
        if isinstance(error, _BROKEN):
            raise
        raise InputError(
            "the points cannot be read",
            where=source.path,
            got=f"{type(error).__name__}: {error}",
            do="the file is damaged; copy or export it again",
        ) from error


def flags_of(points: Any) -> NDArray[np.bool_]:
    """bool (points,): the source flags it as withheld or synthetic: no ground was measured there."""
    return np.asarray(points["withheld"], bool) | np.asarray(points["synthetic"], bool)


class PointReader:
    """Reads any run of points of a source; use it as a context."""

    def __init__(self, source: LasSource, fields: DecompressionSelection = ALL_FIELDS) -> None:
        self.source = source
        if source.compressed:
            check_written(source.header)
        # lazrs seeks to a wrong point where chunks vary in size, and damages waveform formats on writing
        laszip = source.has_waves or (source.compressed and varies_chunks(source.header))
        backend = laspy.LazBackend.Laszip if laszip else laspy.LazBackend.Lazrs
        with _guarded(source):
            stream = open_for_laszip(source.path, source.header.vlrs)
            self._las = laspy.open(stream, laz_backend=backend, read_evlrs=False, decompression_selection=fields)

    def __enter__(self) -> PointReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._las.close()

    @property
    def extra_names(self) -> list[str]:
        """Names of the extra bytes."""
        return list(self._las.header.point_format.extra_dimension_names)

    def extra_byte(self, points: Any, *wanted: str) -> NDArray[np.float32]:
        """The first extra byte of the `wanted` names (any case) that the file has, scaled.

        NaN where it holds its declared no-data value, and everywhere if the file has none of them.
        """
        by_name = {n.strip().lower(): n for n in self.extra_names}
        name = next((by_name[w.lower()] for w in wanted if w.lower() in by_name), None)
        with np.errstate(invalid="ignore", over="ignore"):
            values = np.asarray(points[name], np.float32) if name is not None else np.empty((0, 0), np.float32)
        if name is None or values.ndim != 1:
            return np.full(len(points), np.nan, np.float32)
        no_data = self._no_data(name)
        if no_data is not None:
            values = np.where(points.array[name] == no_data, np.float32(np.nan), values)
        return values

    def _no_data(self, name: str) -> Any:
        """The stored number that stands for "no value", None where the file declares none."""
        for record in self._las.header.vlrs.get("ExtraBytesVlr"):
            for one in record.extra_bytes_structs:
                if one.format_name() == name and one.no_data is not None:
                    return one.no_data[0]
        return None

    def read(self, first: int, last: int) -> Any:
        """The laspy record of points [first, last)."""
        with _guarded(self.source):
            if first < last and self._las.points_read != first:
                self._las.seek(first)
            points = self._las.read_points(last - first)
        if len(points) != last - first:
            raise InputError(
                "the file is cut short",
                where=self.source.path,
                expected=f"points {first} to {last} of {self.source.n_points}",
                got=f"{len(points)} points",
                do="copy the file again",
            )
        _check_written(self.source, first, points)
        return points

    def blocks(self) -> Iterator[tuple[int, Any]]:
        """(first point, record) of consecutive runs over the whole file."""
        for first in range(0, self.source.n_points, BLOCK):
            yield first, self.read(first, min(first + BLOCK, self.source.n_points))


def _check_written(source: LasSource, first: int, points: Any) -> None:
    """`InputError` for records of nothing but zeros: parts of a file that were set aside and never written."""
    if source.compressed:
        return
    stored = points.array
    empty = np.flatnonzero((stored["X"] == 0) & (stored["Y"] == 0) & (stored["Z"] == 0))
    if len(empty) > ZEROS:
        rows = np.ascontiguousarray(stored[empty]).view(np.uint8).reshape(len(empty), -1)
        empty = empty[~rows.any(axis=1)]
    if len(empty) > ZEROS:
        raise InputError(
            "a part of the file was never written: its points are nothing but zeros",
            where=source.path,
            expected=f"at most {ZEROS} such points in {len(stored)}",
            got=f"{len(empty)}, the first of them point {first + int(empty[0])}",
            do="wait for the end of the upload, or copy the file again",
        )


def coordinates(source: LasSource, points: Any) -> tuple[NDArray[np.float64], ...]:
    """x, y, z [m] of a laspy record."""
    return tuple(
        np.asarray(points[name], np.float64) * scale + offset
        for name, scale, offset in zip("XYZ", source.scales, source.offsets, strict=True)
    )


def scan_angles(source: LasSource, points: Any) -> NDArray[np.float32]:
    """Angle of every point's beam from the vertical [degrees], as the file has it, float32 (points,)."""
    if source.header.point_format >= FIRST_OF_14:
        return np.asarray(points["scan_angle"], np.float32) * np.float32(ANGLE_STEP)
    return np.asarray(points["scan_angle_rank"], np.float32)


def gps_times(source: LasSource, points: Any) -> NDArray[np.float64]:
    """Time of every point [s]; NaN where the format has none."""
    if source.header.has_gps_time:
        return np.asarray(points["gps_time"], np.float64)
    return np.full(len(points), np.nan)


def classes_of(source: LasSource) -> NDArray[np.uint8]:
    """Class code of every point, uint8 (points,), in the file's order."""
    codes = np.empty(source.n_points, np.uint8)
    with PointReader(source, CLASS_FIELDS) as reader:
        for first in range(0, source.n_points, BLOCK):
            last = min(first + BLOCK, source.n_points)
            codes[first:last] = np.asarray(reader.read(first, last)["classification"], np.uint8)
    return codes
