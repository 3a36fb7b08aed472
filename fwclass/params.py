"""What the parameters of every room have in common."""

from __future__ import annotations

from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator


class Params(BaseModel):
    """Base of every stage's parameters: frozen, closed, without defaults (the numbers live in `conf/base.yaml`)."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False, allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _check_bool(cls, value: Any, info: ValidationInfo) -> Any:
        """True would be the number 1, in lists, too."""
        if _holds_bool(value) and not _takes_bool(cls.model_fields[str(info.field_name)].annotation):
            raise ValueError("neither true nor false can stand here")
        return value


def _holds_bool(value: Any) -> bool:
    return isinstance(value, bool) or (isinstance(value, (list, tuple)) and any(map(_holds_bool, value)))


def _takes_bool(kind: Any) -> bool:
    named = get_origin(kind) is Literal and any(isinstance(v, bool) for v in get_args(kind))
    return (
        named
        or kind in (bool, Any)
        or any(_takes_bool(of) for of in (*get_args(kind), getattr(kind, "__value__", None)) if of)
    )


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
