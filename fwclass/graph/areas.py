"""Training and test areas: which echoes lie in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.graph.stage import Plan
from fwclass.grid import Box, Tile
from fwclass.label.corrections import far_from_labels
from fwclass.schema import Table

IDENTITY_AND_PLACE = ("strip", "pulse", "echo_number", "x", "y")


def within(table: Table, boxes: tuple[Box, ...]) -> NDArray[np.bool_]:
    """Rows that lie in any of `boxes`."""
    inside = np.zeros(table.rows, bool)
    if not table.rows:
        return inside
    x, y = table["x"], table["y"]
    around = Box(x.min() - 1.0, y.min() - 1.0, x.max() + 1.0, y.max() + 1.0)
    for box in boxes:
        if box.touches(around):
            inside |= box.contains(x, y)
    return inside


def rows_to_test(
    table: Table, train: tuple[Box, ...], test: tuple[Box, ...], gap: float, taught: Table | None = None
) -> NDArray[np.bool_]:
    """Rows to judge on: inside `test` (anywhere if empty), and further than `gap` [m] from every training box and from
    every correction that the model was `taught`."""
    near = within(table, tuple(b.grown(gap) for b in train))
    rows = ~near & (within(table, test) if test else np.ones(table.rows, bool))
    return rows if taught is None else far_from_labels(table["x"], table["y"], taught, gap, rows)


def training_tiles(plan: Plan) -> list[Tile]:
    """Tiles that touch a training area, or have echoes that were corrected."""
    boxes = plan.config.areas.boxes("train")
    corrected = plan.layout.corrected
    return [t for t in plan.layout.tiles if t.key in corrected or any(t.box.touches(b) for b in boxes)]


def has_reference(plan: Plan) -> bool:
    """Whether the survey has a reference."""
    return plan.config.survey.reference.kind != "none"
