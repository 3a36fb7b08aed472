"""A virtual point cloud: one file that lists the tiles as STAC items, which QGIS and PDAL open as one layer."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyproj

from fwclass.formats.area_of_use import dates
from fwclass.publish.files import write_page
from fwclass.units import GPS_EPOCH, utc_of

STAC = "1.0.0"
"""QGIS reads items of this version and no other."""

EXTENSIONS = (
    "https://stac-extensions.github.io/pointcloud/v1.0.0/schema.json",
    "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
)
DATE_LINE = 180.0
"""Degrees of longitude."""

DIGITS = 6
"""Of figures; as many behind the point of degrees are 0.1 m."""


def write_vpc(
    tiles: Mapping[str, Mapping[str, Any]],
    path: Path,
    crs: pyproj.CRS | None,
    schema: Sequence[Mapping[str, Any]],
    overviews: Mapping[str, Sequence[str]] | None = None,
    overview: str = "",
    *,
    standard_time: bool = False,
) -> dict[str, Any]:
    """Write a list of tiles, sorted by name.

    The date is that of a tile's first echo where GPS times are adjusted standard time; else nothing tells it, and the
    items bear that of GPS time's origin. Without a CRS, or with one that is tied to no place, nothing tells a place on
    the globe: the geometry is in the survey's own coordinates then, which QGIS draws.

    Parameters
    ----------
    tiles : `tile_facts.tile_facts` by path, relative to the directory of `path`.
    schema : dimensions of every tile.
    overviews : by path of a tile thinned files that show it too.
    overview : a thinned file of all tiles, for those that have none of `overviews`, and before the others for the first
        and the last of all: QGIS up to 4.0 takes one alone, later versions take all that any item names.

    Returns a dict with ``path, items, bytes``.
    """
    place = _Place(crs)
    names = sorted(tiles)
    items = []
    for k, name in enumerate(names):
        near, end = list((overviews or {}).get(name, ())), k in (0, len(names) - 1)
        thinned = [overview, *near] if overview and (end or not near) else near
        items.append(_item(name, tiles[name], place, schema, thinned, standard_time, first=k == 0))
    text = json.dumps({"type": "FeatureCollection", "features": items}, separators=(",", ":"), ensure_ascii=False)
    return {"path": str(path), "items": len(items), "bytes": write_page(path, f"{text}\n")}


class _Place:
    """The CRS, and what brings its coordinates to longitude and latitude."""

    def __init__(self, crs: pyproj.CRS | None) -> None:
        self.crs = crs
        self.to_globe = _to_globe(crs) if crs is not None else None
        authority = crs.to_authority() if crs is not None else None
        self.code = ":".join(authority) if authority else None

    def corners(self, bounds: Sequence[float]) -> list[list[float]]:
        x0, y0, _, x1, y1, _ = bounds
        x, y = [x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0]
        if self.to_globe is not None:
            x, y = self.to_globe.transform(x, y)
        return [[round(float(a), DIGITS), round(float(b), DIGITS)] for a, b in zip(x, y, strict=True)]


def _outline(ring: list[list[float]], globe: bool) -> tuple[dict[str, Any], list[float]]:
    """Geometry and box of a tile; one that the date line crosses is cut there, and the box's west is greater than its
    east (RFC 7946, 3.1.9 and 5.2); one around a pole is all that lies no further from it."""
    low, high = np.min(ring, axis=0).tolist(), np.max(ring, axis=0).tolist()
    if globe and high[0] - low[0] > DATE_LINE:
        on = [[x + 2 * DATE_LINE if x < 0 else x, y] for x, y in ring]
        if np.ptp(on, axis=0)[0] > DATE_LINE:
            south, north = (-90.0, high[1]) if high[1] < 0 else (low[1], 90.0)
            cap = [[-DATE_LINE, south], [DATE_LINE, south], [DATE_LINE, north], [-DATE_LINE, north]]
            return {"type": "Polygon", "coordinates": [[*cap, cap[0]]]}, [*cap[0], *cap[2]]
        pieces = [_cut(on, 1.0), [[round(x - 2 * DATE_LINE, DIGITS), y] for x, y in _cut(on, -1.0)]]
        (west, _), (east, _) = np.min(pieces[0], axis=0).tolist(), np.max(pieces[1], axis=0).tolist()
        box = [west, low[1], east, high[1]]
        return {"type": "MultiPolygon", "coordinates": [[piece] for piece in pieces]}, box
    return {"type": "Polygon", "coordinates": [ring]}, [*low, *high]


def _cut(ring: list[list[float]], side: float) -> list[list[float]]:
    """What of a closed convex ring lies to the west of the date line (`side` 1), or to the east (-1)."""
    out: list[list[float]] = []
    for (x, y), (to_x, to_y) in pairwise(ring):
        if side * (x - DATE_LINE) <= 0:
            out.append([x, y])
        if (x - DATE_LINE) * (to_x - DATE_LINE) < 0:
            out.append([DATE_LINE, round(y + (to_y - y) * (DATE_LINE - x) / (to_x - x), DIGITS)])
    return [*out, out[0]]


def _to_globe(crs: pyproj.CRS) -> pyproj.Transformer | None:
    """What brings coordinates to longitude and latitude; None where nothing does, as from a plant's own grid."""
    try:
        return pyproj.Transformer.from_crs(crs, 4326, always_xy=True)
    except pyproj.exceptions.ProjError:
        return None


