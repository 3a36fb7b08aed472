"""What the parameters of every room have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Params(BaseModel):
    """Base of every stage's parameters: frozen, closed, without defaults (the numbers live in `conf/base.yaml`)."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False, allow_inf_nan=False)


class ShapeFileParams(Params):
    """A file of polygons, or of lines with heights, that a survey names.

    Attributes
    ----------
    file : GeoParquet, GeoPackage, GeoJSON or Shapefile, relative to `survey.directory`; null for none.
    layer : of the file, where it has several.
    crs : system of the shapes in plan, instead of the one that the file names; heights are the survey's.
    """

    file: str | None
    layer: str | None
    crs: str | None
