"""Style of contour lines in QGIS: index contours are thicker and bear their height, depressions are dashed."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

from fwclass.publish.qgis_style import add, add_layer, rgba

BROWN = (150, 90, 40)
"""Of the lines, as on topographic maps."""

_THIN, _THICK = 0.15, 0.35
_RULES = (
    ("index contour", '"index_contour" AND NOT "depression"', _THICK, "solid"),
    ("contour", 'NOT "index_contour" AND NOT "depression"', _THIN, "solid"),
    ("index contour of a depression", '"index_contour" AND "depression"', _THICK, "dash"),
    ("contour of a depression", 'NOT "index_contour" AND "depression"', _THIN, "dash"),
)

_FOLLOW = 2
"""QGIS's number of labels along the line."""


def contour_style() -> list[Xml.Element]:
    """Renderer and labels of the layer that `write_contours` writes."""
    renderer = Xml.Element("renderer-v2", {"type": "RuleRenderer"})
    rules, symbols = add(renderer, "rules", key="contours"), add(renderer, "symbols")
    for k, (label, condition, width, line) in enumerate(_RULES):
        add(rules, "rule", key=f"rule-{k}", filter=condition, label=label, symbol=k)
        symbol = add(symbols, "symbol", type="line", name=k, alpha=1, clip_to_extent=1, force_rhr=0)
        settings = {"line_color": rgba(BROWN), "line_style": line, "line_width": width, "line_width_unit": "MM"}
        add_layer(symbol, "SimpleLine", settings)
    labels = Xml.Element("labeling", {"type": "simple"})
    settings_of = add(labels, "settings", calloutType="simple")
    shown = 'CASE WHEN "index_contour" THEN "elevation" END'
    text = add(
        settings_of,
        "text-style",
        fieldName=shown,
        isExpression=1,
        fontSize=7,
        fontSizeUnit="Point",
        textColor=rgba(BROWN),
    )
    add(text, "text-buffer", bufferDraw=1, bufferSize=0.6, bufferSizeUnits="MM", bufferColor=rgba((255, 255, 255)))
    add(settings_of, "placement", placement=_FOLLOW, placementFlags=9, repeatDistance=0)
    return [renderer, labels]