def _item(
    name: str,
    tile: Mapping[str, Any],
    place: _Place,
    schema: Sequence[Mapping[str, Any]],
    overviews: Sequence[str],
    standard_time: bool,
    first: bool,
) -> dict[str, Any]:
    geometry, box = _outline(place.corners(tile["bounds"]), place.to_globe is not None)
    properties: dict[str, Any] = {
        **_date(tile["times"] if standard_time and tile["times"] and dates(*tile["times"]) else None),
        "pc:count": tile["points"],
        "pc:type": "lidar",
        "pc:encoding": "COPC",
        "pc:schemas": list(schema),
        "pc:statistics": _statistics(tile["figures"], schema, tile["points"]),
        "proj:code": place.code,
        "proj:bbox": tile["bounds"],
    }
    if first and place.crs is not None:  # QGIS takes the CRS of the first item; in each it would double the file
        properties["proj:wkt2"] = place.crs.to_wkt("WKT2_2019")
    assets = {"data": {"href": f"./{name}", "roles": ["data"]}}
    for number, path in enumerate(overviews, 1):
        assets["overview" if number == 1 else f"overview-{number}"] = {"href": f"./{path}", "roles": ["overview"]}
    return {
        "type": "Feature",
        "stac_version": STAC,
        "stac_extensions": list(EXTENSIONS),
        "id": Path(name).name.removesuffix(".copc.laz"),
        "geometry": geometry,
        "bbox": box,
        "properties": properties,
        "links": [],
        "assets": assets,
    }


def _date(times: Sequence[float] | None) -> dict[str, Any]:
    if times is None:
        return {"datetime": _text(GPS_EPOCH)}
    return {"datetime": _text(utc_of(times[0]))}


def _text(time: datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ")


def _statistics(
    figures: Mapping[str, Mapping[str, float]], schema: Sequence[Mapping[str, Any]], points: int
) -> list[dict[str, Any]]:
    """Figures by name; a `count` stands only where some points have no value: thousands of tiles make a long list."""
    names = {field["name"] for field in schema}
    return [
        {
            "name": name,
            **({"count": int(figure["count"])} if figure["count"] != points else {}),
            "minimum": _short(figure["minimum"]),
            "maximum": _short(figure["maximum"]),
            "average": _short(figure["mean"]),
        }
        for name, figure in figures.items()
        if name in names
    ]


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
