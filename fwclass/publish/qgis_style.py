"""Styles of QGIS layers as XML: classes in the house's colours and by their names, heights, shares."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as Xml

from fwclass.publish.palette import RGB, colours, css

VERSION = "3.34.0"
"""Of QGIS, whose project format this is; 3.22 reads it too."""

MULTIPLY = 6
"""QGIS's number of that way to mix a layer with what lies below it."""

STRIPS_APART = 0.1
"""m, differences of strips in height that are drawn as the largest; on the page of the quality at least."""

HEIGHTS: tuple[tuple[float, RGB], ...] = (
    (0.0, (68, 1, 84)),
    (0.33, (49, 104, 142)),
    (0.66, (53, 183, 121)),
    (1.0, (253, 231, 37)),
)
SURE: tuple[tuple[float, RGB], ...] = ((0.0, (178, 24, 43)), (0.5, (253, 219, 199)), (1.0, (33, 102, 172)))
MANY: tuple[tuple[float, RGB], ...] = ((0.0, (255, 247, 236)), (0.5, (252, 141, 89)), (1.0, (127, 0, 0)))

Ramp = Sequence[tuple[float, RGB]]
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""What XML cannot hold, and what would turn the direction of a legend's text around."""


def plain_text(text: str) -> str:
    """`text` without control characters and marks of direction; the writer of XML escapes the rest."""
    return _CONTROL.sub("", text)


def add(parent: Xml.Element, tag: str, **attributes: Any) -> Xml.Element:
    """A new element below `parent`, its attributes as text."""
    return Xml.SubElement(parent, tag, {k: plain_text(str(v)) for k, v in attributes.items()})


def add_layer(symbol: Xml.Element, kind: str, settings: Mapping[str, Any]) -> None:
    """What a symbol draws."""
    options = add(add(symbol, "layer", **{"class": kind, "enabled": 1, "locked": 0, "pass": 0}), "Option", type="Map")
    for name, value in settings.items():
        add(options, "Option", name=name, value=value, type="QString")


def rgba(colour: RGB) -> str:
    """A colour as QGIS writes it, opaque."""
    return "{},{},{},255".format(*colour)


def class_raster_style(names: Mapping[int, str], multiply: bool = False) -> list[Xml.Element]:
    """One colour a class, of the classes that there are."""
    pipe, renderer = _raster("paletted")
    palette = add(renderer, "colorPalette")
    for code, colour in _class_colours(names).items():
        add(palette, "paletteEntry", value=code, color=css(colour), label=_label(code, names), alpha=255)
    return [pipe, _blend(multiply)]


def ramp_raster_style(ramp: Ramp, low: float, high: float, unit: str = "", multiply: bool = False) -> list[Xml.Element]:
    """Colours between two values, the ends' beyond them."""
    pipe, renderer = _raster("singlebandpseudocolor", classificationMin=low, classificationMax=high)
    _shader(add(renderer, "rastershader"), ramp, low, high, unit)
    return [pipe, _blend(multiply)]


def grey_raster_style(low: float, high: float) -> list[Xml.Element]:
    """Black to white between two values."""
    pipe, renderer = _raster("singlebandgray", "grayBand", gradient="BlackToWhite")
    stretch = add(renderer, "contrastEnhancement")
    for tag, value in (("minValue", low), ("maxValue", high), ("algorithm", "StretchToMinimumMaximum")):
        add(stretch, tag).text = str(value)
    return [pipe, _blend(False)]


def _raster(kind: str, band: str = "band", **attributes: Any) -> tuple[Xml.Element, Xml.Element]:
    """The pipe of a raster's one band, and its renderer."""
    pipe, shared = Xml.Element("pipe"), {band: 1, "opacity": 1, "alphaBand": -1, "nodataColor": ""}
    return pipe, add(pipe, "rasterrenderer", type=kind, **shared, **attributes)


def _blend(multiply: bool) -> Xml.Element:
    mode = Xml.Element("blendMode")
    mode.text = str(MULTIPLY if multiply else 0)
    return mode


def _shader(parent: Xml.Element, ramp: Ramp, low: float, high: float, unit: str, step: float = 1.0) -> None:
    shader = add(
        parent,
        "colorrampshader",
        colorRampType="INTERPOLATED",
        classificationMode=1,
        clip=0,
        minimumValue=low,
        maximumValue=high,
    )
    for share, colour in ramp:
        value = low + share * (high - low)
        label = f"{value * step:.3g} {unit}".strip()
        add(shader, "item", value=value, label=label, color=css(colour), alpha=255)


