"""What one block of the fixed grid says of a survey's quality: counts by cell, pieces of strips, pairs of planes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box, Window, millimetres, whole_millimetres
from fwclass.quality.offsets import SlopePairs, slope_pairs
from fwclass.quality.params import QualityParams
from fwclass.quality.pieces import Pieces, pieces_of
from fwclass.quality.planes import PlanePairs, border_steps, low_steps, plane_pairs, planes_of
from fwclass.quality.roughness import ROUGHEST, count_roughness
from fwclass.schema import Table

READS = ("x", "y", "z", "strip", "gps_time", "echo_number", "number_of_echoes", "noise")
"""Columns of echoes that quality is measured by."""


BORDERS = ("border_first", "border_second", "border_step")
"""Arrays of `border_steps`."""

LOWS = ("low_first", "low_second", "low_step")
"""Arrays of `low_steps`."""


@dataclass(frozen=True)
class BlockQuality:
    """What a block holds, noise left out.

    Attributes
    ----------
    echoes, pulses : in every cell of `quality.cell`, uint32 (rows, columns), row 0 in the south; a pulse counts where
        its first echo lies.
    noise : echoes that are noise.
    pieces, pairs : of its strips.
    borders : files beside each other, and the steps between them (`planes.border_steps`).
    lows : pieces in one cell, and the steps between their lowest echoes (`planes.low_steps`).
    slopes : steep planes that two pieces see.
    roughness : places of every class of `roughness.EDGES`, int64.
    """

    echoes: NDArray[np.uint32]
    pulses: NDArray[np.uint32]
    noise: int
    pieces: Pieces
    pairs: PlanePairs
    borders: tuple[NDArray, NDArray, NDArray]
    lows: tuple[NDArray, NDArray, NDArray]
    slopes: SlopePairs
    roughness: NDArray[np.int64]

    def arrays(self) -> dict[str, NDArray]:
        """Pieces, (pieces,) each, pairs, (pairs,) each, and steps, (steps,) each, by name as a store keeps them."""
        return {
            **vars(self.pieces),
            **{f"pair_{name}": values for name, values in vars(self.pairs).items()},
            **{f"slope_{name}": values for name, values in vars(self.slopes).items()},
            "roughness": self.roughness,
            **dict(zip((*BORDERS, *LOWS), (*self.borders, *self.lows), strict=True)),
        }

    def between(self) -> tuple[int, int]:
        """Pairs of different files, and pairs of one file flown apart: at least one span of time lies between."""
        file, span, one, other = self.pieces.file, self.pieces.span, self.pairs.first, self.pairs.second
        differs = file[one] != file[other]
        apart = ~differs & (np.abs(span[one] - span[other]) > 1)
        return int(differs.sum()), int(apart.sum())


def pieces_from(arrays: Mapping[str, NDArray]) -> Pieces:
    """The pieces of `BlockQuality.arrays`, (pieces,) each."""
    return Pieces(**{name: arrays[name] for name in Pieces.__dataclass_fields__})


def pairs_from(arrays: Mapping[str, NDArray]) -> PlanePairs:
    """The pairs of `BlockQuality.arrays`, (pairs,) each."""
    return PlanePairs(**{name: arrays[f"pair_{name}"] for name in PlanePairs.__dataclass_fields__})


def block_quality(table: Table, box: Box, params: QualityParams) -> BlockQuality:
    """The quality of the echoes (columns `READS`, places [m], times [s]) of the block that covers `box` [m]."""
    sound = table.take(~table["noise"])
    window = Window.covering(box, params.cell)
    x, y = sound["x"], sound["y"]
    mm = whole_millimetres(window.cell, "quality.cell")
    cell = (millimetres(y) // mm - window.row) * window.ncols + (millimetres(x) // mm - window.col)
    first = sound["echo_number"] == 1
    size = window.ncols * window.nrows
    echoes, pulses = (
        np.bincount(some, minlength=size).astype(np.uint32).reshape(window.shape) for some in (cell, cell[first])
    )
    pieces, number = pieces_of(x, y, sound["gps_time"], sound["strip"], (box.xmin, box.ymin), params.line_gap)
    alone = np.flatnonzero(sound["number_of_echoes"] == 1)
    cells = Window.covering(box, params.planes.cell)
    single = x[alone], y[alone], sound["z"][alone], number[alone]
    level = planes_of(*single, cells, params.planes.model_copy(update={"max_residual": ROUGHEST}))
    planes = level.smooth(params.planes.max_residual)
    steep = params.planes.model_copy(update={"max_slope": params.planes.steepest})
    slopes = slope_pairs(
        planes_of(*single, Window.covering(box, params.planes.slope_cell), steep), params.planes.max_slope
    )
    steps = border_steps(planes, pieces.file)
    lows = low_steps(x, y, sound["z"], number, cells, params.planes.least)
    noise = table.rows - sound.rows
    rough = count_roughness(level.residual)
    return BlockQuality(echoes, pulses, noise, pieces, plane_pairs(planes), steps, lows, slopes, rough)
