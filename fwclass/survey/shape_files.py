"""Files of shapes that a survey names beside its strips (water, breaklines, areas), as stages read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pyproj import CRS

from fwclass.formats.wkb import Shapes
from fwclass.read.polygons import open_polygons, read_polygons, reproject
from fwclass.store.remote_file import Location
from fwclass.survey.layout import FileDigests, PolygonFile


def read_shapes(path: Path, crs: str | None, layer: str, own_crs: str | None) -> Shapes:
    """Polygons of a layer of a file (``""``: its only one), in the survey's system.

    `crs`, `own_crs`: the survey's system and theirs, WKT; with None for either they stay where they are.
    """
    shapes = read_polygons(open_polygons(path, layer), None)[1]
    if own_crs is not None and crs is not None:
        shapes, _ = reproject(shapes, CRS.from_wkt(own_crs), CRS.from_wkt(crs), path)
    return shapes


def read_as(file: PolygonFile | None, crs: str | None) -> dict[str, Any]:
    """The survey's system, and the layer and the system that a file of shapes is read in."""
    return {"crs": crs, "layer": file.layer if file else "", "own_crs": file.crs if file else None}


def source_of(file: PolygonFile | None) -> tuple[Location, FileDigests] | None:
    """A file of shapes as the source of its part."""
    return (file.path, file.digests) if file else None
