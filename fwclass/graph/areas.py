"""Training and test areas: which echoes lie in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.graph.stage import Plan
from fwclass.grid import Box, Tile
from fwclass.schema import Table

IDENTITY_AND_PLACE = ("strip", "pulse", "echo_number", "x", "y")


def within(table: Table, boxes: tuple[Box, ...]) -> NDArray[np.bool_]:
    """Rows that lie in any of `boxes`."""
    inside = np.zeros(table.rows, bool)
    for box in boxes:
        inside |= box.contains(table["x"], table["y"])
    return inside


def tested(table: Table, train: tuple[Box, ...], test: tuple[Box, ...], gap: float) -> NDArray[np.bool_]:
    """Rows to judge on: inside `test` (anywhere if empty), and further than `gap` [m] from every training box."""
    near = within(table, tuple(b.grown(gap) for b in train))
    return ~near & (within(table, test) if test else np.ones(table.rows, bool))


def training_tiles(plan: Plan) -> list[Tile]:
    """Tiles that touch a training area."""
    boxes = plan.config.areas.boxes("train")
    return [t for t in plan.layout.tiles if any(t.box.touches(b) for b in boxes)]


def labelled(plan: Plan) -> bool:
    """The survey has a reference."""
    return plan.config.survey.reference.kind != "none"
