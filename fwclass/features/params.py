"""Parameters of the features; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

import math

from pydantic import Field, field_validator, model_validator

from fwclass.params import Params

NORMAL = ("normal_x", "normal_y", "normal_z")

LINEAR, COLLINEAR = "linearity", 0.99
"""Neighbours of a linearity above this, a tenth as wide as long, are a line to radiometry and have no normal: a scan
line, whose own noise would turn it."""


class FeaturesParams(Params):
    """Parameters of the features; which are computed is a list of names, and their scales stand in the names.

    Attributes
    ----------
    also : features that are computed and delivered besides those that the classifier decides by.
    cell_x, cell_y : edges of the cells of `zc` [m].
    normal_radius : sphere whose normals are kept, for radiometry [m]; whole centimetres.
    orientation_rounds : steps of one radius over which the side of a normal spreads from sure ones.
    optimal_radii : spheres that the optimal one is chosen from [m]; whole millimetres.
    nearest_reach : no nearest echo is looked for further away [m].
    pulse_reach : echoes of a pulse further apart in plan are not compared [m].
    noise_counts : echoes that the noise filter takes out are neighbours like all others.
    dense_cell, dense_echoes, dense_step : cubes of this edge [m] with more echoes than this are dense: there one echo
        counts in every small cube of edge `dense_step` [m], which divides `dense_cell`.
    dense_column, dense_in_column : columns of this edge [m], a multiple of `dense_cell`, of which more echoes than this
        would count are dense, too: see `features.dense`.
    """

    also: tuple[str, ...] = Field(max_length=10_000)
    cell_x: float = Field(ge=0.01, le=10_000)
    cell_y: float = Field(ge=0.01, le=10_000)
    normal_radius: float = Field(ge=0.01, le=100)
    orientation_rounds: int = Field(ge=1, le=100)
    optimal_radii: tuple[float, ...] = Field(min_length=2, max_length=100)
    nearest_reach: float = Field(gt=0, le=100)
    pulse_reach: float = Field(gt=0, le=1000)
    noise_counts: bool
    dense_cell: float = Field(ge=0.001, le=10)
    dense_echoes: int = Field(ge=1, le=1_000_000)
    dense_step: float = Field(ge=0.001, le=10)
    dense_column: float = Field(ge=0.001, le=10)
    dense_in_column: int = Field(ge=1, le=1_000_000)

    @field_validator("optimal_radii")
    @classmethod
    def _rising(cls, radii: tuple[float, ...]) -> tuple[float, ...]:
        if min(radii) <= 0 or any(b <= a for a, b in zip(radii, radii[1:], strict=False)):
            raise ValueError("radii must be positive and rise")
        if not all(_is_whole(radius * 1000) for radius in radii):
            raise ValueError("radii must be whole millimetres")
        return radii

    @field_validator("normal_radius")
    @classmethod
    def _whole_centimetres(cls, radius: float) -> float:
        if not _is_whole(radius * 100):
            raise ValueError("must be whole centimetres")
        return radius

    @model_validator(mode="after")
    def _whole_cubes(self) -> FeaturesParams:
        for part, whole in (("dense_step", "dense_cell"), ("dense_cell", "dense_column")):
            ratio = getattr(self, whole) / getattr(self, part)
            if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9:
                raise ValueError(f"{part} must divide {whole}")
        return self


def _is_whole(number: float) -> bool:
    return math.isclose(number, round(number), rel_tol=1e-9)
