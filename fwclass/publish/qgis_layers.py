"""The layers of the project of a delivery, in groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as Xml

from fwclass.publish.contour_file import LAYER
from fwclass.publish.contour_style import contour_style
from fwclass.publish.qgis import MapLayer
from fwclass.publish.qgis_style import (
    HEIGHTS,
    MANY,
    STRIPS_APART,
    SURE,
    Ramp,
    class_cloud_style,
    graduated_style,
    outline_style,
    point_style,
    ramp_cloud_style,
    ramp_raster_style,
)
from fwclass.publish.raster_styles import raster_style
from fwclass.publish.tile_facts import WORTH
from fwclass.schema import column

WORK = 10
"""Tiles of the work list: those with the lowest mean confidence."""

HEIGHT_SHOWN = 25.0
"""m above ground that the colours of echoes reach; a tall tree."""

LEAST_SURE = (0.0, 0.7, 0.8, 0.9, 0.95, 1.0)
"""Edges of the tiles' colours, mean confidence."""

CONTOURS = "contours.gpkg"
OVERVIEW = "laz/overview.copc.laz"

_OF_OVERVIEW = {"confidence": "by confidence", "height_above_ground": "by height above ground"}

_RASTERS = {
    "classes": ("classes", "Maps"),
    "confidence": ("confidence of the classes [%]", "Maps"),
    "density": ("echoes per m²", "Maps"),
    "hillshade": ("shaded relief", "Terrain"),
    "slope": ("slope [°]", "Terrain"),
    "roughness": ("roughness of the ground [m]", "Terrain"),
    "ndsm": ("height of objects [m]", "Terrain"),
    "dsm": ("surface [m]", "Terrain"),
    "dtm": ("terrain [m]", "Terrain"),
    "dtm_mask": ("what the terrain comes from", "Terrain"),
    "dtm_distance": ("distance of the nearest ground echo [m]", "Terrain"),
}

_VECTORS = {
    "buildings": outline_style((150, 40, 10), 0.5),
    "trees": point_style((20, 90, 30), 1.6),
    "crowns": outline_style((40, 130, 60), 0.2),
}

_MARKS = {
    "check_points": ("check points", point_style((20, 20, 20), 2.0), "Point"),
    "voids": ("boxes around the largest voids", outline_style((200, 20, 120), 0.5), "Polygon"),
    "gaps": ("boxes around the largest gaps of the area", outline_style((230, 120, 0), 0.5), "Polygon"),
}


def cloud_styles(names: Mapping[int, str]) -> dict[str, list[Xml.Element]]:
    """Styles of the echoes: by class, confidence and height above ground."""
    return {
        "classes": class_cloud_style(names),
        "confidence": _by_column("confidence", SURE, 1),
        "height_above_ground": _by_column("height_above_ground", HEIGHTS, HEIGHT_SHOWN, "m"),
    }


def _by_column(name: str, ramp: Ramp, high: float, unit: str = "") -> list[Xml.Element]:
    """From zero to `high`."""
    of_column = column(name)
    return ramp_cloud_style(of_column.las, ramp, 0, high, unit, of_column.las_scale)


def layer_groups(
    names: Mapping[int, str],
    columns: Sequence[str],
    ranges: Mapping[str, Mapping[str, Sequence[float]]],
    polygons: Sequence[str],
    whole: str,
    vectors: Sequence[str] = (),
    contours: bool = False,
    overview: bool = True,
    quality: Sequence[str] | None = None,
) -> dict[str, list[MapLayer]]:
    """Groups of layers, the first on top.

    Parameters
    ----------
    names : classes that there are, by code.
    columns : of the tiles.
    ranges : of the rasters of every site; those of the site `whole` lie at the top. Without one of ``confidence``
        nothing shows how sure the classes are.
    polygons : layers of ``tiles.gpkg``.
    vectors : layers of ``vectors.gpkg``.
    contours : there are contour lines.
    overview : there is an overview of all echoes. Confidence and height are those of its echoes: QGIS cannot read extra
        bytes of a list of tiles (it takes all of them for eight bytes), of a single file it can.
    quality : layers of ``quality.gpkg``, None where there are no rasters of the survey's quality either.
    """
    styles, sure = cloud_styles(names), any("confidence" in of_site for of_site in ranges.values())
    echoes = [MapLayer("by class", "pointcloud", "laz/survey.vpc", styles["classes"], shown=True)]
    echoes += [
        MapLayer(title, "copc", OVERVIEW, styles[name])
        for name, title in _OF_OVERVIEW.items()
        if overview and name in columns and (sure or name != "confidence")
    ]
    kinds = {name: "Point" if name == "trees" else "Polygon" for name in vectors}
    shapes = [
        MapLayer(name, "vector", f"vectors.gpkg|layername={name}", _VECTORS[name], name != "crowns", kind)
        for name, kind in kinds.items()
    ]
    groups = {"Echoes": echoes, **({"Vectors": shapes} if shapes else {}), "Tiles": _polygons(polygons, sure)}
    groups |= {"Maps": [], "Terrain": []}
    if contours:
        source = f"{CONTOURS}|layername={LAYER}"
        groups["Terrain"].append(MapLayer("contours", "vector", source, contour_style(), True, "Line"))
    if quality:
        groups["Quality"] = [
            MapLayer(title, "vector", f"quality.gpkg|layername={name}", style, True, geometry)
            for name, (title, style, geometry) in _MARKS.items()
            if name in quality
        ]
    for site, site_ranges in ranges.items():
        where, more = ("rasters", "") if site == whole else (f"rasters/{site}", f", {site}")
        for name, (title, group) in _RASTERS.items():
            if name == "confidence" and name not in site_ranges:
                continue
            style = raster_style(name, site_ranges, names, multiply=group == "Maps")
            shown = name in ("classes", "hillshade")
            groups[group].append(MapLayer(title + more, "raster", f"{where}/{name}.tif", style, shown))
        if quality is not None:  # pulses in the colours of echoes: both compare
            low, high = site_ranges["density"]
            ramps = {
                "pulse_density": ("pulses per m²", ramp_raster_style(MANY, low, high, "pulses/m²")),
                "strip_dz": ("strips apart in height [m]", ramp_raster_style(MANY, 0, STRIPS_APART, "m")),
            }
            for name, (title, style) in ramps.items():
                layer = MapLayer(title + more, "raster", f"{where}/{name}.tif", style)
                groups.setdefault("Quality", []).append(layer)
    return groups


def _polygons(layers: Sequence[str], sure: bool) -> list[MapLayer]:
    map_layers = []
    if "areas" in layers:
        map_layers.append(
            MapLayer("training and test areas", "vector", _source("areas"), outline_style((220, 30, 90), 0.6))
        )
    work = f'{_source("tiles")}|subset="rank" <= {WORK} AND "echoes" >= {WORTH}'
    if sure:
        style = graduated_style("confidence", SURE, LEAST_SURE)
        map_layers.append(MapLayer("work list: least sure tiles", "vector", work, style))
    map_layers.append(MapLayer("tile grid", "vector", _source("tiles"), outline_style((70, 70, 70), 0.3), shown=True))
    return map_layers


def _source(layer: str) -> str:
    return f"tiles.gpkg|layername={layer}"
