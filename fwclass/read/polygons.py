"""Polygons with a class field: GeoParquet, GeoPackage, GeoJSON or Shapefile, in the survey's coordinate system."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from fwclass.errors import ConfigError, InputError, nearest
from fwclass.formats import geoparquet, vector
from fwclass.formats.crs import doubtful_system
from fwclass.formats.wkb import Shapes, lines, shapes

PARQUET = (".parquet", ".geoparquet")
MOST_DEGREES = 361.0
"""No longitude is beyond, with some slack for areas over the date line."""


@dataclass(frozen=True)
class PolygonLayer:
    """A layer of polygons that was opened and found readable.

    `fields`: type by name. `crs`: `pyproj.CRS`, or None where the file names none. `faults`: of how it names it.
    `column`: of the geometries, in GeoParquet.
    """

    path: Path
    layer: str
    fields: Mapping[str, str]
    crs: Any
    faults: tuple[str, ...]
    features: int
    geometry: str
    column: str | None = None

    @property
    def files(self) -> list[Path]:
        """The file and those that belong to it."""
        return vector.files_of(self.path)


def is_polygon_file(path: str | Path) -> bool:
    """By the name's ending."""
    return Path(path).suffix.lower() in (*PARQUET, *vector.FORMATS)


def layers(path: Path) -> list[str]:
    """Names of the file's layers."""
    return [path.stem] if path.suffix.lower() in PARQUET else vector.layers(path)


def open_polygons(path: Path, layer: str | None = None, setting: str = "survey.reference.layer") -> PolygonLayer:
    """Look at a layer without reading its rows; `setting` names it.

    `InputError`: no file of a known format, or one that cannot be read. `ConfigError`: the layer is not there, or has
    to be named.
    """
    if not is_polygon_file(path):
        gpkg, own = (shlex.quote(name) for name in (f"{path.stem}.gpkg", path.name))
        lines_of = "-where \"OGR_GEOMETRY='LINESTRING'\" " if path.suffix.lower() == ".dxf" else ""  # no texts, blocks
        raise InputError(
            "this is no file of polygons or lines that is read",
            where=path,
            expected="GeoParquet, GeoPackage, GeoJSON or Shapefile (.shp)",
            got=path.suffix or "no ending",
            do=f"save it from QGIS as GeoPackage, or ogr2ogr -dim XYZ -a_srs EPSG:<code> {lines_of}{gpkg} {own}",
        )
    if path.suffix.lower() in PARQUET:
        return PolygonLayer(path, **geoparquet.header(path))
    return PolygonLayer(path, **vector.header(path, layer, setting))


def check_field(opened: PolygonLayer, field: str) -> None:
    """`ConfigError` where the layer lacks the class field, `InputError` where it holds nothing."""
    if opened.features == 0:
        raise InputError(
            "the polygon file is empty",
            where=opened.path,
            expected="at least one polygon",
            got="no feature",
            do="check the export of the polygons, and survey.reference.layer",
        )
    if field not in opened.fields:
        raise ConfigError(
            "the polygons have no such field",
            where=f"{opened.path}: survey.reference.field",
            expected=", ".join(opened.fields) or "a field with the class",
            got=field,
            do=nearest(field, opened.fields) if opened.fields else "add a field with the class of every polygon",
        )


NAME_CRS = "--set survey.reference.crs=EPSG:<code>"


def source_crs(
    opened: PolygonLayer,
    configured: CRS | None,
    survey: CRS | None,
    do: str = NAME_CRS,
    say: Callable[[str], None] | None = None,
) -> CRS | None:
    """The system that the polygons' coordinates are in: the one given, else the file's own.

    None where the survey has none either: they are taken as they are. `InputError` where it is unknown, or the file
    names two and there is nobody to `say` so to; `do` says what to do then.
    """
    crs = configured or opened.crs
    if crs is None and survey is not None:
        raise InputError(
            "the coordinate system of the polygons is unknown",
            where=opened.path,
            expected="a CRS in the file" + (", or survey.reference.crs in the configuration" if do == NAME_CRS else ""),
            got="; ".join(opened.faults) or "none",
            do=do,
        )
    doubt = doubtful_system(opened.faults) if configured is None and survey is not None else ""
    if doubt and say is None:
        what, _, got = doubt.partition(", ")
        raise InputError(what, where=opened.path, expected="one", got=got, do=do)
    if doubt and say is not None:
        say(f"note: {opened.path.name}: {doubt}")
    return crs if survey is not None else None


