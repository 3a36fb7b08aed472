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
from fwclass.read.laz import varies_chunks
from fwclass.read.source import Source

BLOCK = 200_000
"""Points that a streaming pass holds at a time."""

_BROKEN = (KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError, InputError)

WAVE_FIELDS = DecompressionSelection.XY_RETURNS_CHANNEL | DecompressionSelection.WAVEPACKET
ALL_FIELDS = DecompressionSelection.all()


@contextmanager
def _guarded(source: Source) -> Iterator[None]:
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


class PointReader:
    """Reads any run of points of a source; use it as a context."""

    def __init__(self, source: Source, fields: DecompressionSelection = ALL_FIELDS) -> None:
        self.source = source
        # lazrs seeks to a wrong point where chunks vary in size, and damages waveform formats on writing
        laszip = source.has_waves or (source.compressed and varies_chunks(source.header))
        backend = laspy.LazBackend.Laszip if laszip else laspy.LazBackend.Lazrs
        with _guarded(source):
            self._las = laspy.open(source.path, laz_backend=backend, read_evlrs=False, decompression_selection=fields)

    def __enter__(self) -> PointReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._las.close()

    @property
    def extra_names(self) -> list[str]:
        return list(self._las.header.point_format.extra_dimension_names)

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
        return points

    def blocks(self) -> Iterator[tuple[int, Any]]:
        """(first point, record) of consecutive runs over the whole file."""
        for first in range(0, self.source.n_points, BLOCK):
            yield first, self.read(first, min(first + BLOCK, self.source.n_points))


def coordinates(source: Source, points: Any) -> tuple[NDArray[np.float64], ...]:
    """x, y, z [m] of a laspy record."""
    return tuple(
        np.asarray(points[name], np.float64) * scale + offset
        for name, scale, offset in zip("XYZ", source.scales, source.offsets, strict=True)
    )


def gps_times(source: Source, points: Any) -> NDArray[np.float64]:
    """Time of every point [s]; NaN where the format has none."""
    if source.header.has_gps_time:
        return np.asarray(points["gps_time"], np.float64)
    return np.full(len(points), np.nan)


def extra(points: Any, names: list[str], wanted: str) -> NDArray[np.float32]:
    """Extra byte `wanted` (any case), scaled; NaN where the file has none."""
    name = next((n for n in names if n.strip().lower() == wanted.lower()), None)
    if name is None:
        return np.full(len(points), np.nan, np.float32)
    values = np.asarray(points[name], np.float32)
    return values if values.ndim == 1 else np.full(len(points), np.nan, np.float32)
