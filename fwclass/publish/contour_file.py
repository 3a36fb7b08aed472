"""Contour lines as a GeoPackage."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyproj
from numpy.typing import NDArray

from fwclass.formats.gdal import write_shapes
from fwclass.publish.files import written_whole
from fwclass.publish.laz import wkt

LAYER = "contours"

LINE = 2
"""ISO WKB of a line."""


@dataclass(frozen=True)
class Contours:
    """Some contour lines.

    Attributes
    ----------
    vertices : float64 (m, 2), of one line after the other [m].
    count : int64 (n,) of each line.
    elevation : float64 (n,) [m].
    index, depression : bool (n,) an index contour; closed around lower land.
    """

    vertices: NDArray[np.float64]
    count: NDArray[np.int64]
    elevation: NDArray[np.float64]
    index: NDArray[np.bool_]
    depression: NDArray[np.bool_]


def write_contours(path: Path, batches: Iterable[Contours], crs: pyproj.CRS | None) -> None:
    """Write a GeoPackage with one layer of lines, batch by batch; at least one, which may be empty."""
    system = wkt(crs) if crs is not None else None
    with written_whole(path) as beside:
        beside.unlink(missing_ok=True)
        for some in batches:
            fields = {"elevation": some.elevation, "index_contour": some.index, "depression": some.depression}
            write_shapes(beside, LAYER, _wkb(some), fields, system, "LineString")


def _wkb(lines: Contours) -> list[bytes]:
    parts = np.split(np.ascontiguousarray(lines.vertices, "<f8"), np.cumsum(lines.count)[:-1])
    return [struct.pack("<BII", 1, LINE, len(part)) + part.tobytes() for part in parts] if len(lines.count) else []
