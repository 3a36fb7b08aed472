"""The squares of the test areas that the page of Shi 2019 draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fwclass.grid import Box
from fwclass.run.inputs import PartInputs
from fwclass.schema import Table
from fwclass.study.papers.facts import Receipts
from fwclass.survey.layout import Layout

Square = tuple[int, int]

COLUMNS = {
    **dict.fromkeys(("x", "y", "z"), "tile"),
    "ground": "ground",
    "height_above_ground": "height",
    "reference": "label",
    "coarse_class": "coarse",
    "classification": "classify",
    "boundary": "refine",
}
SHOWN = 2


def scenes(layout: Layout, receipts: Receipts, inputs: PartInputs) -> list[dict[str, Any]]:
    """Echoes of the squares with most test echoes at the boundary: ``{"place": (xmin, ymin, edge) [m], "echoes"}``."""
    edge = layout.config.papers.block
    counts: dict[Square, int] = {}
    for tile in layout.tiles:
        meta = receipts["paper-layers", tile.key].meta
        for (a, b), matrix in zip(meta["squares"], meta["coarse_boundary"], strict=True):
            counts[a, b] = counts.get((a, b), 0) + int(np.sum(matrix))
    return [_scene(layout, inputs, (a * edge, b * edge, edge)) for a, b in busiest(counts)]


def busiest(counts: Mapping[Square, int]) -> Sequence[Square]:
    """The squares of most echoes, `SHOWN` at most, none beside another and none without any."""
    chosen: list[Square] = []
    for one in sorted((s for s, n in counts.items() if n), key=lambda s: (-counts[s], s)):
        if all(max(abs(one[0] - a), abs(one[1] - b)) > 1 for a, b in chosen):
            chosen.append(one)
    return chosen[:SHOWN]


def _scene(layout: Layout, inputs: PartInputs, place: tuple[float, float, float]) -> dict[str, Any]:
    xmin, ymin, edge = place
    box = Box(xmin, ymin, xmin + edge, ymin + edge)
    parts = []
    for tile in layout.tiles:
        if tile.box.touches(box):
            table = inputs.rows(tile.key, COLUMNS)
            parts.append(table.take(np.flatnonzero(box.contains(table["x"], table["y"]))))
    return {"place": place, "echoes": Table.concat(parts)}
