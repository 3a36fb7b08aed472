"""Parameters of standing water in the terrain."""

from __future__ import annotations

from pydantic import Field

from fwclass.params import ShapeFileParams


class WaterParams(ShapeFileParams):
    """Polygons of standing water that is flattened.

    Attributes
    ----------
    shore : ground echoes so near to the shoreline, on either side, tell the level [m].
    quantile : of their heights, which is the level.
    least : fewer echoes tell no level.
    stretch : length of the pieces of shoreline whose levels are held against each other [m].
    most_spread : between a tenth and nine tenths of the pieces' levels [m]; beyond it the water is not level, and is
        left as it is.
    """

    shore: float = Field(gt=0, le=100)
    quantile: float = Field(ge=0, le=1)
    least: int = Field(ge=1, le=1_000_000)
    stretch: float = Field(ge=1, le=100_000)
    most_spread: float = Field(ge=0, le=1000)
