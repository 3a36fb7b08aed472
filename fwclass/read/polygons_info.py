"""What a file of polygons holds: layers, fields, the values of fields that may be a class, and what is wrong."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from fwclass.errors import InputError, visible
from fwclass.formats.crs import describe_crs
from fwclass.formats.flat import HIGHEST, LONGEST
from fwclass.formats.wkb import Shapes
from fwclass.read.polygons import PolygonLayer, check_degrees, layers, open_polygons, read_polygons, values_of

MOST_VALUES = 40
"""A field with more values than this is no class field."""

MOST_FIELDS = 100
"""Fields whose values are counted, and that are listed, the first ones."""

AT_ONCE = 100_000
"""Values that are held at a time, of as many fields as that are; each time is another reading of the file."""

MAX_TABLE = 1_000_000
"""Features of a layer whose values are counted."""


def polygon_info(path: Path) -> dict[str, Any]:
    """Contents and faults of a polygon file as plain data for JSON; of each layer ``values`` has how often a field
    holds which value, but for those with more than `MOST_VALUES`, and those in ``uncounted``.

    `InputError`: the file cannot be read.
    """
    if not path.is_file():
        raise InputError("no such file", where=path, do="check the path")
    contents, faults = [], []
    for name in layers(path):
        about, wrong = _layer(open_polygons(path, name))
        contents.append(about)
        faults += [f"{name}: {fault}" for fault in wrong]
    if not contents:
        faults.append("no layer with geometries")
    return {"path": str(path), "size": path.stat().st_size, "layers": contents, "faults": faults}


def _layer(opened: PolygonLayer) -> tuple[dict[str, Any], list[str]]:
    crs, faults = opened.crs, [*opened.faults]
    if crs is None:
        faults.append("no coordinate system: name one as survey.reference.crs")
    bounds = None
    if 0 < opened.features <= MAX_TABLE:
        try:
            _, shapes = read_polygons(opened, None)
        except InputError as fault:
            faults.append(f"{fault.what} ({fault.where.rsplit(': ', 1)[-1]}: {fault.got})")
        else:
            if shapes.parts:
                x, y = shapes.x, shapes.y
                bounds = [float(x.min()), float(y.min()), float(x.max()), float(y.max())]
                faults += _beside_its_system(shapes, crs)
            if shapes.invalid:
                faults.append(f"{shapes.invalid} polygons with rings that are not closed or have too few points")
            if shapes.empty:
                faults.append(f"{shapes.empty} features without a polygon")
    about = {
        "name": opened.layer,
        "features": opened.features,
        "geometry": opened.geometry,
        "crs": describe_crs(crs),
        "bounds": bounds,
        "fields": dict(opened.fields),
        "values": _values(opened) if 0 < opened.features <= MAX_TABLE else {},
        "uncounted": list(opened.fields)[0 if opened.features > MAX_TABLE else MOST_FIELDS :],
    }
    return about, faults


def _beside_its_system(shapes: Shapes, crs: CRS | None) -> list[str]:
    """Corners in metres where the file speaks of degrees, and the other way round."""
    if crs is None:
        return []
    try:
        check_degrees(shapes, crs, "", "")
    except InputError as fault:
        return [f"{fault.what} ({fault.expected}: {fault.got})"]
    if crs.is_projected and np.abs(shapes.x).max() <= LONGEST and np.abs(shapes.y).max() <= HIGHEST:
        return [f"the coordinates look like degrees, and the file speaks of {crs.name}"]
    return []


def _values(opened: PolygonLayer) -> dict[str, dict[str, int]]:
    """How many features have which value, of the first fields, where they have few of them."""
    by_field, first, step = {}, list(opened.fields)[:MOST_FIELDS], max(1, AT_ONCE // opened.features)
    for k in range(0, len(first), step):
        for field, values in values_of(opened, first[k : k + step]).items():
            counts = Counter("no value" if v is None or v != v else str(v) for v in values)
            if len(counts) <= MOST_VALUES:
                by_field[field] = dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))
    return by_field


def describe_polygons(info: dict[str, Any]) -> str:
    """`polygon_info` for a terminal."""
    rows = [("file", f"{info['path']}  ({info['size']:,} bytes)"), ("format", "polygons")]
    for layer in info["layers"]:
        crs, box = layer["crs"], layer["bounds"]
        code = f" (EPSG:{crs['epsg']})" if crs and crs["epsg"] else ""
        rows += [
            ("layer", f"{layer['name']}: {layer['features']:,} features, {layer['geometry']}"),
            ("CRS", f"{crs['name']}{code}" if crs else "none"),
            ("bounds", "x {0:.10g} to {2:.10g}, y {1:.10g} to {3:.10g}".format(*box) if box else "none"),
        ]
        fields = list(layer["fields"].items())
        for name, kind in fields[:MOST_FIELDS]:
            values = layer["values"].get(name)
            none = "values not counted" if name in layer["uncounted"] else f"more than {MOST_VALUES} values"
            text = ", ".join(f"{v}: {n:,}" for v, n in values.items()) if values else none
            rows.append(("field", f"{name} ({kind})  {text}"))
        if len(fields) > MOST_FIELDS:
            rows.append(("field", f"and {len(fields) - MOST_FIELDS:,} more, whose values are not counted"))
    lines = [f"{name:<12} {visible(text)}" for name, text in rows]
    lines += [f"  ! {visible(fault)}" for fault in info["faults"]] or ["  no faults found"]
    return "\n".join(lines)
