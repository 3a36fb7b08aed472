"""Parameters of the survey's quality; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fwclass.params import Params, ShapeFileParams


class PlaneParams(Params):
    """Where two strips are compared: cells in which both see one flat plane.

    Attributes
    ----------
    cell : edge of the cells [m]; a whole number of them is a block of the terrain.
    least : single echoes of a strip in a cell, at least; fewer show no plane.
    max_residual : root mean square of the echoes from their plane, at most [m].
    max_slope : of either plane, at most [deg].
    slope_cell : edge of the cells in which roofs and slopes tell how far strips lie apart in plan [m]; a whole number
        of them is a block of the terrain.
    steepest : slope of these, at most [deg].
    max_step : planes further apart than this are not one surface, and are counted apart [m].
    most : so many pairs at most are adjusted; of more a fair sample by place is.
    max_tilt_error : a tilt is told only if its standard error moves the strip's edge by less than this [m].
    """

    cell: float = Field(ge=0.1, le=256)
    least: int = Field(ge=4, le=10_000)
    max_residual: float = Field(gt=0, le=10)
    max_slope: float = Field(gt=0, lt=90)
    slope_cell: float = Field(ge=0.1, le=256)
    steepest: float = Field(gt=0, lt=90)
    max_step: float = Field(gt=0, le=1000)
    most: int = Field(ge=1000, le=100_000_000)
    max_tilt_error: float = Field(gt=0, le=100)


class CheckPointParams(Params):
    """Points surveyed on the ground, that the survey's heights are held against.

    Attributes
    ----------
    file : text with x, y, z and, if there is one, a class code, relative to `survey.directory`; null for none.
    crs : system of x and y, where it is not the survey's; heights are the survey's, or in the unit that it names.
    reach : ground echoes so near to a point make the triangle that it is held against [m].
    """

    file: str | None
    crs: str | None
    reach: float = Field(gt=0, le=100)


class QualityParams(Params):
    """What is measured of a survey's quality.

    Attributes
    ----------
    cell : edge of the cells that echoes and pulses are counted in [m]; a whole number of them is a block.
    void_spacings : a void counts from the square of so many mean pulse spacings on.
    strips : what a strip is: each source file (files), each uninterrupted span of GPS time whatever the files (times),
        or files unless these hold several lines each that overlap (auto).
    line_gap : a strip by time ends where there is no echo for one to two times this [s].
    planes : where strips are compared.
    check_points : what heights are held against.
    area : polygons of what was to be covered.
    min_density, min_pulse_density : echoes and pulses per m², at least; None asks for nothing, here and below.
    max_void : area of the largest void, at most [m²].
    max_dz : root mean square difference of strips, at most [m].
    max_offset : in plan between any two strips, at most [m].
    max_noise : share of the echoes, at most.
    min_coverage : share of the area without its gaps, at least.
    max_rmse_z : root mean square difference from the check points, at most [m].
    """

    cell: float = Field(ge=0.1, le=256)
    void_spacings: float = Field(ge=1, le=1000)
    strips: Literal["auto", "files", "times"]
    line_gap: float = Field(ge=0.1, le=100)
    planes: PlaneParams
    check_points: CheckPointParams
    area: ShapeFileParams
    min_density: float | None = Field(gt=0)
    min_pulse_density: float | None = Field(gt=0)
    max_void: float | None = Field(ge=0)
    max_dz: float | None = Field(gt=0)
    max_offset: float | None = Field(gt=0)
    max_noise: float | None = Field(ge=0, le=1)
    min_coverage: float | None = Field(ge=0, le=1)
    max_rmse_z: float | None = Field(gt=0)


THRESHOLDS = frozenset(
    {"min_density", "min_pulse_density", "max_void", "max_dz", "max_offset", "max_noise", "min_coverage", "max_rmse_z"}
)
"""They judge figures, and change none."""
