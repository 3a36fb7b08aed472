"""Layers of rectangles and points as GeoPackage."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fwclass.formats.gdal import writing

_RECTANGLE = np.dtype([("order", "u1"), ("kind", "<u4"), ("rings", "<u4"), ("corners", "<u4"), ("xy", "<f8", (5, 2))])
"""A polygon of one ring as well-known binary."""


def rectangles(bounds: ArrayLike) -> NDArray:
    """Well-known binary (n,) of rectangles, whose `bounds` (n, 4) are xmin, ymin, xmax, ymax [m]."""
    low_x, low_y, high_x, high_y = np.asarray(bounds, np.float64).reshape(-1, 4).T
    geometries = np.zeros(len(low_x), _RECTANGLE)
    geometries["order"], geometries["kind"], geometries["rings"], geometries["corners"] = 1, 3, 1, 5
    geometries["xy"][:, :, 0] = np.stack([low_x, high_x, high_x, low_x, low_x], axis=1)
    geometries["xy"][:, :, 1] = np.stack([low_y, low_y, high_y, high_y, low_y], axis=1)
    text, width = geometries.tobytes(), _RECTANGLE.itemsize
    return _objects([text[k : k + width] for k in range(0, len(text), width)])


def points(places: Iterable[tuple[float, float]]) -> NDArray:
    """Well-known binary (n,) of points x, y [m]."""
    return _objects([struct.pack("<BIdd", 1, 1, x, y) for x, y in places])


def write_layer(
    path: Path,
    name: str,
    kind: Literal["Polygon", "Point"],
    shapes: NDArray,
    fields: Mapping[str, Sequence[Any] | NDArray],
    crs: str | None,
) -> None:
    """Add a layer to the GeoPackage at `path`, which is made where it is not there; `crs` as WKT, None for none."""
    values = [v if isinstance(v, np.ndarray) else _values(v) for v in fields.values()]
    place = path.absolute()  # before the current directory changes
    with writing(place) as gdal:
        gdal.raw.write(
            str(place),
            shapes,
            values,
            np.array(list(fields), object),
            layer=name,
            driver="GPKG",
            geometry_type=kind,
            crs=crs,
        )


def _values(values: Sequence[Any]) -> NDArray:
    return np.array(values, object if values and isinstance(values[0], str) else np.int64)


def _objects(items: Sequence[bytes]) -> NDArray:
    """One object for each, which numpy would make text of."""
    return np.array([*items, None], object)[:-1]
