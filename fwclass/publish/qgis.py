"""A QGIS project of a delivery: groups of layers with relative paths; QGIS itself is not needed."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import pyproj

from fwclass.publish.files import written_whole
from fwclass.publish.qgis_style import VERSION, document, plain_text

PROVIDERS = {"raster": "gdal", "vector": "ogr", "pointcloud": "vpc", "copc": "copc"}


@dataclass(frozen=True)
class MapLayer:
    """A layer of the project.

    Attributes
    ----------
    kind : a key of `PROVIDERS`.
    source : path below the project, with ``|layername=…|subset=…`` of a vector layer.
    geometry : of a vector layer, ``Polygon``, ``Line`` or ``Point``.
    shown : drawn when the project opens.
    """

    name: str
    kind: str
    source: str
    style: Sequence[Xml.Element]
    shown: bool = False
    geometry: str = "Polygon"


Groups = Mapping[str, Sequence[MapLayer]]


def write_project(
    title: str, groups: Groups, bounds: Sequence[float], path: Path, crs: pyproj.CRS | None
) -> dict[str, Any]:
    """Write ``.qgz``: layers of `groups`, the first on top, seen in `bounds` (xmin, ymin, xmax, ymax [m]).

    Titles, names and sources may hold any text. The same layers give the same bytes.

    Returns a dict with ``path, layers, bytes``.
    """
    layers = [layer for group in groups.values() for layer in group]
    root = Xml.Element("qgis", {"version": VERSION, "projectname": plain_text(title)})
    _text(root, "title", title)
    root.append(_system("projectCrs", crs))
    root.append(_tree(groups))
    root.append(_canvas(bounds, crs))
    listed = Xml.SubElement(root, "projectlayers")
    for k, layer in enumerate(layers):
        listed.append(_layer(layer, k, crs))
    order = Xml.SubElement(root, "layerorder")
    for k in range(len(layers)):
        Xml.SubElement(order, "layer", {"id": _key(k)})
    settings = Xml.SubElement(root, "properties")
    Xml.SubElement(Xml.SubElement(settings, "Paths"), "Absolute", {"type": "bool"}).text = "false"
    if crs is not None:  # without it QGIS does not look at the project's CRS
        enabled = Xml.SubElement(Xml.SubElement(settings, "SpatialRefSys"), "ProjectionsEnabled", {"type": "int"})
        enabled.text = "1"
    with written_whole(path) as beside:
        with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(zipfile.ZipInfo(f"{path.stem}.qgs"), document(root), zipfile.ZIP_DEFLATED)
        size = beside.stat().st_size
    return {"path": str(path), "layers": len(layers), "bytes": size}


def _key(number: int) -> str:
    return f"fwclass_layer_{number:03d}"  # QGIS makes its own of fewer than eleven letters


def _text(parent: Xml.Element, tag: str, text: str) -> Xml.Element:
    element = Xml.SubElement(parent, tag)
    element.text = plain_text(text)
    return element


def _tree(groups: Groups) -> Xml.Element:
    tree = Xml.Element("layer-tree-group")
    number = 0
    for title, layers in groups.items():
        group = Xml.SubElement(
            tree, "layer-tree-group", {"name": plain_text(title), "checked": "Qt::Checked", "expanded": "1"}
        )
        for layer in layers:
            Xml.SubElement(
                group,
                "layer-tree-layer",
                {
                    "id": _key(number),
                    "name": plain_text(layer.name),
                    "source": plain_text(layer.source),
                    "providerKey": PROVIDERS[layer.kind],
                    "checked": "Qt::Checked" if layer.shown else "Qt::Unchecked",
                    "expanded": "1" if layer.shown else "0",
                },
            )
            number += 1
    return tree


def _layer(layer: MapLayer, number: int, crs: pyproj.CRS | None) -> Xml.Element:
    kind = {"pointcloud": "point-cloud", "copc": "point-cloud"}.get(layer.kind, layer.kind)
    element = Xml.Element("maplayer", {"type": kind, "hasScaleBasedVisibilityFlag": "0"})
    if layer.kind == "vector":
        element.set("geometry", layer.geometry)
        element.set("labelsEnabled", str(int(any(part.tag == "labeling" for part in layer.style))))
    _text(element, "id", _key(number))
    _text(element, "datasource", f"./{layer.source}")
    _text(element, "layername", layer.name)
    element.append(_system("srs", crs))
    provider = _text(element, "provider", PROVIDERS[layer.kind])
    if layer.kind == "vector":
        provider.set("encoding", "UTF-8")
    element.extend(layer.style)
    return element


def _system(tag: str, crs: pyproj.CRS | None) -> Xml.Element:
    element = Xml.Element(tag)
    system = Xml.SubElement(element, "spatialrefsys", {"nativeFormat": "Wkt"})
    if crs is not None:
        authority = crs.to_authority()
        _text(system, "wkt", crs.to_wkt("WKT2_2019"))
        _text(system, "authid", ":".join(authority) if authority else "")
        _text(system, "description", crs.name)
    return element


def _canvas(bounds: Sequence[float], crs: pyproj.CRS | None) -> Xml.Element:
    canvas = Xml.Element("mapcanvas", {"name": "theMapCanvas", "annotationsVisible": "1"})
    _text(canvas, "units", "meters")
    extent = Xml.SubElement(canvas, "extent")
    for tag, value in zip(("xmin", "ymin", "xmax", "ymax"), bounds, strict=True):
        _text(extent, tag, repr(float(value)))
    _text(canvas, "rotation", "0")
    canvas.append(_system("destinationsrs", crs))
    return canvas
