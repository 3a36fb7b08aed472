"""Shapes with attributes as GeoPackage layers: tiles, training and test areas, vectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pyproj
from numpy.typing import NDArray

from fwclass.formats.gdal import write_shapes
from fwclass.publish.files import written_whole
from fwclass.publish.laz import wkt


@dataclass(frozen=True)
class Layer:
    """Shapes of one kind.

    `geometry`: well-known binary, one a row; of boxes by `box_wkb`. `fields`: equal-length columns by name; texts as
    lists of str, numbers as arrays.
    """

    name: str
    geometry: Sequence[bytes]
    fields: Mapping[str, NDArray[Any] | Sequence[str]]
    kind: Literal["Polygon", "Point"] = "Polygon"


def write_gpkg(layers: Sequence[Layer], path: Path, crs: pyproj.CRS | None) -> dict[str, Any]:
    """Write layers into one GeoPackage; the same shapes and fields give the same bytes.

    Returns a dict with ``path, layers, bytes``.
    """
    with written_whole(path) as beside:
        beside.unlink(missing_ok=True)
        for layer in layers:
            system = wkt(crs) if crs is not None else None
            write_shapes(beside, layer.name, layer.geometry, layer.fields, system, layer.kind)
        size = beside.stat().st_size
    return {"path": str(path), "layers": [layer.name for layer in layers], "bytes": size}
