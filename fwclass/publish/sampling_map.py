"""A map of where the labels are: tiles, training areas with a bar of their classes, test areas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.patches import Patch, Rectangle

from fwclass.publish.drawing import HALO, INK, View, draw, frame, legend, outline, png
from fwclass.publish.palette import colours, css

TESTED, PLAIN = "#dfe8ec", "#f6f8f9"
BAR = 0.34
"""Height of a box's bar, as a share of the box."""


def sampling_map(counts: Mapping[str, Any]) -> bytes:
    """PNG of ``report["sampling"]``; the same figures give the same bytes.

    Tiles with tested echoes are tinted. In every training area lies a bar: its width is shared among the classes as
    the rows that train are. A training area without labelled echoes is crossed out.
    """
    view = _view(counts)
    palette = {int(k): css(v) for k, v in colours(counts["classes"]).items()}
    figure, axes = frame(view)
    draw(axes, np.full((1, 1, 3), 255, np.uint8), view)
    for tile in counts["tiles"]:
        x0, y0, x1, y1 = tile["box"]
        face = TESTED if any(tile["test"]) else PLAIN
        axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, facecolor=face, edgecolor="#c3ced6", linewidth=0.5))
    areas = {"train": [b["box"] for b in counts["boxes"]], "test": counts["test_boxes"]}
    for place, box in enumerate(counts["boxes"], 1):
        _box(axes, place, box, counts["classes"], palette)
    handles: list[Any] = [
        Patch(facecolor=palette[int(c["code"])], edgecolor="#00000030", label=c["name"]) for c in counts["classes"]
    ]
    handles.append(Patch(facecolor=TESTED, edgecolor="#c3ced6", label="tested tile"))
    handles += outline(axes, areas, view)
    legend(axes, handles, "Training rows")
    return png(figure)


def _view(counts: Mapping[str, Any]) -> View:
    """The tiles with echoes, and a margin."""
    boxes = np.array([t["box"] for t in counts["tiles"]], float)
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    margin = 0.02 * float((high - low).max())
    wide, tall = (high - low) + 2 * margin
    return View(float(low[0]) - margin, float(low[1]) - margin, 1.0, round(float(wide)), round(float(tall)))


def _box(
    axes: Any, place: int, box: Mapping[str, Any], classes: Sequence[Mapping[str, Any]], palette: Mapping[int, str]
) -> None:
    x0, y0, x1, y1 = box["box"]
    rows = sum(box["taken"]) or sum(box["labelled"])
    counts = box["taken"] if sum(box["taken"]) else box["labelled"]
    if not rows:
        axes.plot([x0, x1], [y0, y1], color=INK, linewidth=1.0, zorder=4)
        axes.plot([x0, x1], [y1, y0], color=INK, linewidth=1.0, zorder=4)
        return
    left, tall = x0 + 0.08 * (x1 - x0), BAR * (y1 - y0)
    bottom, width = y0 + 0.5 * (y1 - y0 - tall), 0.84 * (x1 - x0)
    for one, n in zip(classes, counts, strict=True):
        part = width * n / rows
        axes.add_patch(Rectangle((left, bottom), part, tall, facecolor=palette[int(one["code"])], zorder=4))
        left += part
    axes.annotate(
        str(place),
        (x0, y1),
        (4, -4),
        textcoords="offset points",
        ha="left",
        va="top",
        fontsize=7,
        color=INK,
        path_effects=HALO,
        zorder=6,
        annotation_clip=True,
    )