def read_polygons(opened: PolygonLayer, field: str | None) -> tuple[list[Any], Shapes]:
    """Value of `field` of every feature (no values without a field), and the polygons, as the file has them."""
    if opened.column is not None:
        values, geometries = geoparquet.rows(opened.path, opened.column, field)
    else:
        values, geometries = vector.rows(opened.path, opened.layer, field)
    return values, shapes(geometries, opened.path)


def read_lines(opened: PolygonLayer) -> tuple[Shapes, NDArray[np.float64]]:
    """Lines with heights of a layer, and the heights of their points, as the file has them; `InputError` for others."""
    if opened.column is not None:
        geometries = geoparquet.rows(opened.path, opened.column, None)[1]
    else:
        geometries = vector.rows(opened.path, opened.layer, None, flat=False)[1]
    return lines(geometries, opened.path)


def values_of(opened: PolygonLayer, fields: Sequence[str]) -> dict[str, list[Any]]:
    """Values of `fields` of every feature."""
    if opened.column is not None:
        return geoparquet.columns(opened.path, fields)
    return vector.columns(opened.path, opened.layer, fields)


def reproject(shapes: Shapes, source: CRS, target: CRS, where: object, do: str = NAME_CRS) -> tuple[Shapes, str]:
    """`shapes` in `target`, and how it was done in words ("" where nothing had to be).

    Only the corners move: an edge stays straight. `InputError` where a corner has no place in `target`; `do` says what
    to do where they are in another system than `source`.
    """
    check_degrees(shapes, source, where, do)
    if source.equals(target, ignore_axis_order=True) or _flat(source).equals(_flat(target), ignore_axis_order=True):
        return shapes, ""
    try:
        transformer = Transformer.from_crs(_flat(source), _flat(target), always_xy=True)
        x, y = transformer.transform(shapes.x, shapes.y)
    except ProjError as fault:
        raise _no_place_fault(where, 0, str(fault), do) from fault
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    lost = np.flatnonzero(~(np.isfinite(x) & np.isfinite(y)))
    if len(lost):
        ring = int(np.searchsorted(shapes.ring_start, lost[0], "right")) - 1
        part = int(np.searchsorted(shapes.part_start, ring, "right")) - 1
        at = f"{shapes.x[lost[0]]:.10g}, {shapes.y[lost[0]]:.10g}"
        raise _no_place_fault(where, int(shapes.feature[part]) + 1, at, do)
    accuracy = transformer.accuracy
    sure = f", to {accuracy:g} m" if accuracy is not None and accuracy > 0 and math.isfinite(accuracy) else ""
    return replace(shapes, x=x, y=y), f"from {source.name} to {target.name}{sure}"


def _flat(crs: CRS) -> CRS:
    """The horizontal part."""
    return CRS(crs.sub_crs_list[0]) if crs.is_compound else crs.to_2d()


def check_degrees(shapes: Shapes, source: CRS, where: object, do: str) -> None:
    """`InputError` where `source` counts in degrees and the corners are no such numbers; `do` as in `reproject`."""
    if not source.is_geographic or not len(shapes.x):
        return
    most = max(float(np.abs(shapes.x).max()), float(np.abs(shapes.y).max()))
    if most > MOST_DEGREES:
        raise InputError(
            "the polygons' coordinates are not the degrees that the file speaks of",
            where=where,
            expected=f"degrees of {source.name}",
            got=f"coordinates up to {most:.1f}",
            do=f"name the system that they are in: {do}",
        )


def _no_place_fault(where: object, number: int, got: str, do: str) -> InputError:
    return InputError(
        "a polygon cannot be brought into the survey's coordinate system",
        where=f"{where}: feature {number}" if number else where,
        expected="coordinates where both systems are defined",
        got=got,
        do=f"check the file; where its coordinates are in another system: {do}",
    )
