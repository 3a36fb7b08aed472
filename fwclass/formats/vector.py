"""GeoPackage, GeoJSON and Shapefile through GDAL: layers, fields, and the rows of one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import ConfigError, InputError, first_line, nearest, set_words
from fwclass.formats.gdal import offline
from fwclass.formats.polygon_magic import check_format
from fwclass.formats.polygon_systems import system_named
from fwclass.paths import BESIDE

FORMATS = {".gpkg": "GeoPackage", ".geojson": "GeoJSON", ".json": "GeoJSON", ".shp": "Shapefile"}
MOST_FIELDS = 4096
"""Fields of a layer: the time to read one of them grows with the square of their number."""

Header = dict[str, Any]
"""``layer, fields {name: type}, crs, faults, features, geometry`` of a layer; faults are of how its system is named."""


def layers(path: Path) -> list[str]:
    """Names of the layers that hold geometries; `InputError` for a file that cannot be read or is cut short."""
    check_format(path)
    names = _query(path, lambda gdal, place: gdal.list_layers(place))
    return [str(name) for name, kind in names if kind is not None]


def _query(path: Path, question: Callable[[Any, Path], Any]) -> Any:
    """What GDAL says of `path`; `InputError` where it finds a fault."""
    place = path.absolute()
    with offline() as gdal:
        try:
            return question(gdal, place)
        except Exception as fault:  # pyogrio's errors share no base that it exports
            raise _unreadable(path, fault) from fault


def header(path: Path, layer: str | None, setting: str = "survey.reference.layer") -> Header:
    """What a layer holds; `layer`, which `setting` names, None takes the only one.

    `InputError`: the file cannot be read or holds no layer. `ConfigError`: no such layer, or several and none is named.
    """
    names = layers(path)
    if not names:
        raise InputError("the file holds no layer with geometries", where=path, do="check the export of the polygons")
    if layer is None and len(names) > 1:
        raise ConfigError(
            "the file has several layers",
            where=path,
            expected=f"one, or {setting}",
            got=", ".join(names),
            do=set_words(setting, names[0]),
        )
    if layer is not None and layer not in names:
        raise ConfigError(
            "the file has no such layer", where=path, expected=", ".join(names), got=layer, do=nearest(layer, names)
        )
    chosen = layer or names[0]
    about = _query(path, lambda gdal, place: gdal.read_info(place, layer=chosen, force_feature_count=True))
    if len(about["fields"]) > MOST_FIELDS:
        raise InputError(
            "a layer of more fields than any has",
            where=f"{path}: layer {chosen}",
            expected=f"at most {MOST_FIELDS:,}",
            got=f"{len(about['fields']):,}",
            do="export the polygons with the field of their classes alone",
        )
    types = [str(np.dtype(t)) if t != "object" else "text" for t in about["dtypes"]]
    crs, faults = system_named(path, chosen, about["crs"])
    return {
        "layer": chosen,
        "fields": dict(zip(map(str, about["fields"]), types, strict=True)),
        "crs": crs,
        "faults": faults,
        "features": int(about["features"]),
        "geometry": str(about["geometry_type"]),
    }


def rows(path: Path, layer: str, field: str | None, flat: bool = True) -> tuple[list[Any], list[bytes | None]]:
    """Values of a field and geometries as well-known binary, in the file's order; no values without a field, and no
    heights where they are to be `flat`."""
    columns = [field] if field else []
    _, _, geometries, fields, *_ = _query(
        path, lambda gdal, place: gdal.raw.read(place, layer=layer, columns=columns, force_2d=flat)
    )
    values = fields[0].tolist() if field else []
    return values, list(geometries)


def columns(path: Path, layer: str, fields: Sequence[str]) -> dict[str, list[Any]]:
    """Values of fields, in the file's order; all are read at once."""
    read = _query(path, lambda gdal, place: gdal.raw.read(place, layer=layer, columns=fields, read_geometry=False))
    return {str(name): values.tolist() for name, values in zip(read[0]["fields"], read[3], strict=True)}


def files_of(path: Path) -> list[Path]:
    """The file and those that belong to it."""
    if path.suffix.lower() != ".shp":
        return [path]
    beside = [q for q in sorted(path.parent.glob("*")) if q.stem == path.stem and q.suffix.lower() in BESIDE[".shp"]]
    return [path, *beside]


def _unreadable(path: Path, fault: Exception) -> InputError:
    return InputError(
        "the polygon file cannot be read",
        where=path,
        expected=f"a {FORMATS.get(path.suffix.lower(), 'polygon file')}",
        got=first_line(fault),
        do="open it in a GIS and export it again; a Shapefile needs its .shx and .dbf beside it",
    )
