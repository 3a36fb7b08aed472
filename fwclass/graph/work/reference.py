"""Work of the parts that label by polygons."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from fwclass.graph.layout import PolygonFile
from fwclass.graph.work.tiles import write_labels
from fwclass.grid import Tile
from fwclass.label.polygons import Polygons, from_polygons
from fwclass.label.values import codes_of, groups_of
from fwclass.model import ClassDef
from fwclass.read.polygons import open_polygons, read_polygons, reprojected
from fwclass.run.inputs import PartInputs
from fwclass.schema import Table
from fwclass.store.arrays import read_arrays, write_arrays
from fwclass.waveforms import IMPLAUSIBLE

POLYGONS = "polygons.zarr"


def polygons_read(
    file: PolygonFile,
    field: str,
    values: Mapping[str | int, str | int | None],
    classes: tuple[ClassDef, ...],
    crs: str | None,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Polygons of a file with their codes, in whole millimetres of the survey's system (`crs`, WKT)."""
    path = inputs.local(file.path)
    opened = open_polygons(path, file.layer)
    found, shapes = read_polygons(opened, field)
    codes, counts = codes_of(found, values, classes, f"{file.path}: field {field}")
    moved = ""
    if file.crs is not None and crs is not None:
        shapes, moved = reprojected(shapes, CRS.from_wkt(file.crs), CRS.from_wkt(crs), path)
    made = Polygons.of(shapes, codes, groups_of(codes, classes), path)
    write_arrays(directory / POLYGONS, made.arrays())
    least_x, least_y, most_x, most_y = made.bounds
    return {
        "file": file.path.name,
        "features": opened.features,
        "polygons": made.parts,
        "values": counts,
        "without_code": int((codes < 0).sum()),
        "without_polygon": shapes.empty,
        "invalid": shapes.invalid,
        "reprojected": moved,
        "bounds": [int(v) / 1000 for v in (least_x.min(), least_y.min(), most_x.max(), most_y.max())]
        if made.parts
        else None,
    }


_loaded: dict[tuple[str, ...], Polygons] = {}


def polygons_at(parts: tuple[str, ...], inputs: PartInputs) -> Polygons:
    """Polygons of all files, kept in this process as long as their paths, named by their content, are the same."""
    paths = [inputs.path("polygons", part, POLYGONS) for part in parts]
    key = tuple(map(str, paths))
    if key not in _loaded:
        _loaded.clear()
        _loaded[key] = Polygons.joined([Polygons.from_arrays(read_arrays(path)[0]) for path in paths])
    return _loaded[key]


def labelled_by_polygons(tile: Tile, parts: tuple[str, ...], inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """Reference classes from the polygons that the echoes lie in; implausible echoes have none, whatever is above."""
    chunk = inputs.chunk(tile, 0.0, dict.fromkeys(("x", "y", "fit_flags"), "tile"), (tile.key,))
    table, ambiguous = from_polygons(chunk, polygons_at(parts, inputs).within(tile.box))
    implausible = (chunk.table["fit_flags"][chunk.core] & IMPLAUSIBLE) > 0
    table = Table({"reference": np.where(implausible, 0, table["reference"])})
    return {**write_labels(table, directory), "ambiguous": ambiguous}
