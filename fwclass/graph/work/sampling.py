"""Work of the parts that count the labels: census, taken."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.graph.work.forest import SAMPLE, tested
from fwclass.grid import Box, Tile
from fwclass.label.census import census, taken
from fwclass.model import ClassDef
from fwclass.run.inputs import PartInputs
from fwclass.schema import canonical_key

_PLACE = dict.fromkeys(("strip", "pulse", "echo_number", "x", "y"), "tile")


def counted(
    tile: Tile,
    train: tuple[Box, ...],
    test: tuple[Box, ...],
    gap: float,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> Mapping[str, Any]:
    """How many of a tile's echoes are labelled as what, and where they lie."""
    table = inputs.rows(tile.key, {"x": "tile", "y": "tile", "reference": "label"})
    return census(table, tested(table, train, test, gap), train, classes)


def drawn(
    tile: Tile, train: tuple[Box, ...], classes: tuple[ClassDef, ...], inputs: PartInputs, directory: Path
) -> Mapping[str, Any]:
    """How many of a tile's echoes are in the survey's sample."""
    table = inputs.rows(tile.key, {**_PLACE, "reference": "label"})
    arrays, _ = inputs.arrays("training", "all", SAMPLE, ("key",))
    return taken(table, np.isin(canonical_key(table), arrays["key"]), train, classes)
