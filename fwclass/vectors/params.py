"""Parameters of building footprints and trees."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from fwclass.params import Params

Code = Annotated[int, Field(ge=1, le=255)]


class FootprintParams(Params):
    """Parameters of building footprints; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    codes : class codes of buildings.
    least_area : of a building, and of a courtyard in one [m²].
    least_height : of a building, by `height_share` of its cells [m].
    height_share : share of a building's cells that its height is not below.
    low : an echo of another class below shows that a cell is no building's [m].
    tolerance : outlines are simplified by so much [cells].
    shortest : shorter walls are taken into their neighbours' [cells].
    agreement : least intersection over union of a simpler outline with the cells.
    furthest : that a simpler outline covers beyond the cells, or leaves out of them, at most [m]; twice the tolerance
        where that is more.
    """

    codes: tuple[Code, ...] = Field(min_length=1)
    least_area: float = Field(ge=1, le=100_000)
    least_height: float = Field(ge=0, le=1000)
    height_share: float = Field(ge=0.5, le=1)
    low: float = Field(gt=0, le=100)
    tolerance: float = Field(ge=0.5, le=20)
    shortest: float = Field(ge=1, le=100)
    agreement: float = Field(ge=0, le=1)
    furthest: float = Field(ge=0, le=100)


class TreeParams(Params):
    """Parameters of trees; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    codes : class codes of vegetation.
    least_height : of a tree [m].
    cell : edge of the cells at least [m].
    least_area, least_echoes : of a crown [m²], and in it.
    smooth : standard deviation that the surface is smoothed by [m].
    pit : radius of the ball that closes pits of the surface [m].
    scale, widest : standard deviation that crowns are looked for at: share of the height, and at most [m].
    narrowest, widening : width of a crown at no height [m], and more of it for a square metre of height [1/m].
    round : share of the directions from a top in which the surface is no higher than its round crown.
    blur : standard deviation that what sticks out of round crowns is smoothed by: share of the height.
    clear : a pulse that ends lower has come through [m].
    around : standard deviation within which the pulses that come through are counted [m].
    beside : that a tree sticks out of round crowns beside it, at least: weighted as `trees.tops_beside` does [m].
    share : of a tree's height that its crown is not lower than.
    spread : from a tree's top to the end of its crown, share of the height.
    reach : from a tree's top to the end of its crown, at most [m].
    """

    codes: tuple[Code, ...] = Field(min_length=1)
    least_height: float = Field(ge=0.5, le=100)
    cell: float = Field(ge=0.05, le=100)
    least_area: float = Field(ge=0, le=10_000)
    least_echoes: int = Field(ge=1, le=1_000_000)
    smooth: float = Field(ge=0.05, le=10)
    pit: float = Field(ge=0.05, le=10)
    scale: float = Field(gt=0, le=1)
    widest: float = Field(ge=0.1, le=10)
    narrowest: float = Field(gt=0, le=20)
    widening: float = Field(ge=0, le=1)
    round: float = Field(ge=0, le=1)
    blur: float = Field(gt=0, le=1)
    clear: float = Field(gt=0, le=100)
    around: float = Field(ge=0.1, le=10)
    beside: float = Field(ge=0.05, le=1000)
    share: float = Field(gt=0, le=1)
    spread: float = Field(gt=0, le=10)
    reach: float = Field(ge=1, le=50)

    def halo(self, cell: float) -> float:
        """What is read around cells of `cell` [m] for the trees whose tops lie in them [m]: their crowns, those beside,
        the round crowns that these stick out of, and what their surface comes from."""
        beside = 2.0 * self.reach + 3.0 * max(self.widest, self.around) + self.narrowest
        return 2.0 * self.reach + beside + 3.0 * (self.widest + self.smooth) + 2.0 * self.pit + 6.0 * cell

    def width(self, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Width of the crown of a tree of some height [m] (Popescu and Wynne 2004, equation 1)."""
        return self.narrowest + self.widening * height**2


class VectorParams(Params):
    """Parameters of all vectors; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    write : vectors are delivered.
    cells : edges that a cell may have, rising; the smallest that is not finer than the spacing of the pulses [m].
    finer : a cell may be finer than the spacing by this factor.
    sparse : pulses per square metre below which outlines are told to be rough.
    square : edge of the squares that pulses are counted in, for their density [m].
    """

    write: bool
    cells: tuple[Annotated[float, Field(ge=0.05, le=100)], ...] = Field(min_length=1)
    finer: float = Field(gt=0, le=1)
    sparse: float = Field(ge=0, le=10_000)
    square: float = Field(ge=0.5, le=1000)
    buildings: FootprintParams
    trees: TreeParams

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if sorted(set(self.cells)) != list(self.cells):
            raise ValueError("cells must rise")
        return self