def class_cloud_style(names: Mapping[int, str]) -> list[Xml.Element]:
    """Echoes by class; one that is not named is not drawn, and none is left unnamed."""
    renderer = _cloud("classified", "Classification")
    categories = add(renderer, "categories")
    for code, colour in _class_colours(names).items():
        add(categories, "category", value=code, color=rgba(colour), label=_label(code, names), render=1)
    return [renderer]


def ramp_cloud_style(
    attribute: str, ramp: Ramp, low: float, high: float, unit: str = "", step: float = 1.0
) -> list[Xml.Element]:
    """Echoes by the value of an attribute that is stored in units of `step`: QGIS colours by the stored number, the
    legend has the value."""
    renderer = _cloud("ramp", attribute)
    least, most = low / step, high / step
    renderer.set("min", str(least))
    renderer.set("max", str(most))
    _shader(renderer, ramp, least, most, unit, step)
    return [renderer]


def _cloud(kind: str, attribute: str) -> Xml.Element:
    settings = {
        "type": kind,
        "attribute": attribute,
        "pointSize": "1.2",
        "pointSizeUnit": "MM",
        "pointSymbol": "1",
        "maximumScreenError": "0.3",
        "maximumScreenErrorUnit": "MM",
        "drawOrder2d": "1",
        "zoomOutBehavior": "2",  # from afar the overview, not boxes
    }
    return Xml.Element("renderer", settings)


def outline_style(colour: RGB, width: float = 0.4) -> list[Xml.Element]:
    """Empty polygons with an outline."""
    renderer = Xml.Element("renderer-v2", {"type": "singleSymbol"})
    _symbol(add(renderer, "symbols"), "0", None, colour, width)
    return [renderer]


def point_style(colour: RGB, size: float) -> list[Xml.Element]:
    """Points as discs of `size` [mm]."""
    renderer = Xml.Element("renderer-v2", {"type": "singleSymbol"})
    symbol = add(add(renderer, "symbols"), "symbol", type="marker", name="0", alpha=1, clip_to_extent=1, force_rhr=0)
    settings = {"name": "circle", "color": rgba(colour), "outline_style": "no", "size": size, "size_unit": "MM"}
    add_layer(symbol, "SimpleMarker", settings)
    return [renderer]


def graduated_style(attribute: str, ramp: Ramp, edges: Sequence[float]) -> list[Xml.Element]:
    """Polygons filled by the range that an attribute lies in."""
    renderer = Xml.Element(
        "renderer-v2", {"type": "graduatedSymbol", "attr": attribute, "graduatedMethod": "GraduatedColor"}
    )
    ranges, symbols = add(renderer, "ranges"), Xml.Element("symbols")
    pairs = list(zip(edges[:-1], edges[1:], strict=True))
    for k, (low, high) in enumerate(pairs):
        label = f"{low:.2f} to {high:.2f}"
        add(ranges, "range", lower=low, upper=high, symbol=k, label=label, render="true")
        _symbol(symbols, str(k), _between(ramp, k / max(1, len(pairs) - 1)), (90, 90, 90), 0.2)
    renderer.append(symbols)
    return [renderer]


def _between(ramp: Ramp, share: float) -> RGB:
    for (a, one), (b, other) in zip(ramp[:-1], ramp[1:], strict=True):
        if share <= b:
            t = (share - a) / (b - a)
            mixed = [round(p + t * (q - p)) for p, q in zip(one, other, strict=True)]
            return mixed[0], mixed[1], mixed[2]
    return ramp[-1][1]


def _symbol(parent: Xml.Element, name: str, fill: RGB | None, line: RGB, width: float) -> None:
    symbol = add(parent, "symbol", type="fill", name=name, alpha=1, clip_to_extent=1, force_rhr=0)
    settings = {
        "color": rgba(fill or line),
        "style": "solid" if fill else "no",
        "outline_color": rgba(line),
        "outline_style": "solid",
        "outline_width": width,
        "outline_width_unit": "MM",
        "joinstyle": "bevel",
    }
    add_layer(symbol, "SimpleFill", settings)


def _class_colours(names: Mapping[int, str]) -> dict[int, RGB]:
    palette = colours({"name": name, "code": code} for code, name in names.items())
    return dict(sorted(palette.items()))


def _label(code: int, names: Mapping[int, str]) -> str:
    return f"{code} {names[code]}"


def style_file(style: Sequence[Xml.Element], kind: str) -> bytes:
    """A ``.qml`` of a "raster", "vector" or "pointcloud" layer."""
    root = Xml.Element("qgis", {"version": VERSION, "styleCategories": "AllStyleCategories"})
    if kind == "vector":
        root.set("labelsEnabled", str(int(any(part.tag == "labeling" for part in style))))
    root.extend(style)
    return document(root)


def document(root: Xml.Element) -> bytes:
    """An element with QGIS's document type, indented."""
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{text}\n".encode()
