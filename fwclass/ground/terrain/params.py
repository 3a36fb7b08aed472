"""Parameters of the terrain's rasters and of the heights above it."""

from __future__ import annotations

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from fwclass.params import Params

MOST_CELLS = 16_384
"""Along the edge of a raster that a part holds: 2 GiB of float64."""

HEIGHTS = ("height_above_ground",)
"""Columns that the terrain gives to echoes."""


class TerrainParams(Params):
    """Parameters of the rasters and heights.

    Attributes
    ----------
    cell : edge of a raster cell [m].
    thin : ground points are averaged by cells of this edge before the TIN is made [m].
    max_gap : distance from a cell with a ground point up to which there is terrain [m].
    dsm_gap : width of the widest gap between cells with an echo that the surface model bridges [m].
    height : height above ground by ``tin``, ``nearest`` ground point or bilinear ``raster``.
    block, block_halo : edge of a block of the fixed global grid, and what is read around it [m].
    """

    cell: float = Field(ge=0.001, le=1000)
    thin: float = Field(ge=0.001)
    max_gap: float = Field(ge=0)
    dsm_gap: float = Field(ge=0)
    height: Literal["tin", "nearest", "raster"]
    block: float = Field(gt=0, le=100_000)
    block_halo: float = Field(ge=0, le=10_000)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for name in ("block", "block_halo"):
            cells = getattr(self, name) / self.cell
            if not math.isclose(cells, round(cells), abs_tol=1e-9):
                raise ValueError(f"{name} must be a whole number of cells of {self.cell} m")
        for name in ("max_gap", "dsm_gap"):
            if getattr(self, name) > self.block_halo:
                raise ValueError(f"{name} must not exceed block_halo: gaps are seen inside a block and its halo")
        if self.block + 2.0 * self.block_halo > MOST_CELLS * min(self.cell, self.thin):
            raise ValueError(f"a block and its halo must not be more than {MOST_CELLS:,} cells (cell, thin) wide")
        return self

    @property
    def largest_circle(self) -> float:
        """Radius of the largest circumcircle of a triangle of the TIN [m].

        A triangle with a larger circle has its middle further than `max_gap` from any ground point, or reaches
        so far that another block, with other points in its halo, might not see the same triangle.
        """
        return min(self.max_gap, self.block_halo / 2.0)
