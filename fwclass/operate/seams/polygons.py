"""What was computed once more as polygons, and the echoes that differ as points: a GeoPackage."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import ConfigError
from fwclass.formats.gdal import offline
from fwclass.grid import Box
from fwclass.operate.seams.summary import Found
from fwclass.store.atomic import move_into_place, staged


def check_free(path: Path, overwrite: bool) -> None:
    """`ConfigError` where there is a file that may not be replaced."""
    if path.exists() and not overwrite:
        raise ConfigError("there is such a file already", where=path, do="--overwrite, or another name")


def write_gpkg(found: Found, path: Path, crs: str | None) -> None:
    """Layers ``strips`` and, where there are any, ``echoes``.

    Strips lie along the borders; ``part`` is the tile of the shifted grid, ``differ`` how many of its echoes do, in the
    stage with most of them. Echoes are those listed: stage, column, the run's value and the other.
    """
    shapes: list[bytes] = []
    fields: dict[str, list[Any]] = {"part": [], "differ": []}
    tiles = [s for s in found.bounded if s.parts == "tile"]
    for place in found.strips:
        wrong = max((s.at.get(place.tile.key, (0, 0))[1] for s in tiles), default=0)
        for strip in place.strips:
            shapes.append(_polygon(strip))
            fields["part"].append(place.tile.key)
            fields["differ"].append(wrong)
    listed = [{"stage": s.stage, **e} for s in found.bounded for e in s.examples]
    path.parent.mkdir(parents=True, exist_ok=True)
    with staged(path.parent) as directory:
        _layer(directory / path.name, "strips", "Polygon", shapes, fields, crs)
        if listed:
            points = [struct.pack("<BIdd", 1, 1, e["x"], e["y"]) for e in listed]
            names = ("stage", "part", "strip", "pulse", "echo_number", "column")
            told: dict[str, list[Any]] = {n: [e[n] for e in listed] for n in names}
            told |= {n: [str(e[n]) for e in listed] for n in ("run", "shifted")}
            _layer(directory / path.name, "echoes", "Point", points, told, crs)
        move_into_place(directory / path.name, path)


def _polygon(box: Box) -> bytes:
    """Well-known binary of a rectangle."""
    x0, y0, x1, y1 = box.bounds
    return struct.pack("<BIII10d", 1, 3, 1, 5, x0, y0, x1, y0, x1, y1, x0, y1, x0, y0)


def _layer(
    path: Path, name: str, kind: str, shapes: Sequence[bytes], fields: Mapping[str, Sequence[Any]], crs: str | None
) -> None:
    values = [np.array(v, object if isinstance(v[0], str) else np.int64) for v in fields.values()]
    place = str(path.absolute())
    with offline() as gdal:
        gdal.raw.write(
            place,
            np.array([*shapes, None], object)[:-1],
            values,
            np.array(list(fields), object),
            layer=name,
            driver="GPKG",
            geometry_type=kind,
            crs=crs,
        )
