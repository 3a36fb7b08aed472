"""Parameters of standing water in the terrain, and of breaklines."""

from __future__ import annotations

from pydantic import Field

from fwclass.stage import Params


class WaterParams(Params):
    """Water that is flattened.

    Attributes
    ----------
    file : polygons of standing water (GeoParquet, GeoPackage, GeoJSON, Shapefile), relative to `survey.directory`; null
        for none.
    layer : of the file, where it has several.
    crs : system of the polygons, instead of the one that the file names.
    shore : ground echoes so near to the shoreline, on either side, tell the level [m].
    quantile : of their heights, which is the level.
    least : fewer echoes tell no level.
    stretch : length of the pieces of shoreline whose levels are held against each other [m].
    most_spread : between a tenth and nine tenths of the pieces' levels [m]; beyond it the water is not level, and is
        left as it is.
    """

    file: str | None
    layer: str | None
    crs: str | None
    shore: float = Field(gt=0, le=100)
    quantile: float = Field(ge=0, le=1)
    least: int = Field(ge=1, le=1_000_000)
    stretch: float = Field(ge=1, le=100_000)
    most_spread: float = Field(ge=0, le=1000)


class BreaklineParams(Params):
    """Lines with heights that the terrain passes through.

    Attributes
    ----------
    file : lines (GeoParquet, GeoPackage, GeoJSON, Shapefile), relative to `survey.directory`; null for none.
    layer : of the file, where it has several.
    crs : system of the lines in plan, instead of the one that the file names; heights are the survey's.
    """

    file: str | None
    layer: str | None
    crs: str | None
